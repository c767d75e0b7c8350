"""Recordings with people in their frames: found by the body tracker, or read from saved skeletons."""

from __future__ import annotations

import ctypes
import threading
from bisect import bisect_left
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Self

from devices.azure.mkv import MkvRecording
from devices.azure.tracking.body_tracker import BodyTracker
from devices.azure.tracking.recorded_captures import CaptureMaker
from devices.azure.tracking.settings import TrackerSettings
from devices.azure.tracking.tracker_queue import TrackerQueue
from devices.sensor import DeviceError, Sensor, SensorFrame, SensorWrapper
from fusion.body import Body


class TrackedRecording(SensorWrapper):
    """A recording tracked by libk4abt: a :class:`~devices.sensor.Sensor`.

    Every frame is tracked, at the tracker's speed. A frame without infrared has no people.
    """

    tracked_by = "k4abt"

    def __init__(
        self,
        recording: MkvRecording,
        settings: TrackerSettings | None = None,
        libk4a: Path | None = None,
        otherwise: str = "",
    ) -> None:
        """Stores the recording without opening it.

        Args:
            libk4a: File of the Sensor SDK's library; None: beside the tracker's, else found by the system.
            otherwise: Added to the message when there is no tracker: what else to do.
        """
        super().__init__(recording)
        self.recording = recording
        self._tracker = BodyTracker(settings)
        self._libk4a = libk4a or (_libk4a_beside(settings.library) if settings and settings.library else None)
        self._otherwise = otherwise
        self._maker: CaptureMaker | None = None
        self._interrupted = threading.Event()
        self._calibration: ctypes.Array[ctypes.c_char] | None = None

    def __enter__(self) -> Self:
        self._interrupted.clear()
        self.recording.__enter__()
        try:
            info = self.recording.info
            assert info is not None
            self._maker = CaptureMaker(self._libk4a)
            self._calibration = self._maker.calibration(info.calibration_json, info.depth_mode)
            self._tracker.open(ctypes.addressof(self._calibration))
        except DeviceError as fault:
            self.__exit__()
            raise DeviceError(f"{fault}{self._otherwise}") from fault
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *exc_info: object) -> None:
        self._tracker.close()
        self._maker = self._calibration = None
        self.recording.__exit__(*exc_info)

    def interrupt(self) -> None:
        self._interrupted.set()

    def frames(self) -> Iterator[SensorFrame]:
        """Yields the frames of the recording with the people in them, in capture order."""
        if self._maker is None:
            raise DeviceError(f"{self.name} is not open: use it in a with statement.")
        queue = TrackerQueue(self._tracker, wait_s=0.0, interrupted=self._interrupted.is_set)
        for frame in self.recording.frames():
            if frame.ir is None:
                yield from queue.flush()
                yield frame
                continue
            with self._maker.capture(frame) as capture:
                queue.put(frame, capture)
            yield from queue.done()
            if self._interrupted.is_set():
                return
        yield from queue.flush()


def _libk4a_beside(libk4abt: Path) -> Path | None:
    """The Sensor SDK's library in the tracker's folder; None for the system's."""
    names = ("libk4a.so.1.4", "libk4a.so", "k4a.dll")
    return next((libk4abt.with_name(name) for name in names if libk4abt.with_name(name).is_file()), None)


class RecordingWithSkeletons(SensorWrapper):
    """A recording whose images are joined with saved skeletons by capture time."""

    def __init__(self, recording: MkvRecording, skeletons: Sensor) -> None:
        """Stores the two sources without opening them; the times of both must be on the sensor's clock."""
        super().__init__(recording)
        self.recording, self.skeletons = recording, skeletons
        self._unmatched: tuple[str, ...] = ()

    @property
    def body(self) -> Body:  # type: ignore[override]
        """The body of the saved skeletons; known after opening."""
        return self.skeletons.body

    @property
    def warnings(self) -> list[str]:  # type: ignore[override]
        """Of the recording and of the skeletons, and the number of frames without a saved skeleton."""
        return [*self.recording.warnings, *self.skeletons.warnings, *self._unmatched]

    def __enter__(self) -> RecordingWithSkeletons:
        self.recording.__enter__()
        try:
            self.skeletons.__enter__()
        except BaseException:
            self.__exit__()
            raise
        self._unmatched = ()
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.skeletons.__exit__(*exc_info)
        self.recording.__exit__(*exc_info)

    def frames(self) -> Iterator[SensorFrame]:
        """Yields each frame with the saved people nearest in time, at most half a frame interval away.

        Raises:
            DeviceError: A source failed, or no frame has saved skeletons: they are of another recording.
        """
        saved = sorted(self.skeletons.frames(), key=lambda frame: frame.time_ns)
        times = [frame.time_ns for frame in saved]
        info = self.recording.info
        reach_ns = (info.interval_ns if info is not None else 0) // 2
        found = total = 0
        for frame in self.recording.frames():
            i = bisect_left(times, frame.time_ns)
            near = min(
                saved[max(i - 1, 0) : i + 1], key=lambda s: abs(s.time_ns - frame.time_ns), default=None
            )
            total += 1
            if near is not None and abs(near.time_ns - frame.time_ns) <= reach_ns:
                found += 1
                yield replace(frame, people=near.people)
            else:
                yield frame
        if found == 0:
            raise DeviceError(
                f"No skeleton of {self.skeletons.name} falls on a frame of {self.name}: the saved skeletons "
                f"are of another recording or on another clock. Name the files that belong together."
            )
        if found < total:
            self._unmatched = (f"{self.name}: {total - found} of {total} frames have no saved skeleton.",)
