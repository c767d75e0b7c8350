"""Two live streams → pairs of frames captured at the same time.

The sensors' clocks start anywhere and drift apart. Arrivals tell the offset between them. With a sync cable
the sensors capture at the same moments, a fixed delay apart. The master sets the subordinate's clock, so that
both are one, even where the arrivals say otherwise by up to the longest lag: frames whose own times agree are
of one moment. Where it does not set it, the pairs found so far tell the offset to the microsecond.

Each frame gets its moment on this machine's clock when it arrives; those so far get a new one when the clocks
are found to be one. By it a frame waits for its partner. Pairs carry A's time, continued where A's clock is
reset. It never goes back. The person has not been selected yet: see :mod:`devices.people.recorded_people`.

Pure: time is passed in, nothing waits.
"""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import replace
from itertools import islice
from statistics import median_low
from typing import Literal

from devices.capture.clock.host_clock import OutputTime
from devices.capture.clock.incoming_stream import NEWEST_NS, PENDING, Arrived, IncomingStream
from devices.frame_pairs import FramePair, PairingFigures, lone_side
from devices.sensor import SensorFrame
from fusion.skeleton import SkeletonPair

Side = Literal["a", "b"]
_SYNCED_PAIRS, _SYNCED_ENOUGH = 61, 15  # pairs on a cable that tell the offset, at most and at least
_ONE_CLOCK_NS = 1_000_000  # own times of two frames on a cable that agree to so much are of one clock
PATIENCE_NS = 5_000_000
"""A frame waits this much longer than the partner's slowest frame of the last ten seconds took."""


