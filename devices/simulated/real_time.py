"""Plays a simulated sensor in real time; images that take too long are left out."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

from devices.capture.frame_decimation import FrameDecimation
from devices.sensor import SensorFrame
from devices.simulated.kinect import SimulatedKinect
from fusion.body import Body
from fusion.intrinsics import Intrinsics

_FRAME, _TOGETHER = 1.0 / 30.0, 1.0  # seconds
_MARGIN, _FORGETTING = 1.5, 0.95
"""A frame is started 1.5 times its expected duration before it is due.

The expected duration is the longest recent one; it decays by 5 % per frame.
"""


class Beat:
    """Starts sensors together, like real sensors on a sync cable.

    Args:
        sensors: Number of sensors.
    """

    def __init__(self, sensors: int = 1) -> None:
        self._awaited = sensors
        self._came = threading.Condition()
        self._latest = 0.0

    def begin(self, clock: Callable[[], float], stopping: threading.Event) -> float:
        """Waits up to a second for the other sensors; returns the common start time, seconds of the clock."""
        with self._came:
            self._awaited -= 1
            self._latest = clock()
            self._came.notify_all()
            all_here = self._came.wait_for(lambda: self._awaited <= 0 or stopping.is_set(), timeout=_TOGETHER)
            return self._latest if all_here else clock()

    def wake(self) -> None:
        """Wakes the waiting threads, so that they check whether to stop."""
        with self._came:
            self._came.notify_all()


class PacedSensor:
    """Yields each frame of a simulated sensor at its capture time.

    A real sensor makes its frames outside of this process. Simulating a frame therefore starts in the second
    half of the interval before it is due, so that it does not compete with the processing of the previous
    frame. It starts earlier if simulating takes longer.

    Args:
        sensor: The simulated sensor. It is told to hurry while it is slower than real time.
        beat: Shared by sensors that start together; None: this sensor starts alone.
        decimation: Which moments a body tracker that works on the images wants; shared by the sensors. Frames
            of other moments and frames without an image are not given. None: every frame.
        clock: Returns seconds; tests inject their own.
        wait: Waits for an event with a timeout in seconds; tests inject their own.
    """

    def __init__(
        self,
        sensor: SimulatedKinect,
        beat: Beat | None = None,
        decimation: FrameDecimation | None = None,
        *,
        clock: Callable[[], float] = time.perf_counter,
        wait: Callable[[threading.Event, float], bool] = threading.Event.wait,
    ) -> None:
        self.name = sensor.name
        self._sensor = sensor
        self._beat = beat or Beat()
        self._decimation = decimation
        self._clock, self._wait = clock, wait
        self._stopping = threading.Event()
        self.making_ns = 0
        """How long simulating the last frame took."""

    @property
    def body(self) -> Body:
        """Body of the sensor."""
        return self._sensor.body

    @property
    def intrinsics(self) -> Intrinsics | None:
        """Intrinsics of the depth camera."""
        return self._sensor.intrinsics

    @property
    def warnings(self) -> Sequence[str]:
        """Warnings of the sensor."""
        return self._sensor.warnings

    def __enter__(self) -> PacedSensor:
        """Opens the sensor."""
        self._stopping.clear()
        self._sensor.__enter__()
        return self

    def __exit__(self, *exc_info: object) -> None:
        """Closes the sensor."""
        self._sensor.__exit__(*exc_info)

    def interrupt(self) -> None:
        """Ends ``frames`` immediately."""
        self._stopping.set()
        self._beat.wake()

    def frames(self) -> Iterator[SensorFrame]:
        """Yields the frames of the sensor, each when it is due."""
        begun, longest = None, 0.0
        frames = self._sensor.frames()
        if self._decimation is not None:
            self._decimation.restart(self.name)
        while True:
            started = self._clock()
            frame = next(frames, None)
            if frame is None:
                return
            took = self._clock() - started
            longest, self.making_ns = max(took, _FORGETTING * longest), round(took * 1e9)
            if begun is None:
                begun = self._beat.begin(self._clock, self._stopping)
            due = begun + (frame.time_ns - self._sensor.clock_at_start_ns) * 1e-9
            self._sensor.hurried = due - self._clock() < -_FRAME
            if self._stops_before(due):
                return
            frame = replace(frame, host_ns=round(self._clock() * 1e9))
            if self._is_wanted(frame):
                yield frame
            if self._stops_before(due + _FRAME - max(_FRAME / 2.0, _MARGIN * longest)):
                return

    def _is_wanted(self, frame: SensorFrame) -> bool:
        """Whether a tracker wants the frame; the next one then has images only if it wants that."""
        if self._decimation is None or frame.host_ns is None:
            return True
        moment = self._decimation.moment(self.name, frame.time_ns, frame.host_ns)
        self._sensor.imaging = self._decimation.keeps(moment + 1)
        return self._decimation.keeps(moment) and frame.depth is not None

    def _stops_before(self, moment: float) -> bool:
        """Waits until a time; returns whether the wait was interrupted."""
        left = moment - self._clock()
        return self._stopping.is_set() or (left > 0.0 and self._wait(self._stopping, left))


def paced_together(*sensors: SimulatedKinect, decimation: FrameDecimation | None = None) -> list[PacedSensor]:
    """Returns sensors that start together and play in real time; see :class:`PacedSensor`."""
    beat = Beat(len(sensors))
    return [PacedSensor(sensor, beat, decimation) for sensor in sensors]
