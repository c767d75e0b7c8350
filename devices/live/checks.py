"""Checks of live capture on this machine, for the sensors of all vendors and both body trackers."""

import os
from dataclasses import replace
from pathlib import Path

from devices.azure import checks as azure
from devices.blazepose.checks import networks_check
from devices.capture import usb
from devices.capture.sensor_choice import (
    PLUG_IN_TWO,
    ConnectedSensor,
    NeedsChoiceError,
    cable_unknown,
    choose_two,
    no_port,
    sync_master,
)
from devices.check import Check, failed
from devices.live.sensors import (
    NoLibraryError,
    connected_sensors,
    library_for,
    sdks_on_usb,
    vendors,
)
from devices.realsense import sdk_access as realsense
from devices.sensor import DeviceError
from devices.tracker_choice import TrackerChoice, choose_tracker

_TWO = "two sensors"
_PROVEN = Check(
    "proven on hardware",
    False,
    "live capture was tested with stand-ins and simulations only, never with a real sensor",
    "Report on yours with duplex doctor --bundle FILE.zip.",
    needed=False,
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

    One vendor's software is enough, and one body tracker. What only another would need is left out.

    Args:
        tracker: The tracker that is to run, and the settings of both. None: chosen for this machine.
        x_answers: Whether the X display answers, where DISPLAY names one.
        choice: Serial numbers A, B and principal, as for ``choose_two``.
        named_master: Serial number of the master on the sync cable, if named by the user.
    """
    tracker = tracker or choose_tracker(root=root)
    sdks = _libraries()
    of_azure, k4abt = sdks["k4a"], azure.tracker_library_check(tracker.k4abt)
    with_k4abt = tracker.name == "k4abt"
    checks = [*sdks.values()]
    if of_azure.ok:
        checks.append(azure.depth_engine_check(root, x_answers))
    checks.append(Check("body tracker in use", True, f"{tracker.full_name} ({tracker.reason})"))
    if with_k4abt or k4abt.ok:
        of_k4abt = azure.tracker_network_check(tracker.k4abt, root), azure.gpu_check(tracker.k4abt, root)
        checks += [_needed_if(with_k4abt, check) for check in (k4abt, *of_k4abt)]
    checks.append(_needed_if(not with_k4abt, networks_check(tracker.blazepose)))
    checks.append(usb.permission_check(root))
    if usb.usb_kinects(root):
        checks.append(usb.speed_check(root))
    sensors = _sensors(sdks, tracker, root, choice, named_master)
    return checks + [replace(check, about="sensor") for check in sensors]


def _libraries() -> dict[str, Check]:
    """The library of every vendor, by :attr:`ConnectedSensor.sdk`; none alone is needed."""
    return {
        name: replace(
            vendor.sdk_check(), needed=False, about="library", serves=vendor.sensors, install=vendor.install
        )
        for name, vendor in vendors().items()
    }


def _needed_if(used: bool, check: Check) -> Check:
    return replace(check, needed=check.needed and used)


def _sensors(
    sdks: dict[str, Check],
    tracker: TrackerChoice,
    root: Path,
    choice: tuple[str | None, str | None, str | None],
    named_master: str | None,
) -> list[Check]:
    """Checks that there are two sensors, each of them, and the cable between them."""
    try:
        there = connected_sensors(tracker, root)
    except NoLibraryError:
        detail = "none found: the library for them is not installed"
        return [Check(_TWO, False, detail, _what_to_do([], sdks, root))]
    except DeviceError as fault:
        return [failed(_TWO, fault)]
    count = sum(sensor.serial is not None for sensor in there)
    counted, each = f"{len(there)} connected, {count} usable", [_sensor(sensor) for sensor in there]
    if count < 2:
        advice = _what_to_do(there, sdks, root)
        return [Check(_TWO, False, counted if there else "none found", advice), *each]
    try:
        chosen = choose_two(there, *choice)
    except NeedsChoiceError as question:  # duplex live asks the user
        chosen = question.serials
    except DeviceError as fault:
        return [Check(_TWO, False, counted, str(fault)), *each]
    return [Check(_TWO, True, counted), *each, _sync_cable(there, chosen, named_master), _PROVEN]


def _what_to_do(there: list[ConnectedSensor], sdks: dict[str, Check], root: Path) -> str:
    """The next step towards two sensors."""
    for sensor in there:
        if sensor.serial is None:
            check = _sensor(sensor)
            return f"{check.name}: {check.advice}"
    without_library = sorted(name for name in sdks_on_usb(root) if not sdks[name].ok)
    if without_library:
        return library_for(without_library[0])
    if there:
        return PLUG_IN_TWO
    ready = ", ".join(sdk.serves for sdk in sdks.values() if sdk.ok)
    if ready:
        return f"Plug in two sensors that an installed library runs: {ready}."
    return "Install the library of your sensors as its line above says."


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
    said = " (as `sync_master` says)" if named_master else ""
    return Check("sync cable", True, f"from {master} to {other}{said}", needed=False)


def _sensor(sensor: ConnectedSensor) -> Check:
    return vendors()[sensor.sdk].sensor_check(sensor)
