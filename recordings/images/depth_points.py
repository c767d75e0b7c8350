"""A depth image as a sparse point cloud for display. Only the image itself is stored."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from devices.depth.point_cloud import depth_to_points, ray_table
from fusion.intrinsics import Intrinsics

_POINTS = 10_000
"""Approximate maximum number of points shown; 120 kB."""


def thin_points(depth: NDArray[np.uint16], camera: Intrinsics) -> NDArray[np.float32]:
    """The points of every n-th row and column of a depth image.

    Args:
        depth: (height, width) millimetres, 0 where there is no reading.
        camera: Intrinsics of this image.

    Returns:
        (N, 3) metres in the sensor's frame.

    Raises:
        DeviceError: The sizes of the image and the camera differ.
    """
    step, rays = _thin_rays(camera)
    return depth_to_points(depth[::step, ::step], rays)


def prepare_points(*cameras: Intrinsics) -> None:
    """Precomputes the rays that :func:`thin_points` needs, because this takes longer than a frame."""
    for camera in cameras:
        _thin_rays(camera)


@lru_cache(maxsize=4)
def _thin_rays(camera: Intrinsics) -> tuple[int, NDArray[np.float32]]:
    step = max(1, round(math.sqrt(camera.width * camera.height / _POINTS)))
    return step, ray_table(camera)[::step, ::step]
