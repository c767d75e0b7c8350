"""The firmware version of a Kinect, read through libk4a because pyk4a does not offer it."""

from __future__ import annotations

import ctypes
import sys
from typing import Any

from devices.azure.pyk4a_internals import device_handle
from devices.azure.tracking.native_library import loaded_file
from devices.sensor import DeviceError

Version = tuple[int, int, int]
RESTARTS_WITHOUT_COLOR: Version = (1, 6, 110)
"""From this firmware on a subordinate without colour can be stopped and started again (SDK issue 818)."""


class _HardwareVersion(ctypes.Structure):
    """``k4a_hardware_version_t``: major, minor, iteration of four parts; then build and signature."""

    _fields_ = (
        ("rgb", ctypes.c_uint32 * 3),
        ("depth", ctypes.c_uint32 * 3),
        ("audio", ctypes.c_uint32 * 3),
        ("depth_sensor", ctypes.c_uint32 * 3),
        ("build", ctypes.c_int),
        ("signature", ctypes.c_int),
    )


def firmware_version(device: Any) -> Version | None:
    """The firmware of an opened ``pyk4a.PyK4A``: that of its colour camera, which the releases are named by.

    None where libk4a cannot be found in this process, or does not answer.
    """
    library = loaded_libk4a()
    if library is None or not hasattr(library, "k4a_device_get_version"):
        return None
    library.k4a_device_get_version.restype = ctypes.c_int
    library.k4a_device_get_version.argtypes = [ctypes.c_void_p, ctypes.POINTER(_HardwareVersion)]
    version = _HardwareVersion()
    try:
        status = library.k4a_device_get_version(device_handle(device), ctypes.byref(version))
    except (AttributeError, DeviceError):  # another pyk4a, which keeps its handle elsewhere
        return None
    major, minor, iteration = version.rgb
    return None if status != 0 else (major, minor, iteration)


def loaded_libk4a() -> ctypes.CDLL | None:
    """The libk4a that pyk4a has loaded into this process; None if there is none."""
    file = loaded_file("k4a")
    name = "k4a.dll" if sys.platform == "win32" else None if file is None else str(file)
    try:
        return None if name is None else ctypes.CDLL(name)
    except OSError:
        return None


def firmware_advice(serial: str, version: Version | None) -> str:
    """Advice for a firmware that is too old for a sync cable; empty if it is new enough or unknown."""
    if version is None or version >= RESTARTS_WITHOUT_COLOR or not serial.isdigit():
        return ""
    old, needed = (".".join(map(str, numbers)) for numbers in (version, RESTARTS_WITHOUT_COLOR))
    return (
        f"Kinect {serial} has firmware {old}. Before {needed} a subordinate cannot be started again without "
        f"colour, so colour runs on both; update it with AzureKinectFirmwareTool."
    )
