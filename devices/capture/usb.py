"""Depth sensors on the USB bus, and whether this user may open them.

The SDK does not report why a device cannot be opened, so this module asks Linux. Other systems give no
information.
"""

import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from devices.capture.causes import Cause, in_brackets
from devices.check import Check

# The depth camera of each: Azure Kinect DK; Kinect v1 of the Xbox 360 and for Windows; Kinect v2; Orbbec
# Femto Mega, Femto Bolt, Gemini 2, 2 L and the Gemini 330 series; RealSense D415, D435, D435i, D436, D455,
# D405, D421, D555 and D585 (ids as in libfreenect's, libfreenect2's, OrbbecSDK's and librealsense's sources;
# none was seen on a bus of ours). A Femto Mega I has no USB.
_SDK_OF = {
    ("045e", "097c"): "k4a",
    ("045e", "02ae"): "freenect",
    ("045e", "02bf"): "freenect",
    ("045e", "02c4"): "freenect2",
    ("045e", "02d8"): "freenect2",
    **{
        ("2bc5", product): "orbbec"
        for product in ("0669", "066b", "0670", "0673", "0800", "0801", "0803", "0804", "0805", "0807")
    },
    **{
        ("8086", product): "realsense"
        for product in ("0ad3", "0b07", "0b3a", "1156", "0b5c", "0b5b", "1155", "0b56", "0b6a")
    },
}
"""Whose software a depth camera needs (``ConnectedSensor.sdk``), by vendor and product."""


_USB3_MEGABITS = 5000

_RULES = {
    "k4a": "99-k4a.rules (Azure Kinect Sensor SDK: scripts/)",
    "orbbec": "99-obsensor-libusb.rules (pyorbbecsdk2: shared/)",
    "freenect": "51-kinect.rules (libfreenect: platform/linux/udev/)",
    "freenect2": "90-kinect2.rules (libfreenect2: platform/linux/udev/)",
    "realsense": "99-realsense-libusb.rules (librealsense: config/)",
}


def udev_advice(sdk: str) -> str:
    """How a user gets permission for the sensors of one software."""
    return f"Copy {_RULES[sdk]} to /etc/udev/rules.d, then unplug the sensor and plug it in again."


@dataclass(frozen=True)
class UsbKinect:
    """The depth camera of a Kinect on the bus."""

    serial: str  # as the camera tells USB; empty if it does not
    node: Path
    allowed: bool  # whether this user may open it
    megabits: int
    """Speed of its connection, Mbit/s; 0 if unknown. USB 3 has 5000."""
    sdk: str = "k4a"  # whose software it needs, as in ``ConnectedSensor``

    @property
    def usb3(self) -> bool:
        """Whether it needs USB 3."""
        return self.sdk != "freenect"


def usb_kinects(root: Path = Path("/")) -> list[UsbKinect]:
    """The Kinects plugged in, by Linux's own list; empty on other systems."""
    found = []
    for device in sorted((root / "sys/bus/usb/devices").glob("*")):
        sdk = _SDK_OF.get((_read(device / "idVendor"), _read(device / "idProduct")))
        if sdk is None:
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
                sdk=sdk,
            )
        )
    return found


def why_not_open(
    fault: Exception, bus: Sequence[UsbKinect], programs: str, *sdks: str, serial: str = ""
) -> str:
    """Why a connected device does not open; the SDKs give no reason.

    Args:
        sdks: Whose device it is: another vendor's, that this user may not open, is not the reason.
        serial: Its serial number, which some cameras tell USB.
    """
    said, own = in_brackets(fault), [device for device in bus if device.sdk in sdks]
    own = [device for device in own if serial and device.serial == serial] or own
    forbidden = [device for device in own if not device.allowed]
    if forbidden:
        advice = udev_advice(forbidden[0].sdk)
        return Cause.FORBIDDEN.says(node=forbidden[0].node, said=said, advice=advice)
    return Cause.BUSY.says(said=said, programs=programs)


def permission_check(root: Path) -> Check:
    """Whether this user may open the sensors on the bus."""
    name = "USB permission"
    if not sys.platform.startswith("linux"):
        return Check(name, True, f"not restricted on {sys.platform}")
    there = usb_kinects(root)
    forbidden = [device for device in there if not device.allowed]
    if forbidden:
        advice = udev_advice(forbidden[0].sdk)
        return Check(name, False, f"this user may not open {forbidden[0].node}", advice)
    if there:
        return Check(name, True, f"of {len(there)} connected")
    rules = [
        rule
        for folder in ("etc", "lib", "usr/lib")
        for of in ("k4a", "obsensor", "libfreenect", "kinect", "realsense")
        for rule in (root / folder / "udev/rules.d").glob(f"*{of}*.rules")
    ]
    if rules or os.geteuid() == 0:
        return Check(name, True, f"udev rule {rules[0].name}" if rules else "running as root")
    advice = "Plug a sensor in: duplex doctor then names the rule that it needs."
    return Check(name, False, "no udev rule of a sensor", advice, needed=False)


def speed_check(root: Path) -> Check:
    """Whether all sensors on the bus that need USB 3 run at it."""
    there = [device for device in usb_kinects(root) if device.usb3]
    slow = [device for device in there if 0 < device.megabits < _USB3_MEGABITS]
    if slow:
        detail = f"{slow[0].serial or slow[0].node} runs at {slow[0].megabits} Mbit/s"
        return Check("USB speed", False, detail, "Plug it into a USB 3 port, with its own cable.")
    return Check("USB speed", True, f"USB 3, of {len(there)}" if there else "no sensor that needs USB 3")


def _read(path: Path) -> str:
    try:
        return path.read_text().strip()
    except OSError:
        return ""
