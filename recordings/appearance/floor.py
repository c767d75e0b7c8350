"""The floor under the person, found from the ankles of S*.

Skeletons contain no floor. A standing person's trunk and legs give the vertical
(:mod:`fusion.facing.evidence`), and the lower ankle the height.
"""

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from fusion.body import Body
from fusion.facing.evidence import upright_direction
from fusion.rigid import RigidTransform
from recordings.data.session_arrays import SessionArrays

ANKLE = 0.08
"""Metres: height of an ankle above the floor."""
CAMERA_HEIGHT = 1.0
"""Metres: assumed height of a sensor above the floor until feet have been seen."""
_OVER = 300
"""Frames, 10 s: the floor is found from the last ones."""
_EVERY = 30
"""Frames between two findings."""
_ENOUGH = 10
"""Frames with both ankles, before the first finding."""
_MOVED, _TURNED = 0.03, math.radians(1.0)
"""Metres and radians: smaller changes are not reported."""
_LIES = 1.0
"""Radians: a vertical that is farther from the last one, and from that of a sensor that stands upright, is of
a person who lies."""
_CENTIMETRE = 0.01
_SAMPLES = 9000
"""Frames from which the floor of a session is found."""
_STEEP = math.cos(math.radians(3.0))
"""Cosine of the largest angle between gravity and the view's axis at which the axis counts as vertical."""


class FloorFinder:
    """Finds the floor while S* comes in.

    Attributes:
        a_from_floor: The newest floor, see :func:`floor_frame`.
    """

    def __init__(self, body: Body) -> None:
        self._body = body
        self._ankles = [body.joint("ankle left"), body.joint("ankle right")]
        self._recent: deque[NDArray[np.float64]] = deque(maxlen=_OVER)
        self._since = 0
        self.a_from_floor = LEVEL_FLOOR

    def add(self, fused: NDArray[np.floating]) -> bool:
        """Adds (T, J, 3) S* in K_A's frame, metres; returns whether the floor changed noticeably."""
        seen = np.isfinite(fused[:, self._ankles]).all(axis=(1, 2))
        whole = np.asarray(fused[seen], dtype=np.float64)
        self._recent.extend(whole[:: math.ceil(len(whole) / _OVER) or 1])
        self._since += len(fused)
        found = self.a_from_floor is not LEVEL_FLOOR
        if len(self._recent) < _ENOUGH or (self._since < _EVERY and found):
            return False
        self._since = 0
        new = find_floor(self._body, np.array(self._recent))
        moved = np.linalg.norm(new.translation - self.a_from_floor.translation)
        turned = new.angle_to(self.a_from_floor)
        if found and (
            min(turned, new.angle_to(LEVEL_FLOOR)) > _LIES or (moved < _MOVED and turned < _TURNED)
        ):
            return False
        self.a_from_floor = new
        return True


def find_floor(body: Body, fused: NDArray[np.float64]) -> RigidTransform:
    """K_A ← floor, from S* over some seconds.

    The vertical is :func:`fusion.facing.evidence.upright_direction`, and the height the median of the lower
    ankle's, less that of an ankle above the floor.

    Args:
        fused: (T, J, 3) metres in K_A's frame; both ankles are finite.
    """
    up = upright_direction(body, fused)
    ankles = fused[:, [body.joint("ankle left"), body.joint("ankle right")]]
    height = ANKLE - float(np.median((ankles @ up).min(axis=1)))
    return floor_frame(up, round(height / _CENTIMETRE) * _CENTIMETRE)


def floor_under(rows: SessionArrays) -> RigidTransform:
    """K_A ← floor of a whole session; level and at the assumed height where no frame has both ankles."""
    body, fused = rows.body, rows.fused[:: len(rows) // _SAMPLES + 1]
    ankles = [body.joint("ankle left"), body.joint("ankle right")]
    whole = fused[np.isfinite(fused[:, ankles]).all(axis=(1, 2))]
    return find_floor(body, whole) if len(whole) else LEVEL_FLOOR


def height_of(
    a_from_floor: RigidTransform, x: NDArray[np.float64], z: NDArray[np.float64]
) -> NDArray[np.float64]:
    """y of the floor at x and z, of one shape, metres in K_A's frame."""
    down, origin = a_from_floor.rotation[:, 1], a_from_floor.translation
    return np.asarray((down @ origin - down[0] * x - down[2] * z) / down[1])


def floor_frame(up: NDArray[np.float64], height: float) -> RigidTransform:
    """K_A ← floor. The floor's y is down along gravity, its z where K_A looks, its origin below K_A.

    The axes do not depend on how K_A is rolled. Where K_A looks straight down or up, z is where the top or
    the bottom of its image points.

    Args:
        up: (3,) unit vector against gravity in K_A's frame.
        height: Metres of K_A above the floor.
    """
    down = -up
    looks = np.array([0.0, 0.0, 1.0])
    if abs(down[2]) > _STEEP:
        looks = np.array([0.0, -np.sign(down[2]), 0.0])
    right = np.cross(down, looks)
    right /= np.linalg.norm(right)
    return RigidTransform.of(np.stack((right, down, np.cross(right, down)), axis=1), height * down)


LEVEL_FLOOR = floor_frame(np.array([0.0, -1.0, 0.0]), CAMERA_HEIGHT)
"""K_A ← floor of a sensor that stands upright, until feet have been seen."""
