"""Two live streams → pairs of frames captured at the same time.

The sensors' clocks start anywhere and drift apart, so a moment of B is found on A's clock through this
machine's: both sensors' frames arrive on it. With a sync cable the sensors capture at the same moments, a
fixed delay apart, and the pairs found so far tell the offset to the microsecond.

Pairs carry A's time, which stays monotonic and continuous when A's clock is reset. The person has not been
selected yet: see :mod:`devices.people`.

Pure: time is passed in, nothing waits.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace
from itertools import islice, pairwise
from statistics import median_low
from typing import Literal

from devices.capture.host_clock import HostClock, Timing
from devices.capture.sensor_state import Arrival
from devices.pairing import FramePair
from devices.sensor import SensorFrame
from fusion.skeleton import SkeletonPair

Side = Literal["a", "b"]
_PENDING = 8
_LAGS, _LATEST = 300, 31  # frames: ten seconds, and one
_SYNCED_PAIRS = 61
_SYNCED_ENOUGH = 15
PATIENCE_NS = 5_000_000
"""A frame waits this much longer than the partner's slowest frame of the last ten seconds took."""


@dataclass(frozen=True)
class PairingFigures:
    """How pairing goes, counted since the start."""

    pairs: int = 0  # frames of both sensors
    alone_a: int = 0  # frames given without a partner
    alone_b: int = 0
    unmatched_b: int = 0  # frames of B without a partner that were left out
    late: int = 0  # frames left out because their time had passed
    repeated: int = 0  # frames left out because they had come before
    reordered: int = 0  # frames that came after a later one, and were put in their place
    resets: int = 0  # how often a sensor's clock started anew
    skew_ns: int | None = None  # of the newest pair
    offset_ns: int | None = None
    """B's clock minus A's at the same moment, without the sync delay; None before both came."""
    drift_ppm: float = 0.0  # by how many millionths B's clock runs faster than A's
    dropped: tuple[int, int] = (0, 0)
    """Frames of A and of B dropped before pairing because the program was too slow."""

    @property
    def unpaired(self) -> tuple[int, int]:
        """Frames of A and of B without a partner."""
        return self.alone_a, self.alone_b + self.unmatched_b


