"""Landmarks of an image and its depth to joints in space."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fusion.intrinsics import Intrinsics

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Lifted:
    """Landmarks in space.

    Attributes:
        positions: (33, 3) metres, sensor frame.
        seen: (33,) whether a depth reading of the landmark's own surface gave its position.
        known: (33,) whether it has a position.
        size: The person's size relative to the network's mean person.
    """

    positions: Array
    seen: NDArray[np.bool_]
    known: NDArray[np.bool_]
    size: float


def rays(pixels: Array, intrinsics: Intrinsics) -> Array:
    """(N, 2) the points x/z, y/z that the camera images at (N, 2) pixels; the lens's distortion is undone."""
    matrix = np.array(
        ((intrinsics.fx, 0.0, intrinsics.cx), (0.0, intrinsics.fy, intrinsics.cy), (0.0, 0.0, 1.0))
    )
    if not intrinsics.distortion:
        return (pixels - matrix[:2, 2]) / (intrinsics.fx, intrinsics.fy)
    lens = np.zeros(8)
    lens[: len(intrinsics.distortion)] = intrinsics.distortion
    undone = cv2.undistortPoints(np.ascontiguousarray(pixels[:, None]), matrix, lens)
    return np.asarray(undone, dtype=np.float64)[:, 0]


def lift(
    pixels: Array,
    visibility: Array,
    presence: Array,
    world: Array,
    depth: NDArray[np.uint16],
    camera: Intrinsics,
) -> Lifted | None:
    """Places the landmarks in space.

    Args:
        pixels: (33, 2) landmarks, pixels of the depth image.
        visibility, presence: (33,) the network's probabilities.
        world: (33, 3) the network's own landmarks, metres, hip-centred, along the axes of the image.
        depth: (h, w) millimetres along z, 0 without a reading.
        camera: Intrinsics of the depth image.

    Returns:
        None where the depth shows no person of possible size.
    """
    at = rays(pixels, camera)
    inside = (pixels >= -0.5).all(axis=1) & (pixels < (camera.width - 0.5, camera.height - 0.5)).all(axis=1)
    trust = visibility * presence * inside + 1e-3
    place = _placement(at, world, trust)
    model = world + place
    readings = _readings(depth, pixels, inside)
    usable = np.isfinite(readings) & (trust > 0.3) & (model[:, 2] > 0.1)
    if usable.sum() < _FEWEST_READINGS:
        return None
    size = float(np.median((readings[usable] + _FLESH) / model[usable, 2]))
    if not _SMALLEST <= size <= _LARGEST:
        return None
    prior = size * model[:, 2]
    surface = readings + _FLESH
    seen = np.isfinite(surface) & inside & (np.abs(surface - prior) < _REACH) & (visibility > 0.5)
    z = np.where(seen, surface, prior)
    positions = np.column_stack((at * z[:, None], z))
    return Lifted(positions, seen, np.ones(len(z), dtype=bool), size)


_FLESH = 0.05
_REACH = 0.25
_FEWEST_READINGS = 5
_SMALLEST, _LARGEST = 0.4, 1.5


def _placement(at: Array, world: Array, trust: Array) -> Array:
    """(3,) the translation that brings the network's landmarks onto the rays, by weighted least squares.

    A point W + T lies on the ray (x, y) where W_x + T_x = x (W_z + T_z), likewise for y: linear in T.
    """
    count = len(at)
    rows = np.zeros((2, count, 3))
    rows[0, :, 0] = rows[1, :, 1] = 1.0
    rows[:, :, 2] = -at.T
    wanted = at.T * world[:, 2] - world[:, :2].T
    weight = np.sqrt(trust)
    found, *_ = np.linalg.lstsq(
        (rows * weight[:, None]).reshape(-1, 3), (wanted * weight).reshape(-1), rcond=None
    )
    return np.asarray(found)


def _readings(depth: NDArray[np.uint16], pixels: Array, inside: NDArray[np.bool_]) -> Array:
    """(33,) median reading around each landmark, metres; NaN without one."""
    found = np.full(len(pixels), np.nan)
    for j in np.flatnonzero(inside):
        u, v = round(pixels[j, 0]), round(pixels[j, 1])
        window = depth[max(0, v - 2) : v + 3, max(0, u - 2) : u + 3]
        window = window[window > 0]
        if window.size:
            found[j] = 0.001 * float(np.median(window))
    return found
