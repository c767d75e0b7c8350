"""The result of one pair: S* with weights, states and uncertainty."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion.body import Body
from fusion.rigid import RigidTransform
from fusion.support.large_arrays import Rows


@dataclass(frozen=True, eq=False)
class FusedFrame:
    """S* of one pair, with the figures that explain it.

    Attributes:
        positions: (J, 3) metres, in K_A's frame; all NaN if neither sensor sees a person.
        predicted: (J,) whether a joint has no data, so that only its bones and earlier frames place it.
        weights_a, weights_b: (J,) each view's share in a joint; both 0 if predicted. With the paper's
            methods these are w^A and w^B of eq. (11), otherwise shares of the information.
        misleading_joint: (J,) the misleading joint m of sec. 3; -1 if there is none.
        a_from_b: R and t by which S_B was transformed.
        iterations: Iterations of the solver.
        stale_a, stale_b: Whether the sensor's skeleton repeats its previous one.
        time_ns: The pair's time.
        sigma: (J,) metres, one standard deviation of a joint's distance to the truth: the square root of the
            covariance's trace; None with the paper's methods, which do not estimate it.
        covariance: (J, 3, 3) m², of each joint; None likewise.
        exchanged_a, exchanged_b: Which sides of the view were exchanged: bit 0 arms, bit 1 legs, 3 the whole
            body; bit 2 if the trunk is not exchanged with them (:mod:`fusion.facing.model`).
        doubt_a, doubt_b: Probability that the sides of the view are still wrong.
        heading: (3,) direction in which the person faces, normal to the line from the ankles to the
            shoulders, in K_A's frame; its length, from 0 to 1, is the confidence. NaN if it is unknown; None
            with the paper's methods.
        velocities: (J, 3) m/s; None with the paper's methods.
    """

    positions: NDArray[np.float64]
    predicted: NDArray[np.bool_]
    weights_a: NDArray[np.float64]
    weights_b: NDArray[np.float64]
    misleading_joint: NDArray[np.int64]
    a_from_b: RigidTransform
    iterations: int
    stale_a: bool
    stale_b: bool
    time_ns: int
    sigma: NDArray[np.float64] | None = None
    covariance: NDArray[np.float64] | None = None
    exchanged_a: int = 0
    exchanged_b: int = 0
    doubt_a: float = 0.0
    doubt_b: float = 0.0
    heading: NDArray[np.float64] | None = None
    velocities: NDArray[np.float64] | None = None

    @property
    def has_person(self) -> bool:
        """Whether there is an S*."""
        return bool(np.isfinite(self.positions[0, 0]))

    def predicted_for(self, body: Body, seconds: float) -> FusedFrame:
        """This frame extrapolated in time: joints keep their velocities, and bones their lengths."""
        if self.velocities is None or not self.has_person:
            return self
        moved = self.positions + seconds * self.velocities
        later = moved.copy()
        for joint in body.order[1:]:
            parent = body.parents[joint]
            length = np.linalg.norm(self.positions[joint] - self.positions[parent])
            bone = moved[joint] - moved[parent]
            later[joint] = later[parent] + bone * (length / max(float(np.linalg.norm(bone)), 1e-9))
        return replace(self, positions=later, time_ns=self.time_ns + round(1e9 * seconds))


class FusedFrames(Rows[FusedFrame]):
    """The results of T pairs.

    The attributes are those of :class:`FusedFrame`, as arrays of T rows; its default where there is none.

    Args:
        results: Of a method, a NamedTuple whose arrays are named as these attributes.
        a_from_b: By which S_B was transformed: one t for all pairs, or (T, 3).
        time_ns: (T,) the pairs' times.
    """

    def __init__(self, results: Any, a_from_b: RigidTransform, time_ns: NDArray[np.int64]) -> None:
        named = zip(results._fields, results, strict=True)
        self._results = {name: values for name, values in named if name in _NAMES}
        self._a_from_b, self.time_ns = a_from_b, time_ns

    def __getattr__(self, name: str) -> Any:
        """The results of that name."""
        if name not in _NAMES:
            raise AttributeError(name)
        return self._results.get(name, getattr(FusedFrame, name, None))

    @property
    def a_from_b(self) -> RigidTransform:
        """(T, 3, 3) R and (T, 3) t."""
        rotation, translation = self._a_from_b.rotation, self._a_from_b.translation
        T = len(self)
        return RigidTransform(np.broadcast_to(rotation, (T, 3, 3)), np.broadcast_to(translation, (T, 3)))

    def __len__(self) -> int:
        """The number of frames T."""
        return len(self.time_ns)

    def row(self, k: int) -> FusedFrame:
        """The result of pair k."""
        rows = {name: values[k] for name, values in self._results.items()}
        values = {name: row.item() if isinstance(row, np.generic) else row for name, row in rows.items()}
        a_from_b = self._a_from_b
        if a_from_b.translation.ndim > 1:
            a_from_b = RigidTransform(a_from_b.rotation, a_from_b.translation[k])
        return FusedFrame(a_from_b=a_from_b, time_ns=int(self.time_ns[k]), **values)


_NAMES = {field.name for field in fields(FusedFrame)}
