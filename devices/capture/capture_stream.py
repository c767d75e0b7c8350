"""What the live sensors of all vendors share: the newest wanted moment from the queue of an SDK."""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from devices.capture.causes import Cause, in_brackets
from devices.capture.frame_decimation import FrameDecimation
from devices.capture.settings import CaptureSettings
from devices.sensor import AbsentError, ColorCamera, DeviceError, Sensor, SensorFrame
from fusion.body import BLAZEPOSE
from fusion.intrinsics import Intrinsics

_SAME_CLOCK_NS = 5_000_000_000
_QUEUE = 3  # frames that an SDK's queue holds at least, of seven captures; half may be colour alone
_TOLD_S = 2.0  # a longer silence is told as such


@dataclass(frozen=True, eq=False)
class Moment:
    """A capture with depth."""

    time_ns: int  # capture time on the sensor's clock
    host_ns: int  # when the depth image reached this machine, on ``time.perf_counter_ns``


M = TypeVar("M", bound=Moment)


class CaptureStream(ABC, Generic[M]):
    """Takes captures from an SDK's queue and keeps the newest of the wanted moments.

    The queue of an SDK holds seven to ten captures. If the tracker is slower than the camera, the oldest one
    is a quarter of a second old.

    Attributes:
        missed: Wanted moments that were dropped: the SDK's queue was full, or a newer moment was available
            when the tracker was ready. Those before the first one given are not counted.
        gaps: Moments that never reached the SDK's queue.
    """

    cable_advice = ""
    """What to check if a subordinate gets no pulses."""

    def __init__(self, label: str, settings: CaptureSettings, sensor: LiveSensor) -> None:
        self.label, self.settings, self.sensor = label, settings, sensor
        self._silent_s = 0.0
        self._patience_s = settings.start_s if settings.sync == "subordinate" else settings.stall_s
        self._last_ns: int | None = None
        self._delayed: list[M] = []
        self.missed = self.gaps = 0
        self._gave = False
        self._polled_ns = self._away_ns = 0  # end of the last poll; time without one before it

    @abstractmethod
    def poll(self, timeout_ms: int) -> M | None:
        """The next capture of the queue; None for one without depth or infrared.

        Raises:
            TimeoutError: The queue was empty for ``timeout_ms``.
            DeviceError: The SDK reports a failure; see :meth:`lost`.
        """

    @property
    def waits_for(self) -> str:
        """What a sensor without images waits for, where that is known; else empty."""
        waits = self._silent_s > 0.0 and self.settings.sync == "subordinate"
        return "the pulses of its master on the sync cable" if waits else ""

    @abstractmethod
    def is_connected(self) -> bool:
        """Whether the sensor is still connected."""

    def comes_late(self, moment: M) -> bool:
        """Whether the SDK held a moment back, so that it arrives together with the next one."""
        del moment
        return False

    def take(self, wait: bool = True) -> M | None:
        """The newest wanted moment; None if there is none yet.

        Raises:
            DeviceError: Unplugged, or stalled.
        """
        if self._delayed:
            return self._delayed.pop(0)
        if self.sensor.clock() - self._polled_ns > _TOLD_S * 1e9:
            self._gave = False
        newest: M | None = None
        timeout_ms = self.settings.timeout_ms if wait else 0
        while True:
            self._away_ns = self.sensor.clock() - self._polled_ns
            try:
                moment = self.poll(timeout_ms)
            except TimeoutError:
                if timeout_ms and not self.is_connected():  # some SDKs show unplugging only by time-outs
                    raise self.unplugged() from None
                self._stay_silent(timeout_ms / 1000)
                break
            finally:
                self._polled_ns = self.sensor.clock()
            timeout_ms = 0  # take what is in the queue, without waiting again
            if moment is None:
                self._patience_s = self.settings.stall_s  # the cameras run: no master is waited for
                self._stay_silent(1 / self.settings.fps, without_depth=True)
                continue
            if self.sensor.on_capture is not None:
                self.sensor.on_capture(self.sensor.frame_of(moment))
            if self._is_wanted(moment):
                if newest is not None and not self._delayed and self.comes_late(newest):
                    self._delayed.append(newest)
                else:
                    self.missed += self._gave and newest is not None
                newest = moment
        if newest is not None and self._delayed:
            self._delayed.append(newest)
            newest = self._delayed.pop(0)
        self._gave = self._gave or newest is not None
        return newest

    def advise_only_color(self) -> str:
        """What happens, or what to do, if colour comes without depth."""
        return "Run it without --color, or unplug it and plug it in again."

    def lost(self, fault: Exception) -> DeviceError:
        """The error for a failure that the SDK reports."""
        if not self.is_connected():
            return self.unplugged()
        return Cause.STOPPED.error(label=self.label, said=in_brackets(fault))

    def unplugged(self) -> DeviceError:
        """The error for a sensor that is not connected."""
        return AbsentError(Cause.UNPLUGGED.says(label=self.label))

    def _is_wanted(self, moment: M) -> bool:
        self._silent_s, self._patience_s = 0.0, self.settings.stall_s
        number = self.sensor.decimation.moment(self.sensor.name, moment.time_ns, moment.host_ns)
        if self._last_ns is not None:  # after a clock reset the gap is unknown
            gap = max(0, round((moment.time_ns - self._last_ns) * self.settings.fps / 1e9) - 1)
            if gap >= _TOLD_S * self.settings.fps or not self._gave:
                pass
            elif max(self._away_ns, self._polled_ns - moment.host_ns) * self.settings.fps < _QUEUE * 1e9:
                self.gaps += gap
            else:
                self.missed += self.sensor.decimation.kept_before(number, gap)
        self._last_ns = moment.time_ns
        return self.sensor.decimation.keeps(number)

    def _stay_silent(self, seconds: float, without_depth: bool = False) -> None:
        self._silent_s += seconds
        if self._silent_s < self._patience_s:
            return
        if without_depth and self.settings.color is not None:
            advice = self.advise_only_color()
            raise Cause.ONLY_COLOR.error(label=self.label, seconds=self._silent_s, advice=advice)
        subordinate = self.settings.sync == "subordinate" and not without_depth
        cause = Cause.NO_PULSES if subordinate else Cause.NO_DEPTH
        raise cause.error(label=self.label, seconds=self._silent_s, advice=self.cable_advice)


