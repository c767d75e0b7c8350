"""Sources of frames: sensors, recordings and the simulator; pairing of frames."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from devices.blazepose.depth_camera import DepthCamera
    from devices.capture.sensor_pair import TwoSensors
    from devices.files import RecordingChoice, TwoRecordings, open_source, read_two
    from devices.pairing import FramePair, Pairing, pair_recordings
    from devices.sensor import ColorCamera, ColorImage, DeviceError, Sensor, SensorFrame
    from devices.simulated.kinect import simulated_pair

__all__ = [
    "ColorCamera",
    "ColorImage",
    "DepthCamera",
    "DeviceError",
    "FramePair",
    "Pairing",
    "RecordingChoice",
    "Sensor",
    "SensorFrame",
    "TwoRecordings",
    "TwoSensors",
    "open_source",
    "pair_recordings",
    "read_two",
    "simulated_pair",
]

_HOMES = {
    "DepthCamera": "devices.blazepose.depth_camera",
    "TwoSensors": "devices.capture.sensor_pair",
    "FramePair": "devices.pairing",
    "Pairing": "devices.pairing",
    "pair_recordings": "devices.pairing",
    "ColorCamera": "devices.sensor",
    "ColorImage": "devices.sensor",
    "DeviceError": "devices.sensor",
    "Sensor": "devices.sensor",
    "SensorFrame": "devices.sensor",
    "simulated_pair": "devices.simulated.kinect",
    "open_source": "devices.files",
    "RecordingChoice": "devices.files",
    "TwoRecordings": "devices.files",
    "read_two": "devices.files",
}
"""Module of each public name. Modules are imported on first access, because importing numba takes a
second."""


def __getattr__(name: str) -> Any:
    """Imports and returns a name of ``__all__``."""
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    """Lists the public names."""
    return sorted([*globals(), *__all__])
