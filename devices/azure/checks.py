"""Checks of live capture on this machine, as data."""

from __future__ import annotations

import os
import sys
from dataclasses import replace
from pathlib import Path

from devices.azure.firmware import firmware_advice
from devices.azure.pyk4a_access import ConnectedKinect, load_sdk
from devices.azure.tracking.availability import found_gpu
from devices.azure.tracking.body_tracker import INSTALL, TrackerSettings
from devices.azure.tracking.native_library import load_library, loaded_file
from devices.blazepose.checks import networks_check
from devices.capture.sensor_roles import NeedsChoiceError, cable_unknown, choose_two, sync_master
from devices.capture.usb import UDEV_ADVICE, usb_kinects
from devices.check import Check, failed
from devices.connected_sensors import connected_sensors
from devices.orbbec.checks import sdk_check, sensor_check
from devices.sensor import DeviceError
from devices.tracker_choice import TrackerChoice, choose_tracker

_MODELS = ("dnn_model_2_0_op11.onnx", "dnn_model_2_0_lite_op11.onnx", "dnn_model_2_0.onnx")
_DEPTH_ENGINE = "libdepthengine.so.2.0"
_USB3_MEGABITS = 5000
_NO_SDK = Check(
    "two Kinects",
    False,
    "cannot be looked for without pyk4a or pyorbbecsdk2",
    "Install one of them first, as said above.",
)
_CABLE_ADVICE = (
    "A 3.5 mm cable from one's sync out to the other's sync in makes them capture together, without "
    "disturbing each other."
)


def device_checks(
    tracker: TrackerChoice | None = None,
    root: Path = Path("/"),
    *,
    x_answers: bool = True,
    choice: tuple[str | None, str | None, str | None] = (None, None, None),
    named_master: str | None = None,
) -> list[Check]:
    """Checks the devices and libraries that live capture needs, in the order of repair.

    One of the two vendors' software is enough, and one body tracker. What another would need is reported,
    too, and is not needed.

    Args:
        tracker: The tracker that is to run, and the settings of both. None: chosen for this machine.
        root: Root of the file system; tests inject their own.
        choice: Serial numbers A, B and principal, as for ``choose_two``.
        named_master: Serial number of the master on the sync cable, if named by the user.
        x_answers: Whether the X display answers, where DISPLAY names one.
    """
    tracker = tracker or choose_tracker(root=root)
    sdk, orbbec = _sdk(), sdk_check()
    kinects = _kinects(tracker, choice, named_master) if sdk.ok or orbbec.ok else [_NO_SDK]
    with_k4abt = tracker.name == "k4abt"
    k4abt = [_tracker_library(tracker.k4abt)]
    if with_k4abt or k4abt[0].ok:
        k4abt += [_tracker_network(tracker.k4abt, root), _gpu(tracker.k4abt, root)]
    k4abt = [_needed_if(with_k4abt, check) for check in k4abt]
    return [
        replace(sdk, needed=not orbbec.ok, alternative=orbbec.name),
        replace(orbbec, needed=not sdk.ok, alternative=sdk.name),
        _needed_if(sdk.ok, _depth_engine(root, x_answers)),
        Check("body tracker in use", True, f"{tracker.full_name} ({tracker.reason})", needed=False),
        *k4abt,
        _needed_if(not with_k4abt, networks_check(tracker.blazepose)),
        _usb_permission(root),
        _usb_speed(root),
        *kinects,
        Check(
            "proven on hardware",
            False,
            "live capture (libk4a, Orbbec's SDK v2) and both body trackers have met stand-ins and "
            "simulations only, never a real sensor; .mkv recordings have",
            "Report what happens with yours.",
            needed=False,
        ),
    ]


def _needed_if(used: bool, check: Check) -> Check:
    return replace(check, needed=check.needed and used)


def _sdk() -> Check:
    try:
        sdk = load_sdk()
    except DeviceError as fault:
        return failed("pyk4a and the Sensor SDK", fault)
    return Check("pyk4a and the Sensor SDK", True, getattr(sdk, "__file__", None) or "installed")


def _depth_engine(root: Path, x_answers: bool) -> Check:
    """Checks the depth engine, a closed library that computes depth from raw images with OpenGL."""
    name = "depth engine"
    if not sys.platform.startswith("linux"):
        return Check(name, True, f"comes with the Sensor SDK on {sys.platform}")
    display = os.environ.get("DISPLAY")
    if not display or not x_answers:
        what = f"The display {display} (DISPLAY) does not answer" if display else "DISPLAY is not set"
        return Check(
            name,
            False,
            f"{what}, and depth is computed with OpenGL, which needs an X display",
            "Start from a desktop session, or log in at the machine and export DISPLAY=:0.",
        )
    libraries = root / "usr/lib/x86_64-linux-gnu"
    folders = [libraries, libraries / "libk4a1.4", root / "usr/local/lib", root / "usr/lib"]
    sdk = loaded_file("k4a")
    if sdk is not None:
        folders.insert(0, sdk.parent)
    for folder in folders:
        if (folder / _DEPTH_ENGINE).is_file():
            return Check(name, True, f"{folder / _DEPTH_ENGINE}, display {display}")
    return Check(
        name,
        False,
        f"{_DEPTH_ENGINE} is not where the SDK puts it",
        "It comes with the SDK's package libk4a1.4; with Orbbec's wrapper, beside its libk4a.",
        needed=False,  # the SDK may find it in a path of its own
    )


