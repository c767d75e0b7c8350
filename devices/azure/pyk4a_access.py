"""Access to connected Kinects through pyk4a. Only this file imports pyk4a, and only on demand.

The SDK's errors have no description, so this file determines why a device does not open.
"""

import os
import re
import sys
import threading
from types import ModuleType
from typing import Any

from devices.azure.pyk4a_internals import firmware_advice, firmware_version, log_added, put_back_none
from devices.capture import usb
from devices.capture.causes import Cause, in_brackets
from devices.capture.sensor_choice import ConnectedSensor
from devices.capture.usb import usb_kinects
from devices.check import extra_command, installed_version
from devices.sensor import AbsentError, DeviceError
from devices.vendor import load_module

_NAMES = (
    *("CalibrationType.COLOR", "CalibrationType.DEPTH", "ColorResolution", "Config", "DepthMode", "FPS"),
    *("ImageFormat.COLOR_MJPG", "K4AException", "K4ATimeoutException", "PyK4A.calibration"),
    *("PyK4A.calibration_raw", "PyK4A.close", "PyK4A.get_capture", "PyK4A.open", "PyK4A.opened"),
    *("PyK4A.serial", "PyK4A.start", "PyK4A.stop", "PyK4A.sync_jack_status", "WiredSyncMode"),
    "connected_device_count",
)
"""All that this program uses of the module."""
_NEEDS = {
    "linux": (
        "a C++ compiler (Debian, Ubuntu: build-essential), Python's headers (python3-dev) and the headers of "
        "the Azure Kinect Sensor SDK 1.4 (libk4a1.4-dev; for Orbbec their K4A wrapper, its folders named by "
        "CPATH, LIBRARY_PATH and LD_LIBRARY_PATH)"
    ),
    "win32": (
        "Microsoft's C++ Build Tools and the Azure Kinect Sensor SDK 1.4.1 where its installer puts it (for "
        "Orbbec: build against it, then put the DLLs of their K4A wrapper in its place)"
    ),
}

_opening = threading.Lock()
_open_here: set[str] = set()  # serial numbers that this process holds open
_seen_on_bus: set[str] = set()  # serial numbers that the system's list of USB devices has shown, too


def connected_kinects() -> list[ConnectedSensor]:
    """All connected Kinects. Each is opened briefly; one in use by another program has a fault.

    Raises:
        DeviceError: pyk4a or the SDK is not installed.
    """
    sdk = load_sdk()
    found: list[ConnectedSensor] = []
    for index in range(sdk.connected_device_count()):
        device = sdk.PyK4A(device_id=index, thread_safe=False)
        try:
            _open(device, sdk)
            sync_in, sync_out = device.sync_jack_status
            serial, firmware = device.serial, firmware_version(device)
            description = "" if firmware is None else f"firmware {'.'.join(map(str, firmware))}"
            advice = firmware_advice(serial, firmware)
            found.append(
                ConnectedSensor(index, serial, sync_in, sync_out, description=description, advice=advice)
            )
        except sdk.K4AException as fault:
            found.append(ConnectedSensor(index, None, fault=why_not_open(fault)))
        finally:
            release_device(device, sdk)
    return found


def load_sdk() -> ModuleType:
    """The module pyk4a.

    Raises:
        DeviceError: It, or the SDK beneath it, is not installed.
    """
    # libk4a writes its errors to standard output, among ours, unless told not to before it is loaded.
    os.environ.setdefault("K4A_ENABLE_LOG_TO_STDOUT", "0")
    return load_module("pyk4a", "pyk4a", "Live sensors", _NAMES, how_to_install())


def how_to_install(platform: str = sys.platform) -> str:
    """Returns the instructions for installing a pyk4a that works with this program.

    pyk4a is built from source: the wheels of pyk4a-bundle need numpy < 2, and rerun-sdk needs numpy ≥ 2.
    """
    needs = _NEEDS.get(platform)
    if needs is None:
        return "The Azure Kinect Sensor SDK runs on Windows and Linux only: record there, and fuse here."
    remove = ""
    if installed_version("pyk4a-bundle"):
        remove = "Remove pyk4a-bundle, whose wheels need numpy < 2 (pip uninstall pyk4a-bundle). "
    return f"{remove}pyk4a is built from source, with {needs}. Then: {extra_command('kinect')}."


