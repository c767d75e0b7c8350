"""Plays a recording as a live sensor: each frame when its time has come."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

from devices.sensor import Sensor, SensorFrame
from fusion.body import Body
from fusion.intrinsics import Intrinsics


class PlayedRecording:
    """A recording in real time; its first frame comes at once.

    Args:
        recording: The recording.
        clock: Seconds; tests inject their own.
        wait: Waits for an event with a timeout in seconds; tests inject their own.
    """

    def __init__(
        self,
        recording: Sensor,
        *,
        clock: Callable[[], float] = time.perf_counter,
        wait: Callable[[threading.Event, float], bool] = threading.Event.wait,
    ) -> None:
        self._recording = recording
        self._clock, self._wait = clock, wait
        self._stopping = threading.Event()

    @property
    def name(self) -> str:
        """Name of the recording."""
        return self._recording.name

    @property
    def body(self) -> Body:
        """Body of the recording."""
        return self._recording.body

    @property
    def intrinsics(self) -> Intrinsics | None:
        """Intrinsics of the recording's depth camera."""
        return self._recording.intrinsics

    @property
    def warnings(self) -> Sequence[str]:
        """Warnings of the recording."""
        return self._recording.warnings

    def __enter__(self) -> PlayedRecording:
        """Opens the recording."""
        self._stopping.clear()
        self._recording.__enter__()
        return self

    def __exit__(self, *exc_info: object) -> None:
        """Closes the recording."""
        self._recording.__exit__(*exc_info)

    def interrupt(self) -> None:
        """Ends ``frames`` immediately."""
        self._stopping.set()

    def frames(self) -> Iterator[SensorFrame]:
        """The frames, each when it is due."""
        begun_s: float | None = None
        first_ns = 0
        for frame in self._recording.frames():
            if begun_s is None:
                begun_s, first_ns = self._clock(), frame.time_ns
            left_s = begun_s + (frame.time_ns - first_ns) * 1e-9 - self._clock()
            if self._stopping.is_set() or (left_s > 0.0 and self._wait(self._stopping, left_s)):
                return
            yield replace(frame, host_ns=round(self._clock() * 1e9))
