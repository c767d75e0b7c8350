"""The best place to stand, where both sensors see the whole person."""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from devices.findings.rules import TALL, farthest, nearest
from fusion.intrinsics import Intrinsics
from fusion.rigid import RigidTransform
from recordings.appearance.floor import height_of

ARM = 0.9
"""Metres from the trunk to a fingertip, arms out."""
_STEP = 0.1  # metres between the tested places
_TORSO_HEIGHT = 1.0  # metres above the floor
_THERE = 0.4  # metres from the middle of the ring
_TOES = 0.15  # metres that toes before the trunk look lower than the floor under it
_ENOUGH = 0.5  # metres of margin: a step. With as much, nearer is better: depth is more accurate there.
_TILTED = 20.0  # metres that a metre of a person beyond the upper or lower edge is worth
_MARGIN = 0.01  # metres that a metre of margin is worth: it decides between places that are as near


@dataclass(frozen=True)
class StandingSpot:
    """A place on the floor."""

    x: float  # metres in K_A's frame
    z: float
    room: float
    """Margin in metres at the tightest limit of either sensor; negative if the person is not fully
    visible."""
    away: float
    """Metres from the farther sensor."""

    def is_at(self, x: float, z: float) -> bool:
        """Whether a person at (x, z), metres in K_A's frame, stands here."""
        return math.hypot(x - self.x, z - self.z) <= _THERE


@lru_cache(maxsize=4)
def standing_spot(
    a_from_b: RigidTransform | None,
    cameras: tuple[Intrinsics, Intrinsics],
    body: str,
    a_from_floor: RigidTransform,
) -> StandingSpot:
    """Finds the nearest place with a step of margin, or the one with the largest margin.

    The limits of each sensor are its nearest and farthest distance, and the sides of the image for a person
    with both arms out. Places with head and feet in both images, as the sensors are tilted now, come first:
    no sensor has to be tilted there.

    Args:
        a_from_b: Transform K_A ← K_B; None if it is unknown, then only K_A counts.
        body: The name of the sensors' body, on which their range depends.
        a_from_floor: See :func:`recordings.appearance.floor.floor_frame`.
    """
    x, z = np.meshgrid(np.arange(-4.0, 4.0, _STEP), np.arange(0.5, 6.0, _STEP))
    up = -a_from_floor.rotation[:, 1]
    torso = np.stack((x, height_of(a_from_floor, x, z), z), axis=-1) + _TORSO_HEIGHT * up
    room, upright, away = (np.full(x.shape, each) for each in (np.inf, np.inf, 0.0))
    for a_from_k, camera in zip((RigidTransform.identity(), a_from_b), cameras, strict=True):
        if a_from_k is None:
            continue
        k_from_a = a_from_k.inverse()
        feet, middle, head = (
            k_from_a.apply((torso + of * up).reshape(-1, 3)).reshape(torso.shape)
            for of in (-_TORSO_HEIGHT - _TOES, 0.0, TALL - _TORSO_HEIGHT)
        )
        room = np.minimum(room, _room(middle, camera, farthest(body, camera)))
        upright = np.minimum(upright, _upright(feet, head, camera))
        away = np.maximum(away, middle[..., 2])
    lacking = _TILTED * np.maximum(0.0, -upright)
    cost = np.where(room >= min(_ENOUGH, room.max()), away - _MARGIN * room + lacking, np.inf)
    best = np.unravel_index(int(np.argmin(cost)), room.shape)
    return StandingSpot(float(x[best]), float(z[best]), float(room[best]), float(away[best]))


def _upright(feet: NDArray[np.float64], head: NDArray[np.float64], camera: Intrinsics) -> NDArray[np.float64]:
    """Metres from feet and head (…, 3) in the sensor's frame to the lower and the upper edge of the image."""
    below = feet[..., 2] * (camera.height - 0.5 - camera.cy) / camera.fy - feet[..., 1]
    above = head[..., 2] * camera.cy / camera.fy + head[..., 1]
    return np.asarray(np.minimum(below, above))


def _room(torso: NDArray[np.float64], camera: Intrinsics, far: float) -> NDArray[np.float64]:
    """Metres to the tightest limit, for torsos (…, 3) in the sensor's frame."""
    across, away = torso[..., 0], torso[..., 2]
    left = across + away * camera.cx / camera.fx
    right = away * (camera.width - camera.cx) / camera.fx - across
    limits = np.stack((away - nearest(camera), far - away, left - ARM, right - ARM))
    return np.asarray(limits.min(axis=0))
