"""Depth images as points in the sensor's frame."""

import numpy as np
from numpy.typing import NDArray

from devices.depth.camera import rays
from devices.sensor import DeviceError
from fusion.intrinsics import Intrinsics


def ray_table(intrinsics: Intrinsics) -> NDArray[np.float32]:
    """Computes the ray through each pixel of a depth camera, as its point at z = 1 m.

    Compute it once per camera: it takes a fraction of a second.

    Returns:
        (height, width, 3) x, y, 1 in the sensor's frame; NaN where the lens model is not valid: in the
        corners of a wide image.
    """
    rows, columns = np.mgrid[0 : intrinsics.height, 0 : intrinsics.width]
    table = np.ones((intrinsics.height, intrinsics.width, 3), dtype=np.float32)
    found = rays(intrinsics, np.stack((columns, rows), axis=-1).reshape(-1, 2).astype(np.float64))
    table[..., :2] = found.reshape(intrinsics.height, intrinsics.width, 2)
    table[np.isnan(table[..., 0])] = np.nan
    return table


def depth_to_points(depth: NDArray[np.uint16], table: NDArray[np.float32]) -> NDArray[np.float32]:
    """Converts a depth image to points.

    Args:
        depth: (height, width) uint16 millimetres along z, 0 where there is no reading.
        table: (height, width, 3) rays of the same camera, from :func:`ray_table`.

    Returns:
        (N, 3) metres in the sensor's frame, row by row; pixels without a reading or a ray are left out.

    Raises:
        DeviceError: The image has another size than the table.
    """
    if depth.shape != table.shape[:2]:
        raise DeviceError(
            f"The depth image is {depth.shape}, the ray table {table.shape[:2]}: make the table from the "
            f"intrinsics of this image's depth mode."
        )
    flat, every = depth.ravel(), table.reshape(-1, 3)
    seen = np.flatnonzero((flat > 0) & np.isfinite(every[:, 0]))
    points: NDArray[np.float32] = every.take(seen, axis=0)
    points *= (flat.take(seen) * np.float32(0.001))[:, np.newaxis]
    return points
