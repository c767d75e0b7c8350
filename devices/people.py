"""Chooses the person to fuse: live, by following one of the people in view; of a recording, by id."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from devices.pairing import FramePair
from devices.sensor import DeviceError, SensorFrame
from fusion.body import Body
from fusion.large_arrays import Rows
from fusion.pair_arrays import View, view_of
from fusion.rigid import RigidTransform
from fusion.skeleton import Skeleton

_REACH_M = 0.4  # how far a body's centre may be off from frame to frame: tracker noise and a step
_SPEED_M_S = 4.0  # speed of a running person
_HOLD_S = 2.0  # how long to wait for a person who is out of sight
FOLLOWED = "followed"
"""The id of the person that :func:`one_person` follows."""


class PersonChoice:
    """Follows one person of one sensor.

    The first choice is the person nearest to the centre of the view. The person is then followed by the
    tracker's id, as long as the id stays with the body, else by the last position of the body: trackers
    assign a new id after an occlusion, and swap the ids of two people who pass each other. A person out of
    sight is waited for; after two seconds a new person is chosen.

    Attributes:
        identity: The tracker's id of the person followed; None before the first.
        position: (3,) where the person was when chosen last, metres; None before the first.
    """

    def __init__(self) -> None:
        self.identity: str | None = None
        self.position: NDArray[np.float64] | None = None
        self._time_ns = 0

    def choose(
        self, people: Mapping[str, Skeleton], time_ns: int, at: NDArray[np.float64] | None = None
    ) -> Skeleton | None:
        """The followed person's skeleton in this frame; None while they are out of sight.

        Args:
            at: (3,) position of the person as seen by the other sensor, metres in this sensor's frame; None
                if unknown. The person nearest to it is chosen.
        """
        centres = {name: seen for name, person in people.items() if (seen := centre(person)) is not None}
        chosen: str | None
        if at is not None and len(centres) > 1:
            chosen = min(centres, key=lambda name: float(np.linalg.norm(centres[name] - at)))
        else:
            chosen = self._follow(centres, time_ns)
        if chosen is None:
            return None
        self.identity, self.position, self._time_ns = chosen, centres[chosen], time_ns
        return people[chosen]

    def _follow(self, centres: Mapping[str, NDArray[np.float64]], time_ns: int) -> str | None:
        elapsed_s = (time_ns - self._time_ns) / 1e9
        if self.position is None or elapsed_s < 0 or elapsed_s > _HOLD_S:
            # The bearing from the optical axis: what is central in the image, near or far.
            return min(
                centres, key=lambda name: abs(np.arctan2(centres[name][0], centres[name][2])), default=None
            )
        last, reach = self.position, _REACH_M + _SPEED_M_S * elapsed_s
        distance = {name: float(np.linalg.norm(at - last)) for name, at in centres.items()}
        near = [name for name in distance if distance[name] <= reach]
        if not near:
            return None
        nearest = min(near, key=distance.__getitem__)
        own = self.identity
        # The id decides if its body is within reach of the last position. If its body has jumped and
        # another body is at the last position, the ids were swapped.
        if own in near and (distance[own] <= _REACH_M or distance[nearest] > _REACH_M / 2):
            return own
        return nearest


class PersonOfPair:
    """Follows one person in two views; the same person in both, once the sensors' placement is known."""

    def __init__(self) -> None:
        self._a, self._b = PersonChoice(), PersonChoice()

    def chosen(self, pair: FramePair, b_from_a: RigidTransform | None = None) -> FramePair:
        """The pair with the skeletons of the person followed; ``b_from_a`` once a calibration is settled."""
        seen_a, position = _chosen(self._a, pair.a)
        in_b = None if b_from_a is None or position is None else b_from_a.apply(position)
        seen_b, _ = _chosen(self._b, pair.b, in_b)
        return replace(pair, skeletons=replace(pair.skeletons, a=seen_a, b=seen_b))


def _chosen(
    choice: PersonChoice, frame: SensorFrame | None, at: NDArray[np.float64] | None = None
) -> tuple[Skeleton | None, NDArray[np.float64] | None]:
    """The person's skeleton in a frame, and where it is."""
    person = None if frame is None else choice.choose(frame.people, frame.time_ns, at)
    return person, None if person is None else choice.position


def centre(person: Skeleton) -> NDArray[np.float64] | None:
    """(3,) where the body is: the mean of its torso's joints; of all if none of those is tracked."""
    torso = person.positions[list(person.body.torso)].astype(np.float64)
    seen = torso[np.isfinite(torso).all(axis=1)]
    if len(seen) == 0:
        seen = person.positions[person.has_position].astype(np.float64)
    return None if len(seen) == 0 else seen.mean(axis=0)


