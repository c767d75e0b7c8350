"""A sensor's viewing plane: projection of points to its image."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray


@dataclass(frozen=True)
class Intrinsics:
    """A pinhole camera with OpenCV's distortion model, all in pixels of its own image.

    Attributes:
        width, height: Size of the image.
        fx, fy: Focal lengths.
        cx, cy: Principal point; the centre of the first pixel is (0, 0).
        distortion: OpenCV's k1, k2, p1, p2, k3, k4, k5, k6; empty for an ideal lens.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = ()

    def project(self, points: ArrayLike) -> NDArray[np.float64]:
        """Projects (…, 3) points of the sensor's frame to (…, 2) pixels; NaN behind the sensor.

        Lens distortion is ignored: it moves all joints of a person nearly alike, and the method needs only
        the distances between joints.
        """
        at = np.asarray(points, dtype=np.float64)
        depth = np.where(at[..., 2] > 0.0, at[..., 2], np.nan)
        return np.stack(
            (self.fx * at[..., 0] / depth + self.cx, self.fy * at[..., 1] / depth + self.cy), axis=-1
        )


NOMINAL_INTRINSICS = {
    "kinect_v1": Intrinsics(640, 480, 571.26, 571.26, 319.5, 239.5),
    "kinect_v2": Intrinsics(512, 424, 365.5, 365.5, 255.5, 211.5),
    "azure_kinect": Intrinsics(640, 576, 504.0, 504.0, 319.5, 287.5),
    "blazepose": Intrinsics(640, 576, 504.0, 504.0, 319.5, 287.5),
}
"""The depth camera of each sensor family, by body name, for recordings without intrinsics.

Focal lengths: that of the maker's software (v1), the mean of published calibrations (v2), that of the
NFOV_UNBINNED mode (Azure). BlazePose works with any depth camera; the Azure Kinect's is assumed. The
principal point is in the middle."""
