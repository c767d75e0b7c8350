"""Frame decimation: selects the moments for the body trackers if a tracker is slower than the cameras.

Without it each sensor keeps the frame that arrives when its own tracker is free. The two sensors then keep
different moments, and few pairs form. Here both count moments on a common grid and keep every n-th.
"""

import threading
import time
from collections.abc import Callable, Hashable

from devices.capture.clock.moment_grid import MomentGrid
from devices.capture.step_choice import StepChoice


class FrameDecimation:
    """Keeps the same moments of the two sensors that share it. Safe to use from several threads.

    A sensor is told from the other by its :attr:`~devices.sensor.Sensor.key`.

    Attributes:
        period_ns: Time between two frames of the cameras.
        choice: How many moments are kept.
        advice: What to do about a tracker that is too slow.
    """

    advice = (
        "It is the tracker, not USB or light: a faster GPU, or record now and track later "
        "(duplex fuse a.mkv b.mkv)."
    )

    def __init__(self, fps: float, clock: Callable[[], int] = time.perf_counter_ns) -> None:
        self.period_ns = round(1e9 / fps)
        self.choice = StepChoice(self.period_ns)
        self._grid = MomentGrid(self.period_ns)
        self._clock, self._lock = clock, threading.Lock()

    @property
    def step(self) -> int:
        """Every which moment is kept; 1 keeps all."""
        return self.choice.step

    @property
    def interval_ns(self) -> int:
        """Time between two kept moments."""
        return self.step * self.period_ns

    def take_news(self) -> list[str]:
        """What changed besides the frames that are kept, one line each; once."""
        return []

    def restart(self, sensor: Hashable) -> None:
        """Forgets a sensor that was reopened, because its clock and its tracker restart."""
        with self._lock:
            self._grid.restart(sensor)
            self.choice.restart(sensor)

    def moment(self, sensor: Hashable, time_ns: int, host_ns: int) -> int:
        """As :meth:`~devices.capture.clock.moment_grid.MomentGrid.number`."""
        with self._lock:
            return self._grid.number(sensor, time_ns, host_ns)

    def keeps(self, moment: int) -> bool:
        """Whether this moment's frames go to the trackers."""
        return moment % self.step == 0

    def kept_before(self, moment: int, count: int) -> int:
        """How many of the ``count`` moments before one are kept."""
        return (moment - 1) // self.step - (moment - count - 1) // self.step

    def tracked(self, sensor: Hashable, took_ns: int) -> None:
        """Records how long a sensor's tracker worked on one frame."""
        with self._lock:
            now_ns = self._clock()
            self.choice.tracked(sensor, took_ns, now_ns)
            self._chosen(now_ns)

    def _chosen(self, now_ns: int) -> None:
        """What else follows from a choice; called with the lock."""
