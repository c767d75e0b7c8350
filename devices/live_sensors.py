"""All connected sensors, of every vendor whose software is installed, and the live sensors made of them."""

from dataclasses import replace
from importlib.util import find_spec

from devices.azure.kinect import KinectSensor
from devices.azure.pyk4a_access import connected_kinects
from devices.azure.settings import KinectSettings
from devices.blazepose.pace import TrackingPace
from devices.blazepose.tracked_images import TrackedImages
from devices.capture.frame_decimation import FrameDecimation
from devices.capture.sensor_choice import ConnectedSensor
from devices.orbbec.sdk_access import connected_orbbecs
from devices.orbbec.sensor import OrbbecSensor
from devices.sensor import DeviceError, Sensor
from devices.tracker_choice import TrackerChoice


def connected_sensors(tracker: TrackerChoice) -> list[ConnectedSensor]:
    """Connected Azure Kinects and Orbbec sensors.

    A Femto Bolt or Mega may be listed twice, by Orbbec's SDK v2 and by its K4A wrapper. It is taken from the
    wrapper where libk4abt tracks, which needs the wrapper's captures, else from SDK v2.

    Raises:
        DeviceError: No vendor's software is installed.
    """
    faults: list[DeviceError] = []
    orbbecs: list[ConnectedSensor] = []
    kinects: list[ConnectedSensor] = []
    broken = False
    try:
        orbbecs = connected_orbbecs()
    except DeviceError as fault:
        faults.append(fault)
    try:
        kinects = connected_kinects()
    except DeviceError as fault:
        faults.insert(0, fault)
        broken = find_spec("pyk4a") is not None  # installed, but it cannot be imported
    if len(faults) == 2:
        raise DeviceError(f"{faults[0]} Or, for Orbbec's sensors: {faults[1]}")
    if broken and not orbbecs:
        raise faults[0]  # else it would read as if nothing were connected
    by_wrapper = {kinect.serial for kinect in kinects if kinect.serial is not None}
    by_sdk = {orbbec.serial for orbbec in orbbecs}
    if tracker.name == "k4abt":
        orbbecs = [orbbec for orbbec in orbbecs if orbbec.serial not in by_wrapper]
    else:
        kinects = [kinect for kinect in kinects if kinect.serial not in by_sdk]
    return [replace(found, index=index) for index, found in enumerate((*kinects, *orbbecs))]


def decimation_of(tracker: TrackerChoice, fps: float) -> FrameDecimation:
    """The frame decimation that two sensors with this tracker share.

    With the program's own tracker it also changes to the lighter network if a tracker stays too slow.
    """
    return TrackingPace(fps, tracker.blazepose) if tracker.name == "blazepose" else FrameDecimation(fps)


def live_sensor(
    connected: ConnectedSensor, settings: KinectSettings, tracker: TrackerChoice, decimation: FrameDecimation
) -> Sensor:
    """The sensor with its body tracker; opens nothing."""
    serial = str(connected.serial)
    if not isinstance(decimation, TrackingPace):
        return KinectSensor(serial, settings, tracker.k4abt, decimation=decimation)
    images: Sensor
    if connected.sdk == "orbbec":
        images = OrbbecSensor(serial, settings, decimation)
    else:
        images = KinectSensor(serial, replace(settings, infrared=True), track=False, decimation=decimation)
    return TrackedImages(images, decimation.settings, pace=decimation)
