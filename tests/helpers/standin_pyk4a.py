"""A stand-in for the module pyk4a: its names, its capsules, and a bus of sensors to break on demand."""

from __future__ import annotations

import ctypes
import enum
import sys
import time
import types
from collections.abc import Callable
from dataclasses import dataclass, field

import cv2
import numpy as np
import pytest

_new_capsule = ctypes.pythonapi.PyCapsule_New
_new_capsule.restype = ctypes.py_object
_new_capsule.argtypes = [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p]
_CAPTURE_NAME = ctypes.c_char_p(b"pyk4a capture handle")
_CALIBRATION_NAME = ctypes.c_char_p(b"pyk4a calibration handle")
JPEG = cv2.imencode(".jpg", np.full((72, 128, 3), (40, 120, 200), np.uint8))[1].tobytes()


class K4AException(Exception):  # noqa: N818
    """As the real one: often without a message."""


class K4ATimeoutException(K4AException):
    pass


def _names(title: str, names: str) -> type[enum.IntEnum]:
    return enum.IntEnum(title, [(name, number) for number, name in enumerate(names.split())])


@dataclass
class Device:
    """One sensor on the stand-in's bus, and what is wrong with it."""

    serial: str
    jacks: tuple[bool, bool] = (False, False)
    busy: bool = False
    plugged: bool = True
    starts: bool = True
    silent: bool = False
    blind: bool = False  # captures without depth
    fails_to_stop: bool = False
    clock_usec: int = 1_000_000
    captures: int = 0
    interval_usec: int = 33_333
    color: bool = False
    skips: int = 0  # captures before each that the SDK's queue had no room for
    paced: bool = False  # captures come when they are due, by the machine's clock
    begun: float | None = None
    at: dict[int, Callable[[], object]] = field(default_factory=dict)  # what happens at which capture
    opened_by: object = None
    log: list[str] = field(default_factory=list)


class Bus:
    """What is plugged in; ``native`` is the compiled libk4a whose captures the tracker takes."""

    def __init__(self, native: ctypes.CDLL | None) -> None:
        self.devices: list[Device] = []
        self.native = native
        self.configs: list[types.SimpleNamespace] = []
        self.thread_safe: list[bool] = []
        self.timeouts: list[int] = []
        self.started: list[str] = []

    def plugged(self) -> list[Device]:
        return [device for device in self.devices if device.plugged]

    @property
    def open_serials(self) -> list[str]:
        return [device.serial for device in self.devices if device.opened_by is not None]


class Capture:
    def __init__(self, bus: Bus, device: Device) -> None:
        device.captures += 1
        device.clock_usec += device.interval_usec * (1 + device.skips)
        shape = (576, 640)
        self.depth = None if device.blind else np.full(shape, 2000 + device.captures, np.uint16)
        self.ir = np.full(shape, 900, np.uint16)
        self.color = np.frombuffer(JPEG, np.uint8).copy() if device.color else None
        self.depth_timestamp_usec = device.clock_usec
        self.depth_system_timestamp_nsec = 0
        self._bus = bus
        self._handle = ctypes.c_void_p()
        if bus.native is not None and self.depth is not None:
            self._fill(bus.native)
        # As in pyk4a: the capsule holds the address of the handle, not the handle.
        self._capture_handle = _new_capsule(ctypes.addressof(self._handle), _CAPTURE_NAME, None)

    def _fill(self, native: ctypes.CDLL) -> None:
        native.k4a_image_get_buffer.restype = ctypes.c_void_p
        native.k4a_capture_create(ctypes.byref(self._handle))
        for image, kind, attach in (
            (self.depth, 4, native.k4a_capture_set_depth_image),
            (self.ir, 5, native.k4a_capture_set_ir_image),
        ):
            handle = ctypes.c_void_p()
            native.k4a_image_create(kind, 640, 576, 1280, ctypes.byref(handle))
            address = native.k4a_image_get_buffer(handle)
            ctypes.memmove(address, image.ctypes.data, image.nbytes)
            native.k4a_image_set_device_timestamp_usec(handle, ctypes.c_uint64(self.depth_timestamp_usec))
            attach(self._handle, handle)
            native.k4a_image_release(handle)

    def __del__(self) -> None:
        if self._handle:
            self._bus.native.k4a_capture_release(self._handle)


class Calibration:
    def __init__(self, config: types.SimpleNamespace) -> None:
        self._struct = ctypes.create_string_buffer(1032)
        ctypes.c_int.from_buffer(self._struct, 1024).value = int(config.depth_mode)
        self._calibration_handle = _new_capsule(ctypes.addressof(self._struct), _CALIBRATION_NAME, None)

    def get_camera_matrix(self, camera: int) -> np.ndarray:
        if camera == 1:
            return np.array([[610.0, 0.0, 640.0], [0.0, 611.0, 365.0], [0.0, 0.0, 1.0]])
        return np.array([[504.0, 0.0, 332.0], [0.0, 505.0, 348.0], [0.0, 0.0, 1.0]])

    def get_extrinsic_parameters(self, source: int, target: int) -> tuple[np.ndarray, np.ndarray]:
        assert (source, target) == (0, 1), "depth to colour"
        return np.eye(3), np.array([-0.032, 0.0, 0.004])  # metres, as pyk4a makes of the SDK's millimetres

    def get_distortion_coefficients(self, camera: int) -> np.ndarray:
        assert camera in (0, 1)
        return np.array([0.5, -0.02, 1e-5, -7e-5, -0.003, 0.9, 0.09, -0.01])


