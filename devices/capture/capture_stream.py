"""What the live sensors of all vendors share: the newest wanted moment from the queue of an SDK."""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from devices.capture.causes import Cause, in_brackets
from devices.capture.clock.moments import ImageJoiner, Incomplete, Moment
from devices.capture.frame_decimation import FrameDecimation
from devices.capture.settings import CaptureSettings
from devices.capture.stream_health import ImageHealth, Losses, Silence
from devices.sensor import AbsentError, ColorCamera, DeviceError, Sensor, SensorFrame
from fusion.body import BLAZEPOSE
from fusion.intrinsics import Intrinsics

_MOST, _LONGEST_NS = 64, 500_000_000  # images, and time, that one emptying of an SDK's queue takes at most


class CaptureStream(ABC):
    """Takes images from an SDK's queue and keeps the newest of the wanted moments.

    The queue of an SDK holds seven to ten captures. If the tracker is slower than the camera, the oldest one
    is a quarter of a second old.

    Attributes:
        joiner: Makes moments of the images.
    """

    cable_advice = ""
    """What to check if a subordinate gets no pulses."""

    def __init__(self, label: str, sensor: LiveSensor, joiner: ImageJoiner, *wanted: str) -> None:
        """Prepares.

        Args:
            wanted: The images that moments should have beside depth; people are found in the first.
        """
        self.label, self.sensor, self.joiner, settings = label, sensor, joiner, sensor.settings
        self._silence, self._losses = (
            Silence(label, settings),
            Losses(sensor, settings.fps, sensor.decimation),
        )
        self._health = [ImageHealth(label, image, settings, image == wanted[0]) for image in wanted]
        self._held: deque[Moment] = deque()
        self._polled_ns = 0  # end of the last poll

    @abstractmethod
    def receive(self, timeout_ms: int) -> bool:
        """Gives the SDK's next images to the joiner; returns False if none came within ``timeout_ms``.

        Raises:
            DeviceError: The SDK reports a failure; see :meth:`lost`.
        """

    @abstractmethod
    def is_connected(self) -> bool:
        """Whether the sensor is still connected."""

    @property
    def waits_for(self) -> str:
        """What a sensor without images waits for, where that is known; else empty."""
        return self._silence.waits_for

    def poll(self, timeout_ms: int) -> Moment | Incomplete:
        """The oldest moment of the queue."""
        moment = self.joiner.take()
        if moment is None:
            came = self.receive(timeout_ms)
            moment = self.joiner.take()
            return moment or (Incomplete.PART if came else Incomplete.NOTHING)
        return moment

    def take(self, wait: bool = True) -> Moment | None:
        """The newest wanted moment; None if there is none.

        If the wanted moment before it waited for an image that did not come, that one is given first, and the
        newest by the next call.

        Raises:
            DeviceError: Unplugged, or stalled.
        """
        if self._held:
            return self._held.popleft()
        sensor, losses, wanted = self.sensor, self._losses, list[Moment]()
        for moment in self._drained(sensor.settings.timeout_ms if wait else 0):
            number = sensor.decimation.moment(sensor.name, moment.time_ns, moment.host_ns)
            losses.count(moment, number)
            sensor.tell(self._health_of(moment))
            keeps = sensor.decimation.keeps(number)
            wanted += [moment] * keeps
            if sensor.on_capture is not None:
                sensor.made(moment)
        kept = wanted[-2:] if len(wanted) > 1 and wanted[-2].held and wanted[-2].lacks else wanted[-1:]
        losses.drop(len(wanted) - len(kept))
        losses.gave = losses.gave or bool(kept)
        self._held.extend(kept)
        return self._held.popleft() if self._held else None

    def _drained(self, timeout_ms: int) -> Iterator[Moment]:
        """The moments in the SDK's queue, in bounded time; waits for the first."""
        clock, end_ns = self.sensor.clock, None
        for _ in range(_MOST):
            begun_ns = clock()
            self._losses.away(begun_ns - self._polled_ns)
            came = self.poll(timeout_ms)
            self._polled_ns = clock()
            if isinstance(came, Moment):
                self._silence.ends()
                yield came
            else:
                if timeout_ms and came is Incomplete.NOTHING and not self.is_connected():
                    raise self.unplugged()  # some SDKs show unplugging only by time-outs
                self._silence.lasts(1e-9 * (self._polled_ns - begun_ns), came, self.cable_advice)
                if came is Incomplete.NOTHING:
                    return
            timeout_ms = 0  # take what is in the queue, without waiting again
            end_ns = end_ns or self._polled_ns + _LONGEST_NS
            if clock() >= end_ns or self.sensor.interrupted:
                return

    def _health_of(self, moment: Moment) -> Iterator[str]:
        for health in self._health:
            yield from health.told(health.image in moment.lacks, self.joiner.late_ns(health.image))

    def lost(self, fault: Exception) -> DeviceError:
        """The error for a failure that the SDK reports."""
        if not self.is_connected():
            return self.unplugged()
        return Cause.STOPPED.error(label=self.label, said=in_brackets(fault))

    def unplugged(self) -> DeviceError:
        """The error for a sensor that is not connected."""
        return AbsentError(Cause.UNPLUGGED.says(label=self.label))


