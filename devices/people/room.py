"""The people of a room, followed by place through the frames of one sensor or of two.

A body goes on from frame to frame as its track does. Where a track is new or in doubt, the body is who the
other view has in that place, else who was seen there last: by place, time and lengths of bones.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from devices.people.association import bones_of, cost_of_return, differing
from devices.people.recorded_people import Follow
from devices.people.tracks import SPEED_M_S
from fusion.body import Body
from fusion.rigid import RigidTransform
from fusion.skeleton import Skeleton
from fusion.support.types import Array

Place = Sequence[float]  # (3,) metres

REACH_M = 0.4  # how far the middle of a body may be off from frame to frame: tracker noise and a step
HOLD_S, WAIT_S = 2.0, 10.0
"""A person out of sight is waited for; after so long a newcomer is taken, and after so long anybody."""
TOLD_S = 0.5  # others who are seen for less have no event
_FORGET_S = 60.0  # somebody out of sight is no longer recognised
_SAME_PLACE_M = 0.3  # of one person in two views, at most
_PLACE_SD_M = 0.1  # the same, usually
_SURE_NS = 200_000_000  # for so long two views of a person are apart, or those of two people in one place
_BONES_EVERY, _BONES_NEW = 30, 0.2  # frames; share of a new measurement
_RETURN_S = 1.0  # the bones of who was away for less are not compared
_MOST_OWNED = 200  # tracks


@dataclass(frozen=True, slots=True)
class Seen:
    """The bodies of one frame of a view: those that have a place."""

    time_ns: int
    names: list[str]
    skeletons: list[Skeleton]
    tracks: list[int]
    doubtful: list[bool]
    places: list[list[float]]


@dataclass(eq=False, slots=True)
class Person:
    """Somebody in the room."""

    place: Place
    seen_ns: int
    now: list[int | None]  # of each view: which body of this frame
    since_ns: list[int]  # of each view: when the track was found to be theirs
    bones: list[Array | None]  # of each view
    beside: bool = False  # whether seen while the person followed was
    apart_ns: int | None = None  # since when their two views are
    measured: int = 0  # frames in which they were seen

    @property
    def is_seen(self) -> bool:
        return any(index is not None for index in self.now)


class Room:
    """People by place, seen by one sensor, or by two whose placement is known."""

    def __init__(self, body: Body, views: Sequence[int], follow: Follow = "middle") -> None:
        self._body, self._views, self._follow = body, views, follow
        self._owner: dict[tuple[int, int], Person] = {}  # by view and track
        self._met: dict[tuple[int, int], int] = {}  # since when two people are in one place
        self.people: list[Person] = []
        self.followed: Person | None = None
        self.guessed = False  # whether the person followed was chosen or found again among several
        self.changed = False  # whether another person is followed than before

    def adopt_room(self, other: Room, place: RigidTransform) -> None:
        """Begins with the people of another room, whose frame has this place."""
        self._owner, self.people, self.followed = dict(other._owner), list(other.people), other.followed
        for person in self.people:
            person.place = place.apply(person.place).tolist()

    def adopt(self, seen: Sequence[Seen]) -> None:
        """Begins with the only people of some views."""
        for view in self._views:
            if seen[view].tracks:
                person = self._new(0, seen[view]) if self.followed is None else self.followed
                person.now[view] = 0
                self._owner[view, seen[view].tracks[0]] = self.followed = person

    def observe(self, time_ns: int, seen: Sequence[Seen]) -> None:
        """Takes the next frames. Of a room of both views, bodies of B are in K_A's frame."""
        left: list[tuple[int, int]] = []
        for person in self.people:
            person.now = [None, None]
        for view in self._views:
            of = seen[view]
            for k, track in enumerate(of.tracks):
                owner = None if of.doubtful[k] else self._owner.get((view, track))
                if owner is None or owner.now[view] is not None:
                    left.append((view, k))
                else:
                    owner.now[view] = k
        if left:
            self._find(time_ns, seen, left)
        for person in self.people:
            by = [(view, at) for view in self._views if (at := person.now[view]) is not None]
            if by:
                view, at = by[0]
                person.place, person.seen_ns = seen[view].places[at], time_ns
                person.measured += 1
                for view, at in by if person.measured % _BONES_EVERY == 1 else ():
                    self._measure(person, view, seen[view].skeletons[at])
        if len(self._views) > 1:
            self._compare(time_ns, seen)
        self._choose(time_ns, seen)

    def _new(self, k: int, of: Seen) -> Person:
        person = Person(of.places[k], of.time_ns, [None, None], [0, 0], [None, None])
        self.people.append(person)
        return person

    def _own(self, person: Person, view: int, k: int, of: Seen, time_ns: int) -> None:
        person.now[view] = k
        if not of.doubtful[k] and of.tracks[k] >= 0:
            self._owner[view, of.tracks[k]], person.since_ns[view] = person, time_ns

    def _find(self, time_ns: int, seen: Sequence[Seen], left: list[tuple[int, int]]) -> None:
        """Who bodies are whose tracks do not tell it: by the other view, else by place, time and bones."""
        costs = []
        for view, k in left:
            for person in self.people:
                if person.now[view] is None:
                    cost = self._cost(person, view, k, seen, time_ns)
                    if cost < np.inf:
                        costs.append((cost, view, k, person))
        for _, view, k, person in sorted(costs, key=lambda each: each[0]):
            if (view, k) not in left or person.now[view] is not None:
                continue
            if self._cost(person, view, k, seen, time_ns) < np.inf:  # not elsewhere in the other view
                others = sum(of.now[view] is None for of in self.people)
                if person is self.followed and (others > 1 or seen[view].doubtful[k]):
                    self.guessed = True
                self._own(person, view, k, seen[view], time_ns)
                left.remove((view, k))
        for view, k in left:
            place = seen[view].places[k]
            partner = next(
                (
                    person
                    for person in self.people
                    if person.now[view] is None
                    and (other := self._place(person, 1 - view, seen)) is not None
                    and math.dist(other, place) < _SAME_PLACE_M
                ),
                None,
            )
            self._own(partner or self._new(k, seen[view]), view, k, seen[view], time_ns)
        if len(self._owner) > _MOST_OWNED:
            alive = {(view, track) for view in self._views for track in seen[view].tracks}
            self._owner = {track: of for track, of in self._owner.items() if track in alive}
        self.people = [
            person
            for person in self.people
            if person is self.followed or time_ns - person.seen_ns < _FORGET_S * 1e9 or person.is_seen
        ]

    def _place(self, person: Person, view: int, seen: Sequence[Seen]) -> Place | None:
        k = person.now[view] if view in self._views else None
        return None if k is None else seen[view].places[k]

    def _cost(self, person: Person, view: int, k: int, seen: Sequence[Seen], time_ns: int) -> float:
        of = seen[view]
        other = self._place(person, 1 - view, seen)
        if other is not None:
            far = math.dist(other, of.places[k])
            if far > _SAME_PLACE_M:
                return np.inf
            return 0.5 * (far / _PLACE_SD_M) ** 2 + 2.0 * math.log(_PLACE_SD_M)
        far, seconds = math.dist(person.place, of.places[k]), 1e-9 * (time_ns - person.seen_ns)
        if far > REACH_M + SPEED_M_S * seconds:
            return np.inf
        bones, known = np.nan, person.bones[view]
        if seconds > _RETURN_S and known is not None:
            bones = differing(known, bones_of(self._body, of.skeletons[k].positions[None]))
        return cost_of_return(bones, far, seconds)

    def _measure(self, person: Person, view: int, skeleton: Skeleton) -> None:
        now, before = bones_of(self._body, skeleton.positions[None]), person.bones[view]
        if before is not None:
            now = np.where(np.isnan(now), before, now)
            now = np.where(np.isnan(before), now, before + _BONES_NEW * (now - before))
        person.bones[view] = now

    def _compare(self, time_ns: int, seen: Sequence[Seen]) -> None:
        """Separates what two views have of different people, and joins what they have of one."""
        single: tuple[list[Person], list[Person]] = [], []
        for person in self.people:
            a, b = self._place(person, 0, seen), self._place(person, 1, seen)
            if a is None or b is None:
                if (a is None) != (b is None):
                    single[a is None].append(person)
                continue
            if math.dist(a, b) <= _SAME_PLACE_M:
                person.apart_ns = None
                continue
            person.apart_ns = time_ns if person.apart_ns is None else person.apart_ns
            if time_ns - person.apart_ns >= _SURE_NS:
                later = int(person.since_ns[1] >= person.since_ns[0])
                place = (a, b)[later]
                if any(
                    math.dist(at, place) < _SAME_PLACE_M
                    for of in self.people
                    if of is not person and (at := self._place(of, 1 - later, seen)) is not None
                ):
                    k = person.now[later]
                    assert k is not None
                    self._owner.pop((later, seen[later].tracks[k]), None)
                    person.now[later], person.apart_ns = None, None
        met = {}
        for one in single[0]:
            for other in single[1]:
                a, b = self._place(one, 0, seen), self._place(other, 1, seen)
                if a is None or b is None or math.dist(a, b) > _SAME_PLACE_M:
                    continue
                pair = id(one), id(other)
                met[pair] = self._met.get(pair, time_ns)
                if time_ns - met[pair] >= _SURE_NS and one in self.people and other in self.people:
                    self._join(one, other)
        self._met = met

    def _join(self, one: Person, other: Person) -> None:
        if other is self.followed:
            one, other = other, one
        for view in self._views:
            if other.now[view] is not None:
                one.now[view], one.since_ns[view] = other.now[view], other.since_ns[view]
            one.bones[view] = other.bones[view] if one.bones[view] is None else one.bones[view]
        one.beside, one.measured = one.beside or other.beside, max(one.measured, other.measured)
        self._owner = {track: one if of is other else of for track, of in self._owner.items()}
        self.people.remove(other)

    def _choose(self, time_ns: int, seen: Sequence[Seen]) -> None:
        """Whom to follow."""
        here = [person for person in self.people if person.is_seen]
        followed = self.followed
        if followed is not None and followed.is_seen:
            for person in here:
                person.beside = True
            return
        away_s = np.inf if followed is None else 1e-9 * (time_ns - followed.seen_ns)
        if away_s <= HOLD_S or not here:
            return
        chosen = here
        if followed is not None and away_s <= WAIT_S:
            chosen = [person for person in here if not person.beside and self._may_be(person, followed)]
        if chosen:
            longest = max(person.measured for person in chosen) if self._follow == "longest" else 0
            chosen = [person for person in chosen if person.measured >= longest]
            self.followed = min(chosen, key=lambda person: self._off_axis(person, seen))
            self.changed = followed is not None and away_s > WAIT_S
            self.guessed = True
            for person in self.people:
                person.beside = person.is_seen

    def _may_be(self, one: Person, other: Person) -> bool:
        pairs = zip(one.bones, other.bones, strict=True)
        bones = [differing(of, before) for of, before in pairs if of is not None and before is not None]
        return all(cost_of_return(each, 0.0, 0.0) < np.inf for each in bones)

    def _off_axis(self, person: Person, seen: Sequence[Seen]) -> float:
        """The angle between a person and the axis of a view that sees them: near or far, what is central."""
        view = next(v for v in self._views if person.now[v] is not None)
        at = seen[view].skeletons[person.now[view] or 0].positions
        return float(abs(np.arctan2(np.nanmean(at[:, 0]), np.nanmean(at[:, 2]))))
