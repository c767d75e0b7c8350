"""RealSense sensors through pyrealsense2: finding, opening, sync modes, checks. The library is imported on
demand."""

from contextlib import suppress
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

from devices.capture.sensor_choice import ConnectedSensor
from devices.capture.settings import CaptureSettings
from devices.capture.usb import usb_kinects, why_not_open
from devices.check import extra_command
from devices.sensor import AbsentError, DeviceError
from devices.vendor import load_module

SDK_NAME = "pyrealsense2"
_NAMES = (
    *("align", "context.load_device", "context.query_devices", "device.get_info", "device.is_connected"),
    *("device.query_sensors", "device.supports", "frame_queue.try_wait_for_frame", "log_to_file"),
    *("playback.current_status", "playback.get_duration", "playback.get_position", "playback.pause"),
    *("playback.resume", "playback.set_real_time", "processing_block.invoke", "processing_block.start"),
    *("sensor.close", "sensor.get_stream_profiles", "sensor.open", "sensor.set_option", "sensor.start"),
    *("sensor.stop", "sensor.supports", "frame.get_data", "frame.get_frame_metadata", "frame.get_timestamp"),
    *("frame.get_frame_timestamp_domain", "frame.is_depth_frame", "frame.supports_frame_metadata"),
    *("depth_frame.get_units", "composite_frame.get_color_frame", "video_stream_profile.get_intrinsics"),
    *("stream_profile.as_video_stream_profile", "stream_profile.is_video_stream_profile"),
    *("camera_info.firmware_version", "camera_info.name", "camera_info.product_line"),
    *("camera_info.recommended_firmware_version", "camera_info.serial_number"),
    *("camera_info.usb_type_descriptor", "format.rgb8", "format.y8", "format.z16", "log_severity.info"),
    *("frame_metadata_value.time_of_arrival", "option.global_time_enabled", "option.inter_cam_sync_mode"),
    *("playback_status.stopped", "stream.color", "stream.depth", "stream.infrared"),
    *("timestamp_domain.hardware_clock", "timestamp_domain.system_time"),
)
"""All that this program uses of the module."""
_SYNC_MODES = {"standalone": 0, "master": 1, "subordinate": 2}
"""``inter_cam_sync_mode`` of the D400 series: default, master, slave (``ds-private.h`` of librealsense)."""


def load_sdk() -> ModuleType:
    """The module pyrealsense2; raises a DeviceError if it is not installed."""
    install = (
        f"{extra_command('realsense')}; on Linux it needs libusb (Debian: apt install libusb-1.0-0), "
        f"on macOS build it from librealsense."
    )
    return load_module(SDK_NAME, SDK_NAME, "RealSense sensors", _NAMES, install)


def log_to(path: Path) -> None:
    """Has the library, where it is installed, log to a file, which it makes with its first line."""
    with suppress(DeviceError):
        sdk = load_sdk()
        sdk.log_to_file(sdk.log_severity.info, str(path))


@cache
def context_of(sdk: ModuleType) -> Any:
    """The process's one ``context``. Each one watches the buses with threads of its own."""
    return sdk.context()


def connected_realsenses() -> list[ConnectedSensor]:
    """All connected RealSense sensors. One that another program uses has a fault.

    Raises:
        DeviceError: pyrealsense2 is not installed, or it cannot search for sensors.
    """
    sdk = load_sdk()
    try:
        devices = context_of(sdk).query_devices()
        return [_described(sdk, devices, index) for index in range(len(devices))]
    except RuntimeError as fault:
        raise DeviceError(
            f"pyrealsense2 cannot search for sensors ({fault}). Unplug them, try again."
        ) from fault


def _described(sdk: Any, devices: Any, index: int) -> ConnectedSensor:
    info = sdk.camera_info
    try:
        device = devices[index]
        serial, model, usb, firmware, wanted = (
            device.get_info(kind) if device.supports(kind) else ""
            for kind in (
                *(info.serial_number, info.name, info.usb_type_descriptor, info.firmware_version),
                info.recommended_firmware_version,
            )
        )
    except RuntimeError as fault:
        return ConnectedSensor(index, None, fault=_why_not_open(fault), sdk="realsense")
    details = (model, usb and f"USB {usb}", firmware and f"firmware {firmware}")
    advice = ""
    if usb.startswith("2"):
        advice = f"Plug {serial} into a USB 3 port, with its own cable."
    elif firmware and wanted and _numbers(firmware) < _numbers(wanted):
        advice = f"RealSense recommends firmware {wanted} for {serial}: update it with realsense-viewer."
    return ConnectedSensor(
        *(index, serial or None, False, False),
        sdk="realsense",
        description=", ".join(filter(None, details)),
        advice=advice,
        tells_jacks=False,
    )


def _numbers(version: str) -> tuple[int, ...]:
    return tuple(int(number) for number in version.split(".") if number.isdigit())


def open_realsense(sdk: Any, serial: str) -> Any:
    """The ``device`` with a serial number. Its cameras are opened when they start.

    Raises:
        AbsentError: It is not connected.
        DeviceError: It cannot be opened.
    """
    there = connected_realsenses()
    if serial not in [one.serial for one in there]:
        listed = ", ".join(one.serial or one.fault for one in there) or "none"
        raise AbsentError(
            f"No RealSense sensor with serial {serial}. Connected: {listed}. Check its USB 3 port and cable."
        )
    try:
        devices = context_of(sdk).query_devices()
    except RuntimeError as fault:
        raise DeviceError(f"RealSense {serial} cannot be opened: {_why_not_open(fault)}") from fault
    own: Exception = RuntimeError()
    for index in range(len(devices)):
        try:
            device = devices[index]
            if device.get_info(sdk.camera_info.serial_number) == serial:
                return device
        except RuntimeError as fault:  # of another sensor, if this one is found
            own = fault
    raise DeviceError(f"RealSense {serial} cannot be opened: {_why_not_open(own)}")


def _why_not_open(fault: Exception) -> str:
    return why_not_open(fault, usb_kinects(), "realsense-viewer", "realsense")


def is_connected(device: Any, serial: str) -> bool:
    """Whether an opened sensor is still plugged in. Call it when frames stop."""
    try:
        there = connected_realsenses() if device.is_connected() else []
    except (RuntimeError, DeviceError):
        return False
    return any(one.serial in (serial, None) for one in there)  # a sensor in use may hide its serial number


def set_sync_role(sdk: Any, device: Any, serial: str, settings: CaptureSettings) -> None:
    """Gives a sensor its place on the sync cable, before its cameras are opened.

    Raises:
        DeviceError: It cannot take that place: D405 and D421 have no sync modes, those of the D500 series
            mean something else.
    """
    option, line = sdk.option.inter_cam_sync_mode, sdk.camera_info.product_line
    sensor = next((one for one in device.query_sensors() if one.supports(option)), None)
    if sensor is not None and device.supports(line) and device.get_info(line) == "D500":
        sensor = None
    if sensor is None:
        if settings.sync == "standalone":
            return
        raise DeviceError(f"RealSense {serial} has no modes master and slave. Leave `sync_master` out.")
    try:
        sensor.set_option(option, _SYNC_MODES[settings.sync])
    except RuntimeError as fault:
        if settings.sync == "standalone":
            return
        raise DeviceError(
            f"RealSense {serial} does not become a {settings.sync} ({fault}). Leave `sync_master` out."
        ) from fault
