"""The best place to stand, where both sensors see the whole person."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from devices.findings.rules import farthest, nearest
from fusion.intrinsics import Intrinsics
from fusion.rigid import RigidTransform

ARM = 0.9
"""Metres from the trunk to a fingertip, arms out."""
_STEP = 0.1  # metres between the tested places
_TORSO_HEIGHT = 1.0  # metres above the floor
_THERE = 0.4  # metres from the middle of the ring
_ENOUGH = 0.5  # metres of margin: a step. With as much, nearer is better: depth is more accurate there.
_MARGIN = 0.01  # metres that a metre of margin is worth: it decides between places that are as near


@dataclass(frozen=True)
class StandingSpot:
    """A place on the floor."""

    x: float  # metres in K_A's frame
    z: float
    room: float
    """Margin in metres at the tightest limit of either sensor; negative if the person is not fully
    visible."""

    def is_at(self, x: float, z: float) -> bool:
        """Whether a person at (x, z), metres in K_A's frame, stands here."""
        return math.hypot(x - self.x, z - self.z) <= _THERE


def standing_spot(
    a_from_b: RigidTransform | None, cameras: tuple[Intrinsics, Intrinsics], body: str, floor: float
) -> StandingSpot:
    """Finds the nearest place with a step of margin, or the one with the largest margin.

    The limits of each sensor are its nearest and farthest distance, and the sides of the image for a person
    with both arms out. K_A is assumed to be upright: the floor is a plane of equal y.

    Args:
        a_from_b: Transform K_A ← K_B; None if it is unknown, then only K_A counts.
        body: The name of the sensors' body, on which their range depends.
        floor: y of the floor in K_A's frame.
    """
    x, z = np.meshgrid(np.arange(-4.0, 4.0, _STEP), np.arange(0.5, 6.0, _STEP))
    torso = np.stack((x, np.full_like(x, floor - _TORSO_HEIGHT), z), axis=-1)
    room, away = _room(torso, cameras[0], farthest(body, cameras[0])), z
    if a_from_b is not None:
        in_b = a_from_b.inverse().apply(torso.reshape(-1, 3)).reshape(torso.shape)
        room = np.minimum(room, _room(in_b, cameras[1], farthest(body, cameras[1])))
        away = np.maximum(away, in_b[..., 2])
    enough = np.where(room >= min(_ENOUGH, room.max()), away, np.inf)
    best = np.unravel_index(int(np.argmin(enough - _MARGIN * room)), room.shape)
    return StandingSpot(float(x[best]), float(z[best]), float(room[best]))


def _room(torso: NDArray[np.float64], camera: Intrinsics, far: float) -> NDArray[np.float64]:
    """Metres to the tightest limit, for torsos (…, 3) in the sensor's frame."""
    across, away = torso[..., 0], torso[..., 2]
    left = across + away * camera.cx / camera.fx
    right = away * (camera.width - camera.cx) / camera.fx - across
    limits = np.stack((away - nearest(camera), far - away, left - ARM, right - ARM))
    return np.asarray(limits.min(axis=0))
