"""The course of a clock's offset over a recording: constant, growing, or changing in steps.

A clock that runs fast makes the offset grow. Frames that were lost make it change in steps where times are
frame numbers over the rate. The offset is measured in windows, and the simplest course that explains them is
taken: each further parameter must explain more of their scatter than its price.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from fusion.clocks import Clock
from fusion.clocks.search import frame_costs, is_better, mean_costs, refined_offset
from fusion.pair_arrays import View
from fusion.support.types import Array

_SHORTEST_NS = 10_000_000_000  # of what both recordings have in common
_WINDOW_NS, _LONGEST_NS, _WINDOWS = 4_000_000_000, 60_000_000_000, 12
_FEWEST = 4
_CERTAIN = 2.0  # standard errors by which the views must agree better
_CERTAIN_NS = 20_000_000  # standard deviation of the offset in a window that counts
_OUTLIER = 3.0  # standard deviations: a window that is farther off counts no more
_PRICE_OF_STEP = 8.0  # of the sum of squares in standard deviations
_MOST_STEPS = 4
_STEADY = 2.0  # usual intervals in which the offsets of a steady clock lie
_MIDDLE_NS, _REACH_NS = 40_000_000_000, 1_000_000_000  # of what both saw, in which growth is searched
_FASTEST_PPM, _APART_NS, _OFFSETS = 20_000, 33_333_333, 5  # the search's reach and its steps
_LEAST_STEP, _OFF_STEP = 0.6, 0.4  # usual intervals: a step is some whole ones
_SEARCH_STEPS = 8


class _Windows(NamedTuple):
    """The offset in each window, in order of time."""

    time_ns: Array  # (N,) middle of the window on A's clock
    offset_ns: Array
    sd_ns: Array


def find_clock_course(a: View, b: View, middle: Clock) -> Clock:
    """Adds growth or steps to an offset, where the motion tells them and the views then agree better.

    Args:
        a, b: As for :func:`fusion.clocks.search.find_clock_offset`.
        middle: Its result, or an offset of 0.

    Returns:
        The same offset where the recordings overlap for less than 10 s, or where it is constant.
    """
    shifted = b._replace(time_ns=b.time_ns + round(middle.offset_ns))
    first, last = max(a.time_ns[0], shifted.time_ns[0]), min(a.time_ns[-1], shifted.time_ns[-1])
    if last - first < _SHORTEST_NS:
        return middle
    centre = int(first + (last - first) // 2)
    interval = float(np.median(np.diff(b.time_ns)))
    windows, grown = _measured(a, shifted, int(first), int(last)), Clock(0.0, np.inf)
    untilted = windows
    if len(windows.time_ns) < _FEWEST or np.ptp(windows.offset_ns) > _STEADY * interval:
        grown = _grown(a, shifted, centre, int(last - first))
        tilted = shifted._replace(time_ns=shifted.time_ns + grown.at(shifted.time_ns))
        windows = _measured(a, tilted, int(first), int(last)) if grown.rate_ppm else untilted
    if len(windows.time_ns) < (2 if grown.rate_ppm else _FEWEST):
        return middle
    lever = windows.time_ns - float(centre)
    sd = np.maximum(windows.sd_ns, _scatter(windows))
    constant, slope, slope_sd = _line(lever, windows.offset_ns, sd)
    at = float(centre - round(middle.offset_ns))
    known = replace(
        middle, sd_ns=min(middle.sd_ns, float(np.median(sd)) / len(sd) ** 0.5), rate_sd_ppm=1e6 * slope_sd
    )
    growth = replace(
        known,
        offset_ns=middle.offset_ns + grown.offset_ns,
        rate_ppm=grown.rate_ppm,
        set_ns=at - grown.offset_ns,
    )
    finer = replace(growth, offset_ns=growth.offset_ns + constant, rate_ppm=grown.rate_ppm + 1e6 * slope)
    courses = [growth, finer]
    if len(untilted.time_ns) >= _FEWEST:
        spread = np.maximum(untilted.sd_ns, _scatter(untilted))
        flat = _price(untilted.offset_ns, float(np.median(untilted.offset_ns)), spread)
        stepped, breaks = _steps(untilted.offset_ns, spread, interval)
        if stepped < flat:
            courses.append(_with_steps(a, shifted, untilted, breaks, interval, known))
    before = frame_costs(a, shifted, (0,))[0]
    timed = [b._replace(time_ns=b.time_ns + one.at(b.time_ns)) for one in courses]
    costs = [frame_costs(a, view, (0,))[0] for view in timed]
    best = int(np.argmin([float(np.nanmean(cost)) for cost in costs]))
    if is_better(costs[best], before, _CERTAIN):
        return courses[best]
    return replace(middle, rate_sd_ppm=1e6 * slope_sd)


def _grown(a: View, b: View, centre: int, span: int) -> Clock:
    """The offset and its growth with which the middle of two registered views agrees best; 0 where no growth
    is certainly better than none."""
    half = min(span, _MIDDLE_NS) // 2
    seen = a.chosen(np.flatnonzero(np.abs(a.time_ns - centre) <= half))
    near = b.chosen(np.flatnonzero(np.abs(b.time_ns - centre) <= half + _REACH_NS))
    best = Clock(0.0, np.inf, set_ns=float(centre))
    if min(len(seen.time_ns), len(near.time_ns)) < 2:
        return best
    flat = least = frame_costs(seen, near, (0,))[0]
    apart, step = _APART_NS, 1e6 * _APART_NS / half
    for rates in (round(_FASTEST_PPM / step), 2, 2):
        middle = best
        for rate in (middle.rate_ppm + step * np.arange(-rates, rates + 1)).tolist():
            offsets = (round(middle.offset_ns) + apart * np.arange(-_OFFSETS, _OFFSETS + 1)).tolist()
            tilted = replace(best, offset_ns=0.0, rate_ppm=rate).at(near.time_ns)
            costs = frame_costs(seen, near._replace(time_ns=near.time_ns + tilted), offsets)
            means = mean_costs(costs)
            k = int(np.argmin(means))
            if means[k] < mean_costs(least[None])[0]:
                least, best = costs[k], replace(best, offset_ns=float(offsets[k]), rate_ppm=rate)
        apart, step = apart // 2, 0.5 * step
    return best if is_better(least, flat, _CERTAIN) else replace(best, offset_ns=0.0, rate_ppm=0.0)


def _measured(a: View, b: View, first: int, last: int) -> _Windows:
    """The offsets of the windows, from the middle outwards: a neighbour tells where to look."""
    count = int(min(_WINDOWS, (last - first) // _WINDOW_NS))
    half = min(_LONGEST_NS, (last - first) // count) // 2
    moments = np.linspace(first + half, last - half, count).astype(np.int64)
    centre = first + (last - first) // 2
    found: list[tuple[float, float, float]] = []
    for moment in moments[np.argsort(np.abs(moments - centre), kind="stable")].tolist():
        expected = _expected(found, moment, centre)
        seen, near = (
            view.chosen(np.flatnonzero(np.abs(view.time_ns - moment) < within))
            for view, within in ((a, half), (b, half + abs(expected) + 1_000_000_000))
        )
        if min(len(seen.time_ns), len(near.time_ns)) < 2:
            continue
        offset = refined_offset(seen, near, expected, 0, _SEARCH_STEPS)
        if offset is not None and offset.sd_ns <= _CERTAIN_NS:
            found.append((float(moment), offset.offset_ns, offset.sd_ns))
    return _Windows(*np.array(sorted(found)).reshape(-1, 3).T)


def _expected(found: Sequence[tuple[float, float, float]], moment: int, centre: int) -> int:
    """ns: the offset of the nearest window, and its growth."""
    if not found:
        return 0
    time_ns, offset_ns, sd_ns = np.array(found).T
    slope = 0.0 if len(found) < 3 else _line(time_ns - centre, offset_ns, sd_ns)[1]
    nearest = int(np.argmin(np.abs(time_ns - moment)))
    return int(offset_ns[nearest] + slope * (moment - time_ns[nearest]))


def _scatter(windows: _Windows) -> float:
    """ns, standard deviation of a window by the changes from one to the next, few of which are steps."""
    change = np.diff(windows.offset_ns)
    usual = float(np.quantile(np.abs(change - np.median(change)), 0.25)) / 0.319  # of a normal distribution
    return usual / float(np.sqrt(2.0))


def _price(values: Array, expected: Array | float, sd: Array) -> float:
    return float(np.minimum(((values - expected) / sd) ** 2, _OUTLIER**2).sum())


def _line(lever: Array, values: Array, sd: Array) -> tuple[float, float, float]:
    """Value at lever 0, slope, and the slope's standard deviation, by a robust fit."""
    weights: Array = sd**-2.0
    constant = slope = slope_sd = 0.0
    for _ in range(8):
        total = weights.sum()
        mean = float((weights * lever).sum() / total)
        power = float((weights * (lever - mean) ** 2).sum())
        if power <= 0.0:
            return float(np.median(values)), 0.0, np.inf
        slope = float((weights * (lever - mean) * values).sum() / power)
        constant = float((weights * values).sum() / total) - slope * mean
        off = (values - constant - slope * lever) / sd
        size = max(1.0, float(np.median(np.abs(off))) * 1.4826)
        slope_sd = float(size / np.sqrt(power))
        weights = sd**-2.0 / np.maximum(1.0, np.abs(off) / (1.5 * size))
    return constant, slope, slope_sd


