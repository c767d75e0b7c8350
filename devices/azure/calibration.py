"""Reads the factory calibration of an Azure Kinect and converts it to the mode of each camera.

The sensor stores one calibration of the whole image sensor, in units of the image's size, with (0, 0) at the
corner of the first pixel. A camera mode bins and crops that image. The intrinsics in pixels therefore follow
from the binned size and the corner of the crop. Both are those of the Sensor SDK (its ``transformation``
source). NFOV_UNBINNED and 720p are tested against the output of the SDK.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import Any

from devices.sensor import ColorCamera, DeviceError
from fusion.errors import FusionError
from fusion.intrinsics import Intrinsics
from fusion.rigid import RigidTransform


@dataclass(frozen=True)
class CameraMode:
    """A camera mode: the sensor's image is binned, then cropped.

    Attributes:
        binned: Width and height after binning, pixels.
        crop: Column and row of the crop's first pixel in the binned image.
        width, height: Size of the final image, pixels.
    """

    binned: tuple[int, int]
    crop: tuple[int, int]
    width: int
    height: int


DEPTH_MODES = {
    "NFOV_2X2BINNED": CameraMode((512, 512), (96, 90), 320, 288),
    "NFOV_UNBINNED": CameraMode((1024, 1024), (192, 180), 640, 576),
    "WFOV_2X2BINNED": CameraMode((512, 512), (0, 0), 512, 512),
    "WFOV_UNBINNED": CameraMode((1024, 1024), (0, 0), 1024, 1024),
}
COLOR_MODES = {
    "720P": CameraMode((1280, 960), (0, 120), 1280, 720),
    "1080P": CameraMode((1920, 1440), (0, 180), 1920, 1080),
    "1440P": CameraMode((2560, 1920), (0, 240), 2560, 1440),
    "1536P": CameraMode((2048, 1536), (0, 0), 2048, 1536),
    "2160P": CameraMode((3840, 2880), (0, 360), 3840, 2160),
    "3072P": CameraMode((4096, 3072), (0, 0), 4096, 3072),
}


@dataclass(frozen=True)
class AzureCalibration:
    """The calibrated cameras of one sensor.

    Attributes:
        depth: Intrinsics of the depth camera, pixels.
        color: Intrinsics and pose of the colour camera; None if it is off.
    """

    depth: Intrinsics
    color: ColorCamera | None


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


def read_calibration(text: str | bytes, depth: str, color: str | None = None) -> AzureCalibration:
    """Reads the calibration that a sensor stores as JSON, for the given camera modes.

    Args:
        text: The JSON text, as in a recording's ``calibration.json``.
        depth: Depth mode, a key of ``DEPTH_MODES``.
        color: Colour resolution, a key of ``COLOR_MODES``; None for off.

    Raises:
        DeviceError: The JSON is damaged or lacks a camera, or a mode is not supported.
    """
    depth_as = depth_mode(depth)
    if color is not None and color not in COLOR_MODES:
        raise DeviceError(f"Colour mode {color} is not supported. Supported: {', '.join(COLOR_MODES)}.")
    try:
        cameras = {
            camera["Purpose"]: camera
            for camera in json.loads(text.strip(b"\0") if isinstance(text, bytes) else text)[
                "CalibrationInformation"
            ]["Cameras"]
        }
        depth_camera = cameras["CALIBRATION_CameraPurposeDepth"]
        color_camera = cameras["CALIBRATION_CameraPurposePhotoVideo"]
        pose = color_camera["Rt"]
        rotation = [pose["Rotation"][row : row + 3] for row in (0, 3, 6)]
        color_from_depth = RigidTransform.of(rotation, pose["Translation"])
        return AzureCalibration(
            depth=_intrinsics(depth_camera, depth_as),
            color=None
            if color is None
            else ColorCamera(_intrinsics(color_camera, COLOR_MODES[color]), color_from_depth),
        )
    except (ValueError, KeyError, IndexError, TypeError, FusionError) as fault:
        raise DeviceError(
            f"The sensor's calibration cannot be read ({type(fault).__name__}: {fault}). "
            f"Record again, or read the calibration from the sensor with k4arecorder."
        ) from fault


def _intrinsics(camera: dict[str, Any], mode: CameraMode) -> Intrinsics:
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
