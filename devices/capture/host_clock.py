"""Estimates the offset between a sensor's clock and the host clock from arrival times."""

from collections import deque
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from fusion.registration.clock_offset import ClockOffset

ONE_RUN_NS = 60_000_000_000
"""Two sensors whose first frames arrived at most so far apart were recorded by one run of the program."""
_BLOCK_NS = 1_000_000_000
_WINDOW_BLOCKS = 10
_DRIFT_BLOCKS = 60
_LATE_NS = 500_000_000
_SAME_CLOCK_NS = 250_000_000


class Timing(Enum):
    """Classification of a frame's times."""

    IN_TIME = "in time"
    LATE = "late"
    """Far later than frames of this sensor take: held up on its way, or the first after a reset."""
    RESET = "reset"
    """The sensor's clock starts anew: plugged in again, or its firmware restarted."""


class HostClock:
    """The offset host − sensor of one sensor's clock, kept up to date.

    A frame arrives after its capture by the least delay there is plus some jitter, never earlier. So the
    offset is the least arrival − capture of the last ten seconds: jitter only adds and does not disturb it,
    and a clock that drifts by 50 ppm moves 0.5 ms in that time. A jump by more than half a second, confirmed
    by a second frame where it looks like lateness, is a reset.

    Attributes:
        offset_ns: Host time minus sensor time, least delay included; None before the first frame.
    """

    def __init__(self) -> None:
        self._minima: deque[tuple[int, int]] = deque(maxlen=_DRIFT_BLOCKS)  # (block of host time, offset)
        self._suspect: tuple[int, int] | None = None
        self.offset_ns: int | None = None
        self._rate: tuple[int, float] = (0, 0.0)

    def observe(self, sensor_ns: int, host_ns: int) -> Timing:
        """Adds a frame captured at ``sensor_ns`` that arrived at ``host_ns``."""
        offset_ns = host_ns - sensor_ns
        excess_ns = 0 if self.offset_ns is None else offset_ns - self.offset_ns
        if -_LATE_NS <= excess_ns <= _LATE_NS:
            self._suspect = None
            self._note(offset_ns, host_ns)
            return Timing.IN_TIME
        # Nothing arrives before it was captured; lateness must be told from a reset by the next frame.
        suspect, self._suspect = self._suspect, (sensor_ns, offset_ns)
        follows = suspect is not None and sensor_ns > suspect[0]
        if excess_ns < 0 or (follows and suspect and abs(offset_ns - suspect[1]) < _SAME_CLOCK_NS):
            self.restart()
            self._note(offset_ns, host_ns)
            return Timing.RESET
        return Timing.LATE

    def restart(self) -> None:
        """Forgets the offset: the next frame starts it anew."""
        self._minima.clear()
        self.offset_ns, self._suspect = None, None

    @property
    def drift_ppm(self) -> float:
        """By how many millionths the sensor's clock runs faster than the host's; 0 before ten seconds.

        The median of the slopes between all pairs of the last minute's one-second minima (Theil-Sen), so a
        second in which every frame was late does not count.
        """
        newest = self._minima[-1][0] if self._minima else 0
        if len(self._minima) >= _WINDOW_BLOCKS and self._rate[0] != newest:
            at, offset = np.array(self._minima, dtype=np.float64).T
            i, j = np.triu_indices(len(at), 1)
            slope = np.median((offset[j] - offset[i]) / ((at[j] - at[i]) * _BLOCK_NS))
            self._rate = newest, float(-1e6 * slope)
        return self._rate[1]

    def _note(self, offset_ns: int, host_ns: int) -> None:
        block = host_ns // _BLOCK_NS
        if self._minima and self._minima[-1][0] >= block:
            at, least = self._minima[-1]
            self._minima[-1] = at, min(least, offset_ns)
        else:
            self._minima.append((block, offset_ns))
        recent = [least for at, least in self._minima if at > block - _WINDOW_BLOCKS]
        self.offset_ns = min(recent)


def offset_by_arrival(a: NDArray[np.int64], b: NDArray[np.int64]) -> ClockOffset | None:
    """What to add to B's times so that they are on A's clock, from (T, 2) recorded capture and arrival times.

    As :class:`HostClock`, over the whole recording: least delays, with a drift from ten seconds on. None
    where the two did not arrive on one machine's clock.
    """
    if not (len(a) and len(b)) or abs(int(a[0, 1]) - int(b[0, 1])) > ONE_RUN_NS:
        return None
    fits = []
    for arrivals in (a, b):
        times, delays = arrivals[:, 0], (arrivals[:, 1] - arrivals[:, 0]).astype(np.float64)
        firsts = np.flatnonzero(np.diff((times - times[0]) // _BLOCK_NS, prepend=-1))
        least = np.minimum.reduceat(delays, firsts)
        seconds = (times[firsts] - times[0]) * 1e-9
        slope = 0.0
        if len(firsts) >= _WINDOW_BLOCKS:
            i, j = np.triu_indices(len(firsts), 1)
            slope = float(np.median((least[j] - least[i]) / (seconds[j] - seconds[i])))  # ns per second
        residual = delays - slope * (times - times[0]) * 1e-9
        fits.append((int(times[0]), float(residual.min()), slope, float(np.std(least - slope * seconds))))
    (start_a, delay_a, slope_a, sd_a), (start_b, delay_b, slope_b, sd_b) = fits
    middle_ns = int(b[len(b) // 2, 0])
    host_ns = middle_ns + delay_b + slope_b * (middle_ns - start_b) * 1e-9
    on_a_ns = start_a + (host_ns - delay_a - start_a) / (1.0 + slope_a * 1e-9)
    skew_ppm = 1e-3 * (slope_b - slope_a)
    return ClockOffset(on_a_ns - middle_ns, float(np.hypot(sd_a, sd_b)), skew_ppm, middle_ns=middle_ns)
