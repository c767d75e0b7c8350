"""A stand-in for the module pyk4a 1.5.0: its names and capsules, and what libk4a 1.4 refuses.

``tests/devices/azure/test_pyk4a_contract.py`` holds it and the real library to the same clauses.
"""

import ctypes
import enum
import os
import sys
import time
import types

import numpy as np
import pytest

from devices.azure import pyk4a_internals
from devices.azure.calibration import DEPTH_MODES, calibration_json
from fusion.intrinsics import Intrinsics
from tests.helpers.standin_camera import Device, refused
from tests.helpers.standin_values import (
    DEVICE_NAME,
    JPEG,
    Calibration,
    K4AException,
    K4ATimeoutException,
    LeakyCapture,
    PyK4ACapture,
    WouldCrashError,
    give_none_away,
    new_capsule,
)

__all__ = ["JPEG", "Bus", "Device", "WouldCrashError", "make_module"]

_SHAPES = {number: (mode.height, mode.width) for number, mode in enumerate(DEPTH_MODES.values(), start=1)}
_MASTER, _SUBORDINATE = 1, 2


def _names(title, names):
    return enum.IntEnum(title, [(name, number) for number, name in enumerate(names.split())])


class Bus:
    """What is plugged in; ``native`` is the compiled libk4a whose captures the tracker takes."""

    def __init__(self, native):
        self.devices = []
        self.native = native
        self.configs = []
        self.thread_safe = []
        self.timeouts = []
        self.started = []
        self.counts = self.failed_opens = 0  # searches of the bus, and references to None that pyk4a lost
        self.master_begun_ns = None
        self.gives_none_away = False  # as pyk4a 1.5.0 does
        self.log_handler = None

    def plugged(self):
        return [device for device in self.devices if device.plugged]

    def log(self, device, when):
        """Calls the handler of libk4a's log, as where a device does not open or start."""
        if self.log_handler is not None and device is not None and when in device.log:
            self.log_handler(None, 1, b"", 0, device.log[when].encode())

    @property
    def open_serials(self):
        return [device.serial for device in self.devices if device.opened_by is not None]


