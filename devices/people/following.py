"""Follows one person of those whom two running sensors see, whatever ids their trackers give them."""

from __future__ import annotations

from collections import deque
from collections.abc import Generator, Sequence
from dataclasses import replace

import numpy as np

from devices.events import Event
from devices.frame_pairs import FramePair
from devices.people.placement import Placement, search_placement
from devices.people.recorded_people import Follow, RecordedPeople
from devices.people.room import HOLD_NS, NO_FRAME, NOBODY, SECOND, Room, Seen
from devices.people.tracks import Numbering, Tracks
from devices.sensor import SensorFrame
from fusion.body import Body
from fusion.pair_arrays import View
from fusion.rigid import RigidTransform
from fusion.skeleton import TRACKED

_TOLD_NS = SECOND // 2  # others who are seen for less have no event
_KEPT, _FEWEST = 150, 10  # pairs, for the registration
_AGAIN_NS = SECOND // 2  # between two searches
_LEAST_FIT = 0.5  # of the skeletons that can have a partner
_LEAST_LEAD = 0.3  # over another registration: two who stand still look alike


class PersonOfPair:
    """Follows one person in two views: at first the one nearest to the middle of A's view.

    Args:
        follow: Who is next when that one is gone.
        follow_moves: Whether a sensor that was moved is registered anew; B is left out otherwise.
    """

    def __init__(self, body: Body, follow: Follow = "middle", follow_moves: bool = True) -> None:
        self._body, self._follow, self._follow_moves = body, follow, follow_moves
        self._told = False  # whether others are there
        self._events: list[Event] = []
        self._begin(None)

    def _begin(self, found: RigidTransform | None) -> None:
        self._tracks = Numbering(self._body), Numbering(self._body)
        self._room = Room(self._body, self._follow)
        self._search = _Search(self._body, found)
        self._last_ns, self._moved = 0, False
        self._other_ns: int | None = None  # since when it is not as told

    def chosen(self, pair: FramePair, a_from_b: RigidTransform | None = None) -> FramePair:
        """The pair with the skeletons of the person followed; ``a_from_b`` once a calibration is settled."""
        if pair.time_ns < self._last_ns:
            self._begin(self._search.found)
        self._last_ns = pair.time_ns
        seen, room = (self._seen(0, pair.a), self._seen(1, pair.b)), self._room
        room.observe(pair.time_ns, seen, self._search.found if a_from_b is None else a_from_b)
        if a_from_b is None and room.crowded:
            self._search.keep(pair.time_ns, seen)
        picks = [None, None] if room.followed is None else list(room.followed.now)
        self._tell(pair.time_ns, seen, picks)
        if self._moved:
            picks[1] = None
        a, b = (
            None if k is None or frame is None else frame.people[str(of.names[k])]
            for of, k, frame in zip(seen, picks, (pair.a, pair.b), strict=True)
        )
        return replace(pair, skeletons=replace(pair.skeletons, a=a, b=b))

    def learn(self) -> list[Event]:
        """Looks for the registration while that is not known, one fit at a time, and returns the events.

        Call it when the pair is handed over: a fit takes longer than a choice.
        """
        if self._room.crowded:
            self._search.step()
        events, self._events = self._events, []
        return events

    def _seen(self, view: int, frame: SensorFrame | None) -> Seen:
        if frame is None:
            return NO_FRAME
        found = self._tracks[view].of(frame.time_ns, frame.people.values())
        joints = (person.positions for person in frame.people.values())
        each = [of for of in zip(frame.people, joints, *found, strict=True) if of[2] >= 0]
        return Seen(*zip(*each, strict=True)) if each else NOBODY

    def _tell(self, time_ns: int, seen: Sequence[Seen], picks: Sequence[int | None]) -> None:
        room = self._room
        if room.changed:
            room.changed = False
            self._events.append(Event("The person followed is gone; another one is followed.", "WARN"))
        moved = room.moved is not None and not self._follow_moves
        if moved and not self._moved:
            text = "A sensor was moved since the calibration: the view of B is left out. Calibrate again."
            self._events.append(Event(text, "WARN"))
        self._moved = moved
        others = any(person is not room.followed and person.now != (None, None) for person in room.people)
        if others == self._told:
            self._other_ns = None
            return
        self._other_ns = time_ns if self._other_ns is None else self._other_ns
        if time_ns - self._other_ns < (_TOLD_NS if others else HOLD_NS):
            return
        self._told = others
        if not others:
            self._events.append(Event("One person is seen.", topic="others", phase="end"))
            return
        names = [
            f"{of.names[k]!r} of {side}"
            for side, of, k in zip("AB", seen, picks, strict=True)
            if k is not None
        ]
        text = f"Several people are seen. The one followed is {' and '.join(names) or 'out of sight'}."
        if len(names) == 1:
            side = "AB"[picks[0] is not None]
            if seen["AB".index(side)].tracks:
                text += f" {side} sees somebody else, and is left out."
        self._events.append(Event(text, topic="others", phase="start"))


class _Search:
    """Looks for the registration of two views that see several people, while it is not known."""

    def __init__(self, body: Body, found: RigidTransform | None) -> None:
        self._body, self.found = body, found
        self._pairs: deque[tuple[int, tuple[Seen, Seen]]] = deque(maxlen=_KEPT)
        self._next_ns = 0
        self._running: Generator[None, None, Placement | None] | None = None

    def keep(self, time_ns: int, seen: tuple[Seen, Seen]) -> None:
        if seen[0].tracks and seen[1].tracks:
            self._pairs.append((time_ns, seen))

    def step(self) -> None:
        """Computes one fit at most."""
        if self._running is None:
            if len(self._pairs) < _FEWEST or self._pairs[-1][0] < self._next_ns:
                return
            a, b = (self._tracks(view) for view in (0, 1))
            self._running = search_placement(a, b, a.people.time_ns)
        try:
            next(self._running)
        except StopIteration as end:
            self._running = None
            self._next_ns = self._pairs[-1][0] + _AGAIN_NS
            found: Placement | None = end.value
            if found is not None and found.fit >= _LEAST_FIT and found.lead >= _LEAST_LEAD:
                self.found = found.a_from_b

    def _tracks(self, view: int) -> Tracks:
        times = np.array([time_ns for time_ns, _ in self._pairs], dtype=np.int64)
        seen = [of[view] for _, of in self._pairs]
        frame = np.repeat(np.arange(len(seen)), [len(of.tracks) for of in seen])
        joints = np.concatenate([of.joints for of in seen])
        skeletons = View(times[frame], joints, np.full(joints.shape[:2], TRACKED, dtype=np.uint8))
        nobody = np.zeros(len(frame), dtype=np.int64)
        people = RecordedPeople(self._body, times, [""], frame, nobody, skeletons)
        return Tracks(people, np.concatenate([of.tracks for of in seen]), nobody == 1, joints[:, 0])
