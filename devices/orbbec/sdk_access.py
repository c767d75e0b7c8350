"""Access to connected Orbbec sensors through pyorbbecsdk2. Only this file imports it, and only on demand."""

import os
import re
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from types import ModuleType
from typing import Any
from weakref import WeakKeyDictionary

from devices.capture.sensor_choice import ConnectedSensor
from devices.capture.settings import CaptureSettings
from devices.capture.usb import udev_advice, usb_kinects, why_not_open
from devices.check import Check, failed, installed_version
from devices.sensor import DeviceError
from devices.vendor import absent, library_check, load_module

SDK_NAME = "pyorbbecsdk2 (Orbbec's SDK v2)"
RECOMMENDED_FIRMWARE = {"Femto Bolt": (1, 1, 3), "Femto Mega": (1, 3, 1), "Gemini 2": (1, 4, 98)}
"""By product, from ``config/firmware_compatibility_pid.json`` of pyorbbecsdk2 2.1.2."""
COMMAND = "pip install --upgrade --no-deps pyorbbecsdk2"
_NAMES = (
    *("Context.query_devices", "Context.set_logger_level", "Context.set_timestamp_clock_type"),
    *("Device.get_device_info", "Device.get_multi_device_sync_config", "Device.set_multi_device_sync_config"),
    *("Device.get_supported_multi_device_sync_mode_bitmap", "Device.timer_sync_with_host"),
    *("DeviceInfo.get_firmware_version", "DeviceList.get_count", "DeviceList.get_device_by_serial_number"),
    *("DeviceList.get_device_connection_type_by_index", "DeviceList.get_device_name_by_index"),
    *("DeviceList.get_device_serial_number_by_index", "Pipeline.disable_frame_sync", "Pipeline.start"),
    *("Pipeline.get_stream_profile_list", "Pipeline.stop", "Pipeline.wait_for_frames"),
    *("PlaybackDevice.get_duration", "PlaybackDevice.get_playback_status", "Config.enable_stream"),
    *("Config.set_frame_aggregate_output_mode", "FrameSet.get_color_frame", "FrameSet.get_depth_frame"),
    *("FrameSet.get_ir_frame", "FrameSet.get_left_ir_frame", "DepthFrame.get_depth_scale"),
    *("Frame.get_data", "Frame.get_data_size", "Frame.get_timestamp_us", "Frame.get_system_timestamp_us"),
    *("VideoFrame.get_height", "VideoFrame.get_width", "VideoStreamProfile.get_distortion"),
    *("VideoStreamProfile.get_extrinsic_to", "VideoStreamProfile.get_intrinsic"),
    *("OBClockType.MONOTONIC", "OBError", "OBFormat.MJPG", "OBFormat.Y16", "OBFormat.Y8", "OBLogLevel.NONE"),
    *("OBFrameAggregateOutputMode.ANY_SITUATION", "OBFrameAggregateOutputMode.DISABLE"),
    *("OBFrameAggregateOutputMode.FULL_FRAME_REQUIRE", "OBPlaybackStatus.STOPPED"),
    *("OBMultiDeviceSyncMode.FREE_RUN", "OBMultiDeviceSyncMode.PRIMARY", "OBMultiDeviceSyncMode.SECONDARY"),
    *("OBMultiDeviceSyncMode.SECONDARY_SYNCED", "OBMultiDeviceSyncMode.STANDALONE"),
    *("OBSensorType.COLOR_SENSOR", "OBSensorType.DEPTH_SENSOR", "OBSensorType.IR_SENSOR"),
    "OBSensorType.LEFT_IR_SENSOR",
)
"""All that this program uses of the module."""
_opening = threading.Lock()
_contexts: WeakKeyDictionary[ModuleType, Any] = WeakKeyDictionary()


_ROLES = {"standalone": "standalone device", "master": "primary", "subordinate": "secondary"}
"""Orbbec's words for the places on a sync cable."""


def load_sdk() -> ModuleType:
    """The module pyorbbecsdk.

    Raises:
        DeviceError: It is not installed, or of a version that lacks what this program uses.
    """
    with _without_its_greeting():
        return load_module("pyorbbecsdk", "pyorbbecsdk2", "Orbbec's sensors", _NAMES, how_to_install())


def how_to_install(python: tuple[int, int] = sys.version_info[:2]) -> str:
    """Returns the instructions for installing a pyorbbecsdk2 that works with this program.

    Its declared requirements (numpy < 2 on Python 3.11, av 12 or 13, open3d) are those of its examples and
    clash with this program's. The bindings themselves need numpy only.
    """
    remove = ""
    if installed_version("pyorbbecsdk"):
        remove = "Remove pyorbbecsdk, the bindings of SDK v1, first (pip uninstall pyorbbecsdk). "
    newest = "" if python <= (3, 13) else " There are wheels for Python 3.11 to 3.13 only."
    return f"{remove}{COMMAND} (without --no-deps it would replace numpy and av).{newest}"


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


def connected_orbbecs() -> list[ConnectedSensor]:
    """All connected Orbbec sensors. Listing opens none, so it cannot show that one is busy.

    Raises:
        DeviceError: pyorbbecsdk2 is not installed, or it cannot search for sensors.
    """
    sdk = load_sdk()
    try:
        devices = context_of(sdk).query_devices()
        found = []
        for index in range(devices.get_count()):
            model = devices.get_device_name_by_index(index)  # such as "Orbbec Femto Bolt"
            connection = devices.get_device_connection_type_by_index(index)  # "USB3.2" or "Ethernet"
            serial = devices.get_device_serial_number_by_index(index)
            found.append(
                ConnectedSensor(
                    *(index, serial, False, False),
                    sdk="orbbec",
                    description=f"{model}, {connection}",
                    tells_jacks=False,
                )
            )
        return found
    except faults_of(sdk) as fault:
        raise DeviceError(
            f"Orbbec's SDK cannot search for sensors ({fault}). {udev_advice('orbbec')}"
        ) from fault


