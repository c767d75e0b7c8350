"""Runs a sensor on its own thread: keeps the newest frames, reopens lost sensors, closes in bounded time."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Generator
from contextlib import suppress

from devices.capture.causes import Cause
from devices.capture.clock.host_clock import SourceTimes
from devices.capture.sensor_state import (
    USUAL_LIMITS,
    Arrival,
    FrameBorder,
    Retries,
    SensorState,
    TimeLimits,
    failed_within,
    not_closed,
    not_opened,
)
from devices.depth.witness import with_witness
from devices.events import Event
from devices.sensor import DeviceError, Sensor, SensorFrame, SensorWrapper
from fusion.errors import BodyError

_EVENTS_KEPT = 100


class _Worker(threading.Thread):
    """Opens a sensor, takes its frames, closes it. A daemon, so that a hung driver does not block the end."""

    def __init__(self, sensor: Sensor, run: Callable[..., None], *stages: threading.Event) -> None:
        super().__init__(target=run, args=stages, name=f"sensor {sensor.name}", daemon=True)
        self.sensor = sensor


def open_sensors() -> list[Sensor]:
    """The sensors of this process that are open, opening or not closed yet."""
    return [thread.sensor for thread in threading.enumerate() if isinstance(thread, _Worker)]


class SensorThread:
    """Runs a sensor on a thread of its own and keeps its newest frames for a reader.

    Memory is bounded: the queue holds at most ``keep`` frames, then the oldest is dropped and counted. A
    sensor that fails while running is reopened until it works again. ``open`` raises a failure at the first
    opening. All methods are for one reader's thread.

    Attributes:
        sensor: The sensor; its ``intrinsics`` and ``body`` may be read once ``open`` returned.
        received: How many frames the sensor has given.
        returns: How often a lost sensor came back.
    """

    def __init__(
        self,
        sensor: Sensor,
        *,
        keep: int = 4,
        limits: TimeLimits = USUAL_LIMITS,
        arrival: threading.Event | None = None,
        clock: Callable[[], float] = time.perf_counter,
        wait: Callable[[threading.Event, float], bool] = threading.Event.wait,
    ) -> None:
        """Prepares; opens nothing.

        Args:
            keep: Most frames that wait for the reader.
            arrival: Set at every frame and change of state; two sensors may share one, to wait for either.
            wait: Waits for an event at most so many seconds; how retries pass time.
        """
        self.sensor = sensor if isinstance(sensor, Sensor) else SensorWrapper(sensor)
        self.arrival = arrival or threading.Event()
        self._keep, self._retries = keep, Retries(limits.retry_s)
        self._limits, self._stall_s = limits, limits.stall_s
        self._clock, self._wait = clock, wait
        self._lock = threading.Lock()
        self._frames: deque[Arrival] = deque()
        self._events: deque[Event] = deque(maxlen=_EVENTS_KEPT)
        self._state = SensorState.CLOSED
        self.received = self._dropped = self.returns = self._missed_before = self._lost_before = 0
        self._last_s = 0.0
        self._left_behind: threading.Thread | None = None
        self._told, self._stall_told, self._first, self._first_told = "", False, False, False
        self._fault: BaseException | None = None
        self._stopping, self._opened_or_failed = threading.Event(), threading.Event()
        self._thread: threading.Thread | None = None
        self._times = SourceTimes(self.sensor.name, self._tell)

    @property
    def dropped(self) -> int:
        """Number of dropped frames: the reader was too slow for the thread, or the thread for the sensor."""
        return self._dropped + self.sensor.missed - self._missed_before

    @property
    def lost(self) -> int:
        """Number of frames that did not reach this machine."""
        return self.sensor.lost - self._lost_before

    @property
    def waiting(self) -> bool:
        """Whether a frame waits for the reader."""
        return bool(self._frames)

    @property
    def state(self) -> SensorState:
        """What the sensor is doing now."""
        with self._lock:
            silent = self._clock() - self._last_s > (self._limits.open_s if self._first else self._stall_s)
            return SensorState.STALLED if self._state is SensorState.RUNNING and silent else self._state

    @property
    def gone(self) -> bool:
        """Whether no frame is to be expected soon: stalled, lost, ended or closed."""
        return self.state not in (SensorState.RUNNING, SensorState.OPENING)

    def open(self) -> SensorThread:
        """Starts the thread and waits until the sensor is open.

        Raises:
            DeviceError: It cannot be opened, or not in that time.
        """
        self.close()
        if self._left_behind is not None and self._left_behind.is_alive():
            raise DeviceError(not_closed(self.sensor))
        self._stopping, self._opened_or_failed = threading.Event(), threading.Event()
        self._fault, self._state = None, SensorState.OPENING
        self._thread = _Worker(self.sensor, self._run, self._stopping, self._opened_or_failed)
        try:
            self._thread.start()
            opened = self._opened_or_failed.wait(self._limits.open_s)
        except BaseException:  # Ctrl-C while it opens
            self.close()
            raise
        if not opened:
            self.close(0.0)
            raise not_opened(self.sensor, self._limits.open_s)
        self._raise_fault()
        return self

    def count_from_now(self) -> None:
        """Resets the counts of frames and drops. Queued frames are kept."""
        with self._lock:
            if self._dropped:
                self._frames.clear()
            self.received, self._dropped = len(self._frames), 0
            self._missed_before, self._lost_before = self.sensor.missed, self.sensor.lost

    def set_interval(self, interval_s: float) -> None:
        """Changes the time between two frames; a sensor stalls after four of them at the earliest."""
        self._stall_s = max(self._limits.stall_s, 4 * interval_s)

    def end(self) -> None:
        """Asks the thread to end, without waiting. Later frames are neither kept nor counted."""
        self._stopping.set()
        if self._thread is not None:
            self.sensor.interrupt()

    def close(self, within_s: float = 3.0) -> bool:
        """Ends the thread and closes the sensor; closing twice is harmless. A driver that hangs is left
        behind. Returns whether the sensor was closed in time.
        """
        self.end()
        thread, self._thread = self._thread, None
        if thread is None:
            return True
        try:
            with suppress(RuntimeError):  # Ctrl-C came before it could start
                thread.join(within_s)
        finally:  # Ctrl-C may end the wait; the thread closes the sensor all the same
            with self._lock:
                self._frames.clear()
                self._state = SensorState.CLOSED
        if thread.is_alive():
            self._left_behind = thread
            self._tell(not_closed(self.sensor))
            return False
        return True

    def __enter__(self) -> SensorThread:
        return self.open()

    def __exit__(self, *exc_info: object) -> None:
        self.close()

    def take(self) -> list[Arrival]:
        """The frames that came since the last call, oldest first, ``keep`` at most; does not wait.

        Raises:
            BodyError: It gave a skeleton of another body than its own.
            DeviceError: The sensor raised something else: a fault of the program or of a driver, which no
                opening anew mends.
        """
        with self._lock:
            frames = list(self._frames)
            self._frames.clear()
        if self._fault is not None and not isinstance(self._fault, DeviceError):
            self._raise_fault()
        return frames

    def events(self) -> list[Event]:
        """What happened since the last call: lost, back, stalled, running again."""
        stalled = self.state is SensorState.STALLED
        if stalled and not self._stall_told:
            silent_s = self._limits.open_s if self._first else self._stall_s
            waits_for = self.sensor.waits_for
            silent = Cause.NO_MORE_RECORDED if self.sensor.recorded else Cause.SILENT
            cause = Cause.WAITING if waits_for else silent
            self._tell(cause.says(label=self.sensor.name, seconds=silent_s, waits_for=waits_for))
        elif self._stall_told and self.state is SensorState.RUNNING:
            self._tell(f"{self.sensor.name} gives frames again.")
        self._stall_told = stalled
        with self._lock:
            running = self._state is SensorState.RUNNING
            waits = running and self._first and self._clock() - self._last_s > self._stall_s
        if waits and not self._first_told:
            self._first_told = True
            self._tell(f"{self.sensor.name}: waiting for {self.sensor.waits_for or 'its first frame'}.")
        with self._lock:
            told = list(self._events)
            self._events.clear()
        return told

    def _raise_fault(self) -> None:
        if self._fault is None:
            return
        self.close()
        if isinstance(self._fault, BodyError) and self.sensor.name not in str(self._fault):
            raise type(self._fault)(f"{self.sensor.name}: {self._fault}") from self._fault
        if not isinstance(self._fault, Exception) or isinstance(self._fault, DeviceError | BodyError):
            raise self._fault
        raise failed_within(self.sensor.name, self._fault) from self._fault

    def _run(self, stopping: threading.Event, settled: threading.Event) -> None:
        ran = False
        while not stopping.is_set():
            try:
                with self.sensor:
                    if stopping.is_set():
                        break
                    self._started(came_back=ran)
                    ran = True
                    settled.set()
                    try:
                        self._pump(stopping)
                    except DeviceError as fault:  # known at once: closing may take seconds
                        self._failed(str(fault))
                        raise
                break
            except DeviceError as fault:
                if not ran:
                    self._fault = fault
                if not ran or self.sensor.recorded:  # a recording is no better when it is opened anew
                    break
                self._failed(str(fault))
                self._wait(stopping, self._retries.after(fault))
            except BaseException as fault:
                self._fault = fault
                break
        with self._lock:
            if not stopping.is_set():
                self._state = SensorState.ENDED
        settled.set()
        self.arrival.set()

    def _pump(self, stopping: threading.Event) -> None:
        """Hands on frames until the source ends or the reader closes."""
        border = FrameBorder(self.sensor, self._tell)
        frames = self.sensor.frames()
        try:
            for frame in frames:
                if stopping.is_set():
                    return
                border.check(frame)
                if self.sensor.intrinsics is not None:
                    frame = with_witness(frame, self.sensor.intrinsics)
                self._deliver(frame)
        finally:
            # The generator may hold files or handles: release it now, on this thread.
            if isinstance(frames, Generator):
                frames.close()

    def _started(self, came_back: bool) -> None:
        with self._lock:
            self._state, self._last_s, self._told = SensorState.RUNNING, self._clock(), ""
            self.returns += came_back
            self._first, self._first_told = True, False
        self._times = SourceTimes(self.sensor.name, self._tell)
        self._retries.succeeded()
        if came_back:
            self._tell(f"{self.sensor.name} is back.")
        self.arrival.set()

    def _deliver(self, frame: SensorFrame) -> None:
        now_s = self._clock()
        came_ns = round(now_s * 1e9)
        frame = self._times.timed(frame, came_ns)
        with self._lock:
            self._last_s, self._first = now_s, False
            self.received += 1
            self._frames.append(Arrival(came_ns, frame, self.returns))
            if len(self._frames) > self._keep:
                self._frames.popleft()
                self._dropped += 1
        self.arrival.set()

    def _failed(self, message: str) -> None:
        with self._lock:
            self._state = SensorState.LOST
        # Retries repeat the same message: report it once.
        if message != self._told:
            self._told = message
            back = "" if self.sensor.recorded else "; it is used again when it returns"
            self._tell(f"{message} Going on without it{back}.")
        self.arrival.set()

    def _tell(self, text: str) -> None:
        event = Event(text, "WARN", time_ns=round(self._clock() * 1e9))
        with self._lock:
            self._events.append(event)