def open_kinect(sdk: Any, serial: str, configuration: Any) -> Any:
    """Opens the Kinect with a serial number, without starting its cameras.

    It queries all devices, because their indices are not stable. libk4a is told to give each image at
    once, in a capture of its own: else it holds depth back until colour comes.

    Raises:
        AbsentError: It is not connected; libk4a was not asked to open anything.
        DeviceError: It cannot be opened.
    """
    with _opening:
        os.environ["K4A_DISABLE_SYNCHRONIZATION"] = "1"  # libk4a reads it at opening
        others, faults = sorted(_open_here), []
        if _on_bus(serial) is False:  # says Linux, which is asked without holding the GIL
            raise AbsentError(_not_found(serial, sorted({*others, *_serials_on_bus()}), []))
        count = sdk.connected_device_count()
        if count <= len(others):  # ours cannot be opened twice, so a bus with no more holds no other
            raise AbsentError(_not_found(serial, others, []))
        for index in range(count):
            device = sdk.PyK4A(config=configuration, device_id=index, thread_safe=False)
            try:
                _open(device, sdk)
                found = device.serial
            except sdk.K4AException as fault:
                faults.append(why_not_open(fault))
                release_device(device, sdk)
                continue
            if found == serial:
                _open_here.add(serial)
                if serial in _serials_on_bus():
                    _seen_on_bus.add(serial)
                return device
            if found not in others:  # one of ours, where opening is lazy
                others.append(found)
            release_device(device, sdk)
        raise DeviceError(_not_found(serial, others, faults[len(_open_here) :]))


def _open(device: Any, sdk: Any) -> None:
    try:
        with log_added():
            device.open()
    except sdk.K4AException:
        put_back_none()
        raise


def close_kinect(sdk: Any, serial: str, device: Any) -> str:
    """Closes a device opened by ``open_kinect``, even if disconnected; returns the failure, empty if none."""
    with _opening:
        _open_here.discard(serial)
        return release_device(device, sdk)


def is_connected(sdk: Any, serial: str) -> bool:
    """Whether a Kinect opened by this process is still connected. Call it only when frames stop arriving.

    Where the system has listed it by its serial number (Linux), that list decides. Elsewhere (Windows) the
    SDK counts what is connected: fewer than this process has open means that the one that fails is gone.
    The SDK searches the bus for that, and pyk4a holds the GIL meanwhile.
    """
    on_bus = _on_bus(serial)
    if on_bus is not None:
        return on_bus
    return bool(sdk.connected_device_count() >= max(1, len(_open_here)))


def is_listed(serial: str) -> bool:
    """Whether the system lists its sensors by their serial numbers, so that it is known which is missing."""
    return _on_bus(serial) is not None


def _on_bus(serial: str) -> bool | None:
    """Whether the system's list of USB devices contains it; None if the list is empty or never contained
    it."""
    listed = _serials_on_bus()
    return serial in listed if listed and serial in _seen_on_bus else None


def _serials_on_bus() -> list[str]:
    """Of the sensors that libk4a can open: it may be Orbbec's wrapper."""
    return [device.serial for device in usb_kinects() if device.serial and device.sdk in ("k4a", "orbbec")]


def _not_found(serial: str, others: list[str], faults: list[str]) -> str:
    if faults:
        there = f" Open: {', '.join(others)}." if others else ""
        return f"Kinect {serial} cannot be opened: {faults[0]}{there}"
    if others:
        return (
            f"No Kinect with serial {serial}. Connected: {', '.join(others)}. Check its USB and power, or "
            f"choose one of these."
        )
    return f"No Kinect with serial {serial}, and no other. Plug it in: USB 3 and its own power supply."


def why_not_open(fault: Exception, serial: str = "") -> str:
    """Why a connected Kinect does not open; see :func:`devices.capture.usb.why_not_open`."""
    old = re.search(r"Firmware version for \w+ is ([\d.]+) is not current enough", _log_of(fault))
    if old is not None:
        return Cause.OLD_FIRMWARE.says(version=old[1])
    return usb.why_not_open(fault, usb_kinects(), "k4aviewer", "k4a", "orbbec", serial=serial)


def why_not_started(fault: Exception, label: str, what: str, advice: str) -> DeviceError:
    """The error for an open Kinect that does not start.

    Args:
        fault: The SDK's exception, with libk4a's log as notes.
    """
    log = _log_of(fault)
    if "color_start(" in log:
        return Cause.COLOR_NOT_STARTED.error(label=label)
    if "depth engine" in log.lower():
        return Cause.ENGINE_NOT_STARTED.error(label=label)
    fields = {"what": what, "said": in_brackets(fault), "advice": advice, "programs": "k4aviewer"}
    return Cause.CAMERAS_NOT_STARTED.error(label=label, **fields)


def _log_of(fault: Exception) -> str:
    return " ".join(getattr(fault, "__notes__", ()))


def release_device(device: Any, sdk: Any) -> str:
    """Stops and closes a device in any state; returns the failure, empty if none."""
    faults = []
    for running, action in ((True, "stop"), (False, "close")):
        # stop() closes too, unless stopping failed on the way: then close() must still be tried.
        if device.opened and (device.is_running or not running):
            try:
                getattr(device, action)()
            except sdk.K4AException as fault:
                faults.append(str(fault) or f"{action} failed")
            device.is_running = False  # or its destructor stops it once more
    return "; ".join(faults)
