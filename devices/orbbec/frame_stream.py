"""The newest moment of a running Orbbec sensor, from the SDK's queue."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from devices.capture.frame_decimation import FrameDecimation
from devices.orbbec.images import (
    Moment,
    MomentJoiner,
    color_image,
    depth_image,
    infrared_image,
)
from devices.orbbec.sdk_access import faults_of, is_connected
from devices.orbbec.settings import OrbbecSettings
from devices.sensor import ColorCamera, DeviceError, SensorFrame


class OrbbecStream:
    """Takes frames from the SDK's queue and keeps the newest of the wanted moments.

    The queue holds ten sets of frames. If the tracker is slower than the camera, the oldest is a third of a
    second old.

    Attributes:
        missed: Wanted moments that were dropped: the SDK's queue was full, or a newer one was there when the
            tracker was ready.
    """

    def __init__(
        self,
        pipeline: Any,
        sdk: Any,
        serial: str,
        settings: OrbbecSettings,
        color: ColorCamera | None,
        decimation: FrameDecimation,
        clock: Callable[[], int] = time.perf_counter_ns,
    ) -> None:
        """Prepares; takes no frame yet.

        Args:
            pipeline: The running ``pyorbbecsdk.Pipeline``.
            sdk: The module pyorbbecsdk.
            serial: Serial number of the sensor.
            settings: Settings of the sensor.
            color: The colour camera, if colour images are wanted.
            decimation: Selects the wanted moments.
            clock: The clock of ``host_ns``, nanoseconds; tests inject their own.
        """
        self._pipeline, self._sdk, self._serial = pipeline, sdk, serial
        self._settings, self._color, self._decimation, self._clock = settings, color, decimation, clock
        self._joiner = MomentJoiner(round(1e9 / settings.fps))
        self._silent_s = 0.0
        self._patience_s = settings.start_s if settings.sync == "secondary" else settings.stall_s
        self._last_ns: int | None = None
        self.missed = 0

    @property
    def timeless(self) -> bool:
        """Whether a frame came without a time of the sensor's clock."""
        return self._joiner.timeless

    def take(self) -> SensorFrame | None:
        """The newest wanted moment, after waiting ``timeout_ms`` at most; None if there is none yet.

        Raises:
            DeviceError: Unplugged, or stalled.
        """
        newest: Moment | None = None
        timeout_ms = self._settings.timeout_ms
        while True:
            try:
                frames = self._pipeline.wait_for_frames(timeout_ms)
            except faults_of(self._sdk) as fault:
                raise self._lost(fault) from fault
            if frames is None:
                self._stay_silent(timeout_ms / 1000)
                break
            timeout_ms = 0  # take what is in the queue, without waiting again
            moment = self._joiner.add(frames, self._clock())
            if moment is None:
                self._stay_silent(1 / self._settings.fps)
            elif self._is_wanted(moment):
                self.missed += newest is not None
                newest = moment
        return None if newest is None else self._frame(newest)

    def _is_wanted(self, moment: Moment) -> bool:
        self._silent_s, self._patience_s = 0.0, self._settings.stall_s
        number = self._decimation.moment(self._serial, moment.time_ns, moment.host_ns)
        if self._last_ns is not None:  # after a clock reset the gap is unknown
            gap = max(0, round((moment.time_ns - self._last_ns) * self._settings.fps / 1e9) - 1)
            self.missed += self._decimation.kept_before(number, gap)
        self._last_ns = moment.time_ns
        return self._decimation.keeps(number)

    def _frame(self, moment: Moment) -> SensorFrame:
        return SensorFrame(
            time_ns=moment.time_ns,
            depth=depth_image(moment.depth),
            ir=infrared_image(moment.infrared),
            color=color_image(moment.color, self._color),
            host_ns=moment.host_ns,
        )

    def _stay_silent(self, seconds: float) -> None:
        self._silent_s += seconds
        if self._silent_s < self._patience_s:
            return
        if not is_connected(self._sdk, self._serial):  # frames stop, without an error
            raise self._unplugged()
        cause = (
            "A secondary gives frames only while its primary runs: check the primary, the sync hub and the "
            "cables."
            if self._settings.sync == "secondary"
            else "Check its USB 3 port and power supply; two sensors need two USB controllers."
        )
        raise DeviceError(f"Orbbec {self._serial} stalls: no depth for {self._silent_s:.0f} s. {cause}")

    def _lost(self, fault: Exception) -> DeviceError:
        if not is_connected(self._sdk, self._serial):
            return self._unplugged()
        return DeviceError(
            f"Orbbec {self._serial} stopped giving frames ({fault}). Unplug it and plug it in again."
        )

    def _unplugged(self) -> DeviceError:
        return DeviceError(f"Orbbec {self._serial} was unplugged or lost its power. Plug it in again.")
