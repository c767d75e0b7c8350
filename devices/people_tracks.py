"""Bodies that go on from frame to frame in one view, whatever ids a tracker gives them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from devices.pairing import median_interval
from devices.people import RecordedPeople
from fusion.compiling.kernels import inner_kernel, kernel

Array = NDArray[np.float64]
Index = NDArray[np.int64]

_SLOTS = 16  # bodies in one view at a time
_HOLD_NS, _HOLD = 200_000_000, 2.5  # a body unseen for longer, and so many frames, begins a new track
_REACH_M, _SPEED_M_S = 0.1, 3.0  # tracker noise; a running person
_UNSURE_M = 0.05  # mean over the joints: two bodies this near to each other may be exchanged
_FEWEST_JOINTS = 3
_MOST_TRACKS = 150  # the longest; the others are not used


@dataclass(frozen=True, eq=False)
class Tracks:
    """The tracks of one view."""

    people: RecordedPeople
    track: Index  # (N,) of each skeleton; -1 of none that counts
    count: Index  # (M,) skeletons of each track

    @staticmethod
    def of(people: RecordedPeople) -> Tracks:
        track = tracks_of(people)
        count = np.bincount(track[track >= 0])
        if len(count) > _MOST_TRACKS:
            kept = np.sort(np.argsort(-count, kind="stable")[:_MOST_TRACKS])
            number = np.full(len(count) + 1, -1, dtype=np.int64)  # the last one is that of track -1
            number[kept] = np.arange(len(kept))
            track, count = number[track], count[kept]
        return Tracks(people, track, count)

    def longest(self, count: int) -> list[int]:
        return [int(k) for k in np.argsort(-self.count, kind="stable")[:count]]

    def rows(self, tracks: Sequence[int]) -> Index:
        return np.flatnonzero(np.isin(self.track, tracks))

    def at(self, rows: Index) -> Array:
        """(n, J, 3) metres."""
        return np.asarray(self.people.skeletons.positions[rows], dtype=np.float64)

    def centres(self, rows: Index) -> Array:
        """(n, 3) middle of the torso; of all joints where none of those is tracked."""
        at = self.at(rows)
        torso = mean_of_joints(at[:, list(self.people.body.torso)])
        return np.where(np.isnan(torso), mean_of_joints(at), torso)

    def spans(self) -> tuple[Index, Index]:
        """(M,) first and last frame of each track."""
        some = self.track >= 0
        first = np.full(len(self.count), len(self.people), dtype=np.int64)
        last = np.full(len(self.count), -1, dtype=np.int64)
        np.minimum.at(first, self.track[some], self.people.frame[some])
        np.maximum.at(last, self.track[some], self.people.frame[some])
        return first, last


def tracks_of(people: RecordedPeople) -> Index:
    """(N,) track of each skeleton: a body that goes on from frame to frame, whatever its ids; -1 of none."""
    track = np.full(len(people.frame), -1, dtype=np.int64)
    hold_ns = max(_HOLD_NS, int(_HOLD * median_interval(people.time_ns)))
    mirror = np.ascontiguousarray(people.body.mirror)
    _number_tracks(people.frame, people.time_ns, people.skeletons.positions, mirror, np.int64(hold_ns), track)
    return track


@kernel
def _number_tracks(frame, time_ns, positions, mirror, hold_ns, track):  # type: ignore[no-untyped-def]
    last = np.full(_SLOTS, -1, dtype=np.int64)  # the newest skeleton of each track that goes on
    number = np.full(_SLOTS, -1, dtype=np.int64)
    unsure = np.zeros(_SLOTS, dtype=np.bool_)
    slot_of = np.full(_SLOTS, -1, dtype=np.int64)
    owner = np.full(_SLOTS, -1, dtype=np.int64)
    cost = np.full((_SLOTS, _SLOTS), np.inf)
    count = first = 0
    while first < len(frame):
        end = first + 1
        while end < len(frame) and frame[end] == frame[first]:
            end += 1
        here, now = min(end - first, _SLOTS), time_ns[frame[first]]
        for s in range(_SLOTS):
            owner[s] = -1
            waited = np.int64(0) if last[s] < 0 else now - time_ns[frame[last[s]]]
            if waited > hold_ns:
                last[s] = -1
            for r in range(here):
                cost[r, s] = np.inf
                if last[s] >= 0:
                    apart = _apart(positions[first + r], positions[last[s]], mirror)
                    if apart <= _REACH_M + _SPEED_M_S * 1e-9 * waited:
                        cost[r, s] = apart
        for r in range(here):
            slot_of[r] = -1
        for _ in range(here):
            least, row, slot = np.inf, -1, -1
            for r in range(here):
                for s in range(_SLOTS):
                    if slot_of[r] < 0 and owner[s] < 0 and cost[r, s] < least:
                        least, row, slot = cost[r, s], r, s
            if row < 0:
                break
            slot_of[row], owner[slot] = slot, row
        for r in range(here):
            s = slot_of[r]
            if s < 0:
                continue
            doubtful = False
            for other in range(here):
                t = slot_of[other]
                if other != r and t >= 0:
                    as_they_are = cost[r, s] + cost[other, t]
                    doubtful = doubtful or cost[r, t] + cost[other, s] - as_they_are < 2.0 * _UNSURE_M
            if unsure[s] and not doubtful:  # after bodies that were in one place, nobody knows who is who
                number[s] = count
                count += 1
            unsure[s] = doubtful
        for r in range(here):
            s = slot_of[r]
            if s < 0:
                for free in range(_SLOTS):
                    if owner[free] < 0 and (s < 0 or last[free] < 0 <= last[s]):
                        s = free
                if s < 0:
                    continue
                owner[s], number[s], unsure[s] = r, count, False
                count += 1
            last[s] = first + r
            track[first + r] = number[s]
        first = end


@inner_kernel
def _apart(one, other, mirror):  # type: ignore[no-untyped-def]
    """Mean distance of the joints that two skeletons have in common, whichever side is called left.

    Infinite where the joints are too few.
    """
    least = np.inf
    for exchanged in range(2):
        total, joints = 0.0, 0
        for j in range(len(one)):
            k = mirror[j] if exchanged else j
            x, y, z = one[j, 0] - other[k, 0], one[j, 1] - other[k, 1], one[j, 2] - other[k, 2]
            square = x * x + y * y + z * z
            if square >= 0.0:
                total += np.sqrt(square)
                joints += 1
        if joints >= _FEWEST_JOINTS:
            least = min(least, total / joints)
    return least


def mean_of_joints(values: Array) -> Array:
    """(n, d) means over the joints of (n, J, d); NaN where no joint is known."""
    known = np.isfinite(values)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.where(known, values, 0.0).sum(axis=1) / known.sum(axis=1))