def open_orbbec(sdk: Any, serial: str) -> Any:
    """Opens the sensor with a serial number; it is closed when the last reference to it goes.

    Raises:
        AbsentError: It is not connected.
        DeviceError: It cannot be opened.
    """
    there = [str(orbbec.serial) for orbbec in connected_orbbecs()]
    if serial not in there:
        advice = "Check its USB 3 port, cable and power supply."
        raise absent("Orbbec sensor", serial, there, advice)
    try:
        return context_of(sdk).query_devices().get_device_by_serial_number(serial)
    except faults_of(sdk) as fault:
        why = why_not_open(fault, usb_kinects(), "OrbbecViewer, k4aviewer", "orbbec", serial=serial)
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


def set_sync_role(sdk: Any, device: Any, serial: str, settings: CaptureSettings) -> str:
    """Gives an opened sensor its place on the sync cable.

    Sensors keep their place when they lose power, so standalone is set explicitly: a sensor that was left a
    secondary would wait for a primary for ever. Femto Bolt and Mega have the mode SECONDARY, Gemini 2
    SECONDARY_SYNCED (Orbbec, Multi-Device-Synchronization-Example); the sensor is asked which it has.

    Returns:
        A warning; empty if there is none.

    Raises:
        DeviceError: The sensor cannot take that place.
    """
    modes = sdk.OBMultiDeviceSyncMode
    choices = {
        "standalone": (modes.STANDALONE, modes.FREE_RUN),
        "master": (modes.PRIMARY,),
        "subordinate": (modes.SECONDARY_SYNCED, modes.SECONDARY),
    }[settings.sync]
    try:
        supported = device.get_supported_multi_device_sync_mode_bitmap()
        mode = next((mode for mode in choices if supported & int(mode)), None)
        if mode is None:
            if settings.sync == "standalone":
                return ""
            raise DeviceError(
                f"Orbbec {serial} cannot be a sync cable's {_ROLES[settings.sync]}. Leave `sync_master` out."
            )
        wanted = device.get_multi_device_sync_config()
        wanted.mode = mode
        wanted.trigger_out_enable = settings.sync == "master"
        delay_us = settings.delay_us if settings.sync == "subordinate" else 0
        wanted.depth_delay_us = wanted.color_delay_us = delay_us
        device.set_multi_device_sync_config(wanted)
        kept_us = device.get_multi_device_sync_config().depth_delay_us
    except faults_of(sdk) as fault:
        if settings.sync == "standalone":
            return ""  # a sensor without a sync port
        raise DeviceError(
            f"Orbbec {serial} does not assume its role on the sync cable ({fault}). Check the sync hub, its "
            f"power and the cables, or leave `sync_master` out."
        ) from fault
    if kept_us != delay_us:  # reported of a Femto Bolt with firmware 1.1.2: OrbbecSDK_v2 issue 38
        return (
            f"Orbbec {serial} captures {kept_us} µs after the pulse instead of {delay_us} µs: the lasers of "
            f"both sensors may disturb each other. Update its firmware."
        )
    return ""


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


def sdk_check(platform: str = sys.platform) -> Check:
    """Whether Orbbec's SDK v2 is installed, and what it lacks on this platform."""
    check = library_check(SDK_NAME, lambda: load_sdk() and (installed_version("pyorbbecsdk2") or "installed"))
    if check.ok and platform == "darwin":
        lacks = "; on macOS it has no depth engine: no depth from Femto Bolt and Mega, only from Gemini"
        return replace(check, detail=check.detail + lacks)
    return check


def sensor_check(sensor: ConnectedSensor) -> Check:
    """A sensor that Orbbec's SDK lists: opened briefly, for its firmware."""
    serial = str(sensor.serial)
    name, (model, _, connection) = f"Orbbec {serial}", sensor.description.rpartition(", ")
    try:
        sdk = load_sdk()
        try:
            firmware = open_orbbec(sdk, serial).get_device_info().get_firmware_version()
        except faults_of(sdk) as fault:
            raise DeviceError(f"{model} hides its firmware ({fault}). Unplug it, plug it in.") from fault
    except DeviceError as fault:
        return failed(name, fault, needed=False)
    detail = f"{sensor.description}, firmware {firmware}, sync jacks not known"
    if connection.startswith("USB2"):
        return Check(name, False, detail, "Plug it into a USB 3 port, with its own cable.", needed=False)
    advice = firmware_advice(model, firmware)
    return Check(name, not advice, detail, advice, needed=False)


def firmware_advice(model: str, firmware: str) -> str:
    """Advice for a firmware that is older than the maker recommends; empty if it is not, or unknown."""
    product = next((product for product in RECOMMENDED_FIRMWARE if model.endswith(product)), None)
    numbers = tuple(int(number) for number in re.findall(r"\d+", firmware)[:3])
    if product is None or len(numbers) < 3 or numbers >= RECOMMENDED_FIRMWARE[product]:
        return ""
    wanted = ".".join(map(str, RECOMMENDED_FIRMWARE[product]))
    return f"Orbbec recommends firmware {wanted} with this SDK: update it with OrbbecViewer."
