"""Bodies that go on from frame to frame in one view, whatever ids a tracker gives them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from devices.pairing import median_interval
from devices.people.recorded_people import RecordedPeople
from fusion.body import KINECT_V1, Body
from fusion.compiling.kernels import compiles, inner_kernel, kernel
from fusion.skeleton import Skeleton
from fusion.support.large_arrays import parts
from fusion.support.types import Array

Index = NDArray[np.int64]

_SLOTS = 16  # bodies in one view at a time
_HOLD_NS, _HOLD = 200_000_000, 2.5  # a body unseen for longer, and so many frames, begins a new track
_REPEATED_NS = 1_000_000_000  # a body whose joints are the same to the bit for longer is nobody
_REACH_M, SPEED_M_S = 0.1, 4.0  # tracker noise; a running person
_UNSURE_M = 0.05  # mean over the joints: two bodies this near to each other may be exchanged
_FEWEST_JOINTS = 3


@dataclass(frozen=True, eq=False)
class Tracks:
    """The tracks of one view."""

    people: RecordedPeople
    track: Index  # (N,) of each skeleton; -1 of nobody: no joint is known, or all are repeated
    doubtful: NDArray[np.bool_]  # (N,) whether it may be another one's

    @staticmethod
    def of(people: RecordedPeople) -> Tracks:
        track = np.full(len(people.frame), -1, dtype=np.int64)
        doubtful = np.zeros(len(track), dtype=np.bool_)
        hold_ns = np.int64(max(_HOLD_NS, int(_HOLD * median_interval(people.time_ns))))
        mirror = people.body.mirror.copy()
        _number_all(
            people.frame, people.time_ns, people.skeletons.positions, mirror, hold_ns,
            *_held(len(people.body)), track, doubtful,
        )  # fmt: skip
        return Tracks(people, track, doubtful)

    def at(self, rows: Index) -> Array:
        """(n, J, 3) metres."""
        return np.asarray(self.people.skeletons.positions[rows], dtype=np.float64)

    def centres(self) -> Array:
        """(N, 3) middle of the torso; of all joints where none of those is tracked."""
        middle, torso = np.empty((len(self.track), 3)), np.array(self.people.body.torso)
        for part in parts(len(middle)):
            _middles(self.people.skeletons.positions[part], torso, middle[part])
        return middle


def _held(joints: int) -> tuple[NDArray[np.generic], ...]:
    """The bodies that go on, place, time, since when they are the same, number, whether it is in doubt; the
    count of numbers; scratch."""
    return (
        np.full((_SLOTS, joints, 3), np.nan, dtype=np.float32),
        np.zeros((2, _SLOTS), dtype=np.int64),
        np.full(_SLOTS, -1, dtype=np.int64),
        np.zeros(_SLOTS, dtype=np.bool_),
        np.zeros(1, dtype=np.int64),
        np.empty((2, _SLOTS), dtype=np.int64),
        np.empty((_SLOTS, _SLOTS)),
    )


class TracksAhead:
    """The tracks of one view, frame by frame."""

    def __init__(self, body: Body) -> None:
        self._mirror, self._torso = body.mirror.copy(), np.array(body.torso, dtype=np.int64)
        self._held = _held(len(body))
        self._last_ns: int | None = None
        self._interval_ns = _HOLD_NS / _HOLD

    def of(self, time_ns: int, people: Iterable[Skeleton]) -> tuple[list[int], list[bool], list[list[float]]]:
        """Of each body of the next frame: its track, whether it may be another one's, and its middle."""
        at = np.array([person.positions for person in people], dtype=np.float32)
        if self._last_ns is not None:
            since_ns = min(max(time_ns - self._last_ns, 0), 2.0 * self._interval_ns)
            self._interval_ns += 0.1 * (since_ns - self._interval_ns)
        self._last_ns = time_ns
        count = len(at)
        if not count:
            return [], [], []
        hold_ns = max(_HOLD_NS, int(_HOLD * self._interval_ns))
        track, doubtful, middle = np.empty(count, np.int64), np.empty(count, np.bool_), np.empty((count, 3))
        _number_next(
            np.int64(time_ns), at, self._mirror, self._torso, np.int64(hold_ns), *self._held, track, doubtful,
            middle,
        )  # fmt: skip
        return track.tolist(), doubtful.tolist(), middle.tolist()


