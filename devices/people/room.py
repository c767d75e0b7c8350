"""Who is who in two views, from one pair of frames to the next, live and recorded.

A person is a track in either view. Once the placement of the sensors is known, tracks of both views that are
in one place for a while are one person, and tracks that are far apart are two, also where each view has only
one. Before that, the only bodies of both views are one person. Where a track is new or in doubt, the body is
who the other view has in that place, else who was seen there last: by place, time and size.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import product

import numpy as np
from numpy.typing import NDArray

from devices.people.placement import SAME_M, one_movement, sizes
from devices.people.recorded_people import Follow
from devices.people.tracks import SPEED_M_S
from fusion.body import Body
from fusion.calibration.person_size import ANOTHER_SIZE
from fusion.rigid import RigidTransform

Place = Sequence[float]  # (3,) metres
Joints = NDArray[np.float32]  # (J, 3) metres

SECOND = 1_000_000_000
HOLD_NS, WAIT_NS = 2 * SECOND, 10 * SECOND
"""A person out of sight is waited for; after so long a newcomer is taken, and after so long anybody."""
_FORGET_NS = 6 * WAIT_NS  # somebody out of sight is no longer recognised
SURE_NS = 2 * SECOND // 10  # for so long two tracks are in one place, or are not
FAR_M = 2.0 * SAME_M  # of one person in two views, at most, where nobody else is there
_PLACE_SD_M, _ROOM_M = 0.1, 2.0
"""Deviations of a place: of two views, and more by a metre per second out of sight, up to the second."""
_REACH_M = 0.4  # how far somebody may be from where they were, beside what a running person covers
_BEHIND = 0.04  # radians that a metre counts for whom to follow
_EVERY = 100  # frames, between measurements of a size
_COMPARED_NS, _KEPT = SECOND // 10, 60  # pairs that tell a move of a sensor: 6 s, and 2 s at least


@dataclass(frozen=True, slots=True)
class Seen:
    """The bodies of one frame of a view: those that have a place."""

    names: Sequence[object]
    joints: Sequence[Joints]
    tracks: Sequence[int]
    doubtful: Sequence[bool]
    places: Sequence[Place]  # in the sensor's frame


NOBODY, NO_FRAME = Seen((), (), (), (), ()), Seen((), (), (), (), ())


@dataclass(eq=False, slots=True)
class Sight:
    """What one view has of a person."""

    now: int | None = None  # which body of this frame
    track: int | None = None
    since_ns: int = 0  # when the track was found to be theirs
    place: Place | None = None  # the last one
    seen_ns: int = -1  # before the first frame


@dataclass(eq=False, slots=True)
class Person:
    """Somebody in the room."""

    begun_ns: int
    sights: list[Sight] = field(default_factory=lambda: [Sight(), Sight()])
    size: float = math.nan  # logarithm of the scale of an adult
    beside: bool = False  # whether seen while the person followed was
    measured: int = 0  # frames in which they were seen
    paired: int = 0  # the same, of which both views have a frame
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
        self._one: dict[tuple[int, int], int] = {}  # of tracks of A and B: for how long they are one person's
        self._kept: dict[tuple[Person, Person], deque[tuple[int, Joints, Joints]]] = {}
        self._given: RigidTransform | None = None
        self._a_from_b: list[list[float]] | None = None  # (3, 4)
        self._time_ns, self._crowded_ns = 0, -WAIT_NS
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
        step_ns = min(time_ns - self._time_ns, SURE_NS)
        self._time_ns, self._seen = time_ns, seen
        self._at = seen[0].places, [_put_by(self._a_from_b, place) for place in seen[1].places]
        if max(map(len, self._at)) > 1:
            self._crowded_ns = time_ns
        left: list[tuple[int, int]] = []
        for view, of in enumerate(seen):
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
        self._compare(step_ns)
        for person in self.people:
            if person.now != (None, None):
                self._measure(person)
        self._choose()
        if self._a_from_b is not None and self.followed is not None:
            self._look_for_a_move(self.followed)

    @property
    def crowded(self) -> bool:
        """Whether a view has several bodies, or had a while ago."""
        return self._time_ns - self._crowded_ns <= HOLD_NS

    def _put(self, a_from_b: RigidTransform | None) -> None:
        rows = None if a_from_b is None else _rows_of(a_from_b)
        if rows is None or self._a_from_b is None or np.abs(np.subtract(rows, self._a_from_b)).max() > 0.1:
            self._one = {}  # not after a refinement
        self._a_from_b = rows

    def _own(self, person: Person, view: int, k: int) -> None:
        sight, of = person.sights[view], self._seen[view]
        sight.now = k
        if not of.doubtful[k]:
            sight.track, sight.since_ns = of.tracks[k], self._time_ns

    def _find(self, left: list[tuple[int, int]]) -> None:
        """Who bodies are whose tracks do not tell it: by the other view, else by place, time and size."""
        self._match(left)
        for view in (0, 1):
            for of, k in [each for each in left if each[0] == view]:
                self.people.append(Person(self._time_ns))
                self._own(self.people[-1], of, k)
                left.remove((of, k))
            self._match(left)  # those of B with newcomers of A
        self.people = [
            person
            for person in self.people
            if person is self.followed
            or person.now != (None, None)
            or self._time_ns - person.seen_ns < _FORGET_NS
        ]

    def _match(self, left: list[tuple[int, int]]) -> None:
        costs = [
            (self._cost(person, view, k), n, view, k)
            for view, k in left
            for n, person in enumerate(self.people)
            if person.now[view] is None
        ]
        for cost, n, view, k in sorted(costs):
            person = self.people[n]
            if cost == np.inf or (view, k) not in left or person.now[view] is not None:
                continue
            if self._cost(person, view, k) < np.inf:  # not elsewhere in the other view
                if self._a_from_b is None and person.sights[1 - view].place is not None:
                    person = self._only_in(person, view)
                self._own(person, view, k)
                left.remove((view, k))

    def _only_in(self, person: Person, view: int) -> Person:
        """The person of one view, who is no longer known to be that of the other."""
        rest = Person(person.begun_ns, size=person.size, beside=person.beside, measured=person.measured)
        rest.sights[1], person.sights[1] = person.sights[1], Sight()
        self.people.append(rest)
        return rest if view else person

    def _limit(self) -> float:
        """How far two views of one person may be apart."""
        return FAR_M if max(map(len, self._at)) < 2 else SAME_M

    def _cost(self, person: Person, view: int, k: int) -> float:
        """How unlike somebody a body is; infinite for another one."""
        other, place = person.now[1 - view], self._at[view][k]
        if other is not None and self._a_from_b is not None:
            far = math.dist(self._at[1 - view][other], place)
            a, b = (other, k) if view else (k, other)
            if far > self._limit() or self._known_ns(a, b) <= -SURE_NS:
                return np.inf
            return (far / _PLACE_SD_M) ** 2 / 2.0 + 2.0 * math.log(_PLACE_SD_M)
        by = view
        if self._a_from_b is not None and person.seen_ns > person.sights[view].seen_ns:
            by = 1 - view
        last = person.sights[by]
        if last.place is None:
            return np.inf
        seconds = (self._time_ns - last.seen_ns) / SECOND
        far = math.dist(_put_by(self._a_from_b, last.place) if by else last.place, place)
        if far > _REACH_M + SPEED_M_S * seconds:
            return np.inf
        sd = min(_PLACE_SD_M + seconds, _ROOM_M)
        if seconds > 1.0 and abs(self._size(view, k) - person.size) > ANOTHER_SIZE:
            return np.inf
        return (far / sd) ** 2 / 2.0 + 2.0 * math.log(sd)  # the error of a place on the floor

    def _size(self, view: int, k: int) -> float:
        return float(sizes(self._body, self._seen[view].joints[k][None])[0])

    def _measure(self, person: Person) -> None:
        person.measured += 1
        person.paired += not any(of is NO_FRAME for of in self._seen)
        for view, sight in enumerate(person.sights):
            if sight.now is None:
                continue
            sight.place, sight.seen_ns = self._seen[view].places[sight.now], self._time_ns
            if person.measured % _EVERY == 1:
                size = self._size(view, sight.now)
                if not math.isnan(size):
                    old = person.size
                    person.size = size if math.isnan(old) else old + 0.1 * (size - old)

    def _compare(self, step_ns: int) -> None:
        """Separates what two views have of different people, and joins what they have of one."""
        only: tuple[list[Person], list[Person]] = [], []
        both = []
        for person in self.people:
            in_a, in_b = person.now
            if in_a is not None and in_b is not None:
                both.append(person)
            elif in_a is not None or in_b is not None:
                only[in_a is None].append(person)
        if self._a_from_b is None:
            for person in both:
                person.together += 1
            alone = len(self._at[0]) == len(self._at[1]) == 1
            if alone and not self.crowded:
                for a, b in product(*only):
                    self._join(a, b)
            return
        apart = [[math.dist(a, b) for b in self._at[1]] for a in self._at[0]]
        one = self._one if len(self._one) < 100 else {}
        for (i, a_track), (j, b_track) in product(*(enumerate(of.tracks) for of in self._seen)):
            far = apart[i][j]
            if far <= SAME_M:
                now_ns = step_ns
            elif far > FAR_M or min(*apart[i], *(row[j] for row in apart)) <= SAME_M:
                now_ns = -step_ns
            else:
                now_ns = 0
            known_ns = one.get((a_track, b_track), 0) + now_ns
            one[a_track, b_track] = max(min(known_ns, SURE_NS), -HOLD_NS)
        self._one = one
        for person in both:
            self._judge(person, apart)
        near = [(a.now[0] or 0, b.now[1] or 0, a, b) for a, b in product(*only)]
        for i, j, a, b in sorted(near, key=lambda each: apart[each[0]][each[1]]):
            if self._known_ns(i, j) >= SURE_NS and a in self.people and b in self.people:
                self._join(a, b)

    def _known_ns(self, a: int, b: int) -> int:
        """For how long the tracks of two bodies are known to be one person's; less than 0: of two."""
        return self._one.get((self._seen[0].tracks[a], self._seen[1].tracks[b]), 0)

    def _judge(self, person: Person, apart: list[list[float]]) -> None:
        """Whether both views have one person; the later one is somebody else otherwise."""
        a, b = person.now[0] or 0, person.now[1] or 0
        if self.moved is not None and person is self.followed and self._given is not None:
            given = _put_by(_rows_of(self._given), self._seen[1].places[b])
            if math.dist(self._at[0][a], given) <= SAME_M:
                self.moved = None
                self._put(self._given)
                return
        if apart[a][b] <= SAME_M:
            person.together += 1
        elif (known_ns := self._known_ns(a, b)) <= -SURE_NS or (known_ns <= 0 and apart[a][b] > FAR_M):
            later = person.sights[person.sights[1].since_ns >= person.sights[0].since_ns]
            later.now = later.track = None

    def _join(self, one: Person, other: Person) -> None:
        """Both are one person: the one followed, or who was there first."""
        if other is self.followed or (one is not self.followed and other.begun_ns < one.begun_ns):
            one, other = other, one
        for view, sight in enumerate(other.sights):
            mine = one.sights[view]
            if sight.now is not None or (mine.now is None and sight.seen_ns > mine.seen_ns):
                one.sights[view] = sight
        one.size = other.size if math.isnan(one.size) else one.size
        one.together += other.together
        one.beside, one.measured = one.beside or other.beside, max(one.measured, other.measured)
        one.paired = max(one.paired, other.paired)
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
            elif followed.together or self._a_from_b is None or self._time_ns - followed.begun_ns < HOLD_NS:
                return
            else:  # one view has always had somebody whom the other does not see, such as a mirror image
                here = [person for person in here if 2 * person.together > followed.paired]
                changed = True
        elif followed is not None:
            away_ns = self._time_ns - followed.seen_ns
            if away_ns <= HOLD_NS:
                return
            changed = away_ns > WAIT_NS
            if not changed:
                alone = len(here) == 1  # another person, if their size differs
                here = [
                    of
                    for of in here
                    if not of.beside and (alone or not abs(of.size - followed.size) > ANOTHER_SIZE)
                ]
        if not here:
            return
        if self._follow == "longest":
            longest = max(person.measured for person in here)
            here = [person for person in here if person.measured >= longest]
        self.changed = changed
        self.followed = min(here, key=self._rank)
        for person in self.people:
            person.beside = person.now != (None, None)

    def _rank(self, person: Person) -> tuple[bool, float]:
        """Whom both views see comes first, or A before the placement is known; then who is central.

        That is the angle to the axis of a view that sees them. A mirror image is behind the person.
        """
        by = 0 if person.now[0] is not None else 1
        x, _, z = self._seen[by].places[person.now[by] or 0]
        first = by == 0 if self._a_from_b is None else None not in person.now
        return not first, abs(math.atan2(x, z)) + _BEHIND * z

    def _look_for_a_move(self, followed: Person) -> None:
        """Joins whom the other view has elsewhere, if another placement makes one movement of both.

        What one view has of the person followed, and the other view of somebody else, is compared.
        """
        a, b = followed.now
        kept = {}
        for other in self.people if (a is None) != (b is None) else ():
            k = other.now[a is not None]
            if other is followed or k is None or other.now[a is None] is not None:
                continue
            pairs = kept[followed, other] = self._kept.get((followed, other), deque(maxlen=_KEPT))
            if pairs and self._time_ns - pairs[-1][0] < _COMPARED_NS:
                continue
            at = (a if a is not None else k), (b if b is not None else k)
            pairs.append((self._time_ns, self._seen[0].joints[at[0]], self._seen[1].joints[at[1]]))
            if 3 * len(pairs) < _KEPT or 2 * pairs[-1][0] // SECOND == 2 * pairs[-2][0] // SECOND:
                continue
            _, p, q = zip(*pairs, strict=True)
            found = one_movement(self._body, np.array(p, np.float64), np.array(q, np.float64))
            if found is not None:
                self.moved = found
                self._put(found)
                self._join(followed, other)
                kept = {}
                break
        self._kept = kept


def _rows_of(a_from_b: RigidTransform) -> list[list[float]]:
    """(3, 4) [R | t]."""
    return np.column_stack((a_from_b.rotation, a_from_b.translation)).tolist()  # type: ignore[no-any-return]


def _put_by(a_from_b: list[list[float]] | None, place: Place) -> Place:
    """A place of B in K_A's frame; as it is while the placement is unknown."""
    if a_from_b is None:
        return place
    x, y, z = place
    return [a * x + b * y + c * z + d for a, b, c, d in a_from_b]
