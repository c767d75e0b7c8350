"""Turns, as El-Gohary et al. (2014) define them: a person turns faster than 15°/s, by 45° at least."""

import math
from collections.abc import Iterator

import numpy as np

from recordings.gait import Turn
from recordings.gait.parts import ERRORS_LAST, RATE, Part, spans_of

_TURNING = math.radians(15.0)  # per second
_LEAST = math.radians(45.0)
_SECONDS = 0.5, 10.0
_PAUSE = 0.5  # seconds, of hips and shoulders within a turn


def turns_of(part: Part) -> Iterator[Turn]:
    """The turns of a part, but for those that its ends cut."""
    facing = np.unwrap(np.arctan2(part.facing[:, 1], part.facing[:, 0]))
    rate = np.gradient(facing, 1.0 / RATE)
    bend = np.maximum(np.abs(np.gradient(rate, 1.0 / RATE)), 1e-9)
    error = part.facing_error / np.maximum(np.linalg.norm(part.facing, axis=1), 1e-9)
    for sign in (1.0, -1.0):
        for begin, end in spans_of(sign * rate > _TURNING, _PAUSE * RATE):
            angle, seconds = float(facing[end - 1] - facing[begin]), (end - begin) / RATE
            if begin and end < len(rate) and abs(angle) > _LEAST and _SECONDS[0] <= seconds <= _SECONDS[1]:
                ends = [begin, end]
                yield Turn(
                    begins=float(part.t[begin]),
                    seconds=seconds,
                    seconds_sigma=math.hypot(*(error[ends] / ERRORS_LAST / bend[ends])),
                    angle=angle,
                    angle_sigma=math.hypot(*error[ends]),
                )
