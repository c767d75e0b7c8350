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

from fusion.pair_arrays import View
from fusion.registration.clock_offset import ClockOffset
from fusion.registration.clock_search import frame_costs, refined_offset
from fusion.support.types import Array

_SHORTEST_NS = 20_000_000_000  # of what both recordings have in common
_WINDOW_NS, _LONGEST_NS, _WINDOWS = 4_000_000_000, 60_000_000_000, 12
_FEWEST = 4
_CERTAIN_NS = 20_000_000  # standard deviation of the offset in a window that counts
_OUTLIER = 3.0  # standard deviations: a window that is farther off counts no more
_PRICE_OF_SLOPE, _PRICE_OF_STEP = 9.0, 8.0  # of the sum of squares in standard deviations
_MOST_STEPS = 4
_LEAST_STEP, _OFF_STEP = 0.6, 0.4  # usual intervals: a step is some whole ones
_SEARCH_STEPS = 8


class _Windows(NamedTuple):
    """The offset in each window, in order of time."""

    time_ns: Array  # (N,) middle of the window on A's clock
    offset_ns: Array
    sd_ns: Array


def find_clock_course(a: View, b: View, middle: ClockOffset) -> ClockOffset:
    """Adds growth or steps to an offset, where the motion tells them and the views then agree better.

    Args:
        a, b: As for :func:`fusion.registration.clock_search.find_clock_offset`.
        middle: Its result, or an offset of 0.

    Returns:
        The same offset where the recordings overlap for less than 20 s, or where it is constant.
    """
    shifted = b._replace(time_ns=b.time_ns + round(middle.offset_ns))
    first, last = max(a.time_ns[0], shifted.time_ns[0]), min(a.time_ns[-1], shifted.time_ns[-1])
    if last - first < _SHORTEST_NS:
        return middle
    windows = _measured(a, shifted, int(first), int(last))
    if len(windows.time_ns) < _FEWEST:
        return middle
    centre = first + (last - first) // 2
    lever = windows.time_ns - float(centre)
    sd = np.maximum(windows.sd_ns, _scatter(windows))
    constant, slope, slope_sd = _line(lever, windows.offset_ns, sd)
    flat = _price(windows.offset_ns, float(np.median(windows.offset_ns)), sd)
    grown = _price(windows.offset_ns, constant + slope * lever, sd) + _PRICE_OF_SLOPE
    interval = float(np.median(np.diff(b.time_ns)))
    stepped, breaks = _steps(windows.offset_ns, sd, interval)
    known = replace(middle, sd_ns=min(middle.sd_ns, float(np.median(sd)) / len(sd) ** 0.5))
    courses: list[ClockOffset] = []
    if grown < flat:
        growth = replace(known, skew_ppm=1e6 * slope, skew_sd_ppm=1e6 * slope_sd)
        at = float(centre - round(middle.offset_ns))
        courses.append(replace(growth, offset_ns=middle.offset_ns + constant, middle_ns=at))
    if stepped < flat:
        courses.append(_with_steps(a, shifted, windows, breaks, interval, known))
    if not courses:
        return replace(middle, skew_sd_ppm=1e6 * slope_sd)
    # some windows tell steps from growth badly; all frames tell them well
    before = frame_costs(a, shifted, (0,))[0]
    timed = [b._replace(time_ns=b.time_ns + one.at(b.time_ns)) for one in courses]
    gains = [before - frame_costs(a, view, (0,))[0] for view in timed]
    means = [float(np.mean(gain[np.isfinite(gain)])) for gain in gains]
    best = int(np.argmax(means))
    return courses[best] if means[best] > 0.0 else middle


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
    a: View, b: View, windows: _Windows, breaks: list[int], interval: float, middle: ClockOffset
) -> ClockOffset:
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
        middle, offset_ns=middle.offset_ns + levels[0], skew_ppm=0.0, steps=tuple(steps), middle_ns=0.0
    )