@kernel
def _number_all(  # type: ignore[no-untyped-def]
    frame, time_ns, positions, mirror, hold_ns, held, held_ns, number, unsure, total, pairing, cost, track,
    doubtful,
):  # fmt: skip
    first = 0
    while first < len(frame):
        end = first + 1
        while end < len(frame) and frame[end] == frame[first]:
            end += 1
        now = time_ns[frame[first]]
        here = slice(first, min(end, first + _SLOTS))
        _number(
            now, positions[here], mirror, hold_ns, held, held_ns, number, unsure, total, pairing, cost,
            track[here], doubtful[here],
        )  # fmt: skip
        first = end


@kernel
def _number_next(  # type: ignore[no-untyped-def]
    now, positions, mirror, torso, hold_ns, held, held_ns, number, unsure, total, pairing, cost, track,
    doubtful, middle,
):  # fmt: skip
    for r in range(len(track)):
        track[r], doubtful[r] = -1, True
    here = slice(0, min(len(track), _SLOTS))
    _number(
        now, positions[here], mirror, hold_ns, held, held_ns, number, unsure, total, pairing, cost, track,
        doubtful,
    )  # fmt: skip
    for r in range(len(track)):
        _middle(positions[r], torso, middle[r])


@kernel
def _middles(positions, torso, middle):  # type: ignore[no-untyped-def]
    for r in range(len(positions)):
        _middle(positions[r], torso, middle[r])


@inner_kernel
def _middle(joints, torso, middle):  # type: ignore[no-untyped-def]
    """The middle of the torso; of all joints where none of those is tracked."""
    for every in range(2):
        count = 0
        middle[0] = middle[1] = middle[2] = 0.0
        for k in range(len(joints) if every else len(torso)):
            j = k if every else torso[k]
            if np.isfinite(joints[j, 0] + joints[j, 1] + joints[j, 2]):
                count += 1
                for c in range(3):
                    middle[c] += joints[j, c]
        for c in range(3):
            middle[c] = middle[c] / count if count else np.nan
        if count:
            break


@inner_kernel
def _number(  # type: ignore[no-untyped-def]
    now, positions, mirror, hold_ns, held, held_ns, number, unsure, total, pairing, cost, track, doubtful
):
    """Numbers the bodies of the next frame, at most as many as there are slots."""
    here = len(positions)
    slot_of, owner = pairing[0], pairing[1]
    for s in range(_SLOTS):
        slot_of[s] = owner[s] = -1
        for r in range(_SLOTS):
            cost[r, s] = np.inf
        waited = now - held_ns[0, s]
        if waited > hold_ns or waited < 0:
            number[s] = -1
        for r in range(here):
            if number[s] >= 0:
                apart = _apart(positions[r], held[s], mirror)
                # who was hidden is found by the room, that knows the other view
                if apart <= _REACH_M + SPEED_M_S * 1e-9 * min(waited, hold_ns / _HOLD):
                    cost[r, s] = apart
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
        doubt = False
        for other in range(here):
            t = slot_of[other]
            if other != r and t >= 0:
                as_they_are = cost[r, s] + cost[other, t]
                doubt = doubt or cost[r, t] + cost[other, s] - as_they_are < 2.0 * _UNSURE_M
        if unsure[s] and not doubt:  # after bodies that were in one place, nobody knows who is who
            number[s] = total[0]
            total[0] += 1
        unsure[s] = doubt
    for r in range(here):
        s = slot_of[r]
        if s < 0:
            for free in range(_SLOTS):
                if owner[free] < 0 and (s < 0 or number[free] < 0 <= number[s]):
                    s = free
            if s < 0:
                continue
            owner[s], number[s], unsure[s], held_ns[1, s] = r, total[0], False, now
            total[0] += 1
        held_ns[0, s] = now
        known = False
        for j in range(len(mirror)):
            for c in range(3):
                at = positions[r, j, c]
                known = known or at == at
                if at == at and at != held[s, j, c]:
                    held_ns[1, s] = now
                held[s, j, c] = at
        track[r], doubtful[r] = number[s], unsure[s]
        if not known or now - held_ns[1, s] > _REPEATED_NS:
            track[r] = -1


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


@compiles(_number_next)
def warm_up() -> None:
    """Compiles or loads the kernel of :class:`TracksAhead`, so that a first frame does not wait for it."""
    TracksAhead(KINECT_V1).of(0, [Skeleton.of(KINECT_V1, np.zeros((len(KINECT_V1), 3)))])