def make_module(bus: Bus) -> types.ModuleType:
    module = types.ModuleType("pyk4a")

    class PyK4A:
        def __init__(self, config: object = None, device_id: int = 0, thread_safe: bool = True) -> None:
            self._config = config or module.Config()
            self._device_id = device_id
            self._device: Device | None = None
            self.is_running = False
            bus.thread_safe.append(thread_safe)

        @property
        def opened(self) -> bool:
            return self._device is not None

        def open(self) -> None:
            plugged = bus.plugged()
            if self._device_id >= len(plugged) or plugged[self._device_id].busy:
                raise K4AException
            if plugged[self._device_id].opened_by is not None:
                raise K4AException
            self._device = plugged[self._device_id]
            self._device.opened_by = self

        @property
        def serial(self) -> str:
            return self._present().serial

        @property
        def sync_jack_status(self) -> tuple[bool, bool]:
            return self._present().jacks

        def start(self) -> None:
            if not self._present().starts:
                raise K4AException
            self.is_running = True
            bus.started.append(self._device.serial)
            bus.configs.append(self._config)

        def stop(self) -> None:
            assert self.is_running
            if self._device.fails_to_stop or not self._device.plugged:
                raise K4AException
            self.close()
            self.is_running = False

        def close(self) -> None:
            assert self._device is not None
            self._device.opened_by = None
            self._device = None

        def __del__(self) -> None:
            if self.is_running:
                self.stop()
            elif self.opened:
                self.close()

        @property
        def calibration(self) -> Calibration:
            self._present()
            return Calibration(self._config)

        def get_capture(self, timeout: int = -1) -> Capture:
            bus.timeouts.append(timeout)
            self._device.at.pop(self._present().captures, lambda: None)()
            device = self._present()
            if device.silent:
                time.sleep(timeout / 1000 if device.paced else 0.0)
                raise K4ATimeoutException
            if device.paced:
                self._wait_until_due(device)
            return Capture(bus, device)

        @staticmethod
        def _wait_until_due(device: Device) -> None:
            period = device.interval_usec * 1e-6
            now = time.perf_counter()
            if device.begun is None:
                device.begun = now - device.captures * period
            time.sleep(max(0.0, device.begun + (device.captures + 1) * period - now))

        def _present(self) -> Device:
            if self._device is None or not self._device.plugged:
                raise K4AException
            return self._device

    module.K4AException, module.K4ATimeoutException = K4AException, K4ATimeoutException
    module.PyK4A = PyK4A
    module.connected_device_count = lambda: len(bus.plugged())
    module.DepthMode = _names(
        "DepthMode", "OFF NFOV_2X2BINNED NFOV_UNBINNED WFOV_2X2BINNED WFOV_UNBINNED PASSIVE_IR"
    )
    module.FPS = _names("FPS", "FPS_5 FPS_15 FPS_30")
    module.ColorResolution = _names(
        "ColorResolution", "OFF RES_720P RES_1080P RES_1440P RES_1536P RES_2160P RES_3072P"
    )
    module.ImageFormat = _names("ImageFormat", "COLOR_MJPG COLOR_NV12 COLOR_YUY2 COLOR_BGRA32")
    module.WiredSyncMode = _names("WiredSyncMode", "STANDALONE MASTER SUBORDINATE")
    module.CalibrationType = enum.IntEnum("CalibrationType", [("UNKNOWN", -1), ("DEPTH", 0), ("COLOR", 1)])

    def config(
        color_resolution: int = 1,
        color_format: int = 3,
        depth_mode: int = 2,
        camera_fps: int = 2,
        synchronized_images_only: bool = True,
        depth_delay_off_color_usec: int = 0,
        wired_sync_mode: int = 0,
        subordinate_delay_off_master_usec: int = 0,
        disable_streaming_indicator: bool = False,
    ) -> types.SimpleNamespace:
        # As the SDK: refused when the cameras start, here at once.
        assert color_resolution or not synchronized_images_only, "colour off needs unsynchronised images"
        return types.SimpleNamespace(**locals())

    module.Config = config
    return module


@pytest.fixture
def bus(monkeypatch: pytest.MonkeyPatch) -> Bus:
    """An empty bus behind a stand-in pyk4a, without libk4a: captures carry images only."""
    result = Bus(None)
    monkeypatch.setitem(sys.modules, "pyk4a", make_module(result))
    return result