def make_module(bus):
    module = types.ModuleType("pyk4a")

    class PyK4A:
        def __init__(self, config=None, device_id=0, thread_safe=True):
            self._config = config or module.Config()
            self._device_id = device_id
            self._device = None
            self.is_running = False
            bus.thread_safe.append(thread_safe)

        @property
        def opened(self):
            return self._device is not None

        def open(self):
            if self.opened:
                raise K4AException("Device already opened")
            plugged = bus.plugged()
            device = plugged[self._device_id] if self._device_id < len(plugged) else None
            taken = device is not None and (device.busy or device.opened_by or "open" in device.log)
            if device is None or (taken and not device.orbbec):
                bus.failed_opens += 1
                bus.log(device, "open")
                if bus.gives_none_away:
                    give_none_away()
                raise K4AException
            self._device = device
            if not taken:
                device.opened_by = self
                alone = not os.environ.get("K4A_DISABLE_SYNCHRONIZATION", "0").startswith("0")
                device.joins_color = device.orbbec or not alone  # the wrapper does not know the variable
            device.time.wait_until(device.time.now_ns() + round(1e9 * device.open_s))
            self._number = ctypes.c_void_p(1 + bus.devices.index(device))
            self._device_handle = new_capsule(self._number, DEVICE_NAME)

        @property
        def serial(self):
            return self._present().serial

        @property
        def sync_jack_status(self):
            device = self._present()
            if device.orbbec and device.busy:  # the device opens lazily, here
                raise K4AException
            return (False, False) if device.orbbec else device.jacks

        def start(self):
            if not self.opened:
                self.open()
            device, config = self._present(), self._config
            if not device.starts or device.busy or refused(config, device):
                bus.log(device, "start")
                raise K4AException
            device.time.wait_until(device.time.now_ns() + round(1e9 * device.start_s))
            self.is_running = True
            bus.started.append(device.serial)
            bus.configs.append(config)
            begun_ns = device.time.now_ns()
            if int(config.wired_sync_mode) == _MASTER:
                bus.master_begun_ns = begun_ns
            delay_ns = 1000 * config.subordinate_delay_off_master_usec

            def first_exposure_ns():
                if int(config.wired_sync_mode) != _SUBORDINATE:
                    return begun_ns
                return None if bus.master_begun_ns is None else bus.master_begun_ns + delay_ns

            device.start(int(config.color_resolution) != 0, first_exposure_ns)

        def stop(self):
            if not self.opened:
                raise WouldCrashError("stop() of a device that is not open")
            device = self._device
            device.time.wait_until(device.time.now_ns() + round(1e9 * device.stop_s))
            self.close()  # like the real one, even if the device is disconnected
            self.is_running = False

        def close(self):
            if self._device is None:
                raise K4AException("Device is not opened")
            if self._device.opened_by is self:
                self._device.opened_by = None
                if int(self._config.wired_sync_mode) == _MASTER:
                    bus.master_begun_ns = None
            self._device = None

        def __del__(self):
            if self.is_running:
                self.stop()
            elif self.opened:
                self.close()

        @property
        def calibration(self):
            self._present()
            return Calibration(self._config.depth_mode, self._number.value - 1)

        @property
        def calibration_raw(self):
            name = list(DEPTH_MODES)[int(self._config.depth_mode) - 1]
            *camera, distortion = self.calibration._lens(0)
            mode = DEPTH_MODES[name]
            return calibration_json(Intrinsics(mode.width, mode.height, *camera, distortion), name).decode()

        def get_capture(self, timeout=-1):
            if self._device is None:
                raise K4AException("Device is not opened")
            bus.timeouts.append(timeout)
            self._device.at.pop(self._device.captures, lambda: None)()
            device = self._device
            silent = device.silent or not device.plugged  # on Linux libk4a tells of neither
            if silent:
                device.time.wait_until(device.time.now_ns() + timeout * 1_000_000)
            shot = None if silent else device.next_shot(timeout)
            if shot is None:
                raise K4ATimeoutException
            device.captures += shot.has_depth or not shot.has_color  # colour alone is not counted
            return self._capture(device, shot)

        def _capture(self, device, shot):
            kind = LeakyCapture if bus.gives_none_away else PyK4ACapture
            shape = _SHAPES.get(int(self._config.depth_mode), (576, 640))
            host_ns = time.time_ns() if device.orbbec else shot.depth_host_ns
            return kind(
                bus.native,
                np.full(shape, 2000 + (shot.number if device.paced else device.captures), np.uint16)
                if shot.has_depth
                else None,
                np.full(shape, 900, np.uint16)
                if shot.has_depth and not device.infrared_lost(shot.number)
                else None,
                np.frombuffer(JPEG, np.uint8).copy() if shot.has_color else None,
                shot.clock_usec,
                host_ns,
            )

        def _present(self):
            if self._device is None:
                raise K4AException("Device is not opened")
            if not self._device.plugged:
                raise K4AException
            return self._device

    def connected_device_count():
        bus.counts += 1
        return len(bus.plugged())

    module.K4AException, module.K4ATimeoutException = K4AException, K4ATimeoutException
    module.PyK4A, module.PyK4ACapture = PyK4A, PyK4ACapture
    module.Calibration = Calibration
    module.connected_device_count = connected_device_count
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
        color_resolution=1,
        color_format=3,
        depth_mode=2,
        camera_fps=2,
        synchronized_images_only=True,
        depth_delay_off_color_usec=0,
        wired_sync_mode=0,
        subordinate_delay_off_master_usec=0,
        disable_streaming_indicator=False,
    ):
        assert subordinate_delay_off_master_usec >= 0
        return types.SimpleNamespace(**locals())

    module.Config = config
    return module


@pytest.fixture
def bus(monkeypatch):
    """An empty bus behind a stand-in pyk4a, without libk4a: captures carry images only."""
    result = Bus(None)
    monkeypatch.setitem(sys.modules, "pyk4a", make_module(result))
    monkeypatch.setattr(
        pyk4a_internals, "loaded_libk4a", lambda: None
    )  # ignore a library loaded by another test
    return result
