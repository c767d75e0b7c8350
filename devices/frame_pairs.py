"""Frames of two sensors that belong together."""

from __future__ import annotations

from dataclasses import dataclass

from devices.sensor import SensorFrame
from fusion.pair_arrays import Pairs
from fusion.skeleton import SkeletonPair
from fusion.support.large_arrays import Rows

PERSON = "0"
"""The id of the only person in recorded pairs."""


@dataclass(frozen=True, eq=False, slots=True)
class FramePair:
    """The frames of both sensors at one moment, and the person to fuse.

    Attributes:
        a, b: The frames; None if a sensor has none for this moment.
        skeletons: S_A and S_B of the person, and the pair's time and skew. A sensor that does not see the
            person has None; both have None while nobody has been chosen.
    """

    a: SensorFrame | None
    b: SensorFrame | None
    skeletons: SkeletonPair

    @property
    def time_ns(self) -> int:
        """The pair's time, on the principal sensor's clock."""
        return self.skeletons.time_ns

    @property
    def skew_ns(self) -> int:
        """Capture time of B minus capture time of A; 0 unless both exist."""
        return self.skeletons.skew_ns


@dataclass(frozen=True, eq=False, repr=False)
class RecordedPairs(Rows[FramePair]):
    """Pairs without images, whose skeletons are stored as arrays; each pair is made on demand."""

    skeletons: Pairs  # of views with one row for each frame of the sensor

    def __len__(self) -> int:
        return len(self.skeletons)

    def row(self, k: int) -> FramePair:
        pair = self.skeletons[k]
        frames = zip(self.skeletons.views, self.skeletons.frames[k], (pair.a, pair.b), strict=True)
        a, b = (
            None if i < 0 else SensorFrame(int(view.time_ns[i]), {} if seen is None else {PERSON: seen})
            for view, i, seen in frames
        )
        return FramePair(a, b, pair)


@dataclass(frozen=True)
class PairingFigures:
    """How pairing goes, counted since the start."""

    pairs: int = 0  # frames of both sensors
    alone_a: int = 0  # frames given without a partner
    alone_b: int = 0
    unmatched_b: int = 0  # frames of B without a partner that were left out
    late: int = 0  # frames left out because their time had passed
    repeated: int = 0  # frames left out because they had come before
    reordered: int = 0  # frames that came after a later one, and were put in their place
    resets: int = 0  # how often a sensor's clock started anew
    skew_ns: int | None = None  # of the newest pair
    offset_ns: int | None = None
    """B's clock minus A's at the same moment, without the sync delay; None before both came."""
    drift_ppm: float = 0.0  # by how many millionths B's clock runs faster than A's
    dropped: tuple[int, int] = (0, 0)
    """Frames of A and of B dropped before pairing because the program was too slow."""

    @property
    def unpaired(self) -> tuple[int, int]:
        """Frames of A and of B without a partner."""
        return self.alone_a, self.alone_b + self.unmatched_b


def lone_side(skew_ns: int, interval_ns: int) -> int:
    """Which of the oldest frames of two streams has no partner: 1 A's, -1 B's, 0 neither: they are a pair.

    Two frames within half an interval of the faster stream are of one moment. So what is a pair follows from
    the capture moments alone, wherever the streams are cut.

    Args:
        skew_ns: B's moment minus A's.
    """
    return (2 * skew_ns > interval_ns) - (2 * skew_ns < -interval_ns)
