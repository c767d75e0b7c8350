"""Records the images of sensors while they run."""

from __future__ import annotations

import time
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
from viewer_app.sinks.queued_file import QueuedFile


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


class RawRecorder(QueuedFile[SensorFrame]):
    """Writes a sensor's depth, infrared and colour to an ``.mkv``.

    All frames but the last one survive a kill of the program. One that the sensor gave twice does not count.
    """

    keep, keep_with_images = 120, 60  # 130 MB at most, of 640 × 576 pixels
    thinned = "infrared and colour"

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
        super().__init__(path, f"recording {path.name}", on_failure)
        self.sensor = sensor
        self._settings, self._hide = settings or CaptureSettings(), hide
        self._how = {"compress": compress, "overwrite": overwrite, "again": self._again}
        self._open_writer = open_writer
        self._times = _FileTimes()
        self._thread.start()

    def add(self, frame: SensorFrame) -> None:
        """Queues a frame; one without depth is left out."""
        if frame.depth is None:
            return
        if frame.host_ns is None:
            frame = replace(frame, host_ns=time.perf_counter_ns())
        self._queue.put(frame)

    def __enter__(self) -> RawRecorder:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

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
                writer.write(following)
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

        queue = self._queue
        with queue.changed:
            queue.changed.wait_for(lambda: queue.ended or found() or len(queue) >= self._settings.fps)
            return found()

    def _next(self) -> SensorFrame | None:
        """The next frame, at its time in the file; None at the end."""
        while frames := self._queue.take(None, most=1):
            time_ns = self._times.of(frames[0])
            if time_ns is not None:
                return replace(frames[0], time_ns=time_ns)
            with self._queue.changed:
                self._came -= 1
        return None

    def _without_images(self, item: SensorFrame) -> SensorFrame:
        return replace(item, ir=None, color=None)


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
