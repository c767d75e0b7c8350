"""Frame decimation: selects the moments for the body trackers if a tracker is slower than the cameras.

Without it each sensor keeps the frame that arrives when its own tracker is free. The two sensors then keep
different moments, and few pairs form. Here both count moments on a common grid and keep every n-th.
"""

import math
import threading
from collections import deque
from dataclasses import dataclass, field
from statistics import fmean, median

from devices.capture.host_clock import HostClock, Timing

_FIRST_RESULTS = 2  # not counted: a tracker loads and compiles its network then
_ENOUGH, _RECENT = 5, 15  # results
_USED_TO_SLOW = 0.95  # of the time between two kept moments: a tracker busier than this falls behind
_USED_TO_SPEED = 0.8
_HOLD_NS, _LONGEST_HOLD_NS = 5_000_000_000, 80_000_000_000
_REGRID = 0.6  # of a period: beyond half of one, so that a sensor midway between the other's does not swing
_SAME_STREAM_NS = 1_000_000_000


@dataclass(eq=False)
class _Sensor:
    """What is known of one sensor: its place on the grid of moments, and its tracker's times."""

    clock: HostClock = field(default_factory=HostClock)
    time_ns: int | None = None
    moment: int = 0
    results: int = 0
    tracking_ns: deque[int] = field(default_factory=lambda: deque(maxlen=_RECENT))


class FrameDecimation:
    """Keeps the same moments of all sensors that share it: every one, or every second, third …

    How many are left out follows from the slowest tracker. More are left out as soon as it falls behind;
    fewer, only after it was fast enough for five seconds. Each time that such a step has to be taken back in
    less time than was waited for it, the next one waits twice as long: a tracker may be fast only while it
    has fewer frames, because the two share a GPU. Safe to use from several threads.

    Attributes:
        period_ns: Time between two frames of the cameras.
        step: Every which moment is kept; 1 keeps all.
        slowest: The sensor whose tracker decided the step last; empty before.
        slowest_s: Seconds per frame that this tracker took then.
        taken_back: Whether more frames were tried and were too many.
    """

    def __init__(self, fps: float) -> None:
        self.period_ns = round(1e9 / fps)
        self.step = 1
        self.slowest, self.slowest_s = "", 0.0
        self.taken_back = self._sped_up = False
        self._hold_ns, self._unchanged_ns, self._easy_ns = _HOLD_NS, 0, 0
        self._sensors: dict[str, _Sensor] = {}
        self._lock = threading.Lock()

    @property
    def interval_ns(self) -> int:
        """Time between two kept moments."""
        return self.step * self.period_ns

    @property
    def advice(self) -> str:
        """What to do about a tracker that is too slow."""
        return (
            "It is the tracker, not USB or light: a faster GPU, or record now and track later "
            "(duplex fuse a.mkv b.mkv)."
        )

    def take_news(self) -> list[str]:
        """What changed besides the frames that are kept, one line each; once."""
        return []

    def restart(self, sensor: str) -> None:
        """Forgets a sensor that was reopened, because its clock and its tracker restart."""
        with self._lock:
            self._sensors[sensor] = _Sensor()

    def moment(self, sensor: str, time_ns: int, host_ns: int) -> int:
        """The number of the moment at which a sensor captured, counted on a grid that all sensors share.

        Moments are counted on by the sensor's own clock. Where a sensor's grid begins, and whether the
        second sensor's still fits the first's, is told by this machine's clock.

        Args:
            time_ns: Capture time on the sensor's clock.
            host_ns: When the images reached this machine.
        """
        with self._lock:
            mine = self._sensors.setdefault(sensor, _Sensor())
            timing = mine.clock.observe(time_ns, host_ns)
            gap_ns = None if mine.time_ns is None else time_ns - mine.time_ns
            follows = gap_ns is not None and 0 <= gap_ns < _SAME_STREAM_NS and timing is not Timing.RESET
            if follows and gap_ns is not None:
                mine.moment += round(gap_ns / self.period_ns)
            mine.time_ns = time_ns
            first, *_ = self._sensors.values()
            for other in self._sensors.values():
                if other is mine or other.time_ns is None or (follows and mine is first):
                    continue
                off = self._ahead(mine, other) - (mine.moment - other.moment)
                if not follows or abs(off) > _REGRID:
                    mine.moment += round(off)
                break
            return mine.moment

    def keeps(self, moment: int) -> bool:
        """Whether this moment's frames go to the trackers."""
        return moment % self.step == 0

    def kept_before(self, moment: int, count: int) -> int:
        """How many of the ``count`` moments before one are kept."""
        return (moment - 1) // self.step - (moment - count - 1) // self.step

    def tracked(self, sensor: str, time_ns: int) -> None:
        """Records how long a sensor's tracker worked on one frame."""
        with self._lock:
            mine = self._sensors.setdefault(sensor, _Sensor())
            mine.results += 1
            if mine.results > _FIRST_RESULTS:
                mine.tracking_ns.append(time_ns)
                self._choose_step()

    def _ahead(self, mine: _Sensor, other: _Sensor) -> float:
        """How many periods later one sensor captured last than the other, by this machine's clock."""
        mine_ns = (mine.time_ns or 0) + (mine.clock.offset_ns or 0)
        return (mine_ns - (other.time_ns or 0) - (other.clock.offset_ns or 0)) / self.period_ns

    def _choose_step(self) -> None:
        times = {name: sensor.tracking_ns for name, sensor in self._sensors.items() if sensor.tracking_ns}
        enough = [name for name, recent in times.items() if len(recent) >= _ENOUGH]
        if not enough:
            return
        shared_ns = self.interval_ns // len(times)  # the other sensors' results pass the rest of the time
        self._unchanged_ns += shared_ns
        slowest = max(enough, key=lambda name: median(times[name]))
        needed = math.ceil(median(times[slowest]) / (_USED_TO_SLOW * self.period_ns))
        if needed > self.step:
            self.taken_back = self._sped_up and self._unchanged_ns < self._hold_ns
            longer_ns = min(2 * self._hold_ns, _LONGEST_HOLD_NS) if self.taken_back else 0
            self._hold_ns = max(_HOLD_NS, longer_ns)
            self._change_step(needed, slowest)
            return
        # The mean, because of two trackers on one GPU each waits for the other in turn.
        busiest_ns = max(fmean(times[name]) for name in enough)
        needed = max(1, math.ceil(busiest_ns / (_USED_TO_SPEED * self.period_ns)))
        self._easy_ns = self._easy_ns + shared_ns if needed < self.step else 0
        if self._easy_ns > self._hold_ns:
            self._change_step(needed, slowest)

    def _change_step(self, step: int, slowest: str) -> None:
        self._sped_up, self.step, self.slowest = step < self.step, step, slowest
        self.slowest_s = median(self._sensors[slowest].tracking_ns) * 1e-9
        self._forget_times()

    def _forget_times(self) -> None:
        self._unchanged_ns = self._easy_ns = 0
        for sensor in self._sensors.values():
            sensor.tracking_ns.clear()
