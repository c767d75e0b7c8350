"""A stand-in for the module pyorbbecsdk of pyorbbecsdk2 2.1.2, and the sensors behind it.

``tests/devices/orbbec/test_contract.py`` holds it and the real library to the same clauses, and compares the
names of their classes: the stand-in has nothing that the real library lacks.
"""

from __future__ import annotations

import gc
import sys
import types
import weakref
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.helpers.orbbec import standin_values as values
from tests.helpers.orbbec.standin_values import OBError
from tests.helpers.standin_camera import RealTime

JPEG = b"\xff\xd8 a colour image \xff\xd9"
FEMTO_SIZES = ((640, 576), (320, 288), (512, 512))
GEMINI_SIZES = ((1280, 800), (640, 400), (320, 200))
_MODES = values.OBMultiDeviceSyncMode
_FEMTO_MODES = (_MODES.STANDALONE, _MODES.PRIMARY, _MODES.SECONDARY)
_GEMINI_MODES = (_MODES.FREE_RUN, _MODES.STANDALONE, _MODES.PRIMARY, _MODES.SECONDARY_SYNCED)


@dataclass(eq=False)
class Orbbec:
    """One sensor on the stand-in's bus, and what is wrong with it."""

    serial: str
    model: str = "Orbbec Femto Bolt"
    connection: str = "USB3.2"
    firmware: str = "1.1.3"
    sizes: tuple[tuple[int, int], ...] = FEMTO_SIZES
    infrared_sizes: tuple[tuple[int, int], ...] | None = None
    infrared: str = "Y16"
    stereo: bool = False
    modes: tuple[object, ...] = _FEMTO_MODES
    scale: float = 1.0
    plugged: bool = True
    busy: bool = False
    starts: bool = True
    infrared_lost: Callable[[int], bool] = lambda _number: False
    color: bool = True  # the colour camera works
    timed: bool = True  # frames have a time of the sensor's clock
    calibrated: bool = True
    distortion: str = "BROWN_CONRADY_K6"
    keeps_delay: bool = True
    paced: bool = False  # frames come when they are due; otherwise one per wait
    skips: int = 0  # frames that the full queue dropped before each one
    interval_us: int = 33_333
    clock_us: int = 1_000_000
    given: int = 0
    synced_with_host: int = 0
    at: dict[int, Callable[[], object]] = field(default_factory=dict)  # function to call at each frame number
    sync: dict[str, Any] = field(default_factory=lambda: {"mode": _MODES.STANDALONE, "delay_us": 0})
    opened: weakref.WeakSet[object] = field(default_factory=weakref.WeakSet)

    @classmethod
    def gemini(cls, serial, **more):
        """A Gemini 2: active stereo, other sizes, 8-bit infrared, SECONDARY_SYNCED."""
        of_it = {"model": "Orbbec Gemini 2", "sizes": GEMINI_SIZES, "infrared": "Y8", "modes": _GEMINI_MODES}
        return cls(serial, **{**of_it, "firmware": "1.4.98", "distortion": "NONE", **more})


@dataclass(eq=False)
class Bag:
    """A recording: what it plays, and what is wrong with it."""

    sensor: Orbbec
    frames: int
    ends: bool = True  # says that it has stopped


class OrbbecBus:
    """What is plugged in, what is recorded, and what the module was asked."""

    def __init__(self):
        self.devices = []
        self.bags = {}
        self.contexts = 0
        self.log_level = None
        self.started = []
        self.configurations = []
        self.running = []
        self.fault = None  # of the search for sensors
        self.time = RealTime()

    def plugged(self):
        return [device for device in self.devices if device.plugged]

    @property
    def open_serials(self):
        gc.collect()  # references in the tracebacks of faults
        return [device.serial for device in self.devices if len(device.opened)]


