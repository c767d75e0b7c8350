"""The queue of frames that the body tracker is processing."""

import time
from collections import OrderedDict
from collections.abc import Callable, Generator, Iterator
from dataclasses import replace

from devices.azure.tracking.body_tracker import BodyTracker
from devices.sensor import SensorFrame

_AT_WORK = 2  # frames in the tracker: the network runs on one while skeletons are fitted to the other


class TrackerQueue:
    """Joins each frame with the people that the tracker finds in it.

    The tracker works on its own threads. If it needs longer than ``wait_s``, a frame is yielded one or two
    captures later. All methods raise a DeviceError if the tracker has failed or stalls.
    """

    def __init__(
        self,
        tracker: BodyTracker,
        wait_s: float,
        took: Callable[[int], object] = lambda _: None,
        clock: Callable[[], int] = time.perf_counter_ns,
    ) -> None:
        """Makes an empty queue for the frames of one sensor.

        Args:
            took: Called with the tracker's processing time of each frame, ns. It is counted from the frame's
                entry or from the previous result, whichever is later.
        """
        self._tracker = tracker
        self._wait_s = wait_s
        self._took, self._clock = took, clock
        self._inside: OrderedDict[int, tuple[SensorFrame, int]] = OrderedDict()  # frame and time of entry, ns
        self._result_ns: int | None = None
        self._waited_s = 0.0  # total wait for the oldest frame without a result

    @property
    def empty(self) -> bool:
        """Whether the tracker has no frames to process."""
        return not self._inside

    @property
    def full(self) -> bool:
        """Whether another frame would only add latency in the tracker."""
        return len(self._inside) >= _AT_WORK

    def put(self, frame: SensorFrame, capture: int) -> None:
        """Passes the capture of a frame (a ``k4a_capture_t``) to the tracker."""
        self._tracker.enqueue(capture)
        # The tracker stores times in whole microseconds.
        self._inside[frame.time_ns // 1000] = frame, self._clock()

    def done(self) -> Iterator[SensorFrame]:
        """Yields the frames whose people are known.

        It waits longer than ``wait_s`` only while the tracker holds more than two frames.
        """
        while self._inside:
            overdue = self._waited_s >= self._tracker.patience_s
            yielded = yield from self._take(None if len(self._inside) > _AT_WORK or overdue else self._wait_s)
            if not yielded:
                return

    def flush(self) -> Iterator[SensorFrame]:
        """Yields the remaining frames and waits for each."""
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
            return True  # a result of a frame from before a restart
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
