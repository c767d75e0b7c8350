"""Pairs two recorded streams by capture time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from devices.sensor import DeviceError, SensorFrame
from fusion.skeleton import Skeleton, SkeletonPair

_GAP = 1.5
"""Frame intervals: if the nearest frame of the other recording is farther away, the other recording has a
gap."""


@dataclass(frozen=True, eq=False, slots=True)
class FramePair:
    """The frames of both sensors at one moment, and the person to fuse.

    Attributes:
        a, b: The frames; None where a sensor has none for this moment.
        skeletons: S_A and S_B of the person, and the pair's time and skew. A sensor that does not see the
            person has None; both have None while nobody has been chosen.
    """

    a: SensorFrame | None
    b: SensorFrame | None
    skeletons: SkeletonPair

    @staticmethod
    def of(
        a: SensorFrame | None,
        b: SensorFrame | None,
        person_a: str,
        person_b: str,
        time_ns: int,
        skew_ns: int = 0,
    ) -> FramePair:
        """The pair of two frames, with the person who has these ids in each sensor's own numbering."""
        return FramePair(a, b, SkeletonPair(_person(a, person_a), _person(b, person_b), time_ns, skew_ns))

    @property
    def time_ns(self) -> int:
        """The pair's time, on the principal sensor's clock."""
        return self.skeletons.time_ns

    @property
    def skew_ns(self) -> int:
        """Capture time of B minus capture time of A; 0 unless both exist."""
        return self.skeletons.skew_ns


@dataclass(frozen=True, eq=False)
class Pairing:
    """All pairs of two recordings, and what was left over.

    Attributes:
        pairs: In time order; with one side None where the other recording has no frame for this moment.
        frames_a, frames_b: How many frames each recording has.
        alone_a, alone_b: Frames without a partner that are among the pairs.
        dropped_a, dropped_b: Frames left out.
    """

    pairs: list[FramePair] = field(repr=False)
    frames_a: int
    frames_b: int
    dropped_a: int
    dropped_b: int
    alone_a: int = 0
    alone_b: int = 0


def pair_recordings(
    frames_a: Sequence[SensorFrame],
    frames_b: Sequence[SensorFrame],
    person_a: str,
    person_b: str,
    tolerance_ns: int | None = None,
    *,
    offset_ns: int = 0,
    every_frame: bool = False,
) -> Pairing:
    """Pairs each frame of A with the nearest of B in time, each frame once.

    Two frames are a pair when each is the other's nearest and they lie within the tolerance. A frame that
    falls into a gap of the other recording (it saw no one, or lost frames there) is given alone. Frames
    before or after all of the other recording are left out.

    Args:
        tolerance_ns: Half the slower stream's median frame interval where None.
        offset_ns: Added to the times of B, so that both are on A's clock.
        every_frame: Whether a frame that merely finds no partner, as where one sensor is faster, is given
            alone, too. Else it is left out, because the paper's methods fuse pairs.

    Raises:
        DeviceError: A recording is empty, or the two never overlap in time.
    """
    time_a = np.array([frame.time_ns for frame in frames_a], dtype=np.int64)
    time_b = np.array([frame.time_ns for frame in frames_b], dtype=np.int64) + offset_ns
    if len(time_a) == 0 or len(time_b) == 0:
        raise DeviceError("A recording without frames cannot be paired.")
    if tolerance_ns is None:
        tolerance_ns = max(median_interval(time_a), median_interval(time_b)) // 2
    nearest_b = _nearest(time_a, time_b)
    mutual = _nearest(time_b, time_a)[nearest_b] == np.arange(len(time_a))
    skew = time_b[nearest_b] - time_a
    chosen = np.flatnonzero(mutual & (np.abs(skew) <= tolerance_ns))
    if len(chosen) == 0:
        raise DeviceError(
            f"The two recordings never overlap in time: A runs from {_span(time_a)}, B from {_span(time_b)}. "
            "They must be of the same capture, on one clock."
        )
    pairs = [
        FramePair.of(frames_a[i], frames_b[j], person_a, person_b, int(time_a[i]), int(skew[i]))
        for i, j in zip(chosen.tolist(), nearest_b[chosen].tolist(), strict=True)
    ]
    gap = 0.0 if every_frame else _GAP
    alone_a = sorted(set(_in_gaps(time_a, time_b, gap)) - set(chosen.tolist()))
    alone_b = sorted(set(_in_gaps(time_b, time_a, gap)) - set(nearest_b[chosen].tolist()))
    pairs += [FramePair.of(frames_a[i], None, person_a, person_b, int(time_a[i])) for i in alone_a]
    pairs += [FramePair.of(None, frames_b[j], person_a, person_b, int(time_b[j])) for j in alone_b]
    pairs.sort(key=lambda pair: pair.time_ns)
    return Pairing(
        pairs,
        len(time_a),
        len(time_b),
        len(time_a) - len(chosen) - len(alone_a),
        len(time_b) - len(chosen) - len(alone_b),
        len(alone_a),
        len(alone_b),
    )


def _in_gaps(times: NDArray[np.int64], others: NDArray[np.int64], gap: float) -> list[int]:
    """The frames, by index, that lie in a gap of the other recording, and not before or after all of it.

    The gap is the distance to the nearest frame of the other recording that must be exceeded, in its frame
    intervals.
    """
    apart = np.abs(others[_nearest(times, others)] - times)
    within = (times > others[0]) & (times < others[-1])
    return np.flatnonzero(within & (apart > gap * median_interval(others))).tolist()


def _person(frame: SensorFrame | None, person: str) -> Skeleton | None:
    return None if frame is None else frame.people.get(person)


def _nearest(times: NDArray[np.int64], others: NDArray[np.int64]) -> NDArray[np.int64]:
    """For each time the index of the nearest of the others, the earlier where two are as near."""
    after = np.clip(np.searchsorted(others, times), 1, max(len(others) - 1, 1))
    after = np.minimum(after, len(others) - 1)
    before = np.maximum(after - 1, 0)
    return np.where(np.abs(others[before] - times) <= np.abs(others[after] - times), before, after)


def median_interval(times: NDArray[np.int64]) -> int:
    """Nanoseconds between two frames; a thirtieth of a second for a single frame."""
    return int(np.median(np.diff(times))) if len(times) > 1 else 33_000_000


def _span(times: NDArray[np.int64]) -> str:
    return f"{times[0] * 1e-9:.3f} s to {times[-1] * 1e-9:.3f} s"
