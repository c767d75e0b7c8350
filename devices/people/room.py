"""Who is who in two views, from one pair of frames to the next, live and recorded.

A person is a track in either view. Once the placement of the sensors is known, bodies of both views that are
in one place are one person, and bodies that are far apart are two, also where each view has only one. Before
that, the only bodies of both views are one person. Where a track is new or in doubt, the body is who the
other view has in that place, else who was seen there last: by place, time and lengths of bones.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import product

import numpy as np
from numpy.typing import NDArray

from devices.people.placement import one_movement
from devices.people.recorded_people import Follow
from devices.people.tracks import SPEED_M_S
from fusion.body import Body
from fusion.calibration.bone_lengths import bone_lengths_of
from fusion.rigid import RigidTransform
from fusion.support.types import Array

Place = Sequence[float]  # (3,) metres
Joints = NDArray[np.float32]  # (J, 3) metres

HOLD_NS, WAIT_NS = 2_000_000_000, 10_000_000_000
"""A person out of sight is waited for; after so long a newcomer is taken, and after so long anybody."""
ALONE_NS = 5_000_000_000  # nobody else was seen for so long
_FORGET_NS = 60_000_000_000  # somebody out of sight is no longer recognised
_SURE_NS = 200_000_000  # for so long two people are in one place
_SAME_PLACE_M, FAR_M = 0.3, 0.6  # of one person in two views, at most: among others, and alone
_PLACE_SD_M = 0.1  # the same, usually
_REACH_M = 0.4  # how far the middle of a body may be off from frame to frame: tracker noise and a step
_BONES_EVERY, _BONES_NEW = 30, 0.2  # frames; share of a new measurement
_BONE_ERROR, _DIFFERENT_BONES = 0.06, 0.2  # median, of a length: of one person; of a child and a grown-up
_RETURN_M, _WALK_M_S, _ROOM_M = 0.3, 0.7, 2.0
"""People come back this far from where they were last seen: at once, more for each second, and at most."""
_RETURN_NS = 1_000_000_000  # the bones of who was away for less are not compared
_COMPARED_NS, _KEPT, _FEWEST = 90_000_000, 60, 20  # pairs that tell a move of a sensor: 6 s, and 2 s at least
_TESTED_NS = 500_000_000  # between two such comparisons


@dataclass(frozen=True, slots=True)
class Seen:
    """The bodies of one frame of a view: those that have a place."""

    names: Sequence[object]
    joints: Sequence[Joints]
    tracks: Sequence[int]
    doubtful: Sequence[bool]
    places: Sequence[Place]  # in the sensor's frame


NOBODY = Seen((), (), (), (), ())


@dataclass(eq=False, slots=True)
class Sight:
    """What one view has of a person."""

    now: int | None = None  # which body of this frame
    track: int | None = None
    since_ns: int = 0  # when the track was found to be theirs
    place: Place | None = None  # the last one
    seen_ns: int = 0
    bones: Array | None = None  # (J,) metres


@dataclass(eq=False, slots=True)
class Person:
    """Somebody in the room."""

    sights: list[Sight] = field(default_factory=lambda: [Sight(), Sight()])
    beside: bool = False  # whether seen while the person followed was
    apart_ns: int | None = None  # since when their two views are
    begun_ns: int = 0
    measured: int = 0  # frames in which they were seen
    together: int = 0  # the same, by both views in one place
    into: Person | None = None  # who they turned out to be

    @property
    def now(self) -> tuple[int | None, int | None]:
        """Of each view: which body of this frame."""
        return self.sights[0].now, self.sights[1].now

    @property
    def seen_ns(self) -> int:
        return max(self.sights[0].seen_ns, self.sights[1].seen_ns)


class Room:
    """People by place, seen by two sensors; see the module."""

    def __init__(self, body: Body, follow: Follow = "middle") -> None:
        self._body, self._follow = body, follow
        self._met: dict[tuple[Person, Person], int] = {}  # since when two people are in one place
        self._far: dict[tuple[int | None, int | None], int] = {}  # since when tracks are in two places
        self._pairs: dict[tuple[Person, Person], deque[tuple[int, Joints, Joints]]] = {}
        self._given: RigidTransform | None = None
        self._a_from_b: list[list[float]] | None = None  # (3, 4)
        self._time_ns, self._crowded_ns = 0, -(2**62)
        self._seen: Sequence[Seen] = (NOBODY, NOBODY)
        self._at: Sequence[Sequence[Place]] = ((), ())  # places in K_A's frame, once the placement is known
        self.moved: RigidTransform | None = None
        """The placement since a sensor was moved, until the one that is given agrees again."""
        self.people: list[Person] = []
        self.followed: Person | None = None
        self.changed = False  # whether another person is followed than before

    def observe(self, time_ns: int, seen: Sequence[Seen], a_from_b: RigidTransform | None) -> None:
        """Takes the next frames, and the placement once that is known."""
        if a_from_b is not self._given:
            self._given = a_from_b
            self._put(a_from_b if self.moved is None else self.moved)
        self._time_ns, self._seen = time_ns, seen
        self._at = seen[0].places, [_put_by(self._a_from_b, place) for place in seen[1].places]
        left: list[tuple[int, int]] = []
        for view, of in enumerate(seen):
            if len(of.tracks) > 1:
                self._crowded_ns = time_ns
            owners = {}
            for person in self.people:
                sight = person.sights[view]
                sight.now = None
                if sight.track is not None:
                    owners[sight.track] = sight
            for k, track in enumerate(of.tracks):
                if track in owners and not of.doubtful[k]:
                    owners.pop(track).now = k
                else:
                    left.append((view, k))
        if left:
            self._find(left)
        self._compare()
        for person in self.people:
            if person.now != (None, None):
                self._measure(person)
        self._choose()
        if self._a_from_b is not None and self.followed is not None:
            self._look_for_a_move(self.followed)

    def _put(self, a_from_b: RigidTransform | None) -> None:
        self._far = {}
        self._a_from_b = None if a_from_b is None else _rows_of(a_from_b)

    def _own(self, person: Person, view: int, k: int) -> None:
        sight, of = person.sights[view], self._seen[view]
        sight.now = k
        if not of.doubtful[k]:
            sight.track, sight.since_ns = of.tracks[k], self._time_ns

    def _find(self, left: list[tuple[int, int]]) -> None:
        """Who bodies are whose tracks do not tell it: by the other view, else by place, time and bones."""
        costs = [
            (cost, n, view, k, person)
            for view, k in left
            for n, person in enumerate(self.people)
            if person.now[view] is None and (cost := self._cost(person, view, k)) < np.inf
        ]
        for _, _, view, k, person in sorted(costs, key=lambda each: each[:2]):
            if (view, k) not in left or person.now[view] is not None:
                continue
            if self._cost(person, view, k) < np.inf:  # not elsewhere in the other view
                if self._a_from_b is None and self._is_guessed(person, view, k):
                    person = self._only_in(person, view)
                self._own(person, view, k)
                left.remove((view, k))
        for view, k in left:
            near = (of for of in self.people if of.now[view] is None and self._may_be(of, view, k))
            person = next(near, None) or Person(begun_ns=self._time_ns)
            if person.begun_ns == self._time_ns and person not in self.people:
                self.people.append(person)
            self._own(person, view, k)
        self.people = [
            person
            for person in self.people
            if person is self.followed
            or person.now != (None, None)
            or self._time_ns - person.seen_ns < _FORGET_NS
        ]

    def _is_guessed(self, person: Person, view: int, k: int) -> bool:
        """Whether somebody who is found again may be another one."""
        absent = [of for of in self.people if of.now[view] is None and of.sights[view].place is not None]
        lost = max(map(len, self._at)) > 1 and self._time_ns - person.sights[view].seen_ns > _SURE_NS
        return lost or len(absent) > 1 or self._seen[view].doubtful[k]

    def _only_in(self, person: Person, view: int) -> Person:
        """The person of one view, who is no longer known to be that of the other."""
        if person.sights[1 - view].place is None:
            return person
        rest = Person(beside=person.beside, begun_ns=person.begun_ns, measured=person.measured)
        rest.sights[1], person.sights[1] = person.sights[1], Sight()
        self.people.append(rest)
        return rest if view else person

    def _limit(self) -> float:
        """How far two views of one person may be apart."""
        return FAR_M if max(map(len, self._at)) < 2 else _SAME_PLACE_M

    def _are_alone(self) -> bool:
        """Whether both views have one body, and had no other for a while."""
        return len(self._at[0]) == len(self._at[1]) == 1 and self._time_ns - self._crowded_ns > ALONE_NS

    def _is_gone(self, sight: Sight) -> bool:
        """Whether a view has not seen somebody for so long that they may be anywhere."""
        return sight.place is None or self._time_ns - sight.seen_ns > HOLD_NS

    def _may_be(self, person: Person, view: int, k: int) -> bool:
        """Whether a newcomer is somebody whom the other view sees."""
        other = person.now[1 - view]
        if other is None:
            return False
        if self._a_from_b is None:
            return self._are_alone() and self._is_gone(person.sights[view])
        return math.dist(self._at[1 - view][other], self._at[view][k]) <= self._limit()

    def _cost(self, person: Person, view: int, k: int) -> float:
        """How unlike somebody a body is; infinite for another one. Who was seen briefly is unlikelier."""
        known = math.log(min(person.measured, _BONES_EVERY) + 1)
        other, place = person.now[1 - view], self._at[view][k]
        if other is not None and self._a_from_b is not None:
            far = math.dist(self._at[1 - view][other], place)
            if far > self._limit():
                return np.inf
            return 0.5 * (far / _PLACE_SD_M) ** 2 + 2.0 * math.log(_PLACE_SD_M) - known
        own, by = person.sights[view], view
        if self._a_from_b is not None and person.seen_ns > own.seen_ns:
            by = 1 - view
        last = person.sights[by]
        if last.place is None:
            return np.inf
        seconds = 1e-9 * (self._time_ns - last.seen_ns)
        far = math.dist(_put_by(self._a_from_b, last.place) if by else last.place, place)
        if far > _REACH_M + SPEED_M_S * seconds:
            return np.inf
        bones = _BONE_ERROR
        if self._time_ns - last.seen_ns > _RETURN_NS and own.bones is not None:
            differing = _differing(own.bones, self._bones(self._seen[view].joints[k]))
            if differing > _DIFFERENT_BONES:
                return np.inf
            bones = bones if np.isnan(differing) else differing
        sd = min(_RETURN_M + _WALK_M_S * seconds, _ROOM_M)
        # errors of the bones, and of a place on the floor
        return 0.5 * (bones / _BONE_ERROR) ** 2 + 0.5 * (far / sd) ** 2 + 2.0 * math.log(sd) - known

    def _bones(self, joints: Joints) -> Array:
        """(J,) metres; NaN of those not seen."""
        lengths = bone_lengths_of(self._body, joints)
        return np.where(lengths > 0.0, lengths, np.nan)

    def _measure(self, person: Person) -> None:
        person.measured += 1
        for sight, of in zip(person.sights, self._seen, strict=True):
            if sight.now is None:
                continue
            sight.place, sight.seen_ns = of.places[sight.now], self._time_ns
            if person.measured % _BONES_EVERY == 1:
                now, before = self._bones(of.joints[sight.now]), sight.bones
                if before is not None:
                    now = np.where(np.isnan(now), before, now)
                    now = np.where(np.isnan(before), now, before + _BONES_NEW * (now - before))
                sight.bones = now

    def _compare(self) -> None:
        """Separates what two views have of different people, and joins what they have of one."""
        here = [zip(of.tracks, at, strict=True) for of, at in zip(self._seen, self._at, strict=True)]
        far: dict[tuple[int | None, int | None], int] = {}
        for (a_track, at), (b_track, b_at) in product(*here) if self._a_from_b is not None else ():
            since = self._far.get((a_track, b_track), self._time_ns)
            if self._time_ns - since >= _SURE_NS or math.dist(at, b_at) > 2.0 * FAR_M:
                far[a_track, b_track] = since
        self._far = far
        only: tuple[list[Person], list[Person]] = [], []
        for person in self.people:
            in_a, in_b = person.now
            if in_a is None or in_b is None:
                if in_a is not None or in_b is not None:
                    only[in_a is None].append(person)
            elif self._a_from_b is None:
                person.together += 1
            else:
                self._separate(person, in_a, in_b)
        near = []
        for a, b in product(*only):
            apart = math.dist(self._at[0][a.sights[0].now or 0], self._at[1][b.sights[1].now or 0])
            if self._a_from_b is None:
                if self._are_alone() and self._is_gone(a.sights[1]) and self._is_gone(b.sights[0]):
                    self._join(a, b)
            elif apart <= _SAME_PLACE_M and not self._are_two(a, b):
                near.append((apart, a, b))
        met: dict[tuple[Person, Person], int] = {}
        for _, a, b in sorted(near, key=lambda each: each[0]):
            if not any(a is of or b is by for of, by in met):
                met[a, b] = self._met.get((a, b), self._time_ns)
                if self._time_ns - met[a, b] >= _SURE_NS:
                    self._join(a, b)
        self._met = met

    def _are_two(self, a: Person, b: Person) -> bool:
        """Whether the tracks were in two places before they came together."""
        since = self._far.get((a.sights[0].track, b.sights[1].track))
        return since is not None and self._time_ns - since >= _SURE_NS

    def _separate(self, person: Person, a: int, b: int) -> None:
        """Whether both views have one person; the later one is somebody else otherwise."""
        if self.moved is not None and person is self.followed and self._given is not None:
            given = _put_by(_rows_of(self._given), self._seen[1].places[b])
            if math.dist(self._at[0][a], given) <= _SAME_PLACE_M:
                self.moved = None
                self._put(self._given)
                return
        apart = math.dist(self._at[0][a], self._at[1][b])
        if apart <= _SAME_PLACE_M:
            person.together += 1
            person.apart_ns = None
            return
        person.apart_ns = self._time_ns if person.apart_ns is None else person.apart_ns
        later = int(person.sights[1].since_ns >= person.sights[0].since_ns)
        others = [
            math.dist(self._at[view][k], place) < _SAME_PLACE_M
            for view, place in enumerate((self._at[1][b], self._at[0][a]))
            for k in range(len(self._at[view]))
            if k != (a, b)[view]
        ]  # whether either view has another one where the other view has the person
        if apart > FAR_M or (self._time_ns - person.apart_ns >= _SURE_NS and any(others)):
            person.apart_ns = None
            person.sights[later].now = person.sights[later].track = None

    def _join(self, one: Person, other: Person) -> None:
        """Both are one person: the one followed, or who was there first."""
        if other is self.followed or (one is not self.followed and other.begun_ns < one.begun_ns):
            one, other = other, one
        for view, sight in enumerate(other.sights):
            mine = one.sights[view]
            if sight.now is not None or (mine.now is None and sight.seen_ns > mine.seen_ns):
                one.sights[view] = sight
                sight.bones = mine.bones if sight.bones is None else sight.bones
        one.together += other.together
        one.beside, one.measured = one.beside or other.beside, max(one.measured, other.measured)
        other.into = one
        self.people.remove(other)

    def _choose(self) -> None:
        """Whom to follow."""
        here = [person for person in self.people if person.now != (None, None)]
        followed, changed = self.followed, False
        if followed is not None and followed.now != (None, None):
            for person in here:
                person.beside = True
            if self._a_from_b is None and followed.sights[0].place is None:
                here = [person for person in here if person.now[0] is not None]
            elif followed.together or self._a_from_b is None or self._time_ns - followed.begun_ns < WAIT_NS:
                return
            else:  # one view has always had somebody whom the other does not see, such as a mirror image
                here = [person for person in here if 2 * person.together > followed.measured]
                changed = True
        elif followed is not None:
            away_ns = self._time_ns - followed.seen_ns
            if away_ns <= HOLD_NS:
                return
            changed = away_ns > WAIT_NS
            if not changed:
                alone = len(here) == 1  # another person, if their bones differ
                here = [of for of in here if not of.beside and (alone or self._is_like(of, followed))]
        if not here:
            return
        if self._follow == "longest":
            longest = max(person.measured for person in here)
            here = [person for person in here if person.measured >= longest]
        self.changed = changed
        self.followed = min(here, key=self._off_axis)
        for person in self.people:
            person.beside = person.now != (None, None)

    def _is_like(self, one: Person, other: Person) -> bool:
        pairs = zip(one.sights, other.sights, strict=True)
        bones = [(of.bones, before.bones) for of, before in pairs]
        return not any(
            of is not None and before is not None and _differing(of, before) > _DIFFERENT_BONES
            for of, before in bones
        )

    def _off_axis(self, person: Person) -> tuple[bool, float]:
        """The angle between somebody and the axis of a view that sees them: near or far, what is central.

        Before the placement is known, whom A sees comes first.
        """
        by = 0 if person.now[0] is not None else 1
        x, _, z = self._seen[by].places[person.now[by] or 0]
        return self._a_from_b is None and by == 1, abs(math.atan2(x, z))

    def _look_for_a_move(self, followed: Person) -> None:
        """Joins whom the other view has elsewhere, if another placement makes one movement of both.

        What one view has of the person followed, and the other view of somebody else, is compared.
        """
        a, b = followed.now
        others = () if (a is None) == (b is None) else self.people
        pairs = {}
        for other in others:
            k = other.now[a is not None]
            if other is followed or k is None or other.now[a is None] is not None:
                continue
            at = (a if a is not None else k), (b if b is not None else k)
            kept = pairs[followed, other] = self._pairs.get((followed, other), deque(maxlen=_KEPT))
            if kept and self._time_ns - kept[-1][0] < _COMPARED_NS:
                continue
            kept.append((self._time_ns, self._seen[0].joints[at[0]], self._seen[1].joints[at[1]]))
            if len(kept) < _FEWEST or kept[-1][0] // _TESTED_NS == kept[-2][0] // _TESTED_NS:
                continue
            _, p, q = zip(*kept, strict=True)
            found = one_movement(self._body, np.array(p, np.float64), np.array(q, np.float64))
            if found is not None:
                self.moved = found
                self._put(found)
                self._join(followed, other)
                pairs = {}
                break
        self._pairs = pairs


def _rows_of(a_from_b: RigidTransform) -> list[list[float]]:
    """(3, 4) [R | t]."""
    return np.column_stack((a_from_b.rotation, a_from_b.translation)).tolist()  # type: ignore[no-any-return]


def _put_by(a_from_b: list[list[float]] | None, place: Place) -> Place:
    """A place of B in K_A's frame; as it is while the placement is unknown."""
    if a_from_b is None:
        return place
    x, y, z = place
    return [a * x + b * y + c * z + d for a, b, c, d in a_from_b]


def _differing(one: Array, other: Array) -> float:
    """The median difference of the lengths of two people's bones, as a share; NaN if unknown."""
    ratio = np.abs(one / other - 1.0)
    ratio = ratio[np.isfinite(ratio)]
    return float(np.median(ratio)) if len(ratio) else np.nan
