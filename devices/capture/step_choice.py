"""Step choice: how many moments slow body trackers keep up with."""

import math
from collections import deque
from collections.abc import Hashable
from dataclasses import dataclass, field
from statistics import fmean, median

_FIRST_RESULTS = 2  # not counted: a tracker loads and compiles its network then
_ENOUGH, _RECENT = 5, 15  # results
_USED_TO_SLOW = 0.95  # of the time between two kept moments: a tracker busier than this falls behind
_USED_TO_SPEED = 0.8
_HOLD_NS, _LONGEST_HOLD_NS = 5_000_000_000, 80_000_000_000
_SILENT_NS = 2_000_000_000
_NEVER = -math.inf


@dataclass(eq=False)
class _Tracker:
    """How long a sensor's tracker took for its newest results."""

    results: int = 0
    last_ns: int = 0
    took_ns: deque[int] = field(default_factory=lambda: deque(maxlen=_RECENT))


class StepChoice:
    """How many moments the trackers keep up with: every one, or every second, third …

    The slowest tracker decides. More are left out as soon as it falls behind; fewer, only after it was fast
    enough for five seconds. If the tracker falls behind again within that waiting time, the attempt is taken
    back, and the next one waits twice as long, at most 80 s: a tracker may be fast only while it has fewer
    frames, because the two share a GPU. A tracker that gives nothing for two seconds and twice its newest
    time does not count from the next result on.

    Attributes:
        step: Every which moment is kept; 1 keeps all.
        slowest: The sensor whose tracker decided the step last; None before.
        slowest_s: Seconds per frame that this tracker took then.
        taken_back: Whether more frames were tried and were too many.
        easy_ns: Since when a smaller step would do; None if it would not, and after a choice until five
            new times tell.
    """

    def __init__(self, period_ns: int) -> None:
        self.step, self.taken_back = 1, False
        self.slowest: Hashable | None = None
        self.slowest_s = 0.0
        self.easy_ns: int | None = None
        self._period_ns, self._hold_ns, self._sped_up_ns = period_ns, _HOLD_NS, _NEVER
        self._trackers: dict[Hashable, _Tracker] = {}

    def restart(self, sensor: Hashable) -> None:
        """Forgets a sensor's tracker, because it restarts."""
        self._trackers[sensor], self._sped_up_ns = _Tracker(), _NEVER

    def learn_anew(self, hold_ns: int = 0) -> None:
        """Forgets all times. Fewer moments are left out once trackers were fast enough for ``hold_ns``."""
        self.easy_ns, self._hold_ns = None, hold_ns
        for tracker in self._trackers.values():
            tracker.took_ns.clear()

    def tracked(self, sensor: Hashable, took_ns: int, now_ns: int) -> None:
        """Records how long a sensor's tracker worked on one frame, and chooses the step."""
        mine = self._trackers.setdefault(sensor, _Tracker())
        mine.results, mine.last_ns = mine.results + 1, now_ns
        if mine.results <= _FIRST_RESULTS:
            return
        mine.took_ns.append(took_ns)
        for other in self._trackers.values():
            if other.took_ns and now_ns - other.last_ns > _SILENT_NS + 2 * other.took_ns[-1]:
                other.took_ns.clear()
        times = {key: each.took_ns for key, each in self._trackers.items() if len(each.took_ns) >= _ENOUGH}
        if times:
            self._choose(times, now_ns)

    def _choose(self, times: dict[Hashable, deque[int]], now_ns: int) -> None:
        slowest = max(times, key=lambda key: median(times[key]))
        slowest_ns = median(times[slowest])
        needed = math.ceil(slowest_ns / (_USED_TO_SLOW * self._period_ns))
        # The mean: two trackers on one GPU wait for each other in turn, which the median may not show.
        busiest_ns = max(map(fmean, times.values()))
        easy = max(1, math.ceil(busiest_ns / (_USED_TO_SPEED * self._period_ns)))
        self.easy_ns = (self.easy_ns or now_ns) if easy < self.step else None
        if needed > self.step:
            self.taken_back = now_ns - self._sped_up_ns < self._hold_ns
            hold_ns = min(2 * self._hold_ns, _LONGEST_HOLD_NS) if self.taken_back else _HOLD_NS
            self.step, self._sped_up_ns = needed, _NEVER
        elif self.easy_ns is not None and now_ns - self.easy_ns > self._hold_ns:
            self.step, self._sped_up_ns, hold_ns = easy, now_ns, self._hold_ns
        else:
            return
        self.slowest, self.slowest_s = slowest, slowest_ns * 1e-9
        self.learn_anew(hold_ns)
