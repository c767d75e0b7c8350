"""Checks of live capture on this machine, for the sensors of all vendors and both body trackers."""

import os
from dataclasses import replace
from pathlib import Path

from devices.azure import checks as azure
from devices.blazepose.checks import networks_check
from devices.capture import usb
from devices.capture.sensor_choice import (
    ConnectedSensor,
    NeedsChoiceError,
    cable_unknown,
    choose_two,
    no_port,
    sync_master,
)
from devices.check import Check, failed
from devices.live_sensors import VENDORS, connected_sensors
from devices.realsense import sdk_access as realsense
from devices.sensor import DeviceError
from devices.tracker_choice import TrackerChoice, choose_tracker

_NO_SDK = Check(
    "two Kinects",
    False,
    "cannot be looked for without a sensor library",
    "Install one of them first, as said above.",
)
_CABLE_ADVICE = (
    "A 3.5 mm cable from one's sync out to the other's sync in makes them capture together, without "
    "disturbing each other."
)


def log_libraries_to(folder: Path) -> None:
    """Has the sensors' libraries log to files of a folder; call it before the first of them is loaded."""
    for name in ("K4A", "K4ABT"):
        os.environ[f"{name}_ENABLE_LOG_TO_A_FILE"] = str(folder / f"{name}.log")
        os.environ.setdefault(f"{name}_LOG_LEVEL", "i")
    realsense.log_to(folder / "librealsense.log")


def device_checks(
    tracker: TrackerChoice | None = None,
    root: Path = Path("/"),
    *,
    x_answers: bool = True,
    choice: tuple[str | None, str | None, str | None] = (None, None, None),
    named_master: str | None = None,
) -> list[Check]:
    """Checks the devices and libraries that live capture needs, in the order of repair.

    One vendor's software is enough, and one body tracker. What another would need is reported, too, and is
    not needed.

    Args:
        tracker: The tracker that is to run, and the settings of both. None: chosen for this machine.
        x_answers: Whether the X display answers, where DISPLAY names one.
        choice: Serial numbers A, B and principal, as for ``choose_two``.
        named_master: Serial number of the master on the sync cable, if named by the user.
    """
    tracker = tracker or choose_tracker(root=root)
    sdks = [azure.sdk_check(), *(vendor.sdk_check() for vendor in VENDORS.values())]
    usable = any(sdk.ok for sdk in sdks)
    kinects = _kinects(tracker, choice, named_master) if usable else [_NO_SDK]
    with_k4abt = tracker.name == "k4abt"
    k4abt = [azure.tracker_library_check(tracker.k4abt)]
    if with_k4abt or k4abt[0].ok:
        k4abt += [azure.tracker_network_check(tracker.k4abt, root), azure.gpu_check(tracker.k4abt, root)]
    k4abt = [_needed_if(with_k4abt, check) for check in k4abt]
    return [
        *(replace(sdk, needed=not usable, one_of="sensor library") for sdk in sdks),
        _needed_if(sdks[0].ok, azure.depth_engine_check(root, x_answers)),
        Check("body tracker in use", True, f"{tracker.full_name} ({tracker.reason})", needed=False),
        *k4abt,
        _needed_if(not with_k4abt, networks_check(tracker.blazepose)),
        usb.permission_check(root),
        usb.speed_check(root),
        *kinects,
        Check(
            "proven on hardware",
            False,
            "live capture of every sensor and both body trackers have met stand-ins and "
            "simulations only, never a real sensor; .mkv recordings have",
            "Send what it finds with yours: duplex doctor --bundle FILE.zip.",
            needed=False,
        ),
    ]


def _needed_if(used: bool, check: Check) -> Check:
    return replace(check, needed=check.needed and used)


def _kinects(
    tracker: TrackerChoice, choice: tuple[str | None, str | None, str | None], named_master: str | None
) -> list[Check]:
    try:
        there = connected_sensors(tracker)
    except DeviceError as fault:
        return [failed("two Kinects", fault)]
    usable = sum(kinect.serial is not None for kinect in there)
    counted, each = f"{len(there)} connected, {usable} usable", [_sensor(sensor) for sensor in there]
    if usable < 2:
        advice = "Plug in two: USB 3 and a power supply each, on two USB controllers."
        return [Check("two Kinects", False, counted, advice), *each]
    try:
        chosen = choose_two(there, *choice)
    except NeedsChoiceError as question:  # duplex live asks the user
        chosen = question.serials
    except DeviceError as fault:
        return [Check("two Kinects", False, counted, str(fault)), *each]
    return [Check("two Kinects", True, counted), *each, _sync_cable(there, chosen, named_master)]


def _sync_cable(there: list[ConnectedSensor], chosen: tuple[str, str], named_master: str | None) -> Check:
    """Checks the sync cable between the two sensors."""
    a, b = (next(kinect for kinect in there if kinect.serial == serial) for serial in chosen)
    if named_master is None and no_port(a, b):
        return Check("sync cable", True, no_port(a, b), needed=False)
    try:
        master = sync_master(a, b, named_master)
    except DeviceError as fault:
        return failed("sync cable", fault)
    if master is None:
        unknown = cable_unknown(a, b)
        found = "not known" if unknown else "none"
        return Check("sync cable", False, found, unknown or _CABLE_ADVICE, needed=False)
    other = b.serial if master == a.serial else a.serial
    said = " (as --sync-master says)" if named_master else ""
    return Check("sync cable", True, f"from {master} to {other}{said}", needed=False)


def _sensor(sensor: ConnectedSensor) -> Check:
    check = VENDORS[sensor.sdk].sensor_check if sensor.sdk in VENDORS else azure.sensor_check
    return check(sensor)
