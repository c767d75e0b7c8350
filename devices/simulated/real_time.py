"""Plays simulated sensors and recordings in real time: each frame when its time has come."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Hashable, Iterator
from dataclasses import replace
from typing import Any, Literal

from devices.capture.frame_decimation import FrameDecimation
from devices.sensor import Sensor, SensorFrame, SensorWrapper

_FRAME, _TOGETHER = 1.0 / 30.0, 1.0  # seconds
_MARGIN, _FORGETTING = 1.5, 0.95
"""A frame is started 1.5 times its expected duration before it is due.

The expected duration is the longest recent one; it decays by 5 % per frame.
"""


class Beat:
    """Starts sensors together, like real sensors on a sync cable.

    Args:
        begins_s: When they start, seconds of the clock; None: as soon as all are there.
        common: Which times of all the recordings are of one clock: those of the frames' arrival, as one run
            of the program recorded them, or of their capture, on a sync cable. None: each recording starts
            with its first frame.
    """

    def __init__(
        self,
        sensors: int = 1,
        begins_s: float | None = None,
        common: Literal["arrival", "capture"] | None = None,
    ) -> None:
        self._awaited, self._begins_s, self.common = sensors, begins_s, common
        self._came = threading.Condition()
        self._latest = 0.0
        self.first_ns: int | None = None

    def begin(self, clock: Callable[[], float], stopping: threading.Event, first_ns: int = 0) -> float:
        """Waits up to a second for the other sensors; returns the common start time, seconds of the clock.

        Args:
            first_ns: Time of the sensor's first frame; :attr:`first_ns` is the earliest of all afterwards.
        """
        if self._begins_s is not None:
            return self._begins_s
        with self._came:
            self._awaited -= 1
            self._latest = clock()
            self.first_ns = first_ns if self.first_ns is None else min(self.first_ns, first_ns)
            self._came.notify_all()
            all_here = self._came.wait_for(lambda: self._awaited <= 0 or stopping.is_set(), timeout=_TOGETHER)
            return self._latest if all_here else clock()

    def wake(self) -> None:
        """Wakes the waiting threads, so that they check whether to stop."""
        with self._came:
            self._came.notify_all()


class PacedSensor(SensorWrapper):
    """Yields each frame of a simulated sensor or a recording at its capture time.

    A real sensor makes its frames outside of this process. Making a frame therefore starts in the second
    half of the interval before it is due, so that it does not compete with the processing of the previous
    frame. It starts earlier if making takes longer. The first frame of a recording is due at once, and each
    arrives when it is due: as it did then, where that was recorded.

    Args:
        sensor: The sensor. A simulated one leaves out images while it is slower than real time.
        decimation: Which moments a body tracker that works on the images wants; shared by the sensors. Frames
            of other moments and frames without an image are not given. None: every frame.

    Attributes:
        on_capture: Gets every frame for a recording.
    """

    on_capture: Callable[[SensorFrame], object] | None = None

    def __init__(
        self,
        sensor: Sensor,
        beat: Beat | None = None,
        decimation: FrameDecimation | None = None,
        *,
        clock: Callable[[], float] = time.perf_counter,
        wait: Callable[[threading.Event, float], bool] = threading.Event.wait,
    ) -> None:
        super().__init__(sensor)
        self._simulated: Any = sensor if hasattr(sensor, "skips_depth") else None
        self._beat = beat or Beat()
        self._decimation = decimation
        self._clock, self._wait = clock, wait
        self._stopping = threading.Event()

    @property
    def recorded(self) -> bool:  # type: ignore[override]
        """Whether it is no simulated sensor."""
        return not self.simulated

    @property
    def key(self) -> Hashable:
        """Itself: recordings in two folders may have one name."""
        return self

    def __enter__(self) -> PacedSensor:
        self._stopping.clear()
        return super().__enter__()

    def interrupt(self) -> None:
        super().interrupt()
        self._stopping.set()
        self._beat.wake()

    def frames(self) -> Iterator[SensorFrame]:
        if self._decimation is not None:
            self._decimation.restart(self.key)
        for frame in self._paced():
            if self.on_capture is not None:
                self.on_capture(frame)
            if self._is_wanted(frame):
                yield frame

    def _paced(self) -> Iterator[SensorFrame]:
        """Every frame when it is due."""
        begun, longest, start_ns, simulated = None, 0.0, 0, self._simulated
        frames = self.source.frames()
        while True:
            started = self._clock()
            frame = next(frames, None)
            if frame is None:
                return
            took = self._clock() - started
            longest = max(took, _FORGETTING * longest)
            moment_ns = frame.time_ns
            if frame.host_ns is not None and self._beat.common != "capture":
                moment_ns = frame.host_ns
            if begun is None:
                begun = self._beat.begin(self._clock, self._stopping, moment_ns)
                if simulated is None:
                    start_ns = moment_ns if self._beat.common is None else self._beat.first_ns or 0
            due = begun + (moment_ns - start_ns) * 1e-9
            if simulated is not None:
                simulated.skips_depth = self._clock() - due > _FRAME
            if self._stops_before(due):
                return
            came_s = due if simulated is None else self._clock()
            yield replace(frame, host_ns=round(came_s * 1e9))
            if self._stops_before(due + _FRAME - max(_FRAME / 2.0, _MARGIN * longest)):
                return

    def _is_wanted(self, frame: SensorFrame) -> bool:
        """Whether a tracker wants the frame; the next one then has images only if it wants that."""
        if self._decimation is None or frame.host_ns is None:
            return True
        moment = self._decimation.moment(self.key, frame.time_ns, frame.host_ns)
        if self._simulated is not None:
            self._simulated.imaging = self.on_capture is not None or self._decimation.keeps(moment + 1)
        return self._decimation.keeps(moment) and frame.depth is not None

    def _stops_before(self, moment: float) -> bool:
        """Waits until a time; returns whether the wait was interrupted."""
        left = moment - self._clock()
        return self._stopping.is_set() or (left > 0.0 and self._wait(self._stopping, left))


def paced_together(*sensors: Sensor, decimation: FrameDecimation | None = None) -> list[PacedSensor]:
    """Returns sensors that start together and play in real time; see :class:`PacedSensor`."""
    beat = Beat(len(sensors))
    return [PacedSensor(sensor, beat, decimation) for sensor in sensors]
