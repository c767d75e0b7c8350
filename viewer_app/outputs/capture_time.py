"""When frames were captured, by the clock of the world."""

import time

from devices.capture.clock.host_clock import HostClock
from viewer_app.sinks.item_queue import QueuedFrame


class CaptureTime:
    """UNIX times of frames that sensors capture now.

    A frame has its time on the sensor's clock and arrives after a constant delay plus some jitter, which
    :class:`devices.capture.clock.host_clock.HostClock` leaves out. The constant time of exposure and transfer
    is not removed; that of a body tracker is.
    """

    def __init__(self) -> None:
        self._clock, self._unix_ns = HostClock(), time.time_ns() - time.perf_counter_ns()
        self._last_ns = 0

    def __call__(self, frame: QueuedFrame) -> int | None:
        """Nanoseconds since 1970 UTC, later than those of the frame before; None where that is not known."""
        arrived_ns = frame.written_ns - (frame.frame.latency_ns or 0)
        self._clock.observe(frame.time_ns, arrived_ns)
        offset_ns = self._clock.offset_ns
        captured_ns = self._unix_ns + (arrived_ns if offset_ns is None else frame.time_ns + offset_ns)
        self._last_ns = max(captured_ns, self._last_ns + 1)
        return self._last_ns


class RecordedTime(CaptureTime):
    """Those of a session that is played.

    Args:
        first_unix_ns: Of its first frame; None where that is not known.
    """

    def __init__(self, first_unix_ns: int | None) -> None:
        self._first_unix_ns = first_unix_ns

    def __call__(self, frame: QueuedFrame) -> int | None:
        return None if self._first_unix_ns is None else self._first_unix_ns + frame.time_ns
