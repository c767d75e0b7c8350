"""A clock, as it is read on another one: what to add to its times."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from fusion.support.types import Array

Times = NDArray[np.int64]

_SECOND_NS, _STEADY_SECONDS = 1_000_000_000, 10  # from so many on, arrivals show a rate
_NEIGHBOURS, _RHYTHM = 2, 0.25  # frames, and the scatter of their skews compared with others
_EVEN = 0.25  # of an interval: the scatter of frames at even intervals
_COUNTED, _ENOUGH = 3000, 0.995  # frames, and their share


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


def nearest_of(times: Times, others: Times) -> NDArray[np.int64]:
    """For each time the index of the nearest of the others, the earlier where two are as near."""
    after = np.minimum(np.searchsorted(others, times), len(others) - 1)
    before = np.maximum(after - 1, 0)
    return np.where(np.abs(others[before] - times) <= np.abs(others[after] - times), before, after)


def median_interval(times: Times) -> int:
    """Nanoseconds between two frames; a thirtieth of a second for a single frame."""
    return int(np.median(np.diff(times))) if len(times) > 1 else 33_000_000


def rhythm(a_ns: Times, b_ns: Times) -> tuple[float, bool]:
    """How much later B's frames are than those of A that belong to them, and whether that tells them apart.

    Both have one rhythm where one computer took their frames in turns. Frames at even intervals tell the same
    but for whole intervals. NaN where neither is so.
    """
    nearest = nearest_of(b_ns, a_ns)
    skews = [
        b_ns - a_ns[np.clip(nearest + k, 0, len(a_ns) - 1)] for k in range(-_NEIGHBOURS, _NEIGHBOURS + 1)
    ]
    middles = [float(np.median(skew)) for skew in skews]
    scatter = [float(np.median(np.abs(skew - middle))) for skew, middle in zip(skews, middles, strict=True)]
    first, second = np.argsort(scatter, kind="stable")[:2].tolist()
    known = scatter[first] < _RHYTHM * scatter[second]
    even = scatter[first] < _EVEN * median_interval(a_ns)
    return middles[first] if known or even else float("nan"), known


def with_partners(a_ns: Times, b_ns: Times) -> float:
    """What to add to B's times, up to some frames' certainty right, so that its frames have partners.

    A common rhythm tells it. Else it is the least with which hardly a frame loses its partner.
    """
    skew, known = rhythm(a_ns, b_ns)
    if known:
        return -skew
    interval = median_interval(a_ns)
    some = slice(max(len(b_ns) - _COUNTED, 0) // 2, None)
    b_ns = b_ns[some][:_COUNTED]
    shifts = interval // 16 * np.arange(-8, 9)
    counts = []
    for shift in shifts.tolist():
        near = nearest_of(b_ns + shift, a_ns)
        paired = np.abs(a_ns[near] - b_ns - shift) <= interval // 2
        counts.append(len(np.unique(near[paired])))
    enough = shifts[np.array(counts) >= _ENOUGH * max(counts)]
    return float(min(enough, key=abs))
