"""All connected sensors, of every vendor whose software is installed."""

from __future__ import annotations

from dataclasses import replace

from devices.azure.pyk4a_access import connected_kinects
from devices.capture.connected import ConnectedSensor
from devices.orbbec.sdk_access import connected_orbbecs
from devices.sensor import DeviceError
from devices.tracker_choice import TrackerChoice


def connected_sensors(tracker: TrackerChoice) -> list[ConnectedSensor]:
    """Connected Azure Kinects and Orbbec sensors.

    A Femto Bolt or Mega may be listed twice, by Orbbec's SDK v2 and by its K4A wrapper. It is taken from the
    wrapper where libk4abt tracks, which needs the wrapper's captures, else from SDK v2.

    Args:
        tracker: The tracker that takes the images.

    Raises:
        DeviceError: No vendor's software is installed.
    """
    faults: list[DeviceError] = []
    orbbecs: list[ConnectedSensor] = []
    kinects: list[ConnectedSensor] = []
    try:
        orbbecs = connected_orbbecs()
    except DeviceError as fault:
        faults.append(fault)
    try:
        kinects = connected_kinects()
    except DeviceError as fault:
        faults.insert(0, fault)
    if len(faults) == 2:
        raise DeviceError(f"{faults[0]} Or, for Orbbec's sensors: {faults[1]}")
    by_wrapper = {kinect.serial for kinect in kinects if kinect.serial is not None}
    by_sdk = {orbbec.serial for orbbec in orbbecs}
    if tracker.name == "k4abt":
        orbbecs = [orbbec for orbbec in orbbecs if orbbec.serial not in by_wrapper]
    else:
        kinects = [kinect for kinect in kinects if kinect.serial not in by_sdk]
    return [replace(found, index=index) for index, found in enumerate((*kinects, *orbbecs))]
