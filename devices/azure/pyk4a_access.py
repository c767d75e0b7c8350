"""Access to connected Kinects through pyk4a. Only this file imports pyk4a, and only on demand.

The SDK's errors have no description, so this file determines why a device does not open.
"""

from __future__ import annotations

import os
import threading
from dataclasses import dataclass
from types import ModuleType
from typing import Any, Literal

from devices.azure.firmware import firmware_version
from devices.azure.installing import how_to_install
from devices.azure.pyk4a_leaks import put_back_none
from devices.capture.usb import UDEV_ADVICE, UsbKinect, usb_kinects
from devices.sensor import AbsentError, DeviceError

_opening = threading.Lock()
_open_here: set[str] = set()  # serial numbers that this process holds open
_seen_on_bus: set[str] = set()  # serial numbers that the system's list of USB devices has shown, too


@dataclass(frozen=True)
class ConnectedKinect:
    """A Kinect that the SDK sees.

    Attributes:
        index: Its place in the SDK's list, which changes when sensors come and go.
        serial: Its serial number; None if it cannot be opened.
        sync_in, sync_out: Whether a cable is in the jack; None if it cannot be opened. Orbbec's wrapper
            always says no.
        fault: Why it cannot be opened; empty if it can.
        firmware: Version of its colour camera's firmware, which names the release; None if unknown.
        sdk: Whose software gives its images: libk4a's, or Orbbec's SDK v2.
        model, connection: What Orbbec's SDK v2 calls it, and how it is connected; empty with libk4a.
    """

    index: int
    serial: str | None
    sync_in: bool | None = None
    sync_out: bool | None = None
    fault: str = ""
    firmware: tuple[int, int, int] | None = None
    sdk: Literal["k4a", "orbbec"] = "k4a"
    model: str = ""
    connection: str = ""

    @property
    def is_orbbec(self) -> bool:
        """Whether it is of Orbbec. With libk4a, serial numbers tell: Orbbec's hold letters, Microsoft's do
        not."""
        return self.sdk == "orbbec" or (self.serial is not None and not self.serial.isdigit())


def connected_kinects() -> list[ConnectedKinect]:
    """All connected Kinects. Each is opened briefly; one in use by another program has a fault.

    Raises:
        DeviceError: pyk4a or the SDK is not installed.
    """
    sdk = load_sdk()
    found: list[ConnectedKinect] = []
    for index in range(sdk.connected_device_count()):
        device = sdk.PyK4A(device_id=index, thread_safe=False)
        try:
            _open(device, sdk)
            sync_in, sync_out = device.sync_jack_status
            serial, firmware = device.serial, firmware_version(device)
            found.append(ConnectedKinect(index, serial, sync_in, sync_out, firmware=firmware))
        except sdk.K4AException as fault:
            found.append(ConnectedKinect(index, None, fault=why_not_open(fault)))
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
            f"Live sensors need pyk4a, which cannot be imported ({fault}). {how_to_install()}"
        ) from fault
    return pyk4a  # type: ignore[no-any-return]


def open_kinect(sdk: Any, serial: str, configuration: Any) -> Any:
    """Opens the Kinect with a serial number. It queries all devices, because their indices are not stable.

    Returns:
        The opened ``pyk4a.PyK4A``, without cameras running.

    Raises:
        AbsentError: It is not connected; libk4a was not asked to open anything.
        DeviceError: It cannot be opened.
    """
    with _opening:
        others, faults = sorted(_open_here), []
        if _on_bus(serial) is False:  # says Linux, which is asked without holding the GIL
            raise AbsentError(_not_found(serial, others, []))
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
                let_go(device, sdk)
                continue
            if found == serial:
                _open_here.add(serial)
                if serial in _serials_on_bus():
                    _seen_on_bus.add(serial)
                return device
            if found not in others:  # one of ours, where opening is lazy
                others.append(found)
            let_go(device, sdk)
        raise DeviceError(_not_found(serial, others, faults[len(_open_here) :]))


def _open(device: Any, sdk: Any) -> None:
    try:
        device.open()
    except sdk.K4AException:
        put_back_none()
        raise


def close_kinect(sdk: Any, serial: str, device: Any) -> str:
    """Closes a device opened by ``open_kinect``, even if disconnected; returns the failure, or None."""
    with _opening:
        _open_here.discard(serial)
        return let_go(device, sdk)


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


def _on_bus(serial: str) -> bool | None:
    """Whether the system's list of USB devices contains it; None if the list is empty or never contained
    it."""
    listed = _serials_on_bus()
    return serial in listed if listed and serial in _seen_on_bus else None


def _serials_on_bus() -> list[str]:
    return [device.serial for device in usb_kinects() if device.serial]


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


def why_not_open(fault: Exception, bus: list[UsbKinect] | None = None, programs: str = "k4aviewer") -> str:
    """Why a connected device does not open; the SDKs give no reason.

    Args:
        fault: The SDK's exception.
        bus: The sensors on USB; None: looked up.
        programs: Programs that may keep the device busy.
    """
    said = f" ({fault})" if str(fault) else ""
    forbidden = [device for device in (usb_kinects() if bus is None else bus) if not device.allowed]
    if forbidden:
        return f"no permission for {forbidden[0].node}{said}. {UDEV_ADVICE}"
    return (
        f"it is busy or starting up{said}. Close other programs that use it ({programs}), wait 5 s, "
        "try again."
    )


def let_go(device: Any, sdk: Any) -> str:
    """Stops and closes a device in any state; returns the failure, or None."""
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
