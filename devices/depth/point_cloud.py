"""Converts depth images to points in the sensor's frame."""

import cv2
import numpy as np
from numpy.typing import NDArray

from devices.sensor import DeviceError
from fusion.intrinsics import Intrinsics

_MAX_REPROJECTION = 0.05  # pixels: a ray with a larger reprojection error is outside the lens model's range


def ray_table(intrinsics: Intrinsics) -> NDArray[np.float32]:
    """Computes the ray through each pixel of a depth camera, as its point at z = 1 m.

    Compute it once per camera (a fraction of a second): removing the lens distortion has no closed form.

    Returns:
        (height, width, 3) x, y, 1 in the sensor's frame; NaN where the lens model is not valid: in the
        corners of a wide image.
    """
    camera = np.array([[intrinsics.fx, 0.0, intrinsics.cx], [0.0, intrinsics.fy, intrinsics.cy], [0, 0, 1]])
    lens = np.array(intrinsics.distortion if intrinsics.distortion else (0.0,) * 4)
    rows, columns = np.mgrid[0 : intrinsics.height, 0 : intrinsics.width]
    pixels = np.stack((columns, rows), axis=-1).reshape(-1, 1, 2).astype(np.float64)
    until = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-9)
    # OpenCV 4 accepts the criteria in undistortPointsIter, OpenCV 5 in undistortPoints.
    undistort = getattr(cv2, "undistortPointsIter", cv2.undistortPoints)
    ideal = undistort(pixels, camera, lens, R=np.eye(3), P=np.eye(3), criteria=until).reshape(-1, 2)
    rays = np.concatenate((ideal, np.ones((len(ideal), 1))), axis=1)
    projected, _ = cv2.projectPoints(rays.reshape(-1, 1, 3), np.zeros(3), np.zeros(3), camera, lens)
    miss = np.linalg.norm(projected.reshape(-1, 2) - pixels.reshape(-1, 2), axis=1)
    rays[~(miss <= _MAX_REPROJECTION)] = np.nan
    return rays.reshape(intrinsics.height, intrinsics.width, 3).astype(np.float32)


def depth_to_points(depth: NDArray[np.uint16], rays: NDArray[np.float32]) -> NDArray[np.float32]:
    """Converts a depth image to points.

    Args:
        depth: (height, width) uint16 millimetres along z, 0 where there is no reading.
        rays: (height, width, 3) rays of the same camera, from :func:`ray_table`.

    Returns:
        (N, 3) metres in the sensor's frame, row by row; pixels without a reading or a ray are left out.

    Raises:
        DeviceError: The image has another size than the table.
    """
    if depth.shape != rays.shape[:2]:
        raise DeviceError(
            f"The depth image is {depth.shape}, the ray table {rays.shape[:2]}: make the table from the "
            f"intrinsics of this image's depth mode."
        )
    flat, table = depth.ravel(), rays.reshape(-1, 3)
    seen = np.flatnonzero((flat > 0) & np.isfinite(table[:, 0]))
    points: NDArray[np.float32] = table.take(seen, axis=0)
    points *= (flat.take(seen) * np.float32(0.001))[:, np.newaxis]
    return points
