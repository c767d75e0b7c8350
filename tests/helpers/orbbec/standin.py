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
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.helpers.orbbec import standin_values as values
from tests.helpers.orbbec.standin_values import OBError
from tests.helpers.standin_camera import RealTime

JPEG = b"\xff\xd8 a colour image \xff\xd9"
FEMTO_SIZES = ((640, 576), (320, 288), (512, 512))
GEMINI_SIZES = ((1280, 800), (640, 400), (320, 200))
_DISTORTION = (0.5, -0.02, 1e-5, -7e-5, -0.003, 0.9, 0.09, -0.01)
_MODES, _SENSORS = values.OBMultiDeviceSyncMode, values.TYPES["OBSensorType"]
_AGGREGATION, _STATUS = values.TYPES["OBFrameAggregateOutputMode"], values.TYPES["OBPlaybackStatus"]
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
            mode, delay_us = self._sensor.sync["mode"], self._sensor.sync["delay_us"]
            return SimpleNamespace(mode=mode, depth_delay_us=delay_us)

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
            assert isinstance(level, values.TYPES["OBLogLevel"])
            bus.log_level = level

        def __init__(self):
            bus.contexts += 1
            self._clock = values.TYPES["OBClockType"].REALTIME

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
            return _STATUS.STOPPED if over else _STATUS.PLAYING

    class Pipeline:
        def __init__(self, device=None):
            if device is None:
                raise RuntimeError("No device found")
            self._device, self._running = device, False
            self._synced, self._output = True, deque()

        def get_stream_profile_list(self, sensor_type):
            sensor = self._device._sensor
            infrared = _SENSORS.LEFT_IR_SENSOR if sensor.stereo else _SENSORS.IR_SENSOR
            sizes, name = {
                _SENSORS.DEPTH_SENSOR: (sensor.sizes, "Y16"),
                infrared: (sensor.infrared_sizes or sensor.sizes, sensor.infrared),
                _SENSORS.COLOR_SENSOR: (((1920, 1080), (1280, 720)), "MJPG"),
            }.get(sensor_type, ((), ""))
            if not sizes:
                raise OBError("No matched sensor found!")
            return values.StreamProfileList(
                [
                    self._profile(sensor_type, *size, fps, values.TYPES["OBFormat"][name])
                    for size in sizes
                    for fps in (30, 15, 5)
                ]
            )

        def _profile(self, sensor_type, width, height, fps, image_format):
            sensor, calibration = self._device._sensor, ()
            if sensor.calibrated:
                model = values.TYPES["OBCameraDistortionModel"][sensor.distortion]
                known = _DISTORTION if sensor.distortion != "NONE" else (0.0,) * len(_DISTORTION)
                lens = SimpleNamespace(fx=504.0, fy=505.0, cx=332.0, cy=348.0)
                coefficients = dict(zip(("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"), known, strict=True))
                beside = SimpleNamespace(rot=np.eye(3), transform=(-32.0, 0.0, 4.0))  # millimetres
                calibration = lens, SimpleNamespace(model=model, **coefficients), beside
            return values.VideoStreamProfile(sensor_type, width, height, fps, image_format, *calibration)

        def disable_frame_sync(self):
            self._synced = False

        def start(self, configuration):
            sensor = self._device._sensor
            if not sensor.starts:
                raise OBError("Failed to start stream!")
            if not sensor.plugged:
                raise OBError("Device is deactivated/disconnected!")
            assert self._synced == isinstance(self._device, PlaybackDevice), "a late image holds back depth"
            self._profiles = {profile.kind: profile for profile in configuration.profiles}
            self._mode, self._running = configuration.mode, True
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
            sensor = self._device._sensor
            sensor.given += 1
            sensor.clock_us += sensor.interval_us * (1 + sensor.skips)
            depth, number = self._profiles[_SENSORS.DEPTH_SENSOR], sensor.given
            times = sensor.clock_us if sensor.timed else 0, bus.time.now_ns() // 1000
            image = np.full(depth.size[::-1], 2000 + number, np.uint16)
            frames = {"depth": values.DepthFrame(image, *times, sensor.scale)}
            if not sensor.infrared_lost(number):
                image = np.full(depth.size[::-1], 90, np.uint8 if sensor.infrared == "Y8" else np.uint16)
                frames["left_ir" if sensor.stereo else "ir"] = values.VideoFrame(image, *times)
            if _SENSORS.COLOR_SENSOR in self._profiles and sensor.color:
                frames["color"] = values.Frame(np.frombuffer(JPEG, np.uint8), *times)
            if self._mode is _AGGREGATION.DISABLE:
                return [values.FrameSet(**{name: frame}) for name, frame in frames.items()]
            whole = len(frames) == len(self._profiles)
            asked = self._mode is _AGGREGATION.FULL_FRAME_REQUIRE
            return [values.FrameSet(**frames)] if whole or not asked else []

    for name, kind in values.TYPES.items():
        setattr(module, name, kind)
    for kind in (
        *(DeviceInfo, Device, DeviceList, Context, PlaybackDevice, Pipeline, OBError, values.Config),
        *(values.VideoStreamProfile, values.StreamProfileList, values.Frame, values.VideoFrame),
        *(values.DepthFrame, values.FrameSet),
    ):
        setattr(module, kind.__name__, kind)
    return module


@pytest.fixture
def orbbecs(monkeypatch):
    """Returns an empty bus behind a stand-in pyorbbecsdk."""
    result = OrbbecBus()
    monkeypatch.setitem(sys.modules, "pyorbbecsdk", make_module(result))
    return result
