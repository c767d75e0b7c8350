"""When frames were captured, by the clock of the world."""

import time

from devices.capture.clock.host_clock import HostClock

UNIX_NS = time.time_ns() - time.perf_counter_ns()
"""Nanoseconds since 1970 UTC minus ``time.perf_counter_ns``, when the program began."""


class CaptureTime:
    """Times of frames that sensors capture now, which all outputs and the session share.

    A frame has its time on the sensor's clock and arrives after a constant delay plus some jitter, which
    :class:`devices.capture.clock.host_clock.HostClock` leaves out. The constant time of exposure and transfer
    is not removed; that of a body tracker is. Where the offset of the clocks becomes less, times follow at
    half their speed, so that frames stay apart.
    """

    def __init__(self) -> None:
        self._clock = HostClock()
        self._last: tuple[int, int] | None = None  # by the sensor's clock, and since 1970

    def unix_ns(self, time_ns: int, arrived_ns: int) -> int:
        """Nanoseconds since 1970 UTC.

        Args:
            time_ns: On the sensor's clock, as it continues over resets.
            arrived_ns: On ``time.perf_counter_ns``.
        """
        self._clock.observe(time_ns, arrived_ns)
        offset_ns = self._clock.offset_ns
        captured_ns = UNIX_NS + (arrived_ns if offset_ns is None else min(time_ns + offset_ns, arrived_ns))
        if self._last is not None:
            before_ns, captured_before_ns = self._last
            captured_ns = max(captured_ns, captured_before_ns + max((time_ns - before_ns) // 2, 1))
        self._last = time_ns, captured_ns
        return captured_ns
