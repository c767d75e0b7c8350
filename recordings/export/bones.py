"""Bones of constant length: a file with a skeleton holds one person, with the last calibration's lengths.

Frames with others, before a new calibration or of method ``published``, are shown with these: their bones
have the directions of S*.
"""

import math
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from fusion.body import Body
from fusion.calibration.bone_lengths import bone_lengths_of
from fusion.support.types import Array
from recordings.errors import RecordingError
from recordings.export import Writer
from recordings.session_series import SessionSeries

_KNOWN_S = 3.0  # longest time until a person's size is recognized
_SAME_M = 1e-4  # metres: differences by rounding, added up along the bones


def written(writer: Writer, one_skeleton: bool, session: SessionSeries, *paths: Path) -> str:
    """Writes files, and says which of its bones are not those of S*, or change.

    Raises:
        RecordingError: It has one skeleton, and there are two people.
    """
    if one_skeleton:
        check_one_person(session)
    said = writer(session, *paths)
    others, error = other_lengths(session)
    if not others:
        return said
    off = f"their joints are up to {1e3 * error:.0f} mm off"
    whose = f"the file's: {off}" if one_skeleton else f"the last ones, by which {off}"
    return f"{said}; bones of {others} recorded frames have other lengths than {whose}"


def other_lengths(session: SessionSeries) -> tuple[int, float]:
    """The number of frames with other bone lengths than the last calibration's, and how far off, in metres,
    these can make a joint in them: the sum of the differences from the root on.
    """
    body, last = session.body, session.calibration.bone_lengths
    count, largest = 0, 0.0
    for rows in session.rows.parts():
        off = np.abs(bone_lengths_of(body, rows.fused) - last)
        off[:, body.root] = 0.0
        for joint in body.order[1:]:
            off[:, joint] += off[:, body.parents[joint]]
        worst = off.max(axis=1)
        others = worst[worst > _SAME_M]
        count, largest = count + len(others), max(largest, float(others.max(initial=0.0)))
    return count, largest


def check_one_person(session: SessionSeries) -> None:
    """Raises RecordingError where S* has the bones of two people.

    Spans of less than three seconds do not count. It takes up to three seconds to recognize that a
    calibration from a file is of another person.
    """
    known, people = session.first_calibrated_frame or 0, session.people
    ends = [*(each.seconds[0] for each in people[1:]), math.inf]
    begins = [session.time[max(each.first, known)] for each in people]
    times = zip(people, begins, ends, strict=True)
    lasting = [each for each, begin, end in times if end - begin >= _KNOWN_S]
    for each in lasting[1:]:
        if each.person != lasting[0].person:
            raise RecordingError(
                f"{session} shows another person from {each.seconds[0]:.1f} s on, and this format has "
                "one skeleton. Export the parts that `duplex trim` makes, or a table."
            )


def lasting(session: SessionSeries) -> Callable[[Array], Array]:
    """Gives (T, J, 3) positions of S* the last lengths, where not all frames have them."""
    if not other_lengths(session)[0]:
        return lambda positions: positions
    return partial(with_lengths, session.body, lengths=session.calibration.bone_lengths)


def with_lengths(body: Body, positions: Array, lengths: Array) -> Array:
    """(T, J, 3) with the directions of bones, and with (J,) other lengths."""
    found = positions.copy()
    for joint in body.order[1:]:
        parent = body.parents[joint]
        bone = positions[:, joint] - positions[:, parent]
        length = np.linalg.norm(bone, axis=1, keepdims=True)
        found[:, joint] = found[:, parent] + lengths[joint] / np.maximum(length, 1e-9) * bone
    return found
