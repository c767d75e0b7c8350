"""A live source's own times, and the offset of its clock to the host's from arrival times."""

from collections import deque
from collections.abc import Callable
from dataclasses import replace
from enum import Enum

import numpy as np

from devices.sensor import SensorFrame
from fusion.clocks import rate_of_least

_SAME_CLOCK_NS = 60_000_000_000  # a frame may be held up for some seconds by its tracker
_SHORTEST_NS, _SLOW = 3_000_000, 0.2  # of own time per frame, and as a share of that between arrivals
_JUDGED_NS, _FEWEST = 250_000_000, 8  # for how long, and from how many frames on, that is judged
_UNITS = {1_000_000: "milliseconds", 1_000: "microseconds", 100: "ticks of 100 ns"}
_BLOCK_NS = 1_000_000_000
_WINDOW_BLOCKS = 10
_DRIFT_BLOCKS = 60
_LATE_NS = 500_000_000
_EQUAL_NS, _APART_NS = 10_000_000, 20_000_000
"""Frames of a reset clock have offsets that are equal but for jitter, though they arrive one after the other.
Frames that were held up arrive together, and the offset of each is an interval below that of the last one."""


def arrival_ns(host_ns: int, now_ns: int) -> int:
    """An arrival time if its clock is ``time.perf_counter_ns``, as of SDKs on Linux and Windows; else now."""
    return host_ns if 0 <= now_ns - host_ns < _SAME_CLOCK_NS else now_ns


class SourceTimes:
    """The border for the times of a live source: nanoseconds, whatever unit its program gives.

    No sensor gives 300 frames per second. Own times that say so, and that are far behind the arrivals,
    are in another unit, which the arrivals tell, or are no times: then those of the arrivals are used. They
    are used, too, until that is judged.

    Args:
        tell: Gets each line for the user once.
    """

    def __init__(self, name: str, tell: Callable[[str], None]) -> None:
        self._name, self._tell_user, self._told = name, tell, set[str]()
        self._first: tuple[int, int] | None = None  # own time and arrival
        self._frames = 0
        self._scale: int | None = None  # nanoseconds of its unit; 0: the arrivals count; None: not judged yet

    def timed(self, frame: SensorFrame, now_ns: int) -> SensorFrame:
        """A frame that came now, its times in nanoseconds and on this machine's clock."""
        host_ns = now_ns if frame.host_ns is None else frame.host_ns
        if abs(host_ns - now_ns) >= _SAME_CLOCK_NS:
            host_ns = now_ns
            self._tell("host_ns is not on time.perf_counter_ns; the arrivals here are used.")
        first_ns, first_host_ns = self._first = self._first or (frame.time_ns, host_ns)
        own_ns, elapsed_ns = frame.time_ns - first_ns, host_ns - first_host_ns
        self._frames += 1
        slow = 0 <= own_ns < min(self._frames * _SHORTEST_NS, _SLOW * elapsed_ns)
        if self._scale is None and elapsed_ns >= _JUDGED_NS and self._frames >= _FEWEST:
            self._scale = (
                1 if not slow else next((u for u in _UNITS if 0.5 < own_ns * u / elapsed_ns < 2.0), 0)
            )
            if self._scale > 1:
                self._tell(f"time_ns is in {_UNITS[self._scale]}; it must be in nanoseconds, and is read so.")
            elif self._scale == 0:
                grows = own_ns // (self._frames - 1)
                self._tell(f"time_ns grows by {grows} per frame and is no time; the arrivals are used.")
        if self._scale == 0 or (self._scale is None and slow and elapsed_ns >= _APART_NS):
            own_ns = elapsed_ns
        return replace(frame, time_ns=first_ns + own_ns * (self._scale or 1), host_ns=host_ns)

    def _tell(self, text: str) -> None:
        if text not in self._told:
            self._told.add(text)
            self._tell_user(f"{self._name}: its {text}")


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
    do not count. A jump by more than half a second is a reset, and a smaller one of a frame whose time goes
    back; where it looks like lateness, only after a second frame with the same offset.

    Attributes:
        offset_ns: Host time minus sensor time, least delay included; None before the first frame.
    """

    def __init__(self) -> None:
        self._minima: deque[tuple[int, int]] = deque(maxlen=_DRIFT_BLOCKS)  # (block of host time, offset)
        self._suspect: tuple[int, int] | None = None  # arrival and offset of a frame that looks late
        self.offset_ns: int | None = None
        self._rate: tuple[int, float] = (0, 0.0)
        self._newest_ns: int | None = None  # by the sensor's clock

    def observe(self, sensor_ns: int, host_ns: int) -> Timing:
        """Adds a frame captured at ``sensor_ns`` that arrived at ``host_ns``."""
        offset_ns = host_ns - sensor_ns
        excess_ns = 0 if self.offset_ns is None else offset_ns - self.offset_ns
        goes_back = self._newest_ns is not None and sensor_ns <= self._newest_ns
        late = excess_ns > _LATE_NS
        reset = excess_ns < -_LATE_NS  # nothing arrives before it was captured
        if late or (excess_ns > _APART_NS and (goes_back or self._suspect is not None)):
            reset = self._is_confirmed(offset_ns, host_ns)
        else:
            self._suspect = None
        if reset:
            self.restart()
        elif late:
            return Timing.LATE
        self._newest_ns = sensor_ns if self._newest_ns is None else max(sensor_ns, self._newest_ns)
        self._note(offset_ns, host_ns)
        return Timing.RESET if reset else Timing.IN_TIME

    def restart(self) -> None:
        """Forgets the offset: the next frame starts it anew."""
        self._minima.clear()
        self.offset_ns, self._suspect, self._rate, self._newest_ns = None, None, (0, 0.0), None

    @property
    def drift_ppm(self) -> float:
        """By how many millionths the sensor's clock runs faster than the host's; 0 before ten seconds."""
        newest = self._minima[-1][0] if self._minima else 0
        if self._rate[0] != newest:
            at, least = np.array(self._minima, dtype=np.float64).T
            self._rate = newest, -1e-3 * rate_of_least(1e-9 * _BLOCK_NS * at, least)
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

    def forward(self, time_ns: int, apart_ns: int, lone: bool) -> int | None:
        """The time of the next pair, so far after the last one.

        Returns:
            None if it was before the last one, or is that of a lone frame of the last one's moment.
        """
        given_ns = time_ns if self._last_ns is None else max(time_ns, self._last_ns + apart_ns)
        if given_ns - time_ns > (0 if lone else apart_ns):
            return None
        self._last_ns = given_ns
        return given_ns
