"""The person's surface as capsules, and the visibility of joints behind it."""

from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from devices.depth.camera import project
from devices.simulated.imaging.rendering import capsule_depth, share_seen
from devices.simulated.person import anatomy
from devices.simulated.person.anatomy import INDEX, REFERENCE_HEIGHT
from devices.simulated.person.movements import MOTIONS
from fusion.body import Body
from fusion.intrinsics import Intrinsics
from fusion.support.types import Array


def _rows() -> list[tuple[int, int, float, float]]:
    rows = []
    table = Path(__file__).with_suffix(".txt").read_text(encoding="utf-8")
    for line in table.splitlines()[1:]:
        sides = ("LEFT", "RIGHT") if "_S " in line else ("",)
        for side in sides:
            first, second, share, radius = line.replace("_S ", f"_{side} ").split()
            rows.append((INDEX[first], INDEX[second], float(share), float(radius)))
    return rows


_ROWS = _rows()
_FROM = np.array([row[0] for row in _ROWS])
_TO = np.array([row[1] for row in _ROWS])
_SHARE = np.array([row[2] for row in _ROWS])
_RADIUS = np.array([row[3] for row in _ROWS])


def capsules(landmarks: Array, height: float = REFERENCE_HEIGHT) -> Array:
    """(K, 7) capsules of the person's surface: both ends and the radius, metres, in the landmarks' frame."""
    ends = landmarks[_FROM] + _SHARE[:, None] * (landmarks[_TO] - landmarks[_FROM])
    radii = _RADIUS[:, None] * (height / REFERENCE_HEIGHT)
    return np.concatenate((landmarks[_FROM], ends, radii), axis=1)


@cache
def flesh_over(body: Body) -> Array:
    """Returns (J,) the depth of each joint under the skin at reference height, metres; at least 15 mm.

    It is the lower quartile of the depth along the rays of a sensor: in the start-up pose, from in front and
    up to 60 degrees from either side.
    """
    standing = MOTIONS["startup"].landmarks(0.0)[0]
    joints, shapes = standing[anatomy.landmarks_of(body)], capsules(standing)
    before = []
    for azimuth in np.radians(np.linspace(-60.0, 60.0, 9)):
        away = _AFAR * np.array((np.sin(azimuth), 0.0, -np.cos(azimuth)))
        for joint in joints:
            seen_from = shapes - np.concatenate((joint + away, joint + away, (0.0,)))
            x, y, z = -away
            before.append(_AFAR * (1.0 - min(capsule_depth(x, y, z, shape) for shape in seen_from)))
    flesh: Array = np.maximum(np.percentile(np.reshape(before, (9, len(joints))), 25, axis=0), 0.015)
    return flesh


_AFAR = 3.0  # metres


def visibility(joints: Array, shapes: Array, flesh: Array, intrinsics: Intrinsics) -> NDArray[np.float64]:
    """(J,) the visible share of each joint's surface, 0 to 1, without rendering an image.

    Rays are cast from the sensor to a disc around the joint. A ray sees the joint if the first surface that
    it hits is the skin over the joint: the distance from there to the joint is at most the depth of the joint
    under the skin, ``flesh`` (J,), plus a margin. Joints (J, 3) and capsules (K, 7) are in the sensor's
    frame, metres; a joint outside the image is not visible.
    """
    seen = np.asarray(share_seen(np.ascontiguousarray(joints), np.ascontiguousarray(shapes), flesh))
    pixels = project(intrinsics, joints)
    with np.errstate(invalid="ignore"):
        inside = (pixels >= 0.0).all(axis=1) & (pixels[:, 0] < intrinsics.width)
        inside &= pixels[:, 1] < intrinsics.height
    return np.where(inside, seen, 0.0)
