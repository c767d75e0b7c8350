"""Bodies that go on from frame to frame in one view, whatever ids a tracker gives them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from devices.people.recorded_people import RecordedPeople
from fusion.body import KINECT_V1, Body
from fusion.compiling.kernels import compiles, inner_kernel, kernel
from fusion.skeleton import Skeleton
from fusion.support.types import Array

Index = NDArray[np.int64]

_SLOTS = 16  # bodies in one view at a time
_HOLD_NS = 200_000_000  # a body unseen for longer, beside the interval of the frames, begins a new track
_REPEATED_NS = 1_000_000_000  # a body whose joints are the same to the bit for longer is nobody
_REACH_M, SPEED_M_S = 0.1, 4.0  # tracker noise; a running person
_UNSURE_M = 0.05  # two bodies this near to each other may be exchanged


class Numbering:
    """Numbers the bodies of one view, of some frames after the others.

    A body has the number that it had before; another one if it was hidden, since only the other view may know
    who was, or if two bodies were in one place.
    """

    def __init__(self, body: Body) -> None:
        self._torso = np.array(body.torso, dtype=np.int64)
        self._last_ns: int | None = None
        self._held = (
            np.full((_SLOTS, len(body), 3), np.nan, dtype=np.float32),
            np.zeros((2, _SLOTS), dtype=np.int64),  # when each was seen, and since when it is the same
            np.full(_SLOTS, -1, dtype=np.int64),  # its number
            np.zeros(_SLOTS, dtype=np.bool_),  # whether that is in doubt
            np.zeros(1, dtype=np.int64),  # how many numbers there are
            np.empty((2, _SLOTS), dtype=np.int64),
            np.empty((_SLOTS, _SLOTS)),
        )

    def number(
        self, frame: Index, time_ns: Index, positions: NDArray[np.float32]
    ) -> tuple[Index, NDArray[np.bool_], NDArray[np.float32]]:
        """(N,) number of each skeleton, -1 of nobody: no joint is known, or all are repeated; (N,) whether it
        may be another one's; (N, 3) middle of the torso, of all joints where none of those is tracked.

        Args:
            frame: (N,) of each skeleton: its frame, in order.
            time_ns: (T,) of the frames.
        """
        count = len(frame)
        track, doubtful = np.full(count, -1, dtype=np.int64), np.ones(count, dtype=np.bool_)
        middle = np.empty((count, 3), dtype=np.float32)
        _number_frames(frame, time_ns, positions, self._torso, *self._held, track, doubtful, middle)
        return track, doubtful, middle

    def of(self, time_ns: int, people: Iterable[Skeleton]) -> tuple[list[int], list[bool], list[list[float]]]:
        """The same of the bodies of the next frame."""
        at = np.array([person.positions for person in people], dtype=np.float32)
        times = time_ns if self._last_ns is None else self._last_ns, time_ns
        self._last_ns = time_ns
        if not len(at):
            return [], [], []
        found = self.number(np.ones(len(at), dtype=np.int64), np.array(times, dtype=np.int64), at)
        track, doubtful, middle = (each.tolist() for each in found)
        return track, doubtful, middle


@dataclass(frozen=True, eq=False)
class Tracks:
    """The tracks of one view; see :meth:`Numbering.number`."""

    people: RecordedPeople
    track: Index  # (N,)
    doubtful: NDArray[np.bool_]  # (N,)
    places: NDArray[np.float32]  # (N, 3)

    @staticmethod
    def of(people: RecordedPeople) -> Tracks:
        numbering = Numbering(people.body)
        return Tracks(people, *numbering.number(people.frame, people.time_ns, people.skeletons.positions))

    def at(self, rows: Index) -> Array:
        """(n, J, 3) metres."""
        return np.asarray(self.people.skeletons.positions[rows], dtype=np.float64)


@kernel
def _number_frames(  # type: ignore[no-untyped-def]
    frame, time_ns, positions, torso, held, held_ns, number, unsure, total, pairing, cost, track,
    doubtful, middle,
):  # fmt: skip
    first = 0
    while first < len(frame):
        end = first + 1
        while end < len(frame) and frame[end] == frame[first]:
            end += 1
        now = time_ns[frame[first]]
        step = now - time_ns[max(frame[first] - 1, 0)]
        here = slice(first, min(end, first + _SLOTS))
        _number(
            now, step, positions[here], held, held_ns, number, unsure, total, pairing, cost, track[here],
            doubtful[here],
        )  # fmt: skip
        first = end
    for r in range(len(frame)):
        _middle(positions[r], torso, middle[r])


@inner_kernel
def _middle(joints, torso, middle):  # type: ignore[no-untyped-def]
    """The middle of the torso; of all joints where none of those is tracked."""
    for every in range(2):
        count = 0
        for k in range(len(joints) if every else len(torso)):
            j = k if every else torso[k]
            if np.isfinite(joints[j, 0] + joints[j, 1] + joints[j, 2]):
                count += 1
                for c in range(3):
                    middle[c] = joints[j, c] + (middle[c] if count > 1 else 0.0)
        for c in range(3):
            middle[c] = middle[c] / count if count else np.nan
        if count:
            break


@inner_kernel
def _number(  # type: ignore[no-untyped-def]
    now, step, positions, held, held_ns, number, unsure, total, pairing, cost, track, doubtful
):
    """Numbers the bodies of the next frame, at most as many as there are slots."""
    here = len(positions)
    slot_of, owner = pairing[0], pairing[1]
    for s in range(_SLOTS):
        slot_of[s] = owner[s] = -1
        for r in range(_SLOTS):
            cost[r, s] = np.inf
        waited = now - held_ns[0, s]
        if waited > _HOLD_NS + step or waited < 0:
            number[s] = -1
        for r in range(here):
            if number[s] >= 0:
                apart = _apart(positions[r], held[s])
                # who was hidden is found by the room, that knows the other view
                if apart <= _REACH_M + SPEED_M_S * 1e-9 * step:
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
            owner[s], number[s], unsure[s], held_ns[1, s] = r, total[0], False, now
            total[0] += 1
        held_ns[0, s] = now
        known = False
        for j in range(len(held[s])):
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
def _apart(one, other):  # type: ignore[no-untyped-def]
    """Distance of the middles of the joints that two skeletons have in common, whichever side is called left.

    Infinite where there is none.
    """
    joints, square = 0, 0.0
    for c in range(3):
        total, joints = 0.0, 0
        for j in range(len(one)):
            if one[j, c] - other[j, c] == one[j, c] - other[j, c]:
                total += one[j, c] - other[j, c]
                joints += 1
        square += (total / joints) ** 2 if joints else np.inf
    return np.sqrt(square)


@compiles(_number_frames)
def warm_up() -> None:
    """Compiles or loads the kernel of :class:`Numbering`, so that a first frame does not wait for it."""
    Numbering(KINECT_V1).of(0, [Skeleton.of(KINECT_V1, np.zeros((len(KINECT_V1), 3)))])
