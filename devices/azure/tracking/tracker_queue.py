"""The queue of frames that the body tracker is processing."""

import time
from collections import OrderedDict
from collections.abc import Callable, Generator, Iterator
from dataclasses import replace

from devices.azure.tracking.body_tracker import BodyTracker
from devices.capture.causes import Cause
from devices.sensor import SensorFrame

_SLICE_S = 0.25
_STOPPED_NS = 1_000_000_000  # a longer time between two looks is one in which this program stood still
_AT_WORK = 2  # frames in the tracker: the network runs on one while skeletons are fitted to the other


class TrackerQueue:
    """Joins each frame with the people that the tracker finds in it.

    The tracker works on its own threads. If it needs longer than ``wait_s``, a frame is yielded one or two
    captures later. All methods raise a DeviceError if the tracker has failed, or gave no result for its
    ``patience_s``.
    """

    def __init__(
        self,
        tracker: BodyTracker,
        wait_s: float,
        took: Callable[[int], object] = lambda _: None,
        clock: Callable[[], int] = time.perf_counter_ns,
        interrupted: Callable[[], bool] = lambda: False,
    ) -> None:
        """Makes an empty queue for the frames of one sensor.

        Args:
            took: Called with the tracker's processing time of each frame, ns. It is counted from the frame's
                entry or from the previous result, whichever is later.
            interrupted: Ends all waiting within a quarter of a second.
        """
        self._tracker = tracker
        self._wait_s = wait_s
        self._took, self._clock, self._interrupted = took, clock, interrupted
        self._inside: OrderedDict[int, tuple[SensorFrame, int]] = OrderedDict()  # frame and time of entry, ns
        self._result_ns: int | None = None
        self._looked_ns = self._waited_ns = 0  # newest look at the tracker; wait for the oldest result

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
        while self._inside and not self._interrupted():
            too_many = len(self._inside) > _AT_WORK
            if not (yield from self._take(_SLICE_S if too_many else self._wait_s)) and not too_many:
                return

    def flush(self) -> Iterator[SensorFrame]:
        """Yields the remaining frames and waits for each."""
        while self._inside and not self._interrupted():
            yield from self._take(_SLICE_S)

    def _take(self, wait_s: float) -> Generator[SensorFrame, None, bool]:
        _, entered_ns = next(iter(self._inside.values()))
        since_ns = max(entered_ns, self._looked_ns)
        bodies, self._looked_ns = self._tracker.pop(wait_s), self._clock()
        if bodies is None:
            self._waited_ns += min(self._looked_ns - since_ns, _STOPPED_NS)
            if self._waited_ns >= 1e9 * self._tracker.patience_s:
                raise Cause.TRACKER_STALLS.error(what="gave no result", seconds=self._tracker.patience_s)
            return False
        self._waited_ns = 0
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