def make_module(bus):
    module = types.ModuleType("pyorbbecsdk")

    class DeviceInfo:
        def __init__(self, sensor):
            self._sensor = sensor

        def get_firmware_version(self):
            return self._sensor.firmware

    class Device:
        def __init__(self, sensor):
            self._sensor = sensor
            sensor.opened.add(self)

        def get_device_info(self):
            return DeviceInfo(self._sensor)

        def get_supported_multi_device_sync_mode_bitmap(self):
            return sum(int(mode) for mode in self._sensor.modes)

        def get_multi_device_sync_config(self):
            if not self._sensor.modes:
                raise OBError("not supported")
            found = values.OBMultiDeviceSyncConfig()
            found.mode, found.depth_delay_us = self._sensor.sync["mode"], self._sensor.sync["delay_us"]
            return found

        def set_multi_device_sync_config(self, wanted):
            if wanted.mode not in self._sensor.modes:
                raise OBError("Invalid sync mode")
            delay_us = wanted.depth_delay_us if self._sensor.keeps_delay else 0
            self._sensor.sync = {
                "mode": wanted.mode,
                "delay_us": delay_us,
                "color_delay_us": wanted.color_delay_us,
                "out": wanted.trigger_out_enable,
            }

        def timer_sync_with_host(self):
            self._sensor.synced_with_host += 1

    class DeviceList:
        def __init__(self):
            self._devices = bus.plugged()

        def _at(self, index):
            if not 0 <= index < len(self._devices):
                raise OBError('Invalid index value for argument "index"')
            return self._devices[index]

        def get_count(self):
            return len(self._devices)

        def __len__(self):
            return len(self._devices)

        def get_device_serial_number_by_index(self, index):
            return self._at(index).serial

        def get_device_name_by_index(self, index):
            return self._at(index).model

        def get_device_connection_type_by_index(self, index):
            return self._at(index).connection

        def get_device_by_index(self, index):
            return self._opened(self._at(index))

        def get_device_by_serial_number(self, serial_number):
            for sensor in self._devices:
                if sensor.serial == serial_number:
                    return self._opened(sensor)
            raise OBError(f"Device not found by serial number: {serial_number}")

        def _opened(self, sensor):
            if sensor.busy:
                raise OBError("Failed to open the device: libusb error -6")
            return Device(sensor)

    class Context:
        @staticmethod
        def set_logger_level(level):
            assert isinstance(level, values.OBLogLevel)
            bus.log_level = level

        def __init__(self):
            bus.contexts += 1
            self._clock = values.OBClockType.REALTIME

        def query_devices(self):
            if bus.fault is not None:
                raise bus.fault
            return DeviceList()

        def get_timestamp_clock_type(self):
            return self._clock

        def set_timestamp_clock_type(self, clock_type):
            self._clock = clock_type

    class PlaybackDevice(Device):
        def __init__(self, file):
            if file not in bus.bags:
                raise RuntimeError(
                    "Error reading from file: wanted 2021161080 bytes, read 96 bytes"
                    if Path(file).exists()
                    else f"Error opening file: {file}"
                )
            super().__init__(bus.bags[file].sensor)
            self._bag = bus.bags[file]

        def get_duration(self):
            return self._bag.frames * self._bag.sensor.interval_us // 1000

        def get_playback_status(self):
            over = self._bag.sensor.given >= self._bag.frames and self._bag.ends
            return values.OBPlaybackStatus.STOPPED if over else values.OBPlaybackStatus.PLAYING

    class Pipeline:
        def __init__(self, device=None):
            if device is None:
                raise RuntimeError("No device found")
            self._device, self._running = device, False
            self._synced, self._output = True, deque()

        def get_stream_profile_list(self, sensor_type):
            sensor, sensors = self._device._sensor, values.OBSensorType
            infrared = sensors.LEFT_IR_SENSOR if sensor.stereo else sensors.IR_SENSOR
            sizes, names = {
                sensors.DEPTH_SENSOR: (sensor.sizes, ("Y16",)),
                infrared: (sensor.infrared_sizes or sensor.sizes, (sensor.infrared,)),
                sensors.COLOR_SENSOR: (((1920, 1080), (1280, 720)), ("MJPG",)),
            }.get(sensor_type, ((), ()))
            if not sizes:
                raise OBError("No matched sensor found!")
            return values.StreamProfileList(
                [
                    self._profile(sensor_type, *size, fps, getattr(values.OBFormat, name))
                    for size in sizes
                    for fps in (30, 15, 5)
                    for name in names
                ]
            )

        def _profile(self, sensor_type, width, height, fps, image_format):
            sensor = self._device._sensor
            profile = values.VideoStreamProfile(sensor_type, width, height, fps, image_format)
            if sensor.calibrated:
                lens, distortion = values.OBCameraIntrinsic(), values.OBCameraDistortion()
                lens.fx, lens.fy, lens.cx, lens.cy = 504.0, 505.0, 332.0, 348.0
                lens.width, lens.height = width, height
                distortion.model = values.OBCameraDistortionModel[sensor.distortion]
                if sensor.distortion != "NONE":
                    distortion.k1, distortion.k2, distortion.p1, distortion.p2 = 0.5, -0.02, 1e-5, -7e-5
                    distortion.k3, distortion.k4, distortion.k5, distortion.k6 = -0.003, 0.9, 0.09, -0.01
                profile.set_intrinsic(lens)
                profile.set_distortion(distortion)
                profile.get_extrinsic_to = lambda _other: _beside()
            return profile

        def disable_frame_sync(self):
            self._synced = False

        def start(self, configuration):
            sensor = self._device._sensor
            if not sensor.starts:
                raise OBError("Failed to start stream!")
            if not sensor.plugged:
                raise OBError("Device is deactivated/disconnected!")
            assert self._synced == isinstance(self._device, PlaybackDevice), "a late image holds back depth"
            self._profiles = {profile.get_type(): profile for profile in configuration._profiles}
            self._mode, self._running = configuration._mode, True
            self._next_ns = bus.time.now_ns()
            bus.started.append(sensor.serial)
            bus.running.append(sensor.serial)
            bus.configurations.append(configuration)

        def stop(self):
            sensor = self._device._sensor
            if self._running:
                bus.running.remove(sensor.serial)
            self._running = False
            self._output.clear()
            if not sensor.plugged:
                raise OBError("Device is deactivated/disconnected!")

        def wait_for_frames(self, timeout_ms):
            sensor, time = self._device._sensor, bus.time
            assert self._running
            sensor.at.pop(sensor.given, lambda: None)()
            until_ns = time.now_ns() + timeout_ms * 1_000_000
            if not self._output and timeout_ms:
                if sensor.paced:
                    self._next_ns += 1000 * sensor.interval_us
                    time.wait_until(min(self._next_ns, until_ns))
                if self._exposes():
                    self._output.extend(self._exposed())
                if not self._output:
                    time.wait_until(until_ns)
            return self._output.popleft() if self._output else None

        def _exposes(self):
            sensor = self._device._sensor
            over = isinstance(self._device, PlaybackDevice) and sensor.given >= self._device._bag.frames
            return sensor.plugged and not over

        def _exposed(self):
            """The sets of the next exposure, as ``FrameAggregator.cpp`` of OrbbecSDK_v2 makes them."""
            sensor, kinds, sensors = self._device._sensor, values.OBFrameType, values.OBSensorType
            sensor.given += 1
            sensor.clock_us += sensor.interval_us * (1 + sensor.skips)
            depth, number, formats = self._profiles[sensors.DEPTH_SENSOR], sensor.given, values.OBFormat
            size, frames = (depth.get_height(), depth.get_width()), []
            image = np.full(size, 2000 + number, np.uint16)
            frames.append(self._frame(kinds.DEPTH_FRAME, formats.Y16, image))
            if not sensor.infrared_lost(number):
                kind = kinds.LEFT_IR_FRAME if sensor.stereo else kinds.IR_FRAME
                image = np.full(size, 90, np.uint8 if sensor.infrared == "Y8" else np.uint16)
                frames.append(self._frame(kind, formats[sensor.infrared], image))
            if sensors.COLOR_SENSOR in self._profiles and sensor.color:
                frames.append(self._frame(kinds.COLOR_FRAME, formats.MJPG, np.frombuffer(JPEG, np.uint8)))
            if self._mode is values.OBFrameAggregateOutputMode.DISABLE:
                return [_set_of([frame]) for frame in frames]
            whole = len(frames) == len(self._profiles)
            asked = self._mode is values.OBFrameAggregateOutputMode.FULL_FRAME_REQUIRE
            return [_set_of(frames)] if whole or not asked else []

        def _frame(self, kind, image_format, image):
            return _frame(self._device._sensor, kind, image_format, image, bus.time.now_ns())

    for name in (
        *("OBSensorType", "OBStreamType", "OBFrameType", "OBFormat", "OBLogLevel", "OBClockType"),
        *("OBFrameAggregateOutputMode", "OBMultiDeviceSyncMode", "OBCameraDistortionModel"),
        *("OBPlaybackStatus", "OBCameraIntrinsic", "OBCameraDistortion", "OBExtrinsic", "OBError"),
        *("OBMultiDeviceSyncConfig", "VideoStreamProfile", "StreamProfileList", "Config", "Frame"),
        *("VideoFrame", "DepthFrame", "IRFrame", "ColorFrame", "FrameSet"),
    ):
        setattr(module, name, getattr(values, name))
    for kind in (DeviceInfo, Device, DeviceList, Context, PlaybackDevice, Pipeline):
        setattr(module, kind.__name__, kind)
    return module


def _frame(sensor, kind, image_format, image, arrived_ns):
    if image.ndim == 2:
        height, width = image.shape
        frame = values.Frame.create_video_frame(kind, image_format, width, height)
    else:
        frame = values.Frame.create_frame(kind, image_format, image.size)
    frame.update_data(image.tobytes())
    frame._device_us = sensor.clock_us if sensor.timed else 0
    frame._system_us = arrived_ns // 1000
    frame._scale = sensor.scale
    return frame


def _set_of(frames):
    found = values.FrameSet()
    for frame in frames:
        found.push_frame(frame)
    return found


def _beside():
    pose = values.OBExtrinsic()
    pose.rot, pose.transform = np.eye(3), (-32.0, 0.0, 4.0)  # millimetres
    return pose


@pytest.fixture
def orbbecs(monkeypatch):
    """Returns an empty bus behind a stand-in pyorbbecsdk."""
    result = OrbbecBus()
    monkeypatch.setitem(sys.modules, "pyorbbecsdk", make_module(result))
    return result
