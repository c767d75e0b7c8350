"""One person's joints from one sensor: positions, tracking states and capture time."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fusion.body import Body
from fusion.errors import BodyError, FusionError
from fusion.support.large_arrays import parts
from fusion.support.read_only import read_only


class TrackingState(IntEnum):
    """Whether a body tracker sees a joint."""

    NOT_TRACKED = 0
    """No position."""
    INFERRED = 1
    """The joint is hidden; the tracker infers its position."""
    TRACKED = 2
    """The joint is seen. Its position can still be wrong (sec. 3)."""


INFERRED, TRACKED = int(TrackingState.INFERRED), int(TrackingState.TRACKED)
"""For kernels, which compare numbers."""
NO_FRAME = -(2**63)
"""Capture time in arrays where a sensor gave no frame."""
FARTHEST_JOINT = 20.0
"""Metres: a larger coordinate is beyond the range of these sensors and counts as not tracked."""


@dataclass(frozen=True, eq=False, slots=True)
class Skeleton:
    """One person in one frame of one sensor: S_A or S_B.

    Attributes:
        body: The body that defines the joints.
        positions: (J, 3) float32, metres, in the sensor's frame; NaN where not tracked.
        states: (J,) uint8, a :class:`TrackingState` per joint.
        time_ns: Capture time on the sensor's clock.
        witness: (J, 4) float32, evidence of the depth image about each joint, see :mod:`fusion.witness`; None
            without an image.

    The constructor checks the shapes (BodyError); :meth:`of` also checks the values. Arrays that are
    writable or of another type are copied.
    """

    body: Body
    positions: NDArray[np.float32]
    states: NDArray[np.uint8]
    time_ns: int
    witness: NDArray[np.float32] | None = None

    def __post_init__(self) -> None:
        # The kernels are compiled for one type of array. Another, even a writable one, would compile them
        # again in the middle of a session.
        object.__setattr__(self, "positions", _read_only(self.positions, np.float32))
        object.__setattr__(self, "states", _read_only(self.states, np.uint8))
        # The kernels trust the body.
        joints = (len(self.body),)
        if self.states.shape != joints or self.positions.shape != (*joints, 3):
            self.body.require_shape(self.positions.shape)
            raise BodyError(
                f"{self.body.name} has {joints[0]} joints; states have shape {self.states.shape}."
            )
        if self.witness is not None:
            self.body.require_shape(self.witness.shape, columns=4)

    @staticmethod
    def of(body: Body, positions: ArrayLike, states: ArrayLike | None = None, time_ns: int = 0) -> Skeleton:
        """Makes a skeleton from a tracker's report and checks it.

        A joint with a coordinate that is NaN, infinite or farther than any sensor sees, or that lies behind
        the sensor (z ≤ 0), counts as not tracked, whatever its state. A joint that is not tracked has no
        position, whatever its coordinates.

        Args:
            positions: (J, 3) metres, sensor frame.
            states: (J,) tracking states 0, 1 or 2; all tracked if None.
            time_ns: Capture time on the sensor's clock.

        Raises:
            FusionError: A shape does not fit the body, or a state is not 0, 1 or 2.
        """
        return Skeleton(body, *checked_joints(body, positions, states), int(time_ns))

    def with_witness(self, witness: NDArray[np.float32] | None) -> Skeleton:
        """The same skeleton with the evidence of a depth image.

        Raises:
            BodyError: The witness is not (J, 4).
        """
        return replace(self, witness=witness)

    @property
    def has_position(self) -> NDArray[np.bool_]:
        """(J,) whether the joint has a position, tracked or inferred."""
        return np.not_equal(self.states, TrackingState.NOT_TRACKED)

    @property
    def tracked(self) -> NDArray[np.bool_]:
        """(J,) whether the joint is tracked."""
        return np.equal(self.states, TrackingState.TRACKED)

    def repeats(self, earlier: Skeleton | None) -> bool:
        """Whether this repeats the earlier skeleton: a stale frame, which the tracker delivered twice."""
        return (
            earlier is not None
            and np.array_equal(self.positions, earlier.positions, equal_nan=True)
            and np.array_equal(self.states, earlier.states)
        )


def stale_frames(positions: NDArray[np.floating], states: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """(T,) whether a view's skeleton repeats the last one that its sensor gave, joints and states alike.

    Args:
        positions: (T, J, 3); NaN where not tracked.
        states: (T, J) tracking states; all 0 where the sensor sees no one, which is no repetition.
    """
    stale = np.zeros(len(states), dtype=np.bool_)
    seen = np.flatnonzero(states.any(axis=1))
    for part in parts(max(len(seen) - 1, 0)):
        before, later = seen[:-1][part], seen[1:][part]
        same = (positions[later] == positions[before]) | np.isnan(positions[later] + positions[before])
        alike = (states[later] == states[before]).all(axis=1)
        stale[later] = same.all(axis=(1, 2)) & alike
    return stale


def nobody(body: Body) -> Skeleton:
    """A skeleton without a tracked joint."""
    return Skeleton.of(body, np.full((len(body), 3), np.nan))


def checked_joints(
    body: Body, positions: ArrayLike, states: ArrayLike | None = None, frames: tuple[int, ...] = ()
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Read-only positions (frames, J, 3) and states (frames, J), checked as :meth:`Skeleton.of` does."""
    with np.errstate(over="ignore"):  # values beyond float32 become infinite and count as not tracked
        at = np.array(positions, dtype=np.float32)
    body.require_shape(at.shape, frames)
    if states is None:
        state = np.full(at.shape[:-1], TrackingState.TRACKED, dtype=np.uint8)
    else:
        given = np.asarray(states)
        # np.isin would take longer than the rest of this function
        if given.shape != at.shape[:-1] or not ((given == 0) | (given == 1) | (given == 2)).all():
            raise FusionError(
                f"Tracking states must be {len(body)} values of 0, 1 or 2; got shape {given.shape}."
            )
        state = given.astype(np.uint8)
    state[~((np.abs(at) < FARTHEST_JOINT).all(axis=-1) & (at[..., 2] > 0.0))] = TrackingState.NOT_TRACKED
    at[state == TrackingState.NOT_TRACKED] = np.nan
    return read_only(at), read_only(state)


