"""The points that show a gait, at an even rate."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fusion.body import Body
from fusion.support.types import Array
from recordings.gait import Turn

RATE = 100.0  # Hz, of the points that are filtered
_CUT_OFF = 6.0  # Hz, as in the source
_WINDOW = 0.35  # seconds, standard deviation: over about a stride, hips and shoulders swing no more
_TURN = 0.2  # seconds, standard deviation: a turn is not longer by it, and the swing of a stride no turn
ERRORS_LAST = 0.16  # seconds, by hand on simulated walks
_SLOWEST = 0.06  # of the pelvis, lengths of the leg per second
_FORWARDS = math.cos(math.radians(50.0))  # between the directions of facing and of moving
_LONGEST_GAP = 0.3  # seconds without S*
_SHORTEST_GAP = 0.004  # seconds: two frames of one moment are one
_FARTHEST = 1000.0  # metres: what is farther is damaged
_SHORTEST = 1.0  # seconds of a part without gaps
_TRUNK = "HipLeft", "HipRight", "ShoulderLeft", "ShoulderRight"
_FEET = "AnkleLeft", "AnkleRight", "FootLeft", "FootRight"
_FEWEST_FRAMES = 3
_TURNING = math.radians(15.0)  # per second
_LEAST = math.radians(45.0)
_SECONDS = 0.5, 10.0
_PAUSE = 0.5  # seconds, of hips and shoulders within a turn


class Part(NamedTuple):
    """Movement without gaps, at an even rate and filtered. Positions are projected onto the floor."""

    t: Array  # (n,) seconds
    frame_seconds: float  # between the frames that it is from
    leg: float  # metres
    pelvis: Array  # (n, 2)
    ankles: Array  # (2, n, 2)
    toes: Array  # (2, n, 2); the ankles where toes are unknown
    toe_heights: Array  # (2, n) metres; NaN where toes are unknown
    pelvis_error: Array  # (n,)
    ankle_errors: Array  # (2, n)
    toe_errors: Array  # (2, n)
    facing: Array  # (n, 2) metres, as wide as hips and shoulders together
    facing_error: Array  # (n,)
    speed: Array  # (n,) metres per second of the pelvis over about a stride
    direction: Array  # (n, 2) of that
    moving: NDArray[np.bool_]  # (n,) whether the pelvis does
    forwards: NDArray[np.bool_]  # (n,) whether that is where the person faces


def parts_of(
    body: Body, seconds: Array, positions: NDArray[np.floating], up: Array, sigma: ArrayLike | None
) -> Iterator[Part]:
    from scipy.interpolate import CubicSpline
    from scipy.signal import sosfiltfilt  # loads for a second

    up = up / np.linalg.norm(up)
    across = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    across /= np.linalg.norm(across)
    floor = np.stack([across, np.cross(up, across)], axis=1)
    joints = [body.joint(name) for name in _TRUNK + _FEET]
    points = np.array(positions[:, joints], dtype=np.float64)
    errors = np.full(points.shape[:2], np.nan)
    if sigma is not None:
        errors = np.asarray(sigma, dtype=np.float64)[:, joints] / math.sqrt(3.0)
    points[~(np.abs(points) < _FARTHEST).all(axis=2)] = np.nan  # a damaged file has any numbers
    hidden = np.asarray(np.isnan(points[:, 6:]).any(axis=2))
    points[:, 6:] = np.where(hidden[..., None], points[:, 4:6], points[:, 6:])
    facing = np.cross(np.nan_to_num(points[:, 0:4:2] - points[:, 1:4:2]).sum(axis=1), up)
    ground = np.stack([0.5 * (points[:, 0] + points[:, 1]), facing, *points[:, 4:].swapaxes(0, 1)], axis=1)
    legs = np.linalg.norm(points[:, :2] - points[:, 4:6], axis=2).mean(axis=1)
    columns = np.concatenate([(ground @ floor).reshape(len(seconds), 12), points[:, 6:] @ up, errors], axis=1)
    known = np.flatnonzero(np.isfinite(columns[:, :14]).all(axis=1))
    steps = np.diff(seconds[known], prepend=-math.inf)
    known = known[(steps > _SHORTEST_GAP) | (steps < 0.0)]
    steps = np.diff(seconds[known])
    gaps = np.flatnonzero((steps > _LONGEST_GAP) | (steps < 0.0)) + 1  # or a clock was reset
    for part in np.split(known, gaps):
        if len(part) < _FEWEST_FRAMES or seconds[part[-1]] - seconds[part[0]] < _SHORTEST:
            continue
        t = np.arange(seconds[part[0]], seconds[part[-1]], 1.0 / RATE)
        # straight lines would cut the turning points of an ankle at ten frames per second
        even = CubicSpline(seconds[part], columns[part, :14])(t)
        filtered = sosfiltfilt(_low_pass(), even, axis=0).reshape(-1, 7, 2)
        pelvis, facing, *feet, heights = filtered.swapaxes(0, 1)
        of_trunk, of_feet = np.split(
            np.array([np.interp(t, seconds[part], column) for column in columns[part, 14:].T]), [4]
        )
        lost = np.array([np.interp(t, seconds[part], of_foot) for of_foot in hidden[part].T]) > 0.0
        velocity = np.gradient(pelvis, 1.0 / RATE, axis=0)
        mean = _smoothed(velocity)
        direction = mean / np.maximum(np.linalg.norm(mean, axis=1), 1e-9)[:, None]
        # the mean of what is along the way: in a curve the mean velocity is shorter
        speed = _smoothed(np.sum(velocity * direction, axis=1))
        ahead = _smoothed(facing)
        facing = _smoothed(facing, _TURN)
        leg = float(np.median(legs[part]))
        yield Part(
            t,
            float(np.median(np.diff(seconds[part]))),
            leg,
            pelvis,
            np.array(feet[:2]),
            np.array(feet[2:]),
            np.where(lost, np.nan, heights.T),
            0.5 * np.hypot(*of_trunk[:2]),
            of_feet[:2],
            of_feet[2:],
            facing,
            np.sqrt(np.nansum(of_trunk**2, axis=0)) + 0.0 * of_trunk[0],
            speed,
            direction,
            speed > _SLOWEST * leg,
            np.sum(ahead * direction, axis=1) > _FORWARDS * np.linalg.norm(ahead, axis=1),
        )


@cache
def _low_pass() -> Array:
    from scipy.signal import butter

    return np.asarray(butter(2, _CUT_OFF, fs=RATE, output="sos"))


def _smoothed(values: Array, window: float = _WINDOW) -> Array:
    """Means over about a stride, or some seconds (standard deviation)."""
    from scipy.ndimage import gaussian_filter1d

    return np.asarray(gaussian_filter1d(values, window * RATE, axis=0, mode="nearest"))


def spans_of(mask: NDArray[np.bool_], pause: float) -> list[list[int]]:
    """From which sample to before which one a mask holds. Pauses in it of fewer samples count."""
    spans: list[list[int]] = []
    for begin, end in np.flatnonzero(np.diff(mask, prepend=False, append=False)).reshape(-1, 2).tolist():
        if spans and begin - spans[-1][1] < pause:
            spans[-1][1] = end
        else:
            spans.append([begin, end])
    return spans


def turns_of(part: Part) -> Iterator[Turn]:
    """The turns of a part, but for those that its ends cut.

    As El-Gohary et al. (2014) define them: a person turns faster than 15°/s, by 45° at least.
    """
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
