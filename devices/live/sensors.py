"""All connected sensors, of every vendor whose software is installed, and the live sensors made of them."""

from dataclasses import replace
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from devices.azure.kinect import VENDOR as AZURE
from devices.azure.kinect import KinectSensor
from devices.azure.settings import KinectSettings
from devices.blazepose.pace import TrackingPace
from devices.blazepose.tracked_images import TrackedImages
from devices.capture.frame_decimation import FrameDecimation
from devices.capture.sensor_choice import ConnectedSensor
from devices.capture.usb import usb_kinects
from devices.check import Check, failed, is_missing, words_of
from devices.freenect.sensor import VENDOR as FREENECT
from devices.freenect2.sensor import VENDOR as FREENECT2
from devices.orbbec.sensor import VENDOR as ORBBEC
from devices.realsense.sensors import VENDOR as REALSENSE
from devices.sensor import DeviceError, Orientation, Sensor, SensorFrame
from devices.tracker_choice import TrackerChoice
from devices.upright import turned_image, upright
from devices.vendor import Vendor as Vendor

VENDORS: dict[str, Vendor] = {
    "k4a": AZURE,
    "orbbec": ORBBEC,
    "freenect": FREENECT,
    "freenect2": FREENECT2,
    "realsense": REALSENSE,
}
"""The vendors of this package, by :attr:`ConnectedSensor.sdk`."""


def vendors() -> dict[str, Vendor]:
    """:data:`VENDORS` and those of other installed packages."""
    return {**VENDORS, **{name: row for name, row in _installed_once().items() if name not in VENDORS}}


def installed_vendors() -> dict[str, Vendor]:
    """The vendors of other packages, which name a :class:`Vendor` as an entry point of ``duplex.sensors``.

    If one cannot be loaded, its sensors count as those of a broken library, with the reason.
    """
    found = {}
    for point in entry_points(group="duplex.sensors"):
        try:
            vendor = point.load()
            if not isinstance(vendor, Vendor):
                raise DeviceError(f"it is a {type(vendor).__name__}, not a devices.live.sensors.Vendor")
        except Exception as fault:
            vendor = _broken_vendor(point, fault)
        found[point.name] = vendor
    return found


def _broken_vendor(point: EntryPoint, fault: Exception) -> Vendor:
    package = point.dist.name if point.dist is not None else point.name
    install = f"pip install --upgrade {package}"
    why = f"The sensors {point.name!r} of {package} cannot be loaded: {words_of(fault)}"
    error = DeviceError(f"{why}. {install}.")

    def fails(*_: object) -> NoReturn:
        raise error

    def check(*_: object) -> Check:
        return failed(point.name, error)

    return Vendor(point.name, install, fails, fails, check, check)


# not at import: a package that is imported first imports this module before it has its vendor
_installed_once = cache(installed_vendors)


class NoLibraryError(DeviceError):
    """No vendor's software is installed, or not that of the sensors on USB."""


def software() -> dict[str, tuple[str, str]]:
    """Of every vendor, by :attr:`ConnectedSensor.sdk`: its sensors, and how their software is installed."""
    return {name: (vendor.sensors, vendor.install) for name, vendor in vendors().items()}


def sdks_on_usb(root: Path = Path("/")) -> set[str]:
    """Whose software the sensors on USB need, as far as Linux tells."""
    return {device.sdk for device in usb_kinects(root)}


def library_for(sdk: str) -> str:
    """Says how to install the software of a sensor that is on USB."""
    sensors, install = software()[sdk]
    return f"A sensor on USB needs the library of {sensors}, which is not installed: {install}."


def connected_sensors(tracker: TrackerChoice | None, root: Path = Path("/")) -> list[ConnectedSensor]:
    """Connected Azure Kinects and sensors of the other vendors.

    A Femto Bolt or Mega may be listed twice, by Orbbec's SDK v2 and by its K4A wrapper. It is taken from the
    wrapper where libk4abt tracks, which needs the wrapper's captures, else from SDK v2.

    Raises:
        NoLibraryError: No sensor is found, and no software is installed, or not that of a sensor on USB.
        DeviceError: No sensor is found, and software that is installed is broken.
    """
    faults: dict[str, DeviceError] = {}
    found: list[ConnectedSensor] = []
    for name, vendor in vendors().items():
        try:
            found += vendor.connected()
        except Exception as fault:
            faults[name] = _told(fault)
    if not found:
        broken = [fault for fault in faults.values() if not is_missing(fault)]
        if broken:
            raise broken[0]  # else it would read as if nothing were connected
        if on_usb := sdks_on_usb(root) & faults.keys():
            raise NoLibraryError(f"{library_for(min(on_usb))} Next: duplex doctor checks the rest.")
        if len(faults) == len(vendors()):
            *names, last = (sensors.partition(" (")[0] for sensors, _ in software().values())
            raise NoLibraryError(
                "No sensor library is installed. One is enough, that of your two sensors:\n"
                f"{', '.join(names)} or {last}.\n"
                "Next: duplex doctor says how to install each. Without sensors: duplex demo."
            )
    by_wrapper = tracker is not None and tracker.name == "k4abt"
    preferred = {one.serial for one in found if (one.sdk == "k4a") == by_wrapper} - {None}
    listed = [one for one in found if (one.sdk == "k4a") == by_wrapper or one.serial not in preferred]
    return [replace(one, index=index) for index, one in enumerate(listed)]


def _told(fault: Exception) -> DeviceError:
    """A vendor's fault; a version of its software that nobody tried may raise anything."""
    if isinstance(fault, DeviceError):
        return fault
    return DeviceError(f"A sensor library failed ({type(fault).__name__}: {words_of(fault)}).")


def live_sensor(
    connected: ConnectedSensor,
    settings: KinectSettings,
    tracker: TrackerChoice | None,
    decimation: FrameDecimation,
    orientation: Orientation = 0,
) -> Sensor:
    """The sensor with its body tracker, or without one; opens nothing.

    A sensor on its side is tracked, and gives frames, as if it stood upright.
    """
    serial = str(connected.serial)
    if tracker is not None and not isinstance(decimation, TrackingPace):
        k4abt = replace(tracker.k4abt, orientation=orientation)
        return upright(KinectSensor(serial, settings, k4abt, decimation=decimation), orientation)
    images = vendors()[connected.sdk].sensor(serial, settings, decimation)
    if not isinstance(decimation, TrackingPace):
        return images
    source, given = upright(images, orientation), images.registered
    if given is None:
        return TrackedImages(source, decimation.settings, pace=decimation)

    def registered(frame: SensorFrame) -> NDArray[np.uint8] | None:
        image = given(frame)
        return None if image is None else turned_image(image, orientation)

    return TrackedImages(source, decimation.settings, registered=registered, pace=decimation)