def _steps(values: Array, sd: Array, interval: float) -> tuple[float, list[int]]:
    """Least price of a course in steps, and the windows that begin with one; infinite where there is none."""
    count = len(values)

    def level(i: int, j: int) -> tuple[float, float]:
        median = float(np.median(values[i:j]))
        return _price(values[i:j], median, sd[i:j]), median

    best: dict[tuple[int, int], tuple[float, list[int]]] = {(0, 0): (0.0, [])}  # of windows, of segments
    for segments in range(1, _MOST_STEPS + 2):
        for end in range(1, count + 1):
            options = [
                (best[begin, segments - 1][0] + level(begin, end)[0], [*best[begin, segments - 1][1], begin])
                for begin in range(end)
                if (begin, segments - 1) in best
            ]
            if options:
                best[end, segments] = min(options)
    found = np.inf, list[int]()
    for segments in range(2, _MOST_STEPS + 2):
        if (count, segments) not in best:
            continue
        price, begins = best[count, segments]
        levels = [level(i, j)[1] for i, j in zip(begins, [*begins[1:], count], strict=True)]
        lost = np.diff(levels) / interval
        if (np.abs(lost) > _LEAST_STEP).all() and (np.abs(lost - np.rint(lost)) < _OFF_STEP).all():
            found = min(found, (price + _PRICE_OF_STEP * (segments - 1), begins[1:]))
    return found


