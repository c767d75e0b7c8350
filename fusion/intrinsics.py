"""The camera of a depth image; :mod:`devices.depth.camera` projects with it."""

from dataclasses import dataclass


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