@dataclass(frozen=True, eq=False, repr=False)
class RecordedPeople(Rows[SensorFrame]):
    """The frames of a recording without images, as arrays; each frame is made when it is asked for."""

    body: Body
    time_ns: NDArray[np.int64]  # (T,) the frames' times, in order
    ids: Sequence[str]  # the tracker's ids of the people
    frame: NDArray[np.int64]  # (N,) of each skeleton: number of its frame, in order
    person: NDArray[np.int64]  # (N,) index of its id
    skeletons: View  # N rows

    @staticmethod
    def of(body: Body, frames: Iterable[SensorFrame]) -> RecordedPeople:
        """Frames in the order of time; their images are not kept."""
        numbers: dict[str, int] = {}
        times: list[int] = []
        people: list[tuple[int, int]] = []

        def skeletons() -> Iterator[Skeleton]:
            for number, frame in enumerate(frames):
                times.append(frame.time_ns)
                for name, skeleton in frame.people.items():
                    people.append((number, numbers.setdefault(name, len(numbers))))
                    yield skeleton

        seen = view_of(body, skeletons())
        frame, person = np.array(people, dtype=np.int64).reshape(-1, 2).T
        return RecordedPeople(body, np.array(times, dtype=np.int64), list(numbers), frame, person, seen)

    def __len__(self) -> int:
        return len(self.time_ns)

    def row(self, k: int) -> SensorFrame:
        first, end = np.searchsorted(self.frame, (k, k + 1)).tolist()
        people = {self.ids[self.person[i]]: self.skeletons.row(self.body, i) for i in range(first, end)}
        return SensorFrame(int(self.time_ns[k]), people)

    @property
    def crowded(self) -> bool:
        """Whether a frame has several people."""
        return bool((self.frame[1:] == self.frame[:-1]).any())

    def only(self, name: str) -> RecordedPeople:
        """The frames with one person."""
        rows = self.rows_of([name])
        skeletons = self.skeletons.chosen_whole(rows) if len(rows) else self.skeletons
        return replace(self, ids=[name], frame=self.frame[rows], person=0 * rows, skeletons=skeletons)

    def rows_of(self, names: Sequence[str]) -> NDArray[np.int64]:
        """The skeletons that have these ids."""
        return np.flatnonzero(np.isin(self.person, [self.ids.index(name) for name in names]))

    def view(self, names: Sequence[str]) -> View:
        """The frames with one person, who has these ids one after the other."""
        return self.view_of(self.rows_of(names))

    def view_of(self, rows: NDArray[np.int64]) -> View:
        """The frames with one person, whose skeletons are these, at most one in a frame."""
        index = np.full(len(self), -1, dtype=np.int64)
        index[self.frame[rows]] = rows
        if len(rows) == len(self) == len(self.frame):
            return self.skeletons._replace(time_ns=self.time_ns)
        return self.skeletons.chosen_whole(index)._replace(time_ns=self.time_ns)

    def choose_person(self, wanted: str | None, source: str, flag: str) -> str:
        """The id of the person to follow: the one wanted, else the one seen in most frames.

        Raises:
            DeviceError: No one is in the recording, or not the person wanted.
        """
        counts = np.bincount(self.person, minlength=len(self.ids)).tolist()
        seen = Counter(dict(zip(self.ids, counts, strict=True)))
        if not seen:
            raise DeviceError(f"{source} has {len(self)} frames and no person in any of them.")
        if wanted is None:
            return max(seen, key=lambda person: (seen[person], person))
        if wanted not in seen:
            raise DeviceError(
                f"{source} has no person {wanted!r}. It has "
                f"{', '.join(f'{person!r} ({n} frames)' for person, n in seen.most_common(8))}; "
                f"choose one with {flag}."
            )
        return wanted

    def successors(self, person: str) -> tuple[str, ...]:
        """The ids of people seen only while the followed person is absent, the one seen longest first.

        A tracker assigns a new id to a person who returns. After the first person has left, the next one is
        followed.
        """
        when = {name: self.frame[self.person == k] for k, name in enumerate(self.ids)}
        taken, others = np.zeros(len(self), dtype=bool), []
        for name in sorted(when, key=lambda name: (name != person, -len(when[name]), name)):
            if not taken[when[name]].any():
                taken[when[name]] = True
                others.append(name)
        return tuple(others[1:])


def one_person(frames: Iterable[SensorFrame]) -> Iterator[SensorFrame]:
    """The frames with only the person followed from the start, under one id whatever the tracker's ids."""
    choice = PersonChoice()
    for frame in frames:
        person = choice.choose(frame.people, frame.time_ns)
        yield replace(frame, people={} if person is None else {FOLLOWED: person})
