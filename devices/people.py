"""Which person of a recording is meant."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

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
