"""Arrays over the frames of a session that belong together, by name."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from fusion.body import Body
from fusion.support.read_only import ReadOnlyArrays
from recordings.errors import UnknownNameError

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation


class _Series(ReadOnlyArrays):
    """Arrays over the frames of a session."""

    def __repr__(self) -> str:
        names = (each.name for each in fields(self))  # type: ignore[arg-type]
        return f"<{type(self).__name__}: {', '.join(names)}>"


@dataclass(frozen=True, eq=False, repr=False)
class SkeletonSeries(_Series):
    """S_A or S_B over T frames of J joints, as given by the sensor.

    Attributes:
        positions: (T, J, 3) float32 metres in the sensor's own frame; NaN without a skeleton.
        states: (T, J) uint8, 0 not tracked, 1 inferred, 2 tracked.
        weights: (T, J) float32, this view's share of the information; w of eq. (11) with the paper's methods.
        captured_ns: (T,) time on the sensor's clock; :data:`recordings.data.layout.NO_FRAME` if it gave
            no frame.
        stale: (T,) whether the sensor repeated its last skeleton.
    """

    positions: NDArray[np.float32]
    states: NDArray[np.uint8]
    weights: NDArray[np.float32]
    captured_ns: NDArray[np.int64]
    stale: NDArray[np.bool_]


@dataclass(frozen=True, eq=False, repr=False)
class QualitySeries(_Series):
    """Quality figures of T frames.

    Attributes:
        bone_error: (T,) largest absolute error of a bone length of S*, metres; NaN without S*.
        disagreement: (T,) median distance between p and R q + t, metres; NaN if no joint is in both views.
        skew_ns: (T,) capture time of B minus capture time of A; 0 if only one of them gave a frame.
        fuse_ms: (T,) duration of the fusion, milliseconds.
        iterations: (T,) iterations of the solver.
        predicted: (T, J) whether a joint of S* has no data.
    """

    bone_error: NDArray[np.float64]
    disagreement: NDArray[np.float64]
    skew_ns: NDArray[np.int64]
    fuse_ms: NDArray[np.float64]
    iterations: NDArray[np.int64]
    predicted: NDArray[np.bool_]


@dataclass(frozen=True, eq=False, repr=False)
class AngleSeries(_Series, dict[str, NDArray[np.float64]]):
    """Joint angles of S* over T frames; see :mod:`fusion.movement.angles` for their definitions.

    A dictionary that cannot be changed, as pandas and polars take it: ``pandas.DataFrame(session.angles)``.
    ``angles["knee_flexion_left"]`` is (T,) degrees. Another name raises
    :class:`recordings.errors.UnknownNameError`, which lists all names.

    Attributes:
        names: The K angles.
        degrees: (T, K); NaN where a joint is missing.
        sigma: (T, K) degrees, one standard deviation; NaN with the paper's methods.
    """

    names: tuple[str, ...]
    degrees: NDArray[np.float64]
    sigma: NDArray[np.float64]

    def __post_init__(self) -> None:
        super().__post_init__()
        dict.update(self, zip(self.names, self.degrees.T, strict=True))

    def __missing__(self, name: object) -> NoReturn:
        raise UnknownNameError("angle", name, self.names)

    def __reduce__(self) -> tuple[Any, ...]:
        return AngleSeries, (self.names, self.degrees, self.sigma)

    def _refused(self, *_: Any, **__: Any) -> NoReturn:
        raise TypeError("The angles of a session are read-only; `dict(angles)` is not.")

    __setitem__ = __delitem__ = __ior__ = _refused
    clear = pop = popitem = setdefault = update = _refused


@dataclass(frozen=True, eq=False)
class PersonSpan(ReadOnlyArrays):
    """Some frames in a row in which S* has the bones of one person.

    Attributes:
        person: The number of the person; who returns has the one of before.
        first, end: The frames, `end` exclusive.
        seconds: Times of the first and the last of them since the first frame.
        height: Metres, from the bones: that of an adult times the median ratio of the lengths.
        bone_lengths: (J,) metres, as they are in the last of these frames.
    """

    person: int
    first: int
    end: int
    seconds: tuple[float, float]
    height: float
    bone_lengths: NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class RotationSeries(_Series, Mapping[str, "Rotation"]):
    """Rotations of the bones of S* over T frames, in K_A's frame; see :mod:`fusion.movement.joint_rotations`.

    A mapping: ``rotations["KneeRight"]`` is the scipy ``Rotation`` (T,) of the bone that ends in this joint,
    from rest, where the person stands upright with hanging arms and faces the sensor. Joints are named in any
    spelling of :meth:`fusion.body.Body.joint`; another name raises :class:`fusion.errors.UnknownNameError`.

    Attributes:
        of_body: The body.
        quaternions: (T, J, 4) x, y, z, w, by the joint in which a bone ends; at the root, of the pelvis. NaN
            without S*.
    """

    of_body: Body
    quaternions: NDArray[np.float64]

    @property
    def body(self) -> Rotation:
        """(T,) the rotation of the whole body, that is, of the pelvis."""
        return _rotation(self.quaternions[:, self.of_body.root])

    def __getitem__(self, joint: str) -> Rotation:
        return _rotation(self.quaternions[:, self.of_body.joint(joint)])

    def __iter__(self) -> Iterator[str]:
        return iter(self.of_body.joints)

    def __len__(self) -> int:
        return len(self.of_body)


def _rotation(quaternions: NDArray[np.float64]) -> Rotation:
    """(T,) rotations of (T, 4) x, y, z, w; NaN where these are, which ``from_quat`` refuses."""
    from scipy.spatial.transform import Rotation

    known = np.asarray(np.isfinite(quaternions).all(axis=1))
    rotations = Rotation.from_quat(np.where(known[:, None], quaternions, (0.0, 0.0, 0.0, 1.0)))
    if not known.all():
        rotations[~known] = Rotation.from_rotvec(np.full((int((~known).sum()), 3), np.nan))
    return rotations
