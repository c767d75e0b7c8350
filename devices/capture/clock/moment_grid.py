"""Moment grid: numbers the moments at which two sensors capture, on a grid that they share."""

import math
from collections.abc import Hashable
from dataclasses import dataclass, field

from devices.capture.clock.host_clock import HostClock, Timing

_REGRID = 0.6  # of a period: beyond half of one, so that a sensor midway between the other's does not swing
_SAME_STREAM_NS = 1_000_000_000


@dataclass(eq=False)
class _Grid:
    """One sensor's moments: the newest on its own clock, and where they lie on this machine's."""

    clock: HostClock = field(default_factory=HostClock)
    newest_ns: float = -math.inf
    number: int = 0
    zero_ns: int | None = None  # when moment 0 was, by this machine's clock


class MomentGrid:
    """Numbers the moments at which two sensors capture, so that equal numbers mean the same moment.

    Each sensor counts on by its own clock. The sensor that called :meth:`restart` or :meth:`number` first
    leads; this machine's clock tells where a sensor begins, and whether the other's grid still fits.
    """

    def __init__(self, period_ns: int) -> None:
        self._period_ns = period_ns
        self._grids: dict[Hashable, _Grid] = {}

    def restart(self, sensor: Hashable) -> None:
        """Forgets a sensor, because its clock restarts."""
        self._grids[sensor] = _Grid()

    def number(self, sensor: Hashable, time_ns: int, host_ns: int) -> int:
        """The number of the moment that a sensor captured at ``time_ns`` and that arrived at ``host_ns``."""
        mine = self._grids.setdefault(sensor, _Grid())
        timing = mine.clock.observe(time_ns, host_ns)
        gap_ns, mine.newest_ns = time_ns - mine.newest_ns, time_ns
        follows = 0 <= gap_ns < _SAME_STREAM_NS and timing is not Timing.RESET
        if follows:
            mine.number += round(gap_ns / self._period_ns)
        if timing is Timing.LATE:  # held up, or the first of a new clock: its arrival tells nothing
            return mine.number
        moment_ns = time_ns + (mine.clock.offset_ns or 0)
        leads = follows and mine is next(iter(self._grids.values()))
        for other in self._grids.values():
            if other is not mine and other.zero_ns is not None and not leads:
                number = (moment_ns - other.zero_ns) / self._period_ns
                if not follows or abs(number - mine.number) > _REGRID:
                    mine.number = round(number)
        mine.zero_ns = moment_ns - mine.number * self._period_ns
        return mine.number
