"""Recorded sensors with people: the body tracker runs over their frames, or saved skeletons join them."""

from __future__ import annotations

import ctypes
from bisect import bisect_left
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from devices.azure.recording.mkv import MkvRecording
from devices.azure.tracking.body_tracker import BodyTracker, TrackerSettings
from devices.azure.tracking.recorded_captures import CaptureMaker
from devices.azure.tracking.tracker_queue import TrackerQueue
from devices.sensor import DeviceError, Sensor, SensorFrame
from fusion.body import Body
from fusion.intrinsics import Intrinsics


class TrackedRecording:
    """A recording and libk4abt over it: a :class:`~devices.sensor.Sensor`.

    Every frame is tracked, at the tracker's pace. A frame without infrared comes without people.

    Attributes:
        name, body, intrinsics, warnings: The recording's.
    """

    def __init__(
        self, recording: MkvRecording, settings: TrackerSettings | None = None, libk4a: Path | None = None
    ) -> None:
        """Names what to track; opens nothing.

        Args:
            recording: The frames.
            settings: How the tracker runs.
            libk4a: The Sensor SDK's library; the system's where None.
        """
        self.recording = recording
        self.name: str = recording.name
        self.body: Body = recording.body
        self.intrinsics: Intrinsics | None = None
        self.warnings: list[str] = []
        self._tracker = BodyTracker(settings)
        self._libk4a = libk4a
        self._maker: CaptureMaker | None = None
        self._calibration: ctypes.Array[ctypes.c_char] | None = None

    def __enter__(self) -> TrackedRecording:
        """Opens the recording, then the tracker.

        Raises:
            DeviceError: Either cannot be opened.
        """
        self.recording.__enter__()
        try:
            info = self.recording.info
            assert info is not None
            self._maker = CaptureMaker(self._libk4a)
            self._calibration = self._maker.calibration(info.calibration_json, info.depth_mode)
            self._tracker.open(ctypes.addressof(self._calibration))
        except BaseException:
            self.__exit__()
            raise
        self.intrinsics, self.warnings = self.recording.intrinsics, self.recording.warnings
        return self

    def __exit__(self, *exc_info: object) -> None:
        """Closes the tracker and the recording."""
        self._tracker.close()
        self._maker = self._calibration = None
        self.recording.__exit__(*exc_info)

    def frames(self) -> Iterator[SensorFrame]:
        """The recording's frames with the people in them, in capture order.

        Raises:
            DeviceError: The tracker or the recording failed; frames before the failure were given.
        """
        if self._maker is None:
            raise DeviceError(f"{self.name} is not open: use it in a with statement.")
        queue = TrackerQueue(self._tracker, wait_s=0.0)
        for frame in self.recording.frames():
            if frame.ir is None:
                yield from queue.flush()
                yield frame
                continue
            with self._maker.capture(frame) as capture:
                queue.put(frame, capture)
            yield from queue.done()
        yield from queue.flush()


class RecordingWithSkeletons:
    """A recording's images and skeletons saved before, joined by capture time: a Sensor.

    Attributes:
        name, intrinsics: The recording's.
        warnings: The recording's, and how many frames found no skeleton of their time.
    """

    def __init__(self, recording: MkvRecording, skeletons: Sensor) -> None:
        """Names the two sources; opens nothing. Their times must be on the same clock: the sensor's."""
        self.recording, self.skeletons = recording, skeletons
        self.name: str = recording.name
        self.intrinsics: Intrinsics | None = None
        self.warnings: list[str] = []

    @property
    def body(self) -> Body:
        """The saved skeletons'; known once it is open."""
        return self.skeletons.body

    def __enter__(self) -> RecordingWithSkeletons:
        """Opens both.

        Raises:
            DeviceError: Either cannot be opened.
        """
        self.recording.__enter__()
        try:
            self.skeletons.__enter__()
        except BaseException:
            self.__exit__()
            raise
        self.intrinsics, self.warnings = self.recording.intrinsics, self.recording.warnings
        return self

    def __exit__(self, *exc_info: object) -> None:
        """Closes both."""
        self.skeletons.__exit__(*exc_info)
        self.recording.__exit__(*exc_info)

    def frames(self) -> Iterator[SensorFrame]:
        """The recording's frames, each with the people saved nearest to its time, within half a frame.

        Raises:
            DeviceError: Either source failed, or not one frame found its skeletons: another recording's.
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
                f"are of another recording, or timed by another clock. Name the files that belong together."
            )
        if found < total:
            self.warnings.append(f"{self.name}: {total - found} of {total} frames found no saved skeleton.")
