"""Chooses the person to fuse: live, by following one of the people in view; of a recording, by id."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from devices.pairing import FramePair
from devices.sensor import DeviceError, SensorFrame
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
            return min(centres, key=lambda name: _bearing(centres[name]), default=None)
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


def _bearing(at: NDArray[np.float64]) -> float:
    return abs(float(np.arctan2(at[0], at[2])))


def choose_person(frames: Sequence[SensorFrame], wanted: str | None, source: str, flag: str) -> str:
    """The id of the person to follow: the one wanted, else the one seen in most frames.

    Raises:
        DeviceError: No one is in the recording, or not the person wanted.
    """
    seen = Counter(person for frame in frames for person in frame.people)
    if not seen:
        raise DeviceError(f"{source} has {len(frames)} frames and no person in any of them.")
    if wanted is None:
        return max(seen, key=lambda person: (seen[person], person))
    if wanted not in seen:
        raise DeviceError(
            f"{source} has no person {wanted!r}. It has "
            f"{', '.join(f'{person!r} ({n} frames)' for person, n in seen.most_common(8))}; "
            f"choose one with {flag}."
        )
    return wanted


def with_successors(frames: Sequence[SensorFrame], person: str) -> tuple[list[SensorFrame], tuple[str, ...]]:
    """Merges ids: people seen only while the followed person is absent get that person's id.

    A tracker assigns a new id to a person who returns. After the first person has left, the next one is
    followed. Returns the frames, and the other ids, the one seen longest first.
    """
    when: dict[str, set[int]] = {}
    for k, frame in enumerate(frames):
        for name in frame.people:
            when.setdefault(name, set()).add(k)
    taken, others = set(when[person]), []
    for name in sorted(when, key=lambda name: (-len(when[name]), name)):
        if taken.isdisjoint(when[name]):
            taken |= when[name]
            others.append(name)
    if not others:
        return list(frames), ()
    followed = []
    for frame in frames:
        successor = next((name for name in others if name in frame.people), None)
        if successor is not None:
            people = {name: who for name, who in frame.people.items() if name != successor}
            frame = replace(frame, people={person: frame.people[successor], **people})
        followed.append(frame)
    return followed, tuple(others)


def one_person(frames: Iterable[SensorFrame]) -> Iterator[SensorFrame]:
    """The frames with only the person followed from the start, under one id whatever the tracker's ids."""
    choice = PersonChoice()
    for frame in frames:
        person = choice.choose(frame.people, frame.time_ns)
        yield replace(frame, people={} if person is None else {FOLLOWED: person})