def nearer(positions: NDArray[Any], metres: float | NDArray[Any]) -> NDArray[Any]:
    """(..., 3) positions in a sensor's frame, moved along their rays to the sensor, by (..., 1) metres."""
    far = np.linalg.norm(positions, axis=-1, keepdims=True)
    return np.asarray(positions * (1.0 - metres / np.maximum(far, 1e-9)), dtype=positions.dtype)


def impossible(xyz: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(...) which positions (..., 3), in metres, no sensor can report.

    They are infinite, farther away than any sensor sees, or not before the sensor. A position of zeros and
    one with a NaN is a joint that was not seen.
    """
    x, y, z = np.moveaxis(xyz, -1, 0)
    stated = ~(np.isnan(x) | np.isnan(y) | np.isnan(z)) & ((x != 0.0) | (y != 0.0) | (z != 0.0))
    near = (np.abs(x) < FARTHEST_JOINT) & (np.abs(y) < FARTHEST_JOINT) & (z < FARTHEST_JOINT) & (z > 0.0)
    return np.asarray(stated & ~near)


def _read_only(array: NDArray[Any], dtype: type[np.generic]) -> NDArray[Any]:
    """The array itself, if it has the type and cannot be written; otherwise a copy like that."""
    flags = array.flags
    if array.dtype == dtype and flags.c_contiguous and not flags.writeable:
        return array
    return read_only(np.array(array, dtype=dtype, order="C"))


@dataclass(frozen=True, slots=True)
class SkeletonPair:
    """Both sensors' skeletons of one person at one time; None for a sensor that sees no person.

    Attributes:
        a: S_A, in the principal sensor's frame.
        b: S_B, in the secondary sensor's frame.
        time_ns: The pair's own time, on the principal sensor's clock.
        skew_ns: Capture time of B minus that of A, both on the principal sensor's clock; 0 without both.
    """

    a: Skeleton | None
    b: Skeleton | None
    time_ns: int
    skew_ns: int = 0

    def require(self, body: Body) -> None:
        """Checks that both skeletons are of this body.

        Raises:
            BodyError: One of them is of another body.
        """
        if self.a is not None:
            body.require(self.a.body, "S_A")
        if self.b is not None:
            body.require(self.b.body, "S_B")
