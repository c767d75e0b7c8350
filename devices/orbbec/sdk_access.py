"""Access to connected Orbbec sensors through pyorbbecsdk2. Only this file imports it, and only on demand."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import ModuleType
from typing import Any
from weakref import WeakKeyDictionary

from devices.azure.pyk4a_access import why_not_open
from devices.capture.usb import UDEV_ADVICE, usb_kinects
from devices.orbbec.installing import how_to_install
from devices.sensor import AbsentError, DeviceError

_opening = threading.Lock()
_contexts: WeakKeyDictionary[ModuleType, Any] = WeakKeyDictionary()


@dataclass(frozen=True)
class ConnectedOrbbec:
    """An Orbbec sensor that the SDK lists. Listing opens no sensor, so it cannot show that one is busy.

    Attributes:
        serial: Its serial number.
        model: The maker's name for it, such as "Orbbec Femto Bolt".
        connection: How it is connected, such as "USB3.2" or "Ethernet".
    """

    serial: str
    model: str
    connection: str


def load_sdk() -> ModuleType:
    """The module pyorbbecsdk.

    Raises:
        DeviceError: It is not installed, or it is that of SDK v1.
    """
    try:
        with _without_its_greeting():
            import pyorbbecsdk
    except (ImportError, OSError) as fault:
        raise DeviceError(
            f"Orbbec's sensors need pyorbbecsdk2, which cannot be imported ({fault}). {how_to_install()}"
        ) from fault
    if not hasattr(pyorbbecsdk, "PlaybackDevice"):
        raise DeviceError(
            f"The installed pyorbbecsdk is of Orbbec's SDK v1; this program needs v2. {how_to_install()}"
        )
    return pyorbbecsdk  # type: ignore[no-any-return]


def context_of(sdk: Any) -> Any:
    """The process's one ``Context``. Each one searches the buses with threads of its own."""
    with _opening:
        context = _contexts.get(sdk)
        if context is None:
            # By default it writes files into ./Log, and errors among our lines.
            sdk.Context.set_logger_level(sdk.OBLogLevel.NONE)
            context = sdk.Context()
            # With this setting, frames have the time of time.perf_counter on Linux and Windows.
            context.set_timestamp_clock_type(sdk.OBClockType.MONOTONIC)
            _contexts[sdk] = context
        return context


def connected_orbbecs() -> list[ConnectedOrbbec]:
    """All connected Orbbec sensors; opens none.

    Raises:
        DeviceError: pyorbbecsdk2 is not installed, or it cannot search for sensors.
    """
    sdk = load_sdk()
    try:
        devices = context_of(sdk).query_devices()
        return [
            ConnectedOrbbec(
                devices.get_device_serial_number_by_index(index),
                devices.get_device_name_by_index(index),
                devices.get_device_connection_type_by_index(index),
            )
            for index in range(devices.get_count())
        ]
    except faults_of(sdk) as fault:
        raise DeviceError(f"Orbbec's SDK cannot search for sensors ({fault}). {UDEV_ADVICE}") from fault


def open_orbbec(sdk: Any, serial: str) -> Any:
    """Opens the sensor with a serial number; it is closed when the last reference to it goes.

    Returns:
        A ``pyorbbecsdk.Device``.

    Raises:
        AbsentError: It is not connected.
        DeviceError: It cannot be opened.
    """
    there = [orbbec.serial for orbbec in connected_orbbecs()]
    if serial not in there:
        listed = f"Connected: {', '.join(sorted(there))}." if there else "No other is connected."
        raise AbsentError(
            f"No Orbbec sensor with serial {serial}. {listed} Check its USB 3 port, cable and power supply."
        )
    try:
        return context_of(sdk).query_devices().get_device_by_serial_number(serial)
    except faults_of(sdk) as fault:
        why = why_not_open(fault, usb_kinects(), "OrbbecViewer, k4aviewer")
        raise DeviceError(f"Orbbec {serial} cannot be opened: {why}") from fault


def is_connected(sdk: Any, serial: str) -> bool:
    """Whether the SDK still lists a sensor. Call it when frames stop: an open sensor stays in the list."""
    try:
        devices = context_of(sdk).query_devices()
        return any(
            devices.get_device_serial_number_by_index(index) == serial for index in range(devices.get_count())
        )
    except faults_of(sdk):  # the list changed while it was read
        return False


def faults_of(sdk: Any) -> tuple[type[Exception], ...]:
    """The exceptions of the SDK: its own, and those of C++ that its bindings do not translate."""
    return (sdk.OBError, RuntimeError)


@contextmanager
def _without_its_greeting() -> Iterator[None]:
    """Discards the line with a path that the library prints while it is loaded."""
    if "pyorbbecsdk" in sys.modules:
        yield
        return
    try:
        sys.stdout.flush()
        kept = os.dup(1)
    except (OSError, ValueError, AttributeError):  # no standard output
        yield
        return
    try:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, 1)
        os.close(nowhere)
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)
