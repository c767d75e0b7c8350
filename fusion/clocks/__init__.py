"""A clock, as it is read on another one: what to add to its times."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from fusion.support.types import Array

Times = NDArray[np.int64]

_SECOND_NS, _STEADY_SECONDS = 1_000_000_000, 10  # from so many on, arrivals show a rate


@dataclass(frozen=True)
class Clock:
    """What to add to a clock's times, so that they are those of another clock.

    It is stated, or found from arrivals (:meth:`of_arrivals`; frame by frame by
    :class:`devices.capture.clock.host_clock.HostClock`), or from movement that both clocks time
    (:func:`fusion.clocks.search.find_clock`; frame by frame by :class:`fusion.clocks.lag.LagEstimator`).
    """

    offset_ns: float = 0.0
    sd_ns: float = float("nan")  # standard deviation of the offset; NaN where it is stated
    rate_ppm: float = 0.0  # growth of the offset, in millionths of the time
    rate_sd_ppm: float = float("inf")  # infinite where the rate is unknown
    set_ns: float = 0.0  # the clock's time at which ``offset_ns`` counts, where the offset grows
    steps: tuple[tuple[float, float], ...] = ()
    """Times of the clock, ns, from which on the offset is larger, and by how much, ns; in order."""

    @classmethod
    def of_arrivals(cls, time_ns: Times, arrived_ns: Times) -> Self:
        """The clock of frames with (T,) capture times that arrived at (T,) times of the other clock.

        A frame arrives later by the least delay and some jitter, which only adds.
        """
        delays = (arrived_ns - time_ns).astype(np.float64)
        firsts = np.flatnonzero(np.diff((time_ns - time_ns[0]) // _SECOND_NS, prepend=-1))
        least, seconds = np.minimum.reduceat(delays, firsts), (time_ns[firsts] - time_ns[0]) * 1e-9
        rate = rate_of_least(seconds, least)
        offset = float((delays - rate * (time_ns - time_ns[0]) * 1e-9).min())
        sd = float(np.std(least - rate * seconds))
        return cls(offset, sd, 1e-3 * rate, set_ns=int(time_ns[0]))

    def at(self, time_ns: Times) -> Times:
        """What to add at (T,) times of the clock, ns."""
        grown = 1e-6 * self.rate_ppm * (time_ns - self.set_ns)
        for from_ns, longer_ns in self.steps:
            grown = grown + longer_ns * (time_ns >= from_ns)
        return np.asarray(round(self.offset_ns) + np.rint(grown).astype(np.int64))

    def about(self, time_ns: int) -> Clock:
        """The same clock, without its steps, set at another time of it."""
        grown_ns = 1e-6 * self.rate_ppm * (time_ns - self.set_ns)
        return replace(self, offset_ns=self.offset_ns + grown_ns, set_ns=time_ns, steps=())

    def on(self, other: Clock, time_ns: int) -> Clock:
        """This clock as it is read on another one, where both are known on a third; at a time of it."""
        third_ns = time_ns + self.about(time_ns).offset_ns
        since_ns = (third_ns - other.offset_ns - other.set_ns) / (1.0 + 1e-6 * other.rate_ppm)
        return Clock(
            other.set_ns + since_ns - time_ns,
            float(np.hypot(self.sd_ns, other.sd_ns)),
            self.rate_ppm - other.rate_ppm,
            set_ns=time_ns,
        )

    @property
    def significant(self) -> bool:
        """Whether the offset exceeds twice its standard deviation."""
        return abs(self.offset_ns) > 2.0 * self.sd_ns

    @property
    def event(self) -> str:
        """A sentence for the event log, of B's clock on A's."""
        size = f"{self.offset_ns * 1e-6:+.1f} ± {self.sd_ns * 1e-6:.1f} ms"
        if not self.significant:
            return f"The motion shows no certain offset between the sensors' clocks: {size}."
        return f"The motion shows that B captures {size} relative to its time stamps."


def rate_of_least(seconds: Array, least_ns: Array) -> float:
    """By how many ns per second the least delays of the seconds grow; 0 before ten of them.

    The median of the slopes between all pairs (Theil-Sen), so a second in which every frame was late does not
    count.
    """
    if len(seconds) < _STEADY_SECONDS:
        return 0.0
    i, j = np.triu_indices(len(seconds), 1)
    return float(np.median((least_ns[j] - least_ns[i]) / (seconds[j] - seconds[i])))
