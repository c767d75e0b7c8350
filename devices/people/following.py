"""Follows one person of those whom two running sensors see, whatever ids their trackers give.

A person who is alone is followed by place. Where several are seen, each view is a room of its own until the
sensors' placement is known, and B's person counts as A's only if nobody else was there when they were chosen.
The search of :mod:`devices.people.association` then tells who is who, and both views are one room.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from devices.events import Event
from devices.frame_pairs import FramePair
from devices.people.association import Registered
from devices.people.one_place import OnePlace
from devices.people.recorded_people import Follow, RecordedPeople
from devices.people.room import HOLD_S, REACH_M, TOLD_S, Place, Room, Seen
from devices.people.tracks import SPEED_M_S, Tracks, TracksAhead
from devices.sensor import SensorFrame
from fusion.body import Body
from fusion.rigid import RigidTransform

_ALONE_S = 5.0  # nobody else was seen for so long
_SEEN_ON_NS = 200_000_000  # who was out of sight for longer may be somebody else
_KEPT, _FEWEST_KEPT = 150, 20  # pairs, for the registration
_SEARCH_S, _AGAIN_S = 0.5, 5.0
_LEAST_FIT = 0.5  # of the skeletons that can have a partner
_LEAST_LEAD, _CLEAR_LEAD = 0.02, 0.3  # over another registration: to be right twice in a row, and once
_SAME_RAD, _SAME_M = 0.2, 0.3  # of two registrations, one after the other
FOLLOWED = "followed"
"""The id of the person that :func:`one_person` follows."""
_HERE = RigidTransform.identity()
_NOBODY = Seen(0, [], [], [], [], [])


@dataclass
class _Lone:
    """Follows the only person of a view by place: a jump is waited out."""

    place: Place | None = None
    time_ns: int = 0

    def takes(self, place: Place, time_ns: int) -> bool:
        elapsed_s = 1e-9 * (time_ns - self.time_ns)
        known = self.place is not None and 0.0 <= elapsed_s <= HOLD_S
        if (
            known
            and self.place is not None
            and math.dist(self.place, place) > REACH_M + SPEED_M_S * elapsed_s
        ):
            return False
        self.place, self.time_ns = place, time_ns
        return True


@dataclass
class _View:
    """One sensor."""

    tracks: TracksAhead
    lone: _Lone = field(default_factory=_Lone)

    def seen(self, frame: SensorFrame | None, place: RigidTransform) -> Seen:
        if frame is None or not frame.people:
            return _NOBODY
        names, skeletons = list(frame.people), list(frame.people.values())
        tracks, doubtful, places = self.tracks.of(frame.time_ns, skeletons, place)
        for k in range(len(places) - 1, -1, -1):
            if places[k][0] != places[k][0]:  # no joint is known
                for of in (names, skeletons, tracks, doubtful, places):
                    del of[k]
        return Seen(frame.time_ns, names, skeletons, tracks, doubtful, places)


class PersonOfPair:
    """Follows one person in two views: at first the one nearest to the middle of A's view.

    Args:
        follow: Who is next when that one is gone.
        follow_moves: Whether a sensor that was moved is registered anew. None: no view is left out.
    """

    def __init__(self, body: Body, follow: Follow = "middle", follow_moves: bool | None = True) -> None:
        self._body, self._follow = body, follow
        self._views = _View(TracksAhead(body)), _View(TracksAhead(body))
        self._rooms: tuple[Room, ...] = ()  # of both views, or of each; none while one person is alone
        self._crowded_ns = self._last_ns = 0
        self._one = False  # whether the person of B is that of A, before that is seen by place
        self._told: tuple[bool, int | None] = False, None  # whether others are there; since when it is not so
        self._events: list[Event] = []
        self._search = _Search(body)
        self._place = None if follow_moves is None else OnePlace(body, follow_moves)

    def chosen(self, pair: FramePair, a_from_b: RigidTransform | None = None) -> FramePair:
        """The pair with the skeletons of the person followed; ``a_from_b`` once a calibration is settled."""
        time_ns = pair.time_ns
        if time_ns < self._last_ns:
            self._views = _View(TracksAhead(self._body)), _View(TracksAhead(self._body))
            self._rooms, self._told = (), (self._told[0], None)
            self._search.restart()
            if self._place is not None:
                self._place.end("Time begins anew.")
        self._last_ns = time_ns
        known = self._search.found if a_from_b is None else a_from_b
        seen = (
            self._views[0].seen(pair.a, _HERE),
            self._views[1].seen(pair.b, known if self._rooms and known is not None else _HERE),
        )
        if max(len(of.tracks) for of in seen) > 1:
            self._crowded_ns = time_ns
            if not self._rooms:
                if self._place is not None:
                    self._place.end("Several people are seen.")
                self._begin(seen)
                if known is not None and seen[1].places:
                    places = known.apply(seen[1].places).tolist()
                    seen = seen[0], replace(seen[1], places=places)
        if not self._rooms:
            picks = [
                0 if of.tracks and view.lone.takes(of.places[0], of.time_ns) else None
                for view, of in zip(self._views, seen, strict=True)
            ]
            if a_from_b is not None and self._place is not None:
                picks = self._place.chosen(time_ns, seen, picks, a_from_b)
            self._one = self._one or None not in picks
            self._tell(time_ns, seen, picks, others=False)
        else:
            picks = self._of_rooms(time_ns, seen, known)
            if a_from_b is None:
                self._search.keep(time_ns, seen)
        a, b = (None if k is None else of.skeletons[k] for of, k in zip(seen, picks, strict=True))
        return replace(pair, skeletons=replace(pair.skeletons, a=a, b=b))

    def learn(self) -> list[Event]:
        """Looks for the registration while that is not known, one fit at a time, and returns the events.

        Call it when the pair is handed over: a fit takes longer than a choice.
        """
        if self._rooms:
            self._search.step()
        events, self._events = self._events, []
        if self._place is not None:
            events += self._place.events()
        return events

    def _room(self, *views: int) -> Room:
        return Room(self._body, views, self._follow)

    def _begin(self, seen: Sequence[Seen]) -> None:
        """Several people are there: those who were alone until now have tracks already."""
        self._rooms = self._room(0), self._room(1)
        for room, view, of in zip(self._rooms, self._views, seen, strict=True):
            if view.lone.place is not None and of.tracks:
                k = min(range(len(of.tracks)), key=lambda k: math.dist(of.places[k], view.lone.place or ()))
                since_ns = of.time_ns - view.lone.time_ns
                if view.lone.takes(of.places[k], of.time_ns):
                    room.guessed = since_ns > _SEEN_ON_NS
                    only = Seen(
                        of.time_ns, [of.names[k]], [of.skeletons[k]], [of.tracks[k]], [False], [of.places[k]]
                    )
                    room.adopt([only, only])

    def _of_rooms(self, time_ns: int, seen: Sequence[Seen], known: RigidTransform | None) -> list[int | None]:
        if known is not None and len(self._rooms) > 1:
            both = self._room(0, 1)
            first = min((0, 1), key=lambda view: _precedence(self._rooms[view]))
            both.adopt_room(self._rooms[first], known if first else _HERE)
            self._rooms = (both,)
        for room in self._rooms:
            room.observe(time_ns, seen)
        of = [self._rooms[0], self._rooms[-1]]
        picks: list[int | None] = [
            None if room.followed is None else room.followed.now[view] for view, room in enumerate(of)
        ]
        if len(self._rooms) > 1:
            self._one = self._one and not any(room.guessed for room in self._rooms)
            if not self._one:
                picks[1] = None
        others = any(p.is_seen and p is not room.followed for room in self._rooms for p in room.people)
        if others or not any(room.followed and room.followed.is_seen for room in self._rooms):
            self._crowded_ns = time_ns
        self._tell(time_ns, seen, picks, others)
        if time_ns - self._crowded_ns > _ALONE_S * 1e9:
            self._rooms = ()
            self._views = _View(self._views[0].tracks), _View(self._views[1].tracks)
        return picks

    def _tell(self, time_ns: int, seen: Sequence[Seen], picks: Sequence[int | None], others: bool) -> None:
        if any(room.changed for room in self._rooms):
            self._events.append(Event("The person followed is gone; another one is followed.", "WARN"))
            for room in self._rooms:
                room.changed = False
        told, since_ns = self._told
        if others == told:
            self._told = told, None
            return
        since_ns = time_ns if since_ns is None else since_ns
        self._told = told, since_ns
        if time_ns - since_ns < (TOLD_S if others else HOLD_S) * 1e9:
            return
        self._told = others, None
        if not others:
            self._events.append(Event("One person is seen.", topic="others", phase="end"))
            return
        names = " and ".join(
            f"{of.names[k]!r} of {side}"
            for side, of, k in zip("AB", seen, picks, strict=True)
            if k is not None
        )
        text = f"Several people are seen. The one followed is {names or 'out of sight'}."
        self._events.append(Event(text, topic="others", phase="start"))


def _precedence(room: Room) -> tuple[float, float]:
    """The lower one of two rooms has the person to follow: seen last, else nearest to the axis."""
    if room.followed is None:
        return np.inf, 0.0
    x, _, z = room.followed.place
    return -room.followed.seen_ns, abs(math.atan2(x, z))


class _Search:
    """Looks for the registration of two views that see several people, while it is not known."""

    def __init__(self, body: Body) -> None:
        self._body = body
        self._pairs: deque[tuple[int, tuple[Seen, Seen]]] = deque(maxlen=_KEPT)
        self._next_ns = 0
        self._running: Generator[None, None, Registered | None] | None = None
        self._before: RigidTransform | None = None
        self.found: RigidTransform | None = None

    def keep(self, time_ns: int, seen: tuple[Seen, Seen]) -> None:
        if seen[0].tracks and seen[1].tracks:
            self._pairs.append((time_ns, seen))

    def restart(self) -> None:
        """Forgets the pairs, whose times and tracks are not those of the next ones."""
        self._pairs.clear()
        self._next_ns, self._running = 0, None

    def step(self) -> None:
        """Computes one fit at most."""
        if self._running is None:
            if len(self._pairs) < _FEWEST_KEPT or self._pairs[-1][0] < self._next_ns:
                return
            a, b = (self._tracks(view) for view in (0, 1))
            self._running = Registered.search(a, b, a.people.time_ns)
        try:
            next(self._running)
        except StopIteration as end:
            self._running = None
            self._accept(end.value)

    def _accept(self, found: Registered | None) -> None:
        again_s = _SEARCH_S if self.found is None else _AGAIN_S
        self._next_ns = self._pairs[-1][0] + round(again_s * 1e9)
        before, self._before = self._before, None
        if found is None or found.score < max(
            _LEAST_FIT * found.most, found.next_score + _LEAST_LEAD * found.most
        ):
            return
        self._before = now = found.a_from_b
        if found.score >= found.next_score + _CLEAR_LEAD * found.most:
            self.found = now
        elif before is not None and now.angle_to(before) < _SAME_RAD:
            middle = np.nanmean([of.skeletons[0].positions for _, (_, of) in self._pairs], axis=(0, 1))
            if np.linalg.norm(now.apply(middle) - before.apply(middle)) < _SAME_M:
                self.found = now

    def _tracks(self, view: int) -> Tracks:
        seen = [of[view] for _, of in self._pairs]
        times = [time_ns for time_ns, _ in self._pairs]
        frames = [
            SensorFrame(time_ns, dict(zip(of.names, of.skeletons, strict=True)))
            for time_ns, of in zip(times, seen, strict=True)
        ]
        people = RecordedPeople.of(self._body, frames)
        _, track = np.unique(np.concatenate([of.tracks for of in seen]), return_inverse=True)
        return Tracks(people, track.astype(np.int64), np.bincount(track))


def one_person(body: Body, frames: Iterable[SensorFrame]) -> Iterator[SensorFrame]:
    """The frames, at most one person in each, with only the one followed, under one id whatever the ids."""
    view = _View(TracksAhead(body))
    for frame in frames:
        of = view.seen(frame, _HERE)
        taken = bool(of.tracks) and view.lone.takes(of.places[0], frame.time_ns)
        yield replace(frame, people={FOLLOWED: of.skeletons[0]} if taken else {})