class LiveSensor(Sensor):
    """A sensor of this machine. Building one opens nothing.

    Attributes:
        settings: How it runs; a vendor's own where it has more of them.
        decimation: Which moments are given. Those skipped on purpose do not count as missed.
        registered: Gives the RGB image on the depth's pixels of the frame given last, for sensors whose
            frames have no infrared; else None.
        on_capture: Gets for a recording, with all images, every frame of the SDK's queue.
        color_camera: The camera of the frames' colour images, once it is open; None if they have none.
        calibration_json: What an Azure Kinect stores, once it is open; empty for other sensors.
        awaits: What opening, the body tracker or closing waits for, if that may take long; else empty.
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
        self.clock, self.awaits = clock, ""
        self.on_capture: Callable[[SensorFrame], object] | None = None
        self.color_camera: ColorCamera | None = None
        self._sdk: Any = None
        self._interrupted = threading.Event()
        self._stream: CaptureStream | None = None  # while frames are taken
        self._news: deque[str] = deque()

    @property
    def waits_for(self) -> str:  # type: ignore[override]
        """What opening, the first frame or closing waits for; else empty."""
        return self.awaits or ("" if self._stream is None else self._stream.waits_for)

    @property
    def interrupted(self) -> bool:
        """Whether the frames are to end."""
        return self._interrupted.is_set()

    def interrupt(self) -> None:
        self._interrupted.set()

    def take_news(self) -> list[str]:
        """That an image does not come with the frames, or comes again."""
        return [self._news.popleft() for _ in range(len(self._news))]

    def tell(self, news: Iterable[str]) -> None:
        """Adds news."""
        self._news.extend(news)

    def frame_of(self, moment: Moment) -> SensorFrame:
        """The images of a moment, for a recording all of them, copied so that the SDK has its memory back."""
        raise NotImplementedError

    def made(self, moment: Moment) -> SensorFrame:
        """The frame of a moment, which is made, and recorded, once."""
        if moment.frame is None:
            moment.frame = self.frame_of(moment)
            if self.on_capture is not None:
                self.on_capture(moment.frame)
        return moment.frame

    def _warn(self, warning: str) -> None:
        if warning and warning not in self.warnings:
            self.warnings.append(warning)

    def _frames(self, stream: CaptureStream) -> Iterator[SensorFrame]:
        """The newest frames of a stream as they come, until interrupted."""
        yield from map(self.made, self._moments(stream))

    def _moments(self, stream: CaptureStream) -> Iterator[Moment]:
        self._stream = stream
        self.decimation.restart(self.name)
        try:
            while not self.interrupted:
                moment = stream.take()
                if moment is not None:
                    yield moment
        finally:
            self._stream = None
