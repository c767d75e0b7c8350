"""Estimates the offset between a sensor's clock and the host clock from arrival times."""

from collections import deque
from enum import Enum

import numpy as np

_BLOCK_NS = 1_000_000_000
_WINDOW_BLOCKS = 10
_DRIFT_BLOCKS = 60
_LATE_NS = 500_000_000
_PASSED_NS = 50_000_000
_EQUAL_NS, _APART_NS = 10_000_000, 20_000_000
"""Frames of a reset clock have offsets that are equal but for jitter, though they arrive one after the other.
Frames that were held up arrive together, and the offset of each is an interval below that of the last one."""


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
    offset is the least arrival − capture of the last ten seconds that have frames: jitter only adds and does
    not disturb it, and a clock that drifts by 50 ppm moves 0.5 ms in that time. Seconds that are a minute old
    do not count. A jump by more than half a second is a reset; where it looks like lateness, only after a
    second frame with the same offset.

    Attributes:
        offset_ns: Host time minus sensor time, least delay included; None before the first frame.
    """

    def __init__(self) -> None:
        self._minima: deque[tuple[int, int]] = deque(maxlen=_DRIFT_BLOCKS)  # (block of host time, offset)
        self._suspect: tuple[int, int] | None = None  # arrival and offset of a frame that looks late
        self.offset_ns: int | None = None
        self._rate: tuple[int, float] = (0, 0.0)

    def observe(self, sensor_ns: int, host_ns: int) -> Timing:
        """Adds a frame captured at ``sensor_ns`` that arrived at ``host_ns``."""
        offset_ns = host_ns - sensor_ns
        excess_ns = 0 if self.offset_ns is None else offset_ns - self.offset_ns
        if abs(excess_ns) <= _LATE_NS:
            self._suspect = None
            self._note(offset_ns, host_ns)
            return Timing.IN_TIME
        # Nothing arrives before it was captured.
        if excess_ns > 0 and not self._is_confirmed(offset_ns, host_ns):
            return Timing.LATE
        self.restart()
        self._note(offset_ns, host_ns)
        return Timing.RESET

    def restart(self) -> None:
        """Forgets the offset: the next frame starts it anew."""
        self._minima.clear()
        self.offset_ns, self._suspect, self._rate = None, None, (0, 0.0)

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

    def _is_confirmed(self, offset_ns: int, host_ns: int) -> bool:
        """Whether an earlier frame had the same offset; else this one is compared with from now on."""
        if self._suspect is None or abs(offset_ns - self._suspect[1]) > _EQUAL_NS:
            self._suspect = host_ns, offset_ns
        return host_ns - self._suspect[0] >= _APART_NS

    def _note(self, offset_ns: int, host_ns: int) -> None:
        block = host_ns // _BLOCK_NS
        if self._minima and self._minima[-1][0] >= block:
            at, least = self._minima[-1]
            self._minima[-1] = at, min(least, offset_ns)
        else:
            self._minima.append((block, offset_ns))
        recent = [least for at, least in self._minima if at > block - _DRIFT_BLOCKS]
        self.offset_ns = min(recent[-_WINDOW_BLOCKS:])


class ContinuousTime:
    """A sensor's clock that goes on over its resets, by this machine's clock.

    Each moment is given on both clocks as they stood when its frame arrived, so a reset in between changes
    nothing.
    """

    def __init__(self) -> None:
        self._from_sensor: int | None = None
        self._from_host: int | None = None

    def restart(self) -> None:
        """Reports that the following moments are on a clock that was reset."""
        self._from_sensor = None

    def of_sensor(self, sensor_ns: int, host_ns: int) -> int:
        """The time of a moment of the sensor: its own clock, moved by what its resets were."""
        if self._from_sensor is None:
            self._from_sensor = 0 if self._from_host is None else host_ns + self._from_host - sensor_ns
        time_ns = sensor_ns + self._from_sensor
        self._from_host = time_ns - host_ns
        return time_ns

    def of_host(self, host_ns: int, first_ns: int) -> int:
        """The time of a moment without this sensor; ``first_ns`` where it is the very first one."""
        if self._from_host is None:
            self._from_host = first_ns - host_ns
        return host_ns + self._from_host


class OutputTime(ContinuousTime):
    """The time of pairs: that of A, continued. It never goes back."""

    def __init__(self) -> None:
        super().__init__()
        self._last_ns: int | None = None

    def forward(self, time_ns: int) -> int | None:
        """This time, or just after the last one given; None if it is more than 50 ms before that."""
        given_ns = time_ns if self._last_ns is None else max(time_ns, self._last_ns + 1)
        if given_ns - time_ns > _PASSED_NS:
            return None
        self._last_ns = given_ns
        return given_ns