@dataclass(eq=False)
class _Stream:
    """One sensor's frames that wait for a partner, in capture order."""

    clock: HostClock = field(default_factory=HostClock)
    waiting: list[Arrival] = field(default_factory=list)
    recent: deque[int] = field(default_factory=lambda: deque(maxlen=2 * _PENDING))
    lags: deque[int] = field(default_factory=lambda: deque(maxlen=_LAGS))  # from capture to arrival here, ns
    most_lag_ns: int | None = None
    used_ns: int | None = None
    came_ns: int | None = None
    gone: bool = False

    def next_after(self, host_ns: int) -> int:
        """When the first frame from this time on is expected to be captured, by its rate so far."""
        times = sorted(self.recent)
        interval_ns = max(median_low(later - earlier for earlier, later in pairwise(times)), 1)
        last_ns = times[-1] + (self.clock.offset_ns or 0)
        return last_ns + max(-((last_ns - host_ns) // interval_ns), 1) * interval_ns


class LivePairing:
    """Pairs two sensors' frames by capture time; goes on with one while the other is gone.

    Every frame comes out, with its partner or alone.

    Attributes:
        every_frame: Whether frames of B that merely find no partner come out, too. Else they are left out,
            because the paper's methods fuse pairs: a slower A would make their S* change between one and two
            views.
    """

    def __init__(
        self,
        interval_ns: int = 33_333_333,
        *,
        max_lag_ns: int = 250_000_000,
        gone_after_ns: int = 500_000_000,
        sync_delay_ns: int | None = None,
    ) -> None:
        """Starts without a frame.

        Args:
            interval_ns: Time between two frames of the faster sensor. Half of it is the tolerance.
            max_lag_ns: The longest time from capture to arrival that is waited for; an interval at least. A
                frame waits for the frame of the other sensor that is expected next to it, as long as its
                slowest of the last ten seconds took and :data:`PATIENCE_NS` more; an interval more in the
                first second.
            gone_after_ns: After how long without a frame a sensor is gone, and not waited for; four
                intervals at least.
            sync_delay_ns: With a sync cable, how much later B captures than A (negative: earlier); None
                without one.
        """
        self._least_lag_ns, self._least_gone_ns = max_lag_ns, gone_after_ns
        self.set_interval(interval_ns)
        self.sync_delay_ns, self.every_frame = sync_delay_ns, True
        self._a, self._b = _Stream(), _Stream()
        self._synced: deque[int] = deque(maxlen=_SYNCED_PAIRS)
        self._figures = PairingFigures()
        self._time_from_a: int | None = None
        self._time_from_host: int | None = None
        self._last_ns: int | None = None
        self._first_ns: int | None = None

    @property
    def figures(self) -> PairingFigures:
        """How it goes so far."""
        drift = self._b.clock.drift_ppm - self._a.clock.drift_ppm
        return replace(self._figures, offset_ns=self._offset_ns(), drift_ppm=drift)

    @property
    def lag_ns(self) -> int:
        """How much later after their capture B's frames come than A's: median of one second, ns."""
        if min(len(self._a.lags), len(self._b.lags)) < _PENDING:
            return 0
        a, b = (median_low(islice(reversed(stream.lags), _LATEST)) for stream in (self._a, self._b))
        return b - a

    def set_interval(self, interval_ns: int) -> None:
        """Changes the time between two frames of the faster sensor, and the patience that follows from it."""
        self._interval_ns, self._tolerance_ns = interval_ns, interval_ns // 2
        self.max_lag_ns = max(self._least_lag_ns, interval_ns)  # a tracker may take nearly an interval
        self._gone_after_ns = max(self._least_gone_ns, 4 * interval_ns)

    def add(self, side: Side, frame: SensorFrame, now_ns: int) -> list[FramePair]:
        """Takes a frame and gives the pairs that are complete now, in order. ``now_ns`` is on the clock of
        ``host_ns``, which relates the clocks of both sensors.
        """
        self._first_ns = now_ns if self._first_ns is None else self._first_ns
        stream = self._a if side == "a" else self._b
        stream.came_ns, stream.gone = now_ns, False
        if frame.time_ns in stream.recent:
            self._count(repeated=1)
            return self.poll(now_ns)
        timing = stream.clock.observe(frame.time_ns, now_ns if frame.host_ns is None else frame.host_ns)
        pairs: list[FramePair] = []
        if timing is Timing.RESET:
            self._count(resets=1)
            pairs = self._let_out(side)
        elif timing is Timing.LATE or (stream.used_ns is not None and frame.time_ns <= stream.used_ns):
            self._count(late=1)
            return self.poll(now_ns)
        stream.lags.append(now_ns - frame.time_ns - (stream.clock.offset_ns or 0))
        stream.most_lag_ns = max(stream.lags)
        if side == "a":
            self._anchor()
        if stream.recent and frame.time_ns < max(stream.recent):
            self._count(reordered=1)
        stream.recent.append(frame.time_ns)
        stream.waiting.append(Arrival(now_ns, frame))
        stream.waiting.sort(key=lambda arrival: arrival.frame.time_ns)
        return pairs + self.poll(now_ns)

    def poll(self, now_ns: int) -> list[FramePair]:
        """The pairs that need wait no longer at ``now_ns``, in order. Call it when no frame comes, too."""
        pairs: list[FramePair] = []
        while (step := self._step(now_ns)) is not None:
            pairs += step
        return pairs

    def set_gone(self, side: Side, gone: bool) -> None:
        """Marks a sensor as lost, so that no frame waits for it; its next frame ends this state."""
        (self._a if side == "a" else self._b).gone = gone

    def restart(self, side: Side) -> list[FramePair]:
        """Reports that a sensor was reopened, so that its clock may have restarted; returns what waited."""
        (self._a if side == "a" else self._b).clock.restart()
        return self._let_out(side)

    def _step(self, now_ns: int) -> list[FramePair] | None:
        """Decides on the oldest frames: returns the resulting pairs, or None if it must wait."""
        a, b = self._a.waiting, self._b.waiting
        if a and b:
            skews = [self._skew_ns(a[0].frame, other.frame) for other in b]
            nearest = min(range(len(b)), key=lambda index: abs(skews[index]))
            paired = abs(skews[nearest]) <= self._tolerance_ns
            earlier = nearest if paired else sum(skew < 0 for skew in skews)
            if earlier:  # too early for this frame of A, and so for every later one
                return self._unmatched_b(earlier)
            return [self._pair(b[0].frame, skews[0]) if paired else self._alone_a()]
        if a and (self._is_gone(self._b, now_ns) or self._waited(self._a, self._b, now_ns)):
            return [self._alone_a()]
        if b and self._is_gone(self._a, now_ns):
            return [self._alone_b()]
        if b and self._waited(self._b, self._a, now_ns):
            return self._unmatched_b(1)
        return None

    def _unmatched_b(self, count: int) -> list[FramePair]:
        """B's first frames, without a partner."""
        if self.every_frame:
            return [self._alone_b() for _ in range(count)]
        self._count(unmatched_b=count)
        self._use(self._b, count)
        return []

    def _skew_ns(self, a: SensorFrame, b: SensorFrame) -> int:
        """How far B's frame is from where A's partner should be, by A's clock."""
        return b.time_ns - (self._offset_ns() or 0) - (self.sync_delay_ns or 0) - a.time_ns

    def _offset_ns(self) -> int | None:
        a, b = self._a.clock.offset_ns, self._b.clock.offset_ns
        if a is None or b is None:
            return None
        by_arrival = a - b
        if len(self._synced) >= _SYNCED_ENOUGH:
            by_capture = median_low(self._synced)
            if abs(by_capture - by_arrival) <= self._interval_ns:
                return by_capture
            # A frame or more apart from what arrivals say: the pairs it came from were wrong.
            self._synced.clear()
        return by_arrival

    def _pair(self, b: SensorFrame, skew_ns: int) -> FramePair:
        a = self._a.waiting[0].frame
        if self.sync_delay_ns is not None:
            self._synced.append(b.time_ns - a.time_ns - self.sync_delay_ns)
        skew_ns += self.sync_delay_ns or 0
        self._use(self._a, 1)
        self._use(self._b, 1)
        self._count(pairs=1)
        self._figures = replace(self._figures, skew_ns=skew_ns)
        return self._given(a, b, a.time_ns + (self._time_from_a or 0), skew_ns)

    def _alone_a(self) -> FramePair:
        frame = self._a.waiting[0].frame
        self._use(self._a, 1)
        self._count(alone_a=1)
        return self._given(frame, None, frame.time_ns + (self._time_from_a or 0))

    def _alone_b(self) -> FramePair:
        frame = self._b.waiting[0].frame
        self._use(self._b, 1)
        self._count(alone_b=1)
        on_host = frame.time_ns + (self._b.clock.offset_ns or 0)
        if self._time_from_host is None:
            self._time_from_host = frame.time_ns - on_host
        return self._given(None, frame, on_host + self._time_from_host)

    def _given(
        self, a: SensorFrame | None, b: SensorFrame | None, time_ns: int, skew_ns: int = 0
    ) -> FramePair:
        """The pair without a person; its time never goes back."""
        self._last_ns = time_ns if self._last_ns is None else max(time_ns, self._last_ns + 1)
        if a is None:  # captured earlier than the last pair, if it came late
            skew_ns = time_ns - self._last_ns
        return FramePair(a, b, SkeletonPair(None, None, self._last_ns, skew_ns))

    def _anchor(self) -> None:
        """Keeps the output's time on A's clock: the clock itself, moved where it was reset."""
        offset_ns = self._a.clock.offset_ns or 0
        if self._time_from_a is None:
            moved = 0 if self._time_from_host is None else offset_ns + self._time_from_host
            self._time_from_a = moved
        self._time_from_host = self._time_from_a - offset_ns

    def _let_out(self, side: Side) -> list[FramePair]:
        """Handles a clock reset: emits the waiting frames and forgets all estimates from the old clock."""
        pairs = []
        while self._a.waiting:
            pairs.append(self._alone_a())
        while self._b.waiting:
            pairs += self._unmatched_b(1)
        self._synced.clear()
        stream = self._a if side == "a" else self._b
        stream.recent.clear()
        stream.lags.clear()
        stream.used_ns = stream.most_lag_ns = None
        if side == "a":
            self._time_from_a = None
        return pairs

    def _use(self, stream: _Stream, count: int) -> None:
        stream.used_ns = stream.waiting[count - 1].frame.time_ns
        del stream.waiting[:count]

    def _waited(self, stream: _Stream, other: _Stream, now_ns: int) -> bool:
        """Whether the partner of a stream's oldest frame would have come by now."""
        at_ns, frame = stream.waiting[0]
        lag_ns = self.max_lag_ns if other.most_lag_ns is None else min(other.most_lag_ns, self.max_lag_ns)
        captured_ns, patience_ns = frame.time_ns + (stream.clock.offset_ns or 0), self._interval_ns
        if len(other.lags) >= _LATEST:
            delay_ns = self.sync_delay_ns or 0
            expected_ns = captured_ns + (delay_ns if stream is self._a else -delay_ns)
            next_ns = other.next_after(expected_ns - self._tolerance_ns)
            if next_ns > expected_ns + self._tolerance_ns + PATIENCE_NS:
                return True
            captured_ns, patience_ns = max(captured_ns, next_ns), PATIENCE_NS
        # What delays both, as a pause of this machine does, delays the partner too.
        overdue_ns = now_ns - max(captured_ns + lag_ns, at_ns)
        return overdue_ns >= patience_ns or len(stream.waiting) > _PENDING

    def _is_gone(self, stream: _Stream, now_ns: int) -> bool:
        since = stream.came_ns if stream.came_ns is not None else self._first_ns
        return stream.gone or (since is not None and now_ns - since > self._gone_after_ns)

    def _count(self, **more: int) -> None:
        now = {name: getattr(self._figures, name) + by for name, by in more.items()}
        self._figures = replace(self._figures, **now)
