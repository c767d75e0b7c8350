"""The queue of frames in the body tracker."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Callable, Generator, Iterator
from dataclasses import replace

from devices.azure.tracking.body_tracker import BodyTracker
from devices.sensor import SensorFrame

_AT_WORK = 2  # frames in the tracker: it runs the network on one while it fits the skeletons of the other


class TrackerQueue:
    """Joins each frame with the people that the tracker finds in it.

    The tracker works on its own threads. If it needs longer than ``wait_s``, frames come out one or two
    captures later; otherwise at once.
    """

    def __init__(
        self,
        tracker: BodyTracker,
        wait_s: float,
        took: Callable[[int], object] = lambda _: None,
        clock: Callable[[], int] = time.perf_counter_ns,
    ) -> None:
        """Joins one sensor's frames with an open tracker's results.

        Args:
            tracker: Open; nothing enqueued but what goes through here.
            wait_s: How long to wait for the newest frame's people before going on to the next frame.
            took: Told how long the tracker worked on each frame, in ns: since the frame went in, or since
                the result before it where that came later.
            clock: Nanoseconds; tests put their own.
        """
        self._tracker = tracker
        self._wait_s = wait_s
        self._took, self._clock = took, clock
        self._inside: OrderedDict[int, tuple[SensorFrame, int]] = OrderedDict()  # with the time of entry
        self._result_ns: int | None = None
        self._waited_s = 0.0  # for the oldest frame, in waits that ended without a result

    @property
    def empty(self) -> bool:
        """Whether the tracker has nothing to work on."""
        return not self._inside

    @property
    def full(self) -> bool:
        """Whether another frame would only add latency in the tracker."""
        return len(self._inside) >= _AT_WORK

    def put(self, frame: SensorFrame, capture: int) -> None:
        """Gives the tracker a frame's capture (a ``k4a_capture_t``).

        Raises:
            DeviceError: The tracker refuses it or stalls.
        """
        self._tracker.enqueue(capture)
        # The tracker knows times in whole microseconds.
        self._inside[frame.time_ns // 1000] = frame, self._clock()

    def done(self) -> Iterator[SensorFrame]:
        """The frames whose people are found; waits for one only while more than two are at work.

        Raises:
            DeviceError: The tracker failed or stalls.
        """
        while self._inside:
            overdue = self._waited_s >= self._tracker.patience_s
            yielded = yield from self._take(None if len(self._inside) > _AT_WORK or overdue else self._wait_s)
            if not yielded:
                return

    def flush(self) -> Iterator[SensorFrame]:
        """The rest of the frames, waiting for each.

        Raises:
            DeviceError: The tracker failed or stalls.
        """
        while self._inside:
            yield from self._take(None)

    def _take(self, wait_s: float | None) -> Generator[SensorFrame, None, bool]:
        bodies = self._tracker.pop(wait_s)
        if bodies is None:
            self._waited_s += self._wait_s
            return False
        self._waited_s = 0.0
        time_us = bodies.time_ns // 1000
        if time_us not in self._inside:
            return True  # a result from before a restart
        while self._inside:
            at_us, (frame, went_in_ns) = self._inside.popitem(last=False)
            if at_us == time_us:
                now_ns = self._clock()
                begun_ns = went_in_ns if self._result_ns is None else max(went_in_ns, self._result_ns)
                self._result_ns = now_ns
                self._took(now_ns - begun_ns)
                yield replace(frame, people=bodies.people)
                return True
            yield frame  # the tracker skipped this frame: its people are unknown
        return True
