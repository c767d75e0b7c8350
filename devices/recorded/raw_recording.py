"""Records the images of sensors while they run: a bounded queue and a thread per sensor."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from devices.azure.mkv_writer import MkvWriter
from devices.blazepose.tracked_images import TrackedImages
from devices.capture.capture_stream import LiveSensor
from devices.capture.clock.host_clock import ContinuousTime, HostClock, Timing
from devices.capture.settings import CaptureSettings
from devices.sensor import ColorImage, DeviceError, Sensor, SensorFrame
from devices.simulated.real_time import PacedSensor
from devices.upright import UprightSensor

_KEEP, _KEEP_WITH_IMAGES = 120, 60
"""Most queued frames; from the second number on, frames wait without infrared and colour: 130 MB at most, of
640 × 576 pixels."""


class _FileTimes:
    """A sensor's times in a file: those of its clock, continued by this machine's where it starts anew."""

    def __init__(self) -> None:
        self._clock, self._time = HostClock(), ContinuousTime()
        self._last_ns: int | None = None

    def of(self, frame: SensorFrame) -> int | None:
        """The time of a frame in the file; None if the frame repeats or precedes the last one."""
        sensor_ns, host_ns = frame.time_ns, frame.host_ns or 0
        timing = self._clock.observe(sensor_ns, host_ns)
        passed = self._last_ns is not None and sensor_ns <= self._last_ns
        if sensor_ns == self._last_ns or (passed and timing is Timing.IN_TIME):
            return None
        if passed and timing is Timing.LATE:  # frames come in order, so the clock is another one
            self._clock.restart()
            self._clock.observe(sensor_ns, host_ns)
        if passed or timing is Timing.RESET:
            self._time.restart()
        self._last_ns = sensor_ns
        return self._time.of_sensor(sensor_ns, sensor_ns + (self._clock.offset_ns or 0))


class RawRecorder:
    """Writes a sensor's depth, infrared and colour to an ``.mkv``; :meth:`add` never waits.

    While the queue is long, because the disk is slow, new frames lose colour and infrared; when it is full,
    they are lost. A full disk ends the recording; the file keeps the frames before. All frames but the last
    one survive a kill of the program.

    Attributes:
        failure: Why the recording ended early, in a sentence; None if it did not.
        written: Frames in the file.
        lost: Frames with depth that are not; one that the sensor gave twice does not count.
        without_images: Frames of the file whose infrared and colour were left out.
    """

    def __init__(
        self,
        path: Path,
        sensor: Sensor,
        settings: CaptureSettings | None = None,
        *,
        compress: bool = False,
        overwrite: bool = False,
        hide: Callable[[str], str] = str,
        on_failure: Callable[[str], object] = lambda _: None,
        open_writer: Callable[..., MkvWriter] = MkvWriter,
    ) -> None:
        """Starts the thread, which makes the file with the first frame.

        Args:
            sensor: Gives serial number, camera and calibration once it is open.
            hide: What becomes of the serial number and of the calibration's text, before they are written.
            on_failure: Called on the thread with the reason when the recording ends early.
        """
        self.path, self.sensor = path, sensor
        self.failure: str | None = None
        self.written = self.lost = self.without_images = 0
        self._settings, self._hide = settings or CaptureSettings(), hide
        self._how = {"compress": compress, "overwrite": overwrite}
        self._on_failure, self._open_writer = on_failure, open_writer
        self._queue: deque[SensorFrame] = deque()
        self._more = threading.Condition()
        self._ending = False
        self._fault: BaseException | None = None
        self._times = _FileTimes()
        self._thread = threading.Thread(target=self._run, name=f"recording {path.name}", daemon=False)
        self._thread.start()

    def add(self, frame: SensorFrame) -> None:
        """Queues a frame; one without depth is left out."""
        with self._more:
            if frame.depth is None:
                return
            if self._ending or len(self._queue) >= _KEEP:
                self.lost += 1
                return
            if len(self._queue) >= _KEEP_WITH_IMAGES:
                frame = replace(frame, ir=None, color=None)
                self.without_images += 1
            if frame.host_ns is None:
                frame = replace(frame, host_ns=time.perf_counter_ns())
            self._queue.append(frame)
            self._more.notify()

    @property
    def written_bytes(self) -> int:
        """The file's size so far."""
        try:
            return self.path.stat().st_size if self.written else 0
        except OSError:
            return 0

    def close(self) -> None:
        """Writes what is queued and closes the file. Closing twice has no effect."""
        with self._more:
            self._ending = True
            self._more.notify()
        self._thread.join()
        fault, self._fault = self._fault, None
        if fault is not None:
            raise fault

    def __enter__(self) -> RawRecorder:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _run(self) -> None:
        try:
            self._write()
        except OSError as fault:
            self._fail(f"{fault.strerror or fault}")
        except DeviceError as fault:
            self._fail(str(fault))
        except BaseException as fault:
            self._fault = fault
        finally:
            with self._more:
                self._ending = True
                self.lost += len(self._queue)
                self._queue.clear()

    def _write(self) -> None:
        images = self._first_whole()
        frame = self._next()
        if frame is None:
            return
        sensor = self.sensor
        if sensor.intrinsics is None:
            raise DeviceError(f"{sensor.name} does not know its depth camera, which a recording needs.")
        calibration = self._hide(getattr(sensor, "calibration_json", b"").decode("latin-1")).encode("latin-1")
        first = replace(images or frame, time_ns=frame.time_ns)
        camera = getattr(sensor, "color_camera", None)
        if first.color is None and camera is not None:  # it may start later
            first = replace(first, color=ColorImage(b"", camera))
        given = self._hide(sensor.name), self._settings, sensor.intrinsics, first
        with self._open_writer(self.path, *given, calibration=calibration, **self._how) as writer:
            following: SensorFrame | None = frame
            while following is not None:
                try:
                    writer.write(following)
                except OSError:
                    self.lost += 1
                    if not writer.placed:  # an older file stays
                        self.lost, self.written = self.lost + self.written, 0
                    raise
                self.written += 1
                following = self._next()

    def _first_whole(self) -> SensorFrame | None:
        """The first frame with all the images that the sensor gives, which name the file's tracks.

        Cameras start one after the other, and depth may come first. A second of frames is waited for.
        """
        with_color = self._settings.color is not None

        def whole(frame: SensorFrame) -> bool:
            return frame.color is not None or (frame.ir is not None and not with_color)

        def found() -> SensorFrame | None:
            return next(filter(whole, self._queue), None)

        with self._more:
            self._more.wait_for(lambda: self._ending or found() or len(self._queue) >= self._settings.fps)
            return found()

    def _next(self) -> SensorFrame | None:
        """The next frame, at its time in the file; None at the end."""
        while True:
            with self._more:
                self._more.wait_for(lambda: self._queue or self._ending)
                frame = self._queue.popleft() if self._queue else None
            if frame is None:
                return None
            time_ns = self._times.of(frame)
            if time_ns is not None:
                return replace(frame, time_ns=time_ns)

    def _fail(self, why: str) -> None:
        rest = f" from frame {self.written} on: {why}. Everything before that can be read."
        self.failure = f"{self.path} is not recorded{rest}" if self.written else f"{self.path}: {why}."
        self._on_failure(self.failure)


def camera_of(sensor: Sensor) -> Sensor:
    """The sensor whose images are recorded: before it is turned, and before a body tracker has them."""
    while isinstance(sensor, TrackedImages | UprightSensor):
        sensor = sensor.source
    return sensor


def record_images(sensor: Sensor, recorder: RawRecorder) -> None:
    """Gives the recorder the images of a sensor from now on, before a body tracker has them.

    It gets every image, also those that the body tracker is too slow for.
    """
    images = camera_of(sensor)
    assert isinstance(images, LiveSensor | PacedSensor)
    images.on_capture = recorder.add
