"""The Kinects connected, through pyk4a: the only file that imports it, and only when a sensor is asked for.

Errors of the SDK come without words, so this file finds out why a device does not open.
"""

from __future__ import annotations

import ctypes
import os
import threading
from dataclasses import dataclass
from types import ModuleType
from typing import Any

from devices.azure.usb import UDEV_ADVICE, UsbKinect, usb_kinects
from devices.sensor import DeviceError

_INSTALL = (
    "Install the Azure Kinect Sensor SDK 1.4 (libk4a1.4-dev; for Orbbec their K4A wrapper), then this "
    "program's extra, from its folder: pip install '.[kinect]' (after make: "
    ".venv/bin/pip install -e '.[kinect]')."
)
_opening = threading.Lock()
_open_here: set[str] = set()  # serial numbers that this process holds open


@dataclass(frozen=True)
class ConnectedKinect:
    """A Kinect that the SDK sees.

    Attributes:
        index: Its place in the SDK's list, which changes when sensors come and go.
        serial: Its serial number; None if it cannot be opened.
        sync_in, sync_out: Whether a cable is in the jack; None if it cannot be opened.
        fault: Why it cannot be opened; empty if it can.
    """

    index: int
    serial: str | None
    sync_in: bool | None = None
    sync_out: bool | None = None
    fault: str = ""


def connected_kinects() -> list[ConnectedKinect]:
    """Every Kinect connected, each opened for a moment; one that another program uses has a fault.

    Raises:
        DeviceError: pyk4a or the SDK is not installed.
    """
    sdk = load_sdk()
    found: list[ConnectedKinect] = []
    for index in range(sdk.connected_device_count()):
        device = sdk.PyK4A(device_id=index, thread_safe=False)
        try:
            device.open()
            sync_in, sync_out = device.sync_jack_status
            found.append(ConnectedKinect(index, device.serial, sync_in, sync_out))
        except sdk.K4AException as fault:
            found.append(ConnectedKinect(index, None, fault=_why_not_open(fault)))
        finally:
            let_go(device, sdk)
    return found


def load_sdk() -> ModuleType:
    """The module pyk4a.

    Raises:
        DeviceError: It, or the SDK beneath it, is not installed.
    """
    # libk4a writes its errors to standard output, among ours, unless told not to before it is loaded.
    os.environ.setdefault("K4A_ENABLE_LOG_TO_STDOUT", "0")
    try:
        import pyk4a
    except (ImportError, OSError) as fault:
        raise DeviceError(
            f"Live sensors need pyk4a, which cannot be imported ({fault}). {_INSTALL}"
        ) from fault
    return pyk4a  # type: ignore[no-any-return]


def open_kinect(sdk: Any, serial: str, configuration: Any) -> Any:
    """Opens the Kinect with a serial number, by asking every one for its own: indices are not stable.

    Returns:
        The opened ``pyk4a.PyK4A``, without cameras running.

    Raises:
        DeviceError: It is not there, or cannot be opened.
    """
    with _opening:
        # Ours cannot be opened twice, so a bus with no more than ours holds no other.
        others, faults = sorted(_open_here), []
        for index in range(sdk.connected_device_count() if sdk.connected_device_count() > len(others) else 0):
            device = sdk.PyK4A(config=configuration, device_id=index, thread_safe=False)
            try:
                device.open()
                found = device.serial
            except sdk.K4AException as fault:
                faults.append(_why_not_open(fault))
                let_go(device, sdk)
                continue
            if found == serial:
                _open_here.add(serial)
                return device
            others.append(found)
            let_go(device, sdk)
        raise DeviceError(_not_found(serial, others, faults[len(_open_here) :]))


def close_kinect(sdk: Any, serial: str, device: Any) -> str:
    """Closes what ``open_kinect`` opened, also when it is no longer there; what failed, or nothing."""
    with _opening:
        _open_here.discard(serial)
        return let_go(device, sdk)


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


def _why_not_open(fault: Exception, bus: list[UsbKinect] | None = None) -> str:
    """Why a device that is there does not open; the SDK itself does not say."""
    said = f" ({fault})" if str(fault) else ""
    forbidden = [device for device in (usb_kinects() if bus is None else bus) if not device.allowed]
    if forbidden:
        return f"no permission for {forbidden[0].node}{said}. {UDEV_ADVICE}"
    return (
        f"it is busy or starting up{said}. Close other programs that use it (k4aviewer), wait 5 s, try again."
    )


def let_go(device: Any, sdk: Any) -> str:
    """Stops and closes a device whatever state it is in; what failed, or nothing."""
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


def capture_pointer(capture: Any) -> int:
    """The ``k4a_capture_t`` in a capture: its capsule holds the address of the handle."""
    at = capsule_pointer(capture._capture_handle, b"pyk4a capture handle")
    return ctypes.c_void_p.from_address(at).value or 0


def capsule_pointer(capsule: object, name: bytes) -> int:
    """The address in a capsule; the name guards against handing the library a pointer to something else."""
    get_pointer = ctypes.pythonapi.PyCapsule_GetPointer
    get_pointer.restype, get_pointer.argtypes = ctypes.c_void_p, [ctypes.py_object, ctypes.c_char_p]
    try:
        pointer: int = get_pointer(capsule, name)
    except ValueError as fault:
        raise DeviceError(
            f"This pyk4a keeps no {name.decode()!r} ({fault}): it is another version. Install pyk4a 1.5."
        ) from fault
    return pointer
