"""How likely positions are those of a person before a sensor, by the axes and the unit of their file.

A hypothesis is one of 48 axes (which of the file's are x right, y down and z forward) and one of five units.
Its log likelihood adds up what a body that moves before a sensor tells:

* **size**: bones are as long as a person's;
* **place**: the person is in the image, 0.5 to 6 m away;
* **posture**: trunk, legs and head point up in some frames at least; or the person lies: level, not
  above the sensor, rather on the back, and staying in one place. Nobody rises and sinks much. In one file of
  who lies, a sensor on its side and somebody who stands fit alike;
* **side**: toes, face, knees and hands are in front of the plane that the names of left and right span, the
  person rather looks at the sensor and walks forward. Only this distinguishes a person from the mirror image.

Nothing of it depends on one frame: each part is a mean over those of a sample.
"""

import re
import warnings

import numpy as np

from devices.skeletons.stated_format import MATRICES, SIGNED
from fusion.body import ADULT_HEIGHT, Body
from fusion.support.types import Array

_HANDED = np.rint(np.linalg.det(MATRICES))

_STATURE, _SIZES = 1.4, 0.17  # metres, the middle of all people, with children; deviation of the logarithm
_WIDE, _HIGH = 0.45, 0.45  # the person's usual place in the image, as tangents
_NEAR, _FAR, _BEYOND = 0.5, 6.0, 0.25
_LEANING = 0.35  # radians from the vertical, of people and sensors
_UPRIGHT, _ENOUGH = 0.002, 0.3  # of the frames: counts as none, and as all
_BELOW = -0.1, 0.2  # statures of who lies below the sensor, and its deviation
_STILL, _MOVES = 0.1, 1.5  # statures; log odds at most, so that no movement alone decides
_RISES = 0.3  # statures up and down, of who squats or sits down
_ALL, _NOTHING = 0.95, 0.0005  # of the frames; statures: rounding to millimetres, and no sway of who stands
_LEAST = -12.0  # log likelihood of what cannot be
_FEWEST_BONES = 3
_LARGEST = 1e9  # in any unit; a larger number is an error
_PARTS = re.findall(r"\w+", "shoulder hip knee ankle foot elbow wrist thumb head eye ear nose")
_UP = {("hip", "shoulder"): 1.0, ("ankle", "hip"): 1.0, ("shoulder", "head"): 1.0, ("elbow", "shoulder"): 0.1}
"""Joints, those above them in a person who stands, and the weight of it."""
_ACROSS = {"shoulder": 1.0, "hip": 1.0, "knee": 0.1, "elbow": 0.1, "ear": 0.1, "eye": 0.1}
_IN_FRONT = {
    ("ankle", "foot"): 9.0, ("ear", "eye"): 6.0, ("head", "nose"): 6.0, ("wrist", "thumb"): 1.0,
    ("shoulder", "wrist"): 2.0, ("hip", "knee", "ankle"): 1.0, ("wrist", "elbow", "shoulder"): -1.0,
}  # fmt: skip
"""Joints, those in front of them or to which others bend, and the weight of it, as log odds."""
_FAR_IN_FRONT = 0.03  # statures
_FACES, _WALKS, _SURELY = 1.6, 2.0, 0.3  # log odds, and the cosine and statures per second that tell it


