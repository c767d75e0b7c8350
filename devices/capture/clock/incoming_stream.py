"""The frames of one live sensor that wait for a partner, and how its frames come."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from itertools import islice, pairwise
from statistics import median_low
from typing import NamedTuple

from devices.capture.clock.host_clock import HostClock, Timing
from devices.sensor import SensorFrame

PENDING = 8
"""Frames that tell how a sensor's frames come, at least."""
NEWEST_NS = 1_000_000_000
"""A sensor's usual lag is the median over the frames that arrived in this time."""
_AGREE = 16  # newest frames of a sensor that tell whether both clocks are one
_LOST = 1  # of the newest frames, of a stream that is regular all the same
_NEVER_NS = -(1 << 63)
_SLOWEST_NS = 10_000_000_000  # for how long the arrivals of frames are kept


class Arrived(NamedTuple):
    """A frame that arrived, with what this machine's clock said then."""

    at_ns: int
    moment_ns: int  # its capture; of B the capture of A's partner, which is the cable's delay earlier
    frame: SensorFrame


@dataclass(eq=False)
class IncomingStream:
    """One sensor's frames that wait for a partner, in capture order, and how its frames come."""

    delay_ns: int = 0  # how much later than its partner it captures
    clock: HostClock = field(default_factory=HostClock)
    waiting: list[Arrived] = field(default_factory=list)
    recent: deque[tuple[int, int, int]] = field(default_factory=deque)
    """Arrival, moment and own time of the frames of ten seconds; no frame, which would keep its images."""
    agree: deque[bool] = field(default_factory=lambda: deque(maxlen=_AGREE))
    """On a cable, of the newest frames: whether the other sensor had given one of the same time before."""
    used_ns: int | None = None
    came_ns: int | None = None  # when the last one arrived, or the first one of the other sensor
    gone: bool = False
    overtakes_until_ns: int = _NEVER_NS
    """Until then a frame may come although a later one has: one did within ten seconds."""

    def oddity(self, frame: SensorFrame, now_ns: int) -> str:
        """Feeds the clock with a frame, once, before :meth:`take`.

        Returns:
            What is odd about the frame, a field of
            :class:`~devices.capture.stream_pairing.PairingFigures`; else empty.
        """
        times = [time_ns for _, _, time_ns in self.recent]
        if frame.time_ns in times:
            return "repeated"
        timing = self.clock.observe(frame.time_ns, now_ns if frame.host_ns is None else frame.host_ns)
        if timing is Timing.RESET:
            return "resets"
        overtaken = frame.time_ns < max(times, default=frame.time_ns)
        if overtaken:
            self.overtakes_until_ns = now_ns + _SLOWEST_NS
        if timing is Timing.LATE or (self.used_ns is not None and frame.time_ns <= self.used_ns):
            return "late"
        return "reordered" if overtaken else ""

    def take(self, frame: SensorFrame, now_ns: int, clock_ns: int | None) -> None:
        """Gives a frame its moment and its place among those that wait.

        Args:
            clock_ns: This machine's clock minus the sensor's; None before any frame told it.
        """
        taken = Arrived(now_ns, frame.time_ns + (clock_ns or 0) - self.delay_ns, frame)
        self.waiting.append(taken)
        self.waiting.sort(key=lambda each: each.frame.time_ns)
        self.recent.append((now_ns, taken.moment_ns, frame.time_ns))
        while self.recent[0][0] < now_ns - _SLOWEST_NS:
            self.recent.popleft()

    def use(self, count: int) -> list[Arrived]:
        """Removes the oldest frames from those that wait, and returns them."""
        used, self.waiting = self.waiting[:count], self.waiting[count:]
        self.used_ns = used[-1].frame.time_ns
        return used

    def forget(self) -> list[Arrived]:
        """Forgets all times, because the sensor's clock starts anew.

        Returns:
            The frames that waited, which wait no more.
        """
        waited, self.waiting, self.used_ns = self.waiting, [], None
        self.recent.clear()
        return waited

    def set_clock(self, clock_ns: int) -> None:
        """Gives the frames so far their moments anew.

        Args:
            clock_ns: This machine's clock minus the sensor's.
        """
        shift_ns = clock_ns - self.delay_ns
        self.waiting = [each._replace(moment_ns=each.frame.time_ns + shift_ns) for each in self.waiting]
        self.recent = deque((at, time_ns + shift_ns, time_ns) for at, _, time_ns in self.recent)

    def usual_lag_ns(self) -> int | None:
        """Median time from capture to arrival of the newest second; None before a few frames came."""
        if len(self.recent) < PENDING:
            return None
        since_ns = self.recent[-1][0] - NEWEST_NS
        return median_low(at - moment for at, moment, _ in self.recent if at >= since_ns) - self.delay_ns

    def next_near(self, due_ns: int, half_ns: int, now_ns: int) -> int | None:
        """The first moment from ``due_ns - half_ns`` on, by the rate so far.

        Where some frames are missing, it may be any: then it is the last one within ``half_ns``.

        Returns:
            None in the first second, and where frames overtake each other.
        """
        if now_ns < self.overtakes_until_ns or len(self.recent) < PENDING:
            return None
        if self.recent[-1][0] - self.recent[0][0] < NEWEST_NS:
            return None
        moments = sorted(moment for _, moment, _ in islice(reversed(self.recent), 2 * PENDING))
        steps = [later - earlier for earlier, later in pairwise(moments)]
        interval_ns = max(median_low(steps), 1)
        if sum(abs(step - interval_ns) > interval_ns // 4 for step in steps) > _LOST:
            return max(due_ns + half_ns, moments[-1])
        return moments[-1] + max(-((moments[-1] - due_ns + half_ns) // interval_ns), 1) * interval_ns
