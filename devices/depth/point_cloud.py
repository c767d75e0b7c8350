"""The lens of a camera, and depth images as points in the sensor's frame."""

import cv2
import numpy as np
from numpy.typing import NDArray

from devices.sensor import DeviceError
from fusion.intrinsics import Intrinsics

_MAX_REPROJECTION = 0.05  # pixels: a ray with a larger reprojection error is outside the lens model's range


def rays(pixels: NDArray[np.float64], intrinsics: Intrinsics) -> NDArray[np.float64]:
    """The points x/z, y/z that a camera images at pixels. Removing the lens distortion has no closed form.

    Args:
        pixels: (N, 2).

    Returns:
        (N, 2); NaN where the lens model is not valid: in the corners of a wide image, and outside of it.
    """
    matrix, lens = _camera(intrinsics)
    if not intrinsics.distortion:
        straight: NDArray[np.float64] = (pixels - matrix[:2, 2]) / np.diag(matrix)[:2]
        return straight
    until = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-9)
    # OpenCV 4 accepts the criteria in undistortPointsIter, OpenCV 5 in undistortPoints.
    undistort = getattr(cv2, "undistortPointsIter", cv2.undistortPoints)
    given = np.ascontiguousarray(pixels[:, None], dtype=np.float64)
    found = np.array(undistort(given, matrix, lens, R=np.eye(3), P=np.eye(3), criteria=until)[:, 0])
    images = pixels_of(np.column_stack((found, np.ones(len(found)))), intrinsics)
    found[~(np.linalg.norm(images - pixels, axis=1) <= _MAX_REPROJECTION)] = np.nan
    return found


def pixels_of(points: NDArray[np.float64], intrinsics: Intrinsics) -> NDArray[np.float64]:
    """(N, 2) where a camera images (N, 3) points in front of it, with the lens distortion."""
    given = np.ascontiguousarray(points[:, None], dtype=np.float64)
    return np.asarray(cv2.projectPoints(given, np.zeros(3), np.zeros(3), *_camera(intrinsics))[0][:, 0])


def _camera(intrinsics: Intrinsics) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The camera as OpenCV takes it: its matrix, and the lens."""
    of = intrinsics
    matrix = np.array([[of.fx, 0.0, of.cx], [0.0, of.fy, of.cy], [0.0, 0.0, 1.0]])
    return matrix, np.array(of.distortion or (0.0,) * 4)


def ray_table(intrinsics: Intrinsics) -> NDArray[np.float32]:
    """Computes the ray through each pixel of a depth camera, as its point at z = 1 m.

    Compute it once per camera: it takes a fraction of a second.

    Returns:
        (height, width, 3) x, y, 1 in the sensor's frame; NaN where the lens model is not valid: in the
        corners of a wide image.
    """
    rows, columns = np.mgrid[0 : intrinsics.height, 0 : intrinsics.width]
    table = np.ones((intrinsics.height, intrinsics.width, 3), dtype=np.float32)
    found = rays(np.stack((columns, rows), axis=-1).reshape(-1, 2).astype(np.float64), intrinsics)
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
