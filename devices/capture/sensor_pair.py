"""Two live sensors as one stream of pairs, robust against failures of either sensor."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace

from devices.capture.causes import SLOWER, Cause, origin_of
from devices.capture.frame_decimation import FrameDecimation
from devices.capture.sensor_state import USUAL_LIMITS, Arrival, SensorState, TimeLimits
from devices.capture.sensor_thread import SensorThread
from devices.capture.stream_pairing import LivePairing, Side
from devices.events import Event
from devices.frame_pairs import FramePair, PairingFigures
from devices.sensor import LinkFigures, Sensor

_POLL_S = 0.005  # latest delay of a pair that no longer waits for a partner
_CLOSE_S = 3.0  # for both together
_LATE_NS = 100_000_000
_KEEP = 8  # frames per sensor: a pause of a quarter of a second


class TwoSensors:
    """K_A and K_B, each on its own thread, paired.

    Use it as a context manager, from one thread. Frames are those that
    :class:`~devices.capture.stream_pairing.LivePairing` gives. A sensor that fails is gone until it comes
    back.

    Attributes:
        a, b: The sensors' threads, for their counts of frames and drops.
        step: Both sensors use every ``step``-th frame, so that the slower body tracker keeps up.
    """

    def __init__(
        self,
        a: Sensor,
        b: Sensor,
        *,
        pairing: LivePairing | None = None,
        decimation: FrameDecimation | None = None,
        limits: TimeLimits = USUAL_LIMITS,
        tell: Callable[[Event], None] = lambda _: None,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        """Prepares; opens nothing.

        Args:
            decimation: What the two sensors share to keep the same moments; pairing follows its step.
            tell: Told of every event at once, also while no pair comes; on the thread that asks for pairs.
        """
        self._arrival = threading.Event()
        self.a, self.b = (
            SensorThread(sensor, keep=_KEEP, limits=limits, arrival=self._arrival, clock=clock)
            for sensor in (a, b)
        )
        self._sides: tuple[tuple[Side, SensorThread], ...] = (("a", self.a), ("b", self.b))
        self._pairing = pairing or LivePairing()
        self.rate = round(1e9 / self._pairing.interval_ns, 3)
        """Nominal frames per second of the faster sensor, before a tracker leaves any out."""
        self._decimation, self.step = decimation, 1
        self._clock, self._tell = clock, tell
        self._stopped = self._late_told = self._late_images_told = False
        self._openings: dict[Side, int] = {"a": 0, "b": 0}  # of the newest frames
        self._events: list[Event] = []

    @property
    def figures(self) -> PairingFigures:
        """Counts of the pairing so far, with the dropped frames of both sensors."""
        return replace(self._pairing.figures, dropped=(self.a.dropped, self.b.dropped))

    @property
    def links(self) -> tuple[LinkFigures | None, LinkFigures | None]:
        """How the messages of A and of B arrive; None for a local sensor."""
        return self.a.sensor.link, self.b.sensor.link

    @property
    def waiting(self) -> bool:
        """Whether a frame has arrived that was not taken yet."""
        return self.a.waiting or self.b.waiting

    def __enter__(self) -> TwoSensors:
        """Opens both.

        Raises:
            DeviceError: One cannot be opened; the other is closed again.
        """
        self._stopped = False
        try:
            # The subordinate on a sync cable starts first, so that it receives the first pulse.
            a_leads = self._pairing.sync_delay_ns is None or self._pairing.sync_delay_ns > 0
            for thread in (self.b, self.a) if a_leads else (self.a, self.b):
                thread.open()
            # Frames of one sensor that arrived while the other's tracker was loading do not count as dropped.
            self.count_from_now()
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *exc_info: object) -> None:
        """Closes both sensors in bounded time on every path, and reports their events."""
        self._end()
        until_s = time.monotonic() + _CLOSE_S
        try:
            self.a.close(_CLOSE_S)
        finally:
            self.b.close(max(0.0, until_s - time.monotonic()))
        for _, thread in self._sides:
            self._take_events(thread)

    def count_from_now(self) -> None:
        """Resets the counts of both sensors' frames and drops."""
        for _, thread in self._sides:
            thread.count_from_now()

    def pairs(self, every_frame: bool = True) -> Iterator[FramePair]:
        """Pairs as they arrive, until both sources end or :meth:`stop` is called; waits while both are gone.

        Args:
            every_frame: As for :class:`~devices.capture.stream_pairing.LivePairing`.

        Raises:
            DeviceError: A fault of the program or of a driver inside a sensor.
        """
        self._pairing.every_frame = every_frame
        while not self._stopped:
            ended = all(thread.state is SensorState.ENDED for thread in (self.a, self.b))
            yield from self.poll(0.0 if ended else _POLL_S)
            if ended:
                yield from self._pairing.poll(_ns(self._clock()) + 10**12)
                return
        self._end()  # frames that arrive during closing do not count as dropped

    def stop(self) -> None:
        """Makes ``pairs`` end; for signal handlers and other threads."""
        self._stopped = True  # a plain flag: the interrupted thread may hold the lock of an Event

    def poll(self, wait_s: float = _POLL_S) -> list[FramePair]:
        """The pairs that are complete now, after waiting for a frame at most ``wait_s``. Raises as
        :meth:`pairs`.
        """
        self._arrival.wait(wait_s)
        self._arrival.clear()
        self._follow_decimation()
        self._name_late_sensor()
        now_ns, pairs = _ns(self._clock()), list[FramePair]()
        arrivals: list[tuple[Side, Arrival]] = []
        for side, thread in self._sides:
            arrivals += [(side, arrival) for arrival in thread.take()]
            self._take_events(thread)
        # Use the arrival times, so that a pause of this thread does not look like a pause of a sensor.
        for side, arrival in sorted(arrivals, key=lambda entry: entry[1].at_ns):
            if arrival.opening != self._openings[side]:
                self._openings[side] = arrival.opening
                pairs += self._pairing.restart(side)
            pairs += self._pairing.add(side, arrival.frame, arrival.at_ns)
        for side, thread in self._sides:
            if thread.gone:
                self._pairing.set_gone(side, True)
        return pairs + self._pairing.poll(now_ns)

    def events(self) -> list[Event]:
        """What happened since the last call, oldest first."""
        events, self._events = sorted(self._events, key=lambda event: event.time_ns), []
        return events

    def _follow_decimation(self) -> None:
        decimation = self._decimation
        if decimation is None:
            return
        for news in decimation.take_news():
            self._say(news)
        if decimation.step == self.step:
            return
        self.step = decimation.step
        self._pairing.set_interval(decimation.interval_ns)
        for _, thread in self._sides:
            thread.set_interval(decimation.interval_ns * 1e-9)
        full, kept = 1e9 / decimation.period_ns, 1e9 / decimation.interval_ns
        slowest, sensors = decimation.choice, (self.a.sensor, self.b.sensor)
        name = next((sensor.name for sensor in sensors if sensor.key == slowest.slowest), slowest.slowest)
        message = (
            f"The body tracker of {name} takes {1000 * slowest.slowest_s:.0f} ms per frame: "
            f"both sensors continue with {kept:.3g} of {full:.3g} frames per second. {decimation.advice}"
            if self.step > 1
            else f"The body trackers keep up again: {full:.3g} frames per second."
        )
        self._say(message)

    def _name_late_sensor(self) -> None:
        signed_ns = self._pairing.lag_ns
        lag_ns = abs(signed_ns)
        self._name_late_images()
        if lag_ns < _LATE_NS / 2:
            self._late_told = False
        if lag_ns < _LATE_NS or self._late_told:
            return
        self._late_told = True
        other, late = (self.a, self.b) if signed_ns > 0 else (self.b, self.a)
        cause = Cause.LATE if lag_ns <= self._pairing.max_lag_ns else Cause.TOO_LATE
        names = {"label": late.sensor.name, "other": other.sensor.name}
        self._say(cause.says(late_ms=lag_ns / 1e6, slower=SLOWER[origin_of(late.sensor)], **names))

    def _name_late_images(self) -> None:
        late_ns, least_ns = self._pairing.images_late_ns, self._pairing.interval_ns // 2
        if abs(late_ns) < least_ns // 2:
            self._late_images_told = False
        if abs(late_ns) < least_ns or self._late_images_told:
            return
        self._late_images_told = self._late_told = True  # one reason is enough
        other, late = (self.a, self.b) if late_ns > 0 else (self.b, self.a)
        names = {"label": late.sensor.name, "other": other.sensor.name}
        self._say(Cause.LATE_ON_CABLE.says(late_ms=abs(late_ns) / 1e6, **names))

    def _say(self, text: str) -> None:
        event = Event(text, "WARN", time_ns=_ns(self._clock()))
        self._events.append(event)
        self._tell(event)

    def _end(self) -> None:
        for _, thread in self._sides:
            thread.end()

    def _take_events(self, thread: SensorThread) -> None:
        events = thread.events()
        events += [Event(text, "WARN", time_ns=_ns(self._clock())) for text in thread.sensor.take_news()]
        self._events += events
        for event in events:
            self._tell(event)


def _ns(seconds: float) -> int:
    return round(seconds * 1e9)
