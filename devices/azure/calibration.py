"""Reads the factory calibration of an Azure Kinect's depth camera and converts it to the camera's mode.

The sensor stores one calibration of the whole image sensor, in units of the image's size, with (0, 0) at the
corner of the first pixel. A camera mode bins and crops that image. The intrinsics in pixels therefore follow
from the binned size and the corner of the crop. Both are those of the Sensor SDK (its ``transformation``
source); tested against the output of the SDK.
"""

import json
import math
from dataclasses import dataclass
from typing import Any

from devices.sensor import DeviceError
from fusion.intrinsics import Intrinsics


@dataclass(frozen=True)
class CameraMode:
    """A camera mode: the sensor's image is binned, then cropped."""

    binned: tuple[int, int]  # width and height after binning, pixels
    crop: tuple[int, int]  # column and row of the crop's first pixel in the binned image
    width: int  # size of the final image, pixels
    height: int


DEPTH_MODES = {
    "NFOV_2X2BINNED": CameraMode((512, 512), (96, 90), 320, 288),
    "NFOV_UNBINNED": CameraMode((1024, 1024), (192, 180), 640, 576),
    "WFOV_2X2BINNED": CameraMode((512, 512), (0, 0), 512, 512),
    "WFOV_UNBINNED": CameraMode((1024, 1024), (0, 0), 1024, 1024),
}
COLOR_SIZES = {
    "720P": (1280, 720),
    "1080P": (1920, 1080),
    "1440P": (2560, 1440),
    "1536P": (2048, 1536),
    "2160P": (3840, 2160),
    "3072P": (4096, 3072),
}
"""Width and height of each colour mode, pixels."""


def depth_mode(name: str) -> CameraMode:
    """Returns the depth mode of a name, spelled as in the SDK.

    Raises:
        DeviceError: The mode has no depth image, or it is unknown.
    """
    mode = DEPTH_MODES.get(name)
    if mode is None:
        raise DeviceError(
            f"Depth mode {name or 'unnamed'} is not supported. Supported: {', '.join(DEPTH_MODES)}; "
            f"record in NFOV_UNBINNED."
        )
    return mode


def depth_intrinsics(text: bytes, mode: str) -> Intrinsics:
    """Reads the depth camera from the calibration that a sensor stores as JSON.

    Raises:
        DeviceError: The JSON is damaged or lacks the camera, or the mode is not supported.
    """
    camera_mode = depth_mode(mode)
    try:
        cameras = json.loads(text.strip(b"\0"))["CalibrationInformation"]["Cameras"]
        by_purpose = {camera["Purpose"]: camera for camera in cameras}
        return intrinsics_of(by_purpose["CALIBRATION_CameraPurposeDepth"], camera_mode)
    except (ValueError, KeyError, IndexError, TypeError) as fault:
        raise DeviceError(
            f"The sensor's calibration cannot be read ({type(fault).__name__}: {fault}). "
            f"Record again, or read the calibration from the sensor with k4arecorder."
        ) from fault


def intrinsics_of(camera: dict[str, Any], mode: CameraMode) -> Intrinsics:
    """The lens of one camera of the JSON, in pixels of a mode."""
    parameters = [float(value) for value in camera["Intrinsics"]["ModelParameters"]]
    if not all(math.isfinite(value) for value in parameters) or min(parameters[2:4]) <= 0:
        raise ValueError("a model parameter is out of range")
    cx, cy, fx, fy, k1, k2, k3, k4, k5, k6, _, _, p2, p1 = parameters[:14]
    # A calibration measured on a 16:9 image covers the middle 2304 of the sensor's 3072 rows.
    if camera["SensorWidth"] * 9 == camera["SensorHeight"] * 16:
        fy, cy = fy * 0.75, (cy * 2304 + 384) / 3072
    width, height = mode.binned
    return Intrinsics(
        width=mode.width,
        height=mode.height,
        fx=fx * width,
        fy=fy * height,
        cx=cx * width - mode.crop[0] - 0.5,
        cy=cy * height - mode.crop[1] - 0.5,
        distortion=(k1, k2, p1, p2, k3, k4, k5, k6),
    )
