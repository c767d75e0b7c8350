"""The session's clock on that of motion capture, from the motion that both show.

1. The joints' speeds, which need no common frame, give candidates for the offset.
2. Each is refined by displacements (:mod:`fusion.clocks.fit`).
3. Those at which the registered views match best are the offset and, if the movement repeats itself, others.
4. Offset and rate are refined together, from the middle of the session outwards; an uncertain rate is 0.
5. S* is refined from there. Its displacements must correlate with the truth's, and show its lag.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fusion.body import Body
from fusion.clocks import Clock, Times
from fusion.clocks.fit import Path, best_offsets, fitted_clock, part_offsets, with_rate
from fusion.pair_arrays import View
from fusion.skeleton import TRACKED
from fusion.support.large_arrays import parts, stored
from fusion.support.types import Array

_LONGEST_GAP = 0.1  # seconds without a point that are interpolated
_SEARCH_RATE = 60.0  # Hz of the truth in the search of the offset
_OTHERS_NS = 100_000_000  # nearer candidates are one
_LEAST_CORRELATION = 0.8  # of displacements; other movements reach 0.7, seldom 0.85; right ones 0.97
_LARGEST_SD, _LARGEST_LAG = 0.015, 0.050  # seconds: the person moves too little to tell
_CONTRADICTS = 0.020  # seconds between a given offset and one by the motion


@dataclass(frozen=True, eq=False)
class JointPath:
    """Joints over time: cubic splines, over short gaps only.

    Attributes:
        seconds: (N,) times in order.
        at: (N, J, 3) positions in the truth's unit; NaN in longer gaps.
        slopes: (N, J, 3) what they change by in a second.
        metres: Metres per unit.
    """

    seconds: Array
    at: NDArray[np.float32]
    slopes: NDArray[np.float32]
    metres: float = 1.0

    @staticmethod
    def of(seconds: Array, positions: NDArray[np.float32]) -> JointPath:
        """That of (N, J, 3) positions, NaN where unknown."""
        from scipy.interpolate import CubicSpline

        at, slopes = np.full((2, *positions.shape), np.nan, dtype=np.float32)
        for joint in range(positions.shape[1]):
            known = np.flatnonzero(np.isfinite(positions[:, joint, 0]))
            if len(known) > 1:
                times = seconds[known]
                spline = CubicSpline(times, positions[known, joint])
                after = np.clip(np.searchsorted(times, seconds), 1, len(times) - 1)
                short = times[after] - times[after - 1] <= _longest_gap(seconds)
                inside = (seconds >= times[0]) & (seconds <= times[-1]) & (short | (times[after] == seconds))
                at[inside, joint], slopes[inside, joint] = (spline(seconds[inside], n) for n in (0, 1))
        at, slopes = stored(at, slopes)
        return JointPath(seconds, at, slopes)

    def changed(self, change: Callable[[NDArray[np.float32]], NDArray[np.float32]]) -> JointPath:
        """The path whose positions, and what they change by, are changed."""
        return replace(self, at=change(self.at), slopes=change(self.slopes))

    def positions(self, times: Array) -> Array:
        """(T, J, 3) metres at (T,) times; NaN in gaps and outside."""
        found, most = np.empty((len(times), *self.at.shape[1:])), _longest_gap(self.seconds)
        for part in parts(len(times)):
            some = times[part]
            k = np.clip(np.searchsorted(self.seconds, some, side="right") - 1, 0, len(self.seconds) - 2)
            step = self.seconds[k + 1] - self.seconds[k]
            share = (some - self.seconds[k]) / step
            share[(share < 0.0) | (share > 1.0) | (step > most)] = np.nan
            s, step = share[:, None, None], step[:, None, None]
            start, change = self.at[k], self.at[k + 1] - self.at[k]
            bend = (1.0 - s) * (step * self.slopes[k] - change) - s * (step * self.slopes[k + 1] - change)
            found[part] = self.metres * (start + s * change + s * (1.0 - s) * bend)
        return found


def _longest_gap(seconds: Array) -> float:
    return max(_LONGEST_GAP, 2.5 * float(np.median(np.diff(seconds))))


@dataclass(frozen=True)
class TimeOffset:
    """When the truth begins on the session's clock.

    Attributes:
        clock: The session's, on the truth's.
        first_ns: The truth's first time, at which ``seconds`` counts.
        correlation: Of the displacements of S* and of the truth.
        lag_seconds: By which S* is behind S_A and S_B, which decide.
        others: Offsets that match about as well, because the movement repeats itself.
        instead_of: The offset by the motion, where the given one contradicts it.
    """

    clock: Clock
    first_ns: int = 0
    correlation: float = float("nan")
    lag_seconds: float = float("nan")
    others: tuple[float, ...] = ()
    instead_of: float = float("nan")

    @staticmethod
    def stated(seconds: float, first_ns: int = 0, clock: Clock | None = None) -> TimeOffset:
        """That of so many seconds, and of the rate of a clock."""
        set_ns = first_ns + round(1e9 * seconds)
        fast, sd = (0.0, float("nan")) if clock is None else (clock.rate_ppm, clock.rate_sd_ppm)
        return TimeOffset(Clock(-1e9 * seconds, rate_ppm=fast, rate_sd_ppm=sd, set_ns=set_ns), first_ns)

    @property
    def seconds(self) -> float:
        """Add it to the truth's times."""
        on_truth = self.clock.set_ns + self.clock.offset_ns - self.first_ns
        return float(-self.clock.offset_ns / 1e9 + on_truth / 1e9 * (1.0 - 1.0 / (1.0 + self.fast)))

    @property
    def sd_seconds(self) -> float:
        """By the jackknife; NaN where the offset was given."""
        return 1e-9 * self.clock.sd_ns

    @property
    def fast(self) -> float:
        """The share by which the truth's clock is fast; 0 where that is not certain."""
        return 1e-6 * self.clock.rate_ppm

    @property
    def fast_sd(self) -> float:
        """Its standard deviation; NaN where that is not known."""
        return 1e-6 * self.clock.rate_sd_ppm if np.isfinite(self.clock.rate_sd_ppm) else float("nan")

    @property
    def sure(self) -> bool:
        """Whether the person moves enough to tell the offset."""
        return self.sd_seconds <= _LARGEST_SD and abs(self.lag_seconds) <= _LARGEST_LAG

    def given(self, seconds: float) -> TimeOffset:
        """An offset that is given instead of this one; it keeps the rate of the clock where it is near."""
        if abs(seconds - self.seconds) < _CONTRADICTS:
            return TimeOffset.stated(seconds, self.first_ns, self.clock)
        near = any(abs(seconds - other) < _CONTRADICTS for other in self.others)
        given = TimeOffset.stated(seconds, self.first_ns)
        return replace(given, instead_of=self.seconds if self.sure and not near else float("nan"))


