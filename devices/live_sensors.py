"""All connected sensors, of every vendor whose software is installed, and the live sensors made of them."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib.util import find_spec

from devices.azure.kinect import KinectSensor
from devices.azure.pyk4a_access import connected_kinects
from devices.azure.settings import KinectSettings
from devices.blazepose.pace import TrackingPace
from devices.blazepose.tracked_images import TrackedImages
from devices.capture.capture_stream import LiveSensor
from devices.capture.frame_decimation import FrameDecimation
from devices.capture.sensor_choice import ConnectedSensor
from devices.capture.settings import CaptureSettings
from devices.check import Check
from devices.freenect.libfreenect import connected_freenects
from devices.freenect.libfreenect import library_check as freenect_library_check
from devices.freenect.libfreenect import sensor_check as freenect_sensor_check
from devices.freenect.sensor import FreenectSensor
from devices.freenect2.library import connected_freenect2s
from devices.freenect2.library import library_check as freenect2_library_check
from devices.freenect2.library import sensor_check as freenect2_sensor_check
from devices.freenect2.sensor import Freenect2Sensor
from devices.orbbec.checks import sdk_check as orbbec_sdk_check
from devices.orbbec.checks import sensor_check as orbbec_sensor_check
from devices.orbbec.sdk_access import connected_orbbecs
from devices.orbbec.sensor import OrbbecSensor
from devices.realsense.sdk_access import connected_realsenses
from devices.realsense.sdk_access import sdk_check as realsense_sdk_check
from devices.realsense.sdk_access import sensor_check as realsense_sensor_check
from devices.realsense.sensors import RealSenseSensor
from devices.sensor import DeviceError, Sensor
from devices.tracker_choice import TrackerChoice


@dataclass(frozen=True)
class Vendor:
    """Sensors whose people the program's own tracker finds, and the software that gives their images."""

    sensors: str  # what they are called in messages
    connected: Callable[[], list[ConnectedSensor]]
    """Those that are connected; raises a DeviceError if the software is not installed."""
    sensor: Callable[[str, CaptureSettings, FrameDecimation], LiveSensor]
    """The sensor with a serial number, without people; opens nothing."""
    sdk_check: Callable[[], Check]
    sensor_check: Callable[[ConnectedSensor], Check]


VENDORS = {
    "orbbec": Vendor(
        "Orbbec's sensors", connected_orbbecs, OrbbecSensor, orbbec_sdk_check, orbbec_sensor_check
    ),
    "freenect": Vendor(
        "a Kinect v1", connected_freenects, FreenectSensor, freenect_library_check, freenect_sensor_check
    ),
    "freenect2": Vendor(
        "a Kinect v2", connected_freenect2s, Freenect2Sensor, freenect2_library_check, freenect2_sensor_check
    ),
    "realsense": Vendor(
        "RealSense sensors",
        connected_realsenses,
        RealSenseSensor,
        realsense_sdk_check,
        realsense_sensor_check,
    ),
}
"""All vendors but Microsoft, by :attr:`ConnectedSensor.sdk`."""


def connected_sensors(tracker: TrackerChoice | None) -> list[ConnectedSensor]:
    """Connected Azure Kinects and sensors of the other vendors.

    A Femto Bolt or Mega may be listed twice, by Orbbec's SDK v2 and by its K4A wrapper. It is taken from the
    wrapper where libk4abt tracks, which needs the wrapper's captures, else from SDK v2.

    Raises:
        DeviceError: No vendor's software is installed.
    """
    faults: list[str] = []
    others: list[ConnectedSensor] = []
    kinects: list[ConnectedSensor] = []
    try:
        kinects = connected_kinects()
    except DeviceError as fault:
        faults.append(str(fault))
    broken = bool(faults) and find_spec("pyk4a") is not None  # installed, but it cannot be imported
    for vendor in VENDORS.values():
        try:
            others += vendor.connected()
        except DeviceError as fault:
            faults.append(f"For {vendor.sensors}: {fault}")
    if len(faults) == len(VENDORS) + 1:
        raise DeviceError(" Or: ".join(faults))
    if broken and not others:
        raise DeviceError(faults[0])  # else it would read as if nothing were connected
    if tracker is not None and tracker.name == "k4abt":
        by_wrapper = {kinect.serial for kinect in kinects if kinect.serial is not None}
        others = [other for other in others if other.serial not in by_wrapper]
    else:
        by_sdk = {other.serial for other in others}
        kinects = [kinect for kinect in kinects if kinect.serial is None or kinect.serial not in by_sdk]
    return [replace(found, index=index) for index, found in enumerate((*kinects, *others))]


def decimation_of(tracker: TrackerChoice | None, fps: float) -> FrameDecimation:
    """The frame decimation that two sensors with this tracker share.

    With the program's own tracker it also changes to the lighter network if a tracker stays too slow.
    """
    if tracker is None or tracker.name != "blazepose":
        return FrameDecimation(fps)
    return TrackingPace(fps, tracker.blazepose)


def live_sensor(
    connected: ConnectedSensor,
    settings: KinectSettings,
    tracker: TrackerChoice | None,
    decimation: FrameDecimation,
) -> Sensor:
    """The sensor with its body tracker, or without one; opens nothing."""
    serial = str(connected.serial)
    if tracker is not None and not isinstance(decimation, TrackingPace):
        return KinectSensor(serial, settings, tracker.k4abt, decimation=decimation)
    images: LiveSensor
    if connected.sdk in VENDORS:
        images = VENDORS[connected.sdk].sensor(serial, settings, decimation)
    else:
        images = KinectSensor(serial, replace(settings, infrared=True), track=False, decimation=decimation)
    if not isinstance(decimation, TrackingPace):
        return images
    return TrackedImages(images, decimation.settings, registered=images.registered, pace=decimation)
