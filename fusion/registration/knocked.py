"""Detection of a knocked sensor: the two views move apart as a whole and stay apart.

The offset between the views is measured on points that an exchange of left and right cannot move: joints of
the midline, and midpoints of joints with a left and a right. So a mirrored view
does not matter. A tracker's fault moves some joints, or all of them for a moment. A person far away makes the
offset noisy but not different. A knocked sensor moves all points by one rigid transform within half a second.

The views' biases change with the place and the heading of the person, so that an offset is compared
with earlier offsets at a similar place and heading.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion.body import Body
from fusion.rigid import RigidTransform
from fusion.skeleton import TRACKED, SkeletonPair

Array = NDArray[np.float64]


class SensorState(Enum):
    """The result of the detector."""

    STEADY = "steady"
    """The offset between the views is as before."""
    APART = "apart"
    """The views moved apart, and the offset still changes or was seen too briefly."""
    SETTLED = "settled"
    """The views moved apart, and the offset is steady again, so that the sensors can be registered anew."""


@dataclass(frozen=True)
class KnockSettings:
    """Thresholds of the detector.

    Attributes:
        block_ns: The offset is the median over blocks of this length.
        blocks: Number of successive blocks that must be off in the same direction.
        smallest: Metres; a smaller offset is left to the refinement.
        deviations: Threshold in robust standard deviations of the offset's own history.
        unfamiliar: Metres; the smallest offset that counts at a place where the person has not been.
        history: Number of blocks in the history.
        alike: Number of blocks with the most similar place and heading that an offset is compared with.
        fewest: Number of blocks that a decision needs.
        still: Metres, by which the offsets of a sensor that is still may differ.
        settled_ns: How long the offset must be steady before the sensors are registered anew.
        moving_ns: How long a sensor moves; pairs within this time count neither as before nor as after.
        judged_ns: Time after which a suspicion is judged; see :mod:`fusion.registration.knock_evidence`.
        dropped_ns: Time after which it is dropped if it has less than half the gain that it needs, and
            after twice this time in any case.
        gain: By how much a knock must raise the log-likelihood of the pairs.
        few: Number of keyframes before the knock at which twice that gain is needed: they do not yet show
            how biases change from pose to pose.
    """

    block_ns: int = 250_000_000
    blocks: int = 4
    smallest: float = 0.035
    deviations: float = 4.0
    unfamiliar: float = 0.090
    history: int = 200
    alike: int = 8
    fewest: int = 10
    still: float = 0.05
    settled_ns: int = 1_500_000_000
    moving_ns: int = 250_000_000
    judged_ns: int = 1_250_000_000
    dropped_ns: int = 2_500_000_000
    gain: float = 30.0
    few: float = 3.0

    def needed(self, keyframes: int) -> float:
        """The gain that a knock needs after so many keyframes."""
        return self.gain * (1.0 + self.few / max(keyframes, 1))


class _Block(NamedTuple):
    """The views' offset over a fraction of a second, and the person's place and heading."""

    start_ns: int
    offset: Array  # (3,) metres, K_A's frame
    situation: Array  # (4,) place along x and z, cosine and sine of the heading; one unit is "elsewhere"


_RECENT = 40  # blocks: no suspicion lasts longer
_PLACE, _HEADING = 0.6, 0.7  # metres; chord of a turn by about 40°


class KnockDetector:
    """Watches the offset between the views under the transform in force.

    Args:
        body: Of both views.
        a_from_b: In force.
        settings: Thresholds.

    Attributes:
        since_ns: When the views moved apart; None if they did not.
        offset: Metres, by how much they moved apart.
    """

    def __init__(self, body: Body, a_from_b: RigidTransform, settings: KnockSettings | None = None) -> None:
        self._settings = settings or KnockSettings()
        self._own, self._other = body.midpoints
        self._shoulders = [body.joint("SHOULDER_LEFT"), body.joint("SHOULDER_RIGHT")]
        self._a_from_b = a_from_b
        self._history: deque[_Block] = deque(maxlen=self._settings.history)
        self._recent: deque[_Block] = deque(maxlen=_RECENT)
        self._growing: list[SkeletonPair] = []
        self._block_start_ns = 0
        self._steady = False
        self.since_ns: int | None = None
        self.offset = 0.0

    def adopt(self, a_from_b: RigidTransform) -> None:
        """Uses another transform and forgets the offsets measured under the former one."""
        self._a_from_b = a_from_b
        self._history.clear()
        self._recent.clear()
        self._growing.clear()
        self.since_ns, self.offset = None, 0.0

    def refine(self, a_from_b: RigidTransform, centre: Array) -> None:
        """Uses a refined transform and converts the history to it.

        Args:
            a_from_b: The refined transform.
            centre: (3,) the mean place of the joints, where the change of an old offset is measured.
        """
        in_b = self._a_from_b.inverse()
        old, self._a_from_b = self._a_from_b, a_from_b

        def moved(block: _Block) -> _Block:
            place = np.array([block.situation[0] * _PLACE, centre[1], block.situation[1] * _PLACE])
            b = in_b.apply(place)
            return block._replace(offset=block.offset - (a_from_b.apply(b) - old.apply(b)))

        self._history = deque(map(moved, self._history), maxlen=self._history.maxlen)
        self._recent = deque(map(moved, self._recent), maxlen=self._recent.maxlen)
        self._growing.clear()

    def withdraw(self) -> None:
        """Counts the offsets since the views moved apart as usual: no sensor was moved."""
        since_ns = self.since_ns
        if since_ns is not None:
            self._history.extend(block for block in self._recent if block.start_ns >= since_ns)
        self.since_ns, self.offset = None, 0.0

    def observe(self, pair: SkeletonPair) -> SensorState:
        """Takes a pair that is neither stale nor one-sided."""
        if not self._growing:
            self._block_start_ns = pair.time_ns
        elif pair.time_ns - self._block_start_ns >= self._settings.block_ns:
            self._end_block()
            self._block_start_ns = pair.time_ns
        self._growing.append(pair)
        if self.since_ns is None:
            return SensorState.STEADY
        return SensorState.SETTLED if self._steady else SensorState.APART

    def _end_block(self) -> None:
        block = self._measure(self._growing)
        self._growing.clear()
        if block is None:
            return
        self._recent.append(block)
        needed = self._settings.blocks
        if len(self._recent) < needed:
            return
        newest = list(self._recent)[-needed:]
        if self.since_ns is not None:
            if all(self._excess(late)[1] < 1.0 for late in newest):
                self.since_ns, self.offset = None, 0.0
            else:
                self._steady = self._settled()
            return
        if len(self._history) >= self._settings.fewest:
            self._look_for_parting(newest)
        if self.since_ns is None:  # a block joins the history once no knock can begin in it
            self._history.append(newest[0])

    def _look_for_parting(self, blocks: list[_Block]) -> None:
        judged = [self._excess(block) for block in blocks]
        off = np.array([excess for excess, _ in judged])
        mean = off.mean(axis=0)
        length = float(np.linalg.norm(mean))
        # While the sensor still turns, the first block is between the old and the new offset.
        together = np.linalg.norm(off[1:] - mean, axis=1).max() < 0.5 * length
        if min(ratio for _, ratio in judged) > 1.0 and together:
            self.since_ns, self.offset, self._steady = blocks[0].start_ns, length, False

    def _excess(self, block: _Block) -> tuple[Array, float]:
        """Difference of an offset from the usual one at that place, and its ratio to the tolerance."""
        offsets = np.array([past.offset for past in self._history])
        elsewhere = np.linalg.norm(
            np.array([past.situation for past in self._history]) - block.situation, axis=1
        )
        nearest = np.argsort(elsewhere)[: self._settings.alike]
        middle = np.median(offsets[nearest], axis=0)
        apart = np.linalg.norm(offsets[nearest] - middle, axis=1)
        # The median norm of a normal 3-vector is 1.538 standard deviations of one axis.
        limit = max(self._settings.smallest, self._settings.deviations * float(np.median(apart)) / 1.538)
        if elsewhere[nearest[len(nearest) // 2]] > 1.0:
            everywhere = np.linalg.norm(offsets - np.median(offsets, axis=0), axis=1)
            limit = max(limit, self._settings.unfamiliar, 2.0 * float(np.quantile(everywhere, 0.95)))
        excess = block.offset - middle
        return excess, float(np.linalg.norm(excess)) / limit

    def _settled(self) -> bool:
        """Whether the offsets since the views moved apart are steady, because the sensor is still."""
        needed = int(np.ceil(self._settings.settled_ns / self._settings.block_ns))
        since = [block for block in self._recent if self.since_ns is None or block.start_ns >= self.since_ns]
        if len(since) < needed:
            return False
        off = np.array([self._excess(block)[0] for block in since[-needed:]])
        spread = np.sort(np.linalg.norm(off - np.median(off, axis=0), axis=1))
        return bool(spread[-2] < max(self._settings.still, 0.3 * self.offset))  # one block may be wrong

    def _measure(self, pairs: list[SkeletonPair]) -> _Block | None:
        """The median offset of the points without a side, and the person's place and heading."""
        both = [(pair.a, pair.b) for pair in pairs if pair.a is not None and pair.b is not None]
        if len(both) < 3:
            return None
        a = np.array([skeleton.positions for skeleton, _ in both], dtype=np.float64)  # (T, J, 3)
        b = np.array([skeleton.positions for _, skeleton in both], dtype=np.float64)
        tracked = np.array([(p.states == TRACKED) & (q.states == TRACKED) for p, q in both])
        usable = tracked[:, self._own] & tracked[:, self._other]
        mid_a = 0.5 * (a[:, self._own] + a[:, self._other])
        mid_b = 0.5 * (b[:, self._own] + b[:, self._other])
        often = usable.sum(axis=0) >= 3
        if np.count_nonzero(often) < 3:
            return None
        apart = mid_a - self._a_from_b.apply(mid_b)
        apart[~usable] = np.nan
        # Over time first: a point that is seen more often must not count more.
        offset = np.median(_median_over_time(apart[:, often]), axis=0)
        mid_a[~usable] = np.nan
        place = np.median(_median_over_time(mid_a[:, often]), axis=0)
        across = np.nansum(a[:, self._shoulders[0]] - a[:, self._shoulders[1]], axis=0)
        length = max(float(np.hypot(across[0], across[2])), 1e-9)
        heading = across[[0, 2]] / (length * _HEADING)
        situation = np.concatenate((place[[0, 2]] / _PLACE, heading))
        return _Block(self._block_start_ns, offset, situation)


def _median_over_time(values: Array) -> Array:
    """(M, 3) median of (T, M, 3) over time, NaN left out; much faster than ``np.nanmedian``."""
    ordered = np.sort(values, axis=0)  # NaN last
    count = np.isfinite(values[..., :1]).sum(axis=0)[None].repeat(3, axis=2)
    low = np.take_along_axis(ordered, (count - 1) // 2, axis=0)
    high = np.take_along_axis(ordered, count // 2, axis=0)
    return np.asarray(0.5 * (low + high)[0])
