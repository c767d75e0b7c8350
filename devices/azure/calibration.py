"""The factory calibration of an Azure Kinect: reads its depth camera in a mode; writes one for any sensor.

The sensor stores one calibration of the whole image sensor, in units of the image's size, with (0, 0) at the
corner of the first pixel. A camera mode bins and crops that image. The intrinsics in pixels therefore follow
from the binned size and the corner of the crop. Both are those of the Sensor SDK (its ``transformation``
source); tested against the output of the SDK.
"""

import json
import math
import re
from dataclasses import dataclass
from typing import Any

import numpy as np

from devices.sensor import ColorCamera, DeviceError
from fusion.intrinsics import Intrinsics
from fusion.rigid import RigidTransform


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
    """Returns the depth mode of a name, spelled as in the SDK; of another sensor its size, as in 640X480.

    Raises:
        DeviceError: The mode has no depth image, or it is unknown.
    """
    mode = DEPTH_MODES.get(name)
    if mode is None and (size := re.fullmatch(r"([1-9]\d{1,3})X([1-9]\d{1,3})", name)):
        width, height = int(size[1]), int(size[2])
        mode = CameraMode((width, height), (0, 0), width, height)
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


def mode_name(lens: Intrinsics, wanted: str = "") -> str:
    """The depth mode of a camera's images by their size: the wanted one where it fits."""
    size = lens.width, lens.height
    names = [name for name, mode in DEPTH_MODES.items() if (mode.width, mode.height) == size]
    return wanted if wanted in names else next(iter(names), f"{lens.width}X{lens.height}")


def calibration_json(lens: Intrinsics, mode: str, color: ColorCamera | None = None) -> bytes:
    """A calibration in the form that an Azure Kinect stores, of a depth camera in a mode."""
    camera = depth_mode(mode)
    cameras = [_camera("Depth", "D0", lens, camera.binned, camera.crop, RigidTransform.identity())]
    # Microsoft's tools want a colour camera and inertial sensors in every calibration
    color = color or ColorCamera(lens, RigidTransform.identity())
    width, height = color.intrinsics.width, color.intrinsics.height
    # the colour sensor is 4:3; its images of 16:9 lack rows above and below
    size = (width, width * 3 // 4 if width * 9 == height * 16 else height)
    crop = (0, (size[1] - height) // 2)
    cameras.append(_camera("PhotoVideo", "PV0", color.intrinsics, size, crop, color.color_from_depth))
    inertial = [_inertial_sensor(kind) for kind in ("Gyro", "Accelerometer")]
    return json.dumps({"CalibrationInformation": {"Cameras": cameras, "InertialSensors": inertial}}).encode()


def _inertial_sensor(kind: str) -> dict[str, Any]:
    mixing = np.zeros((9, 4))
    mixing[::4, 0] = 1.0
    return {
        "SensorType": f"CALIBRATION_InertialSensorType_{kind}",
        "Id": "CALIBRATION_InertialSensorId_LSM6DSM",
        "ModelTypeMask": 16,
        "Rt": {"Rotation": np.eye(3).ravel().tolist(), "Translation": [0.0] * 3},
        "BiasTemperatureModel": [0.0] * 12,
        "BiasUncertainty": [0.0] * 3,
        "MixingMatrixTemperatureModel": mixing.ravel().tolist(),
        "Noise": [0.0] * 6,
        "SecondOrderScaling": [0.0] * 9,
        "TemperatureBounds": [5.0, 60.0],
        "TemperatureC": 20.0,
    }


def _camera(
    purpose: str,
    location: str,
    lens: Intrinsics,
    binned: tuple[int, int],
    crop: tuple[int, int],
    place: RigidTransform,
) -> dict[str, Any]:
    k1, k2, p1, p2, k3, k4, k5, k6 = (*lens.distortion, *[0.0] * 8)[:8]
    middle = ((lens.cx + crop[0] + 0.5) / binned[0], (lens.cy + crop[1] + 0.5) / binned[1])
    focal = (lens.fx / binned[0], lens.fy / binned[1])
    size = (1024, 1024) if purpose == "Depth" else (4096, 3072)
    return {
        "Purpose": f"CALIBRATION_CameraPurpose{purpose}",
        "Location": f"CALIBRATION_CameraLocation{location}",
        "Intrinsics": {
            "ModelParameters": [*middle, *focal, k1, k2, k3, k4, k5, k6, 0.0, 0.0, p2, p1],
            "ModelParameterCount": 14,
            "ModelType": "CALIBRATION_LensDistortionModelBrownConrady",
        },
        "MetricRadius": 1.7,
        "Rt": {"Rotation": place.rotation.ravel().tolist(), "Translation": place.translation.tolist()},
        "SensorWidth": size[0],
        "SensorHeight": size[1],
    }