def _with_steps(
    a: View, b: View, windows: _Windows, breaks: list[int], interval: float, middle: Clock
) -> Clock:
    """The offset with steps, each where the frames begin to agree with the later offset."""
    begins = [0, *breaks]
    ends = [*breaks, len(windows.time_ns)]
    levels = [float(np.median(windows.offset_ns[i:j])) for i, j in zip(begins, ends, strict=True)]
    steps = []
    for number, at in enumerate(breaks):
        before, after = levels[number], levels[number + 1]
        span = windows.time_ns[at - 1], windows.time_ns[at]
        within = a.chosen(np.flatnonzero((a.time_ns >= span[0]) & (a.time_ns <= span[1])))
        costs = frame_costs(within, b, [int(offset) for offset in (before, after)])
        gain = np.nan_to_num(costs[0] - costs[1])  # of the later offset
        split = int(np.argmin(np.append(0.0, np.cumsum(gain))))
        chosen = np.linspace(0, len(within.time_ns) - 1, len(gain)).astype(np.int64)
        time_ns = float(within.time_ns[chosen[min(split, len(chosen) - 1)]])
        lost = round((after - before) / interval)
        steps.append((time_ns - before - round(middle.offset_ns), lost * interval))
    return replace(
        middle, offset_ns=middle.offset_ns + levels[0], rate_ppm=0.0, steps=tuple(steps), set_ns=0.0
    )