def is_relative(body: Body, positions: Array) -> bool:
    """Whether a coordinate of the person's hips is 0 in all frames (T, J, 3)."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        hips = np.abs(np.nanmean(_both(body, positions, "hip"), axis=1))
        usual = np.nanquantile(hips, _ALL, axis=0) / (stature_of(body, positions) or np.nan)
    return bool((usual < _NOTHING).any())


def axes_likelihood(body: Body, seconds: Array, positions: Array) -> tuple[float | None, float, Array, Array]:
    """What frames of a person, as a file has them, tell of the unit and the axes.

    Args:
        seconds: (T,) times of the frames.
        positions: (T, J, 3) as the file has them; NaN where a joint was not seen.

    Returns:
        The person's stature, None if too few bones were seen; the distance from the origin; (2, 48) log
        likelihood of :data:`SIGNED` but for the size, of a person who stands and who lies; and (48, 3) by
        each of these, the direction of gravity in the body's frame: up, to the front, to the left.
    """
    stature = stature_of(body, positions)
    at = np.where(np.abs(positions) < _LARGEST, positions, np.nan) / (stature or 1.0)
    with warnings.catch_warnings(), np.errstate(invalid="ignore", divide="ignore"):
        warnings.simplefilter("ignore", RuntimeWarning)  # frames in which joints are not seen
        both = {part: _both(body, at, part) for part in _PARTS}
        middle = {part: np.nanmean(pair, axis=1) for part, pair in both.items()}
        up = _unit(
            np.nansum(
                [weight * _unit(middle[high] - middle[low]) for (low, high), weight in _UP.items()], axis=0
            )
        )
        across = np.nansum(
            [weight * (both[part][:, 0] - both[part][:, 1]) for part, weight in _ACROSS.items()], axis=0
        )
        front = _unit(np.cross(across, up))
        centre = np.nanmean(np.concatenate([both["hip"], both["shoulder"]], axis=1), axis=1)
        speed = np.full_like(centre, np.nan)
        speed[1:-1] = (centre[2:] - centre[:-2]) / (seconds[2:] - seconds[:-2])[:, None]
        found = [
            (_offset(*(both[part] for part in parts)) / _FAR_IN_FRONT, weight)
            for parts, weight in _IN_FRONT.items()
        ]
        found += [
            (-_unit(centre) / _SURELY, _FACES),
            ((speed - up * np.sum(speed * up, axis=1, keepdims=True)) / _SURELY, _WALKS),
        ]
        shares = [weight * np.nanmean(np.tanh(np.sum(way * front, axis=1))) for way, weight in found]
        known = np.isfinite(centre + up).all(axis=1)
        centre, up, front = centre[known], up[known], front[known]
        if not len(centre):
            return stature, np.nan, np.zeros((2, len(SIGNED))), np.zeros((len(SIGNED), 3))
        right, down, forward = np.moveaxis(MATRICES, 1, 0)
        away = centre @ forward.T
        place = -0.5 * ((centre @ right.T / away / _WIDE) ** 2 + (centre @ down.T / away / _HIGH) ** 2)
        place = np.where(away > 0.0, np.maximum(place, _LEAST), _LEAST).mean(axis=0)
        gravity = np.stack([up @ down.T, _HANDED * (front @ down.T), _unit(across)[known] @ down.T])
        upright = np.mean(_along(-gravity[0]), axis=0)
        stands = np.log(np.minimum(upright, _ENOUGH) / _ENOUGH + _UPRIGHT)
        on_back = np.nan_to_num(np.nanmean(_along(-gravity[1]), axis=0))
        level = np.mean(_along(np.sqrt(1.0 - np.minimum(gravity[0] ** 2, 1.0))), axis=0)
        below = np.median(centre @ down.T, axis=0)
        of_body = np.nan_to_num(np.nanmean(gravity, axis=1)).T
    moves = 2.0 * np.linalg.norm(np.std(centre, axis=0))
    rises = -0.5 * (2.0 * np.std(centre @ down.T, axis=0) / _RISES) ** 2
    lies = np.log(level * (1.0 + on_back) / 2.0 + _UPRIGHT) - np.logaddexp(
        0.0, (_BELOW[0] - below) / _BELOW[1]
    )
    lies -= _MOVES * moves**2 / (moves**2 + _STILL**2)
    mirrored = np.maximum(0.0, -np.nansum(shares) * _HANDED)
    distance = (stature or np.nan) * float(np.median(np.linalg.norm(centre, axis=1)))
    return stature, distance, place + np.maximum([stands + rises, lies + rises], _LEAST) - mirrored, of_body


def size_likelihood(stature: float) -> float:
    """Log likelihood of a unit by how tall the person is in it, metres."""
    return float(-0.5 * (np.log(stature / _STATURE) / _SIZES) ** 2)


def place_likelihood(away: float) -> float:
    """Log likelihood of a person's distance, metres."""
    return float(
        np.nan_to_num(-0.5 * (np.log(away / np.clip(away, _NEAR, _FAR)) / _BEYOND) ** 2, neginf=_LEAST)
    )


def stature_of(body: Body, positions: Array) -> float | None:
    """How tall the person is, in the unit of (N, J, 3) positions; None if too few bones were seen.

    It is the median over the bones, so that some joints may have any place.
    """
    bones = body.bone_joints
    at = np.where(np.abs(positions) < _LARGEST, positions, np.nan)
    length = np.linalg.norm(at[:, bones] - at[:, body.parent_indices[bones]], axis=2)
    length[length == 0.0] = np.nan
    seen = np.isfinite(length).any(axis=0)
    if seen.sum() < _FEWEST_BONES:
        return None
    nominal = body.nominal_lengths[bones[seen]]
    ratio = np.nanmedian(length[:, seen], axis=0) / nominal
    order = np.argsort(ratio)
    middle = np.searchsorted(np.cumsum(nominal[order]), 0.5 * nominal.sum())
    return ADULT_HEIGHT * float(ratio[order[middle]])


def _both(body: Body, at: Array, part: str) -> Array:
    """(T, 2, 3) the left and the right joint, or the only one; NaN where the body has none."""
    joints = (body.find(f"{part} {side}") for side in ("left", "right"))
    found = [body.find(part) if joint is None else joint for joint in joints]
    nothing = np.full_like(at[:, 0], np.nan)
    return np.stack([nothing if joint is None else at[:, joint] for joint in found], axis=1)


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def _along(cosine: Array) -> Array:
    """How near directions are to one, by the cosine of their angles, 0 to 1."""
    return np.exp((cosine - 1.0) / _LEANING**2)


def _offset(first: Array, joint: Array, last: Array | None = None) -> Array:
    """(T, 3) mean offset of both sides' joints (T, 2, 3) from others, or from the line between two others."""
    away = joint - first
    if last is not None:
        line = last - first
        away -= line * np.sum(away * line, axis=2, keepdims=True) / np.sum(line**2, axis=2, keepdims=True)
    return np.asarray(np.nanmean(away, axis=1))
