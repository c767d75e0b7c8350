"""Selects the moments for the body trackers if a tracker is slower than the cameras.

Without it each sensor keeps the frame that arrives when its own tracker is free. The two sensors then keep
different moments, and few pairs form. Here both count moments on a common grid and keep every n-th.
"""

import threading
import time
from collections import deque
from collections.abc import Callable, Hashable, Iterator
from typing import TypeVar

from devices.capture.clock.moment_grid import MomentGrid
from devices.capture.step_choice import StepChoice

Item = TypeVar("Item")


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


class Newest(Iterator[Item]):
    """The newest item each time, of an iterator that runs on a thread of its own, whatever the reader does.

    What the iterator raises is raised after the item before it.

    Args:
        name: Of the thread.
        drop: Called for each item that the reader did not get, because a newer one came.
        interrupt: Makes ``items`` end soon.
    """

    def __init__(
        self, items: Iterator[Item], name: str, *, drop: Callable[[], object], interrupt: Callable[[], object]
    ) -> None:
        self._items, self._drop, self._interrupt = items, drop, interrupt
        self._waiting: deque[Item] = deque(maxlen=1)
        self._ended, self._came = False, threading.Condition()
        self._fault: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)  # a driver may hang
        self._thread.start()

    def __next__(self) -> Item:
        with self._came:
            self._came.wait_for(lambda: self._waiting or self._ended)
            if self._waiting:
                return self._waiting.pop()
        self.close()
        fault, self._fault = self._fault, None
        if fault is not None:
            raise fault
        raise StopIteration

    def close(self) -> None:
        """Ends the thread. What gives the items may be closed afterwards, not before."""
        if not self._ended:
            self._interrupt()
        self._thread.join()

    def _run(self) -> None:
        try:
            for item in self._items:
                with self._came:
                    if self._waiting:
                        self._drop()
                    self._waiting.append(item)
                    self._came.notify()
        except BaseException as raised:
            self._fault = raised
        with self._came:
            self._ended = True
            self._came.notify()