def _tracker_library(tracker: TrackerSettings) -> Check:
    try:
        library = load_library("k4abt", tracker.library, INSTALL)
    except DeviceError as fault:
        return failed("k4abt", fault)
    if not hasattr(library, "k4abt_tracker_create"):
        return Check("k4abt", False, f"{library._name} is another library.", INSTALL)
    return Check("k4abt", True, str(library._name))


def _tracker_network(tracker: TrackerSettings, root: Path) -> Check:
    name = "k4abt's network"
    if tracker.model is not None:
        advice = "" if tracker.model.is_file() else "Check the path, or leave it out."
        return Check(name, tracker.model.is_file(), str(tracker.model), advice)
    folders = [root / "usr/bin", root / "usr/lib/x86_64-linux-gnu", Path.cwd()]
    beside = tracker.library or loaded_file("k4abt")
    if beside is not None:
        folders.insert(0, beside.parent)
    if sys.platform == "win32":
        folders.append(Path("C:/Program Files/Azure Kinect Body Tracking SDK/tools"))
    for folder in folders:
        for model in _MODELS:
            if (folder / model).is_file():
                return Check(name, True, str(folder / model))
    return Check(name, False, f"none of {', '.join(_MODELS)} where libk4abt looks", INSTALL)


def _usb_permission(root: Path) -> Check:
    name = "USB permission"
    if not sys.platform.startswith("linux"):
        return Check(name, True, f"not restricted on {sys.platform}")
    there = usb_kinects(root)
    forbidden = [device for device in there if not device.allowed]
    if forbidden:
        return Check(name, False, f"this user may not open {forbidden[0].node}", UDEV_ADVICE)
    if there:
        return Check(name, True, f"{len(there)} Kinect(s) on the bus may be opened")
    rules = [
        rule
        for folder in ("etc", "lib", "usr/lib")
        for of in ("k4a", "obsensor")
        for rule in (root / folder / "udev/rules.d").glob(f"*{of}*.rules")
    ]
    if rules or os.geteuid() == 0:
        return Check(name, True, f"udev rule {rules[0].name}" if rules else "running as root")
    return Check(name, False, "no udev rule for the Kinect", UDEV_ADVICE)


def _usb_speed(root: Path) -> Check:
    there = usb_kinects(root)
    slow = [device for device in there if 0 < device.megabits < _USB3_MEGABITS]
    if slow:
        detail = f"{slow[0].serial or slow[0].node} runs at {slow[0].megabits} Mbit/s"
        return Check("USB speed", False, detail, "Plug it into a USB 3 port, with its own cable.")
    return Check("USB speed", True, f"{len(there)} Kinect(s) at USB 3" if there else "no Kinect on the bus")


def _kinects(
    tracker: TrackerChoice, choice: tuple[str | None, str | None, str | None], named_master: str | None
) -> list[Check]:
    try:
        there = connected_sensors(tracker)
    except DeviceError as fault:
        return [failed("two Kinects", fault)]
    usable = sum(kinect.serial is not None for kinect in there)
    counted, each = f"{len(there)} connected, {usable} usable", [_kinect(kinect) for kinect in there]
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


def _sync_cable(there: list[ConnectedKinect], chosen: tuple[str, str], named_master: str | None) -> Check:
    """Checks the sync cable between the two sensors."""
    a, b = (next(kinect for kinect in there if kinect.serial == serial) for serial in chosen)
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


def _kinect(kinect: ConnectedKinect) -> Check:
    if kinect.sdk == "orbbec":
        return sensor_check(str(kinect.serial), kinect.model, kinect.connection)
    if kinect.serial is None:
        what, _, advice = kinect.fault.partition(". ")
        return Check(f"Kinect at place {kinect.index}", False, what, advice, needed=False)
    plugs = (
        "sync jacks not known"
        if kinect.is_orbbec
        else f"sync in {_plug(kinect.sync_in)}, sync out {_plug(kinect.sync_out)}"
    )
    if kinect.firmware is not None:
        plugs += f", firmware {'.'.join(map(str, kinect.firmware))}"
    old = firmware_advice(kinect.serial, kinect.firmware)
    return Check(f"Kinect {kinect.serial}", not old, plugs, old, needed=False)


def _plug(connected: bool | None) -> str:
    return "connected" if connected else "empty"


def _gpu(tracker: TrackerSettings, root: Path) -> Check:
    gpu = found_gpu(root)
    if gpu:
        return Check("GPU", True, f"{gpu} found", needed=False)
    slow = (
        "about one frame per second of both sensors: record with k4arecorder now, "
        "duplex fuse a.mkv b.mkv later."
    )
    if tracker.processing == "cpu":
        return Check(
            "GPU", False, "none found; the tracker runs on the CPU", f"That gives {slow}", needed=False
        )
    return Check(
        "GPU",
        False,
        f"no driver found, and the tracker is to run on {tracker.processing}",
        f"Install NVIDIA's driver, or try --processing cpu, which gives {slow}",
    )