class LiveSensor(Sensor):
    """A sensor of this machine. Building one opens nothing.

    Attributes:
        settings: How it runs; a vendor's own where it has more of them.
        decimation: Which moments are given. Those skipped on purpose do not count as missed.
        registered: Gives the RGB image on the depth's pixels of the frame given last, for sensors whose
            frames have no infrared; else None.
        on_capture: Gets every frame of the SDK's queue, wanted or not, with all images, for a recording.
        calibration_json: What an Azure Kinect stores, once it is open; empty for other sensors.
    """

    body = BLAZEPOSE
    registered: Callable[[SensorFrame], NDArray[np.uint8] | None] | None = None
    calibration_json: bytes = b""

    def __init__(
        self,
        serial: str,
        settings: CaptureSettings | None = None,
        decimation: FrameDecimation | None = None,
        clock: Callable[[], int] = time.perf_counter_ns,
    ) -> None:
        self.name, self.settings = serial, settings or CaptureSettings()
        self.intrinsics: Intrinsics | None = None
        self.warnings: list[str] = []
        self.missed = self.lost = 0
        self.decimation = decimation or FrameDecimation(self.settings.fps)
        self.clock = clock
        self.on_capture: Callable[[SensorFrame], object] | None = None
        self._color: ColorCamera | None = None
        self._sdk: Any = None
        self._interrupted = threading.Event()

    def interrupt(self) -> None:
        self._interrupted.set()

    def frame_of(self, moment: Any) -> SensorFrame:
        """All images of a capture, copied so that the SDK has its memory back."""
        raise NotImplementedError

    def _warn(self, warning: str) -> None:
        if warning and warning not in self.warnings:
            self.warnings.append(warning)

    def _moments(self, stream: CaptureStream[M]) -> Iterator[M]:
        """The newest moments of a stream as they come, until interrupted."""
        self.decimation.restart(self.name)
        while not self._interrupted.is_set():
            moment = self._take(stream)
            if moment is not None:
                yield moment

    def _take(self, stream: CaptureStream[M], wait: bool = True) -> M | None:
        """The newest moment of a stream; counts what it missed."""
        missed, gaps = stream.missed, stream.gaps
        moment = stream.take(wait)
        self.missed += stream.missed - missed
        self.lost += stream.gaps - gaps
        return moment


def arrival_ns(host_ns: int, now_ns: int) -> int:
    """An SDK's arrival time if its clock is ``time.perf_counter_ns``, as on Linux and Windows; else now."""
    return host_ns if 0 <= now_ns - host_ns < _SAME_CLOCK_NS else now_ns
