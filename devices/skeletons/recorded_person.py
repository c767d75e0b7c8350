"""Chooses the person of a recording."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

from devices.sensor import DeviceError, SensorFrame


def choose_person(frames: Sequence[SensorFrame], wanted: str | None, source: str, flag: str) -> str:
    """The id of the person to follow: the one wanted, else the one seen in most frames.

    Args:
        frames: All frames of a recording.
        wanted: An id from the recording; None leaves the choice open.
        source: The recording's name, for the message.
        flag: The option that names a person, for the message.

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
    followed.

    Args:
        frames: All frames of a recording.
        person: The id to follow.

    Returns:
        The frames, and the other ids, the one seen longest first.
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