def path_of(truth: JointPath) -> Path:
    """The truth's joints on its clock."""
    first, last = (round(1e9 * end) for end in (truth.seconds[0], truth.seconds[-1]))
    return Path(first, last, lambda time_ns: truth.positions(np.asarray(1e-9 * time_ns)))


def find_offset(body: Body, views: Sequence[View], fused: View, truth: JointPath) -> TimeOffset | None:
    """The offset; None if none matches.

    Args:
        views: S_A and S_B, which decide: S* may lag behind them.
    """
    span, true_span = np.ptp(fused.time_ns), 1e9 * np.ptp(truth.seconds)
    even = truth.seconds[0] + np.arange(int(1e-9 * true_span * _SEARCH_RATE) + 1) / _SEARCH_RATE
    own, true = (
        view.chosen(np.flatnonzero(view.states.any(axis=1)))
        for view in (fused, view_of(np.rint(1e9 * even).astype(np.int64), truth.positions(even)))
    )
    # the search takes the frames of the first view, the shorter one, and adds nanoseconds to the second
    pair, sign = ((true, own), 1.0) if true_span < span else ((own, true), -1.0)
    path, refined = path_of(truth), list[Clock]()
    for candidate in part_offsets(body, *pair):
        found = fitted_clock(views, path, Clock(sign * candidate))
        if found and all(abs(found.clock.offset_ns - one.offset_ns) > _OTHERS_NS for one in refined):
            refined.append(found.clock)
    equal = best_offsets(*pair, [round(sign * one.offset_ns) for one in refined])
    if not equal:
        return None
    clock, *others = (refined[k] for k in equal)
    clock = with_rate(views, path, clock)
    of_fused = fitted_clock([fused], path, clock)
    if of_fused is None or of_fused.correlation < _LEAST_CORRELATION:
        return None
    lag = 1e-9 * (clock.offset_ns - of_fused.clock.offset_ns)
    elsewhere = tuple(-other.offset_ns / 1e9 for other in others)
    return TimeOffset(clock, path.first_ns, of_fused.correlation, lag, elsewhere)


def view_of(time_ns: Times, positions: NDArray[np.floating]) -> View:
    """(T, J, 3) joints at (T,) times, tracked where they are known."""
    states = np.where(np.isfinite(positions).all(axis=2), TRACKED, 0).astype(np.uint8)
    return View(time_ns, positions.astype(np.float32, copy=False), states)
