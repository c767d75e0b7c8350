"""A simulated sensor at the pace of a real one: slowed down, or relieved of images that take too long."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace

from devices.sensor import SensorFrame
from devices.simulated.sensor import SimulatedKinect
from fusion.body import Body
from fusion.viewing_plane import Intrinsics

_LATE = 1.0 / 30.0  # seconds: a frame


class PacedSensor:
    """Gives each frame of a simulated sensor when its capture time has come.

    Args:
        sensor: Whose frames. It is told to hurry while it does not keep pace.
        clock: Seconds; tests put their own.
        wait: Waits for an event at most so many seconds; tests put their own.
    """

    def __init__(
        self,
        sensor: SimulatedKinect,
        *,
        clock: Callable[[], float] = time.perf_counter,
        wait: Callable[[threading.Event, float], bool] = threading.Event.wait,
    ) -> None:
        self.name = sensor.name
        self._sensor = sensor
        self._clock, self._wait = clock, wait
        self._stopping = threading.Event()

    @property
    def body(self) -> Body:
        """The sensor's body."""
        return self._sensor.body

    @property
    def intrinsics(self) -> Intrinsics | None:
        """The sensor's depth camera."""
        return self._sensor.intrinsics

    def __enter__(self) -> PacedSensor:
        """Opens the sensor."""
        self._stopping.clear()
        self._sensor.__enter__()
        return self

    def __exit__(self, *exc_info: object) -> None:
        """Closes the sensor."""
        self._sensor.__exit__(*exc_info)

    def interrupt(self) -> None:
        """Makes ``frames`` end now."""
        self._stopping.set()

    def frames(self) -> Iterator[SensorFrame]:
        """The sensor's frames, each when it is due."""
        begun: float | None = None
        for frame in self._sensor.frames():
            at = frame.time_ns * 1e-9
            if begun is None:
                begun = self._clock() - at
            due = begun + at - self._clock()
            self._sensor.hurried = due < -_LATE
            if self._stopping.is_set() or (due > 0.0 and self._wait(self._stopping, due)):
                return
            yield replace(frame, host_ns=round(self._clock() * 1e9))
