"""The camera of a depth image: which pixel shows a point, and which ray a pixel looks along.

Pixels are (u, v): columns to the right, rows down. As in OpenCV, (0, 0) is the centre of the first pixel, so
an image reaches from -0.5 to width - 0.5, and the pixel that contains (u, v) has the indices
floor(u + 0.5), floor(v + 0.5). The lens is OpenCV's rational model. No other module has a lens.
"""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fusion.compiling.kernels import inner_kernel, kernel
from fusion.intrinsics import Intrinsics

_MAX_REPROJECTION = 0.05  # pixels: a ray with a larger reprojection error is outside the lens model's range

AZURE_KINECT_OFFSET, KINECT_V2_OFFSET = 0.010, 0.024
"""Metres by which a camera shows all things too far away: the Azure Kinect a chessboard (issue 1362 of its
SDK), the Kinect v2 as libfreenect2 reads it (its issue 144). Cameras of one kind differ by 5 to 10 mm."""


def project(camera: Intrinsics, points: ArrayLike) -> NDArray[np.float64]:
    """The (…, 2) pixels of (…, 3) points of the sensor's frame; NaN where z is not positive."""
    at = np.asarray(points, dtype=np.float64)
    pixels = np.empty((*at.shape[:-1], 2))
    _project(*lens_of(camera), np.ascontiguousarray(at.reshape(-1, 3)), pixels.reshape(-1, 2))
    return pixels


def rays(camera: Intrinsics, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
    """The points x/z, y/z that a camera images at pixels. Removing the lens distortion has no closed form.

    Args:
        pixels: (N, 2).

    Returns:
        (N, 2); NaN where the lens model is not valid: in the corners of a wide image, and outside of it.
    """
    import cv2  # it changes the environment; importing this package must not

    if not camera.distortion:
        straight: NDArray[np.float64] = (pixels - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
        return straight
    matrix = np.array([[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]])
    until = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-9)
    # OpenCV 4 accepts the criteria in undistortPointsIter, OpenCV 5 in undistortPoints.
    undistort = getattr(cv2, "undistortPointsIter", cv2.undistortPoints)
    given = np.ascontiguousarray(pixels[:, None], dtype=np.float64)
    lens = np.array(camera.distortion)
    found = np.array(undistort(given, matrix, lens, R=np.eye(3), P=np.eye(3), criteria=until)[:, 0])
    images = project(camera, np.column_stack((found, np.ones(len(found)))))
    found[~(np.linalg.norm(images - pixels, axis=1) <= _MAX_REPROJECTION)] = np.nan
    return found


def in_image(camera: Intrinsics, pixels: NDArray[np.float64], margin: float = 0.0) -> NDArray[np.bool_]:
    """(…) whether (…, 2) pixels lie in the image, or at most a margin outside of it; False for NaN."""
    size = np.array((camera.width, camera.height))
    return np.asarray(((pixels >= -0.5 - margin) & (pixels < size - 0.5 + margin)).all(axis=-1))


def turned(camera: Intrinsics) -> Intrinsics:
    """The camera of the same images turned by a quarter, clockwise: a point (x, y, z) is at (-y, x, z)."""
    _, lens = lens_of(camera)
    lens[2], lens[3] = lens[3], -lens[2]  # p1, p2; the others depend on the distance from the middle only
    return replace(
        camera,
        width=camera.height,
        height=camera.width,
        fx=camera.fy,
        fy=camera.fx,
        cx=camera.height - 1 - camera.cy,
        cy=camera.cx,
        distortion=tuple(lens[: len(camera.distortion)].tolist()),
    )


def lens_of(camera: Intrinsics) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """What :func:`pixel` takes: (4,) fx, fy, cx, cy, and (8,) the lens."""
    lens = np.zeros(8)
    lens[: len(camera.distortion)] = camera.distortion
    return np.array((camera.fx, camera.fy, camera.cx, camera.cy)), lens


@inner_kernel
def pixel(pinhole, lens, x, y):  # type: ignore[no-untyped-def]
    """The pixel of the ray through (x, y, 1), by OpenCV's rational model k1, k2, p1, p2, k3, k4, k5, k6."""
    r2 = x * x + y * y
    radial = 1.0 + r2 * (lens[0] + r2 * (lens[1] + r2 * lens[4]))
    radial /= 1.0 + r2 * (lens[5] + r2 * (lens[6] + r2 * lens[7]))
    p1, p2 = lens[2], lens[3]
    u = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
    v = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
    return pinhole[0] * u + pinhole[2], pinhole[1] * v + pinhole[3]


@kernel
def _project(pinhole, lens, points, pixels):  # type: ignore[no-untyped-def]
    for i in range(len(points)):
        z = points[i, 2] if points[i, 2] > 0.0 else math.nan
        pixels[i, 0], pixels[i, 1] = pixel(pinhole, lens, points[i, 0] / z, points[i, 1] / z)