class LivePairing:
    """Pairs two sensors' frames by capture time; goes on with one while the other is gone.

    Every frame comes out, with its partner or alone, unless it is counted as late, repeated or unmatched.

    Attributes:
        interval_ns: Time between two frames of the faster sensor.
        every_frame: Whether frames of B that merely find no partner come out, too. Else they are left out,
            because the paper's methods fuse pairs: a slower A would make their S* change between one and two
            views.
    """

    def __init__(
        self,
        interval_ns: int = 33_333_333,
        *,
        max_lag_ns: int = 300_000_000,
        gone_after_ns: int = 500_000_000,
        sync_delay_ns: int | None = None,
    ) -> None:
        """Starts without a frame.

        Args:
            interval_ns: Time between two frames of the faster sensor. Half of it is the tolerance.
            max_lag_ns: The longest time from capture to arrival that is waited for; an interval at least.
            gone_after_ns: After how long without a frame a sensor is gone, and not waited for; four
                intervals at least.
            sync_delay_ns: With a sync cable, how much later B captures than A (negative: earlier); None
                without one.
        """
        self._least_lag_ns, self._least_gone_ns = max_lag_ns, gone_after_ns
        self.set_interval(interval_ns)
        self.sync_delay_ns, self.every_frame = sync_delay_ns, True
        self._a, self._b = IncomingStream(), IncomingStream(sync_delay_ns or 0)
        self._streams: dict[Side, IncomingStream] = {"a": self._a, "b": self._b}
        self._synced: deque[int] = deque(maxlen=_SYNCED_PAIRS)  # B's clock minus A's, of pairs on the cable
        self._one_clock = False  # whether the master on the cable has set the subordinate's clock
        self._counts: Counter[str] = Counter()
        self._time = OutputTime()
        self._given_ns = [-(1 << 63), -(1 << 63)]  # own times of the newest frames of A and of B
        self._skew_ns: int | None = None

    @property
    def figures(self) -> PairingFigures:
        """How it goes so far."""
        drift_ppm = self._b.clock.drift_ppm - self._a.clock.drift_ppm
        now = PairingFigures(skew_ns=self._skew_ns, offset_ns=self._offset_ns(), drift_ppm=drift_ppm)
        return replace(now, **self._counts)  # type: ignore[arg-type]

    @property
    def lag_ns(self) -> int:
        """How much later after their capture B's frames come than A's: median of one second, ns."""
        a, b = self._a.usual_lag_ns(), self._b.usual_lag_ns()
        return 0 if a is None or b is None else b - a

    @property
    def images_late_ns(self) -> int:
        """How much later B's images come than A's of one moment, by the least delays, ns; 0 unless both have
        one clock and two seconds of frames."""
        a, b = self._a.clock.offset_ns, self._b.clock.offset_ns
        recent = [each.recent for each in self._streams.values()]
        settled = all(each and each[-1][0] - each[0][0] >= 2 * NEWEST_NS for each in recent)
        if not self._one_clock or not settled or a is None or b is None:
            return 0
        return b - a + self._one_clock_ns()

    def set_interval(self, interval_ns: int) -> None:
        """Changes the time between two frames of the faster sensor, and the patience that follows from it."""
        self.interval_ns = interval_ns
        self.max_lag_ns = max(self._least_lag_ns, interval_ns)  # a tracker may take nearly an interval
        self._gone_after_ns = max(self._least_gone_ns, 4 * interval_ns)

    def add(self, side: Side, frame: SensorFrame, now_ns: int) -> list[FramePair]:
        """Takes a frame and gives the pairs that are complete now, in order. ``now_ns`` is on the clock of
        ``host_ns``, which relates the clocks of both sensors.
        """
        for each in self._streams.values():  # from the first frame on, both are expected
            each.came_ns = now_ns if each.came_ns is None else each.came_ns
        stream = self._streams[side]
        stream.came_ns, stream.gone = now_ns, False
        oddity = stream.oddity(frame, now_ns)
        if oddity:
            self._counts[oddity] += 1
        pairs = self._forget(stream) if oddity == "resets" else []
        if oddity not in ("repeated", "late"):
            self._compare_clocks(stream, frame.time_ns)
            stream.take(frame, now_ns, self._clock_ns(stream))
        return pairs + self.poll(now_ns)

    def poll(self, now_ns: int) -> list[FramePair]:
        """The pairs that need wait no longer at ``now_ns``, in order. Call it when no frame comes, too."""
        pairs: list[FramePair] = []
        while (step := self._step(now_ns)) is not None:
            pairs += step
        return pairs

    def set_gone(self, side: Side, gone: bool) -> None:
        """Marks a sensor as lost, so that no frame waits for it; its next frame ends this state."""
        self._streams[side].gone = gone

    def restart(self, side: Side) -> list[FramePair]:
        """Reports that a sensor was reopened, so that its clock may have restarted; returns what waited."""
        self._streams[side].clock.restart()
        return self._forget(self._streams[side])

    def _forget(self, stream: IncomingStream) -> list[FramePair]:
        """Forgets what is on a sensor's old clock.

        Its frames that waited are given alone, those of B only with ``every_frame``.
        """
        pairs = self._alone(stream, stream.forget())
        self._synced.clear()
        self._one_clock = False
        for each in self._streams.values():
            each.agree.clear()
        if stream is self._a:
            self._time.restart()
        return pairs

    def _step(self, now_ns: int) -> list[FramePair] | None:
        """Decides on the oldest frames: returns the resulting pairs, or None if it must wait."""
        a, b = self._a.waiting, self._b.waiting
        if a and b:
            ahead_ns = (self._offset_ns() or 0) + self._b.delay_ns
            skew_ns = b[0].frame.time_ns - a[0].frame.time_ns - ahead_ns
            lone = lone_side(skew_ns, self.interval_ns)
            if not lone:
                return self._pair(skew_ns)
            stream, other = (self._a, self._b) if lone > 0 else (self._b, self._a)
            if now_ns < other.overtakes_until_ns and not self._has_waited(stream, other, now_ns):
                return None
            return self._alone(stream, stream.use(1))
        for stream, other in ((self._a, self._b), (self._b, self._a)):
            gone = self._is_gone(other, now_ns)
            if stream.waiting and (gone or self._has_waited(stream, other, now_ns)):
                return self._alone(stream, stream.use(1), unmatched=not gone)
        return None

    def _compare_clocks(self, stream: IncomingStream, time_ns: int) -> None:
        """Finds whether both clocks are one, from a new frame of one sensor and the other's frames so far.

        The frames of the sensor that comes later find their partners there.
        """
        a, b = self._a.clock.offset_ns, self._b.clock.offset_ns
        if self.sync_delay_ns is None or a is None or b is None:
            return
        other, ahead_ns = self._b, self._one_clock_ns()
        if stream is self._b:
            other, ahead_ns = self._a, -ahead_ns
        wanted_ns = time_ns - stream.delay_ns + other.delay_ns + ahead_ns
        near = (abs(own_ns - wanted_ns) for _, _, own_ns in islice(reversed(other.recent), 4 * PENDING))
        stream.agree.append(min(near, default=_ONE_CLOCK_NS) < _ONE_CLOCK_NS)
        before, agree = self._one_clock, any(True in each.agree for each in self._streams.values())
        self._one_clock = abs(a - b) <= self.max_lag_ns and agree
        if self._one_clock and not before:
            self._synced.clear()
            for each in self._streams.values():
                each.set_clock(self._clock_ns(each) or 0)

    def _clock_ns(self, stream: IncomingStream) -> int | None:
        """This machine's clock minus a sensor's; where theirs are one, by the sensor with the least delay."""
        a, b = self._a.clock.offset_ns, self._b.clock.offset_ns
        if not self._one_clock or a is None or b is None:
            return stream.clock.offset_ns
        ahead_ns = self._one_clock_ns()
        return min(a, b + ahead_ns) - (ahead_ns if stream is self._b else 0)

    def _one_clock_ns(self) -> int:
        """B's clock minus A's where the cable has made them one: 0, and what they have drifted since."""
        known = self._one_clock and len(self._synced) >= _SYNCED_ENOUGH
        return median_low(self._synced) if known else 0

    def _offset_ns(self) -> int | None:
        """B's clock minus A's, as the cable says, or the pairs on it; while they are few, as arrivals say."""
        if self._one_clock:
            return self._one_clock_ns()
        a, b = self._a.clock.offset_ns, self._b.clock.offset_ns
        by_arrival = None if a is None or b is None else a - b
        if by_arrival is None or len(self._synced) < _SYNCED_ENOUGH:
            return by_arrival
        by_capture = median_low(self._synced)
        if abs(by_capture - by_arrival) <= self.interval_ns:
            return by_capture
        # A frame or more apart from what arrivals say: the pairs it came from were wrong.
        self._synced.clear()
        return by_arrival

    def _pair(self, skew_ns: int) -> list[FramePair]:
        """The oldest frames as a pair."""
        (a,), (b,) = self._a.use(1), self._b.use(1)
        if self.sync_delay_ns is not None:
            self._synced.append(b.frame.time_ns - self.sync_delay_ns - a.frame.time_ns)
        self._skew_ns = skew_ns + self._b.delay_ns
        return self._given(a, b, self._skew_ns)

    def _alone(
        self, stream: IncomingStream, frames: list[Arrived], unmatched: bool = True
    ) -> list[FramePair]:
        """Frames without a partner; ``unmatched`` where the other sensor is there all the same."""
        if stream is self._a:
            return [pair for taken in frames for pair in self._given(taken, None)]
        if unmatched and not self.every_frame:
            self._counts["unmatched_b"] += len(frames)
            return []
        return [pair for taken in frames for pair in self._given(None, taken)]

    def _given(self, a: Arrived | None, b: Arrived | None, skew_ns: int = 0) -> list[FramePair]:
        """The pair without a person, later than the last one; none where its time has passed."""
        if a is not None:
            time_ns = self._time.of_sensor(a.frame.time_ns, a.moment_ns)
        elif b is not None and self._one_clock:
            on_a_ns = b.frame.time_ns - self._one_clock_ns()
            time_ns = self._time.of_sensor(on_a_ns, b.moment_ns + self._b.delay_ns)
        elif b is not None:
            time_ns = self._time.of_host(b.moment_ns + self._b.delay_ns, b.frame.time_ns)
        apart_ns = self.interval_ns
        for k, taken in enumerate((a, b)):
            if taken is not None:
                step_ns = taken.frame.time_ns - self._given_ns[k]
                if step_ns > 0:  # it may be faster than it says
                    apart_ns = min(apart_ns, step_ns)
                self._given_ns[k] = taken.frame.time_ns
        given_ns = self._time.forward(time_ns, apart_ns // 2, lone=not (a and b))
        if given_ns is None:
            self._counts["late"] += (a is not None) + (b is not None)
            return []
        self._counts["pairs" if a and b else "alone_a" if a else "alone_b"] += 1
        pair = SkeletonPair(None, None, given_ns, skew_ns if a else time_ns - given_ns)
        return [FramePair(a and a.frame, b and b.frame, pair)]

    def _has_waited(self, stream: IncomingStream, other: IncomingStream, now_ns: int) -> bool:
        """Whether the partner of a stream's oldest frame would have come by now.

        =============================== ============================================================
        the other sensor                a frame waits, after its arrival, until
        =============================== ============================================================
        has run for less than a second  its moment, the other's slowest lag so far, and an interval
        has no frame near its moment    it does not wait
        has one                         that frame's moment, the slowest lag of ten seconds, and 5 ms
        =============================== ============================================================

        It never waits longer than the longest lag and an interval. What delays both, as a pause of this
        machine does, delays the partner too, so the patience begins with the arrival at the earliest.
        """
        at_ns, due_ns, _ = stream.waiting[0]
        patience_ns, half_ns = self.interval_ns, self.interval_ns // 2
        next_ns = other.next_near(due_ns, half_ns, now_ns)
        if next_ns is not None:
            if next_ns > due_ns + half_ns + PATIENCE_NS:
                return True
            due_ns, patience_ns = max(due_ns, next_ns), PATIENCE_NS
        slowest_ns = max((at - moment for at, moment, _ in other.recent), default=self.max_lag_ns)
        until_ns = max(due_ns + slowest_ns, at_ns) + patience_ns
        longest_ns = at_ns + self.max_lag_ns + self.interval_ns
        return now_ns >= min(until_ns, longest_ns)

    def _is_gone(self, stream: IncomingStream, now_ns: int) -> bool:
        silent_ns = 0 if stream.came_ns is None else now_ns - stream.came_ns
        return stream.gone or silent_ns > self._gone_after_ns
