"""The newest capture of a running Kinect, from the SDK's queue."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from devices.azure.kinect_settings import KinectSettings
from devices.azure.pyk4a_access import is_connected
from devices.azure.pyk4a_leaks import image_of
from devices.capture.frame_decimation import FrameDecimation
from devices.sensor import ColorCamera, ColorImage, DeviceError, SensorFrame

_SAME_CLOCK_NS = 5_000_000_000


@dataclass(frozen=True, eq=False)
class _Seen:
    """A capture with depth, and its times in ns."""

    capture: Any
    time_ns: int
    host_ns: int


class CaptureStream:
    """Takes captures from the SDK's queue and keeps the newest of the wanted moments.

    The queue holds seven captures. If the tracker is slower than the camera, the oldest capture in the queue
    is a quarter of a second old.

    Attributes:
        missed: Wanted captures that were dropped: the SDK's queue was full, or a newer capture was available
            when the tracker was ready.
    """

    def __init__(
        self,
        device: Any,
        sdk: Any,
        serial: str,
        settings: KinectSettings,
        color: ColorCamera | None,
        decimation: FrameDecimation,
        clock: Callable[[], int] = time.perf_counter_ns,
    ) -> None:
        """Prepares; takes no capture yet.

        Args:
            device: The running ``pyk4a.PyK4A``.
            sdk: The module pyk4a.
            serial: Serial number of the device.
            settings: Settings of the device.
            color: The colour camera, if colour images are wanted.
            decimation: Selects the wanted moments.
            clock: The clock of ``host_ns``, nanoseconds; tests inject their own.
        """
        self._device, self._sdk, self._serial = device, sdk, serial
        self._settings, self._color, self._decimation, self._clock = settings, color, decimation, clock
        self._silent_s = 0.0
        self._patience_s = settings.start_s if settings.sync == "subordinate" else settings.stall_s
        self._last_ns: int | None = None
        self._delayed: list[_Seen] = []
        self.missed = 0

    def take(self, wait: bool) -> tuple[SensorFrame, Any] | None:
        """The newest wanted capture and the frame of it; None if there is none yet.

        Args:
            wait: Whether to wait for a capture where the queue is empty, ``timeout_ms`` at most.

        Raises:
            DeviceError: Unplugged, or stalled.
        """
        if self._delayed:
            held = self._delayed.pop(0)
            return self._frame(held), held.capture
        newest: _Seen | None = None
        timeout_ms = self._settings.timeout_ms if wait else 0
        while True:
            try:
                capture = self._device.get_capture(timeout=timeout_ms)
            except self._sdk.K4ATimeoutException:
                self._stay_silent(timeout_ms / 1000)
                break
            except self._sdk.K4AException as fault:
                raise self._lost(fault) from fault
            timeout_ms = 0  # take what is in the queue, without waiting again
            seen = self._look(capture)
            if seen is None:
                self._stay_silent(1 / self._settings.fps)
            elif self._is_wanted(seen):
                if newest is not None and self._waited_for_color(newest):
                    self._delayed.append(newest)
                else:
                    self.missed += newest is not None
                newest = seen
        if newest is not None and self._delayed:
            self._delayed.append(newest)
            newest = self._delayed.pop(0)
        return None if newest is None else (self._frame(newest), newest.capture)

    def _waited_for_color(self, seen: _Seen) -> bool:
        """Whether capture sync delayed a depth image for nothing: it arrives together with the next one."""
        if self._settings.camera_color is None or self._delayed:
            return False
        return image_of(seen.capture, "color") is None

    def _look(self, capture: Any) -> _Seen | None:
        """The capture with its times; None for a capture without depth."""
        if image_of(capture, "depth") is None or image_of(capture, "ir") is None:
            return None
        now_ns, host_ns = self._clock(), int(capture.depth_system_timestamp_nsec)
        return _Seen(
            capture,
            1000 * int(capture.depth_timestamp_usec),
            # The SDK's host time is this clock's on Linux and Windows. Orbbec's wrapper gives the epoch's.
            host_ns if 0 <= now_ns - host_ns < _SAME_CLOCK_NS else now_ns,
        )

    def _is_wanted(self, seen: _Seen) -> bool:
        self._silent_s, self._patience_s = 0.0, self._settings.stall_s
        moment = self._decimation.moment(self._serial, seen.time_ns, seen.host_ns)
        if self._last_ns is not None:  # after a clock reset the gap is unknown
            gap = max(0, round((seen.time_ns - self._last_ns) * self._settings.fps / 1e9) - 1)
            self.missed += self._decimation.kept_before(moment, gap)
        self._last_ns = seen.time_ns
        return self._decimation.keeps(moment)

    def _frame(self, seen: _Seen) -> SensorFrame:
        """The capture's images, copied so that the SDK has its memory back."""
        capture = seen.capture
        jpeg = None if self._color is None else image_of(capture, "color")
        return SensorFrame(
            time_ns=seen.time_ns,
            depth=np.array(capture.depth, dtype=np.uint16),
            ir=np.array(capture.ir, dtype=np.uint16) if self._settings.infrared else None,
            color=None if jpeg is None or self._color is None else ColorImage.of(jpeg.tobytes(), self._color),
            host_ns=seen.host_ns,
        )

    def _stay_silent(self, seconds: float) -> None:
        self._silent_s += seconds
        if self._silent_s < self._patience_s:
            return
        if not is_connected(
            self._sdk, self._serial
        ):  # Orbbec's wrapper reports unplugging only through time-outs
            raise self._unplugged()
        cause = (
            "A subordinate gives frames only while its master runs: check the master and the sync cable."
            if self._settings.sync == "subordinate"
            else "Check its USB 3 port and power supply; two sensors need two USB controllers."
        )
        raise DeviceError(f"Kinect {self._serial} stalls: no depth for {self._silent_s:.0f} s. {cause}")

    def _lost(self, fault: Exception) -> DeviceError:
        if not is_connected(self._sdk, self._serial):
            return self._unplugged()
        said = f" ({fault})" if str(fault) else ""
        return DeviceError(
            f"Kinect {self._serial} stopped giving frames{said}. Unplug it and plug it in again."
        )

    def _unplugged(self) -> DeviceError:
        return DeviceError(f"Kinect {self._serial} was unplugged or lost its power. Plug it in again.")
