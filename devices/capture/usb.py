"""Kinects on the USB bus, and whether this user may open them.

The SDK does not report why a device cannot be opened, so this module asks Linux. Other systems give no
information.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

# The depth camera of each: Azure Kinect DK; Orbbec Femto Mega, Femto Bolt, Gemini 2, 2 L and the Gemini 330
# series (ids as in OrbbecSDK's device lists and udev rules; none was seen on a bus of ours). A Femto Mega I
# has no USB.
_ORBBECS = ("0669", "066b", "0670", "0673", "0800", "0801", "0803", "0804", "0805", "0807")
_DEPTH_CAMERAS = {("045e", "097c"), *(("2bc5", product) for product in _ORBBECS)}

UDEV_ADVICE = (
    "Copy 99-k4a.rules of the Azure Kinect Sensor SDK (scripts/), for an Orbbec 99-obsensor-libusb.rules "
    "(in pyorbbecsdk2: shared/), to /etc/udev/rules.d, then unplug the sensor and plug it in again."
)


@dataclass(frozen=True)
class UsbKinect:
    """The depth camera of a Kinect on the bus.

    Attributes:
        serial: As the camera tells USB; empty if it does not.
        node: The device file.
        allowed: Whether this user may open it.
        megabits: Speed of its connection, Mbit/s; 0 if unknown. USB 3 has 5000.
    """

    serial: str
    node: Path
    allowed: bool
    megabits: int


def usb_kinects(root: Path = Path("/")) -> list[UsbKinect]:
    """The Kinects plugged in, by Linux's own list; empty on other systems.

    Args:
        root: Where the file system starts; tests inject their own.
    """
    found = []
    for device in sorted((root / "sys/bus/usb/devices").glob("*")):
        if (_read(device / "idVendor"), _read(device / "idProduct")) not in _DEPTH_CAMERAS:
            continue
        bus, number = _read(device / "busnum"), _read(device / "devnum")
        node = root / "dev/bus/usb" / bus.zfill(3) / number.zfill(3)
        speed = _read(device / "speed")
        found.append(
            UsbKinect(
                serial=_read(device / "serial"),
                node=node,
                allowed=os.access(node, os.R_OK | os.W_OK),
                megabits=int(speed) if speed.isdigit() else 0,
            )
        )
    return found


def _read(path: Path) -> str:
    try:
        return path.read_text().strip()
    except OSError:
        return ""
