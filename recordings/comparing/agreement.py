"""How far one method agrees with another, as laboratories state it, with 95 % intervals.

Bias and limits of agreement are those of Bland and Altman (1986), the absolute agreement is ICC(A,1) of
McGraw and Wong (1996). The intervals are by the jackknife over blocks of values, with Student's t: values of
one block may depend on each other, as those of neighbouring frames do, but blocks must not.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from fusion.support.types import Array
from recordings.gait import SIDES, Gait, Step

Interval = tuple[float, float]

_LIMITS = 1.96  # standard deviations between which 95 % of the differences lie
_FEWEST_BLOCKS = 5
_TWO_SIDED = 0.975
_NEAR = 0.5  # of the usual step: strikes of a foot that are farther apart are two
_UNKNOWN = math.nan, math.nan


class Agreement(NamedTuple):
    """How n values agree with the true ones; an interval is (NaN, NaN) of fewer than five blocks."""

    n: int
    bias: float
    """Mean of found less true."""
    bias_interval: Interval
    limits: Interval
    """Between which 95 % of the differences lie."""
    limits_intervals: tuple[Interval, Interval]
    rmse: float
    rmse_interval: Interval
    icc: float
    icc_interval: Interval


def agreement(found: ArrayLike, true: ArrayLike, blocks: ArrayLike | None = None) -> Agreement:
    """How (n,) values agree with the true ones; n is at least 2.

    Args:
        blocks: (n,) the number of the block of each value; None: each value is one.
    """
    x, y = np.asarray(found, dtype=np.float64), np.asarray(true, dtype=np.float64)
    numbers = np.arange(len(x)) if blocks is None else np.asarray(blocks)
    off, middle = x - y, 0.5 * (x + y)
    middle = middle - middle.mean()
    _, at = np.unique(numbers, return_inverse=True)
    each = np.stack([np.ones_like(off), off, off**2, middle, middle**2], axis=1)
    sums = np.zeros((int(at.max()) + 1, 5))
    np.add.at(sums, at, each)
    whole, without = _figures(sums.sum(axis=0)), _figures(sums.sum(axis=0) - sums)
    B = len(sums)
    intervals: list[Interval] = [_UNKNOWN] * 5
    if B >= _FEWEST_BLOCKS:
        from scipy.special import stdtrit

        t = float(stdtrit(B - 1, _TWO_SIDED))
        with np.errstate(divide="ignore", invalid="ignore"):  # an ICC of 1, an RMSE of 0
            for k, (scale, back) in enumerate(_SCALES):
                value, others = scale(whole[k]), scale(without[:, k])
                error = t * math.sqrt((B - 1) / B * float(np.sum((others - others.mean()) ** 2)))
                if math.isfinite(error):
                    intervals[k] = float(back(value - error)), float(back(value + error))
    bias, low, high, rmse, icc = whole.tolist()
    return Agreement(
        len(x), bias, intervals[0], (low, high), (intervals[1], intervals[2]),
        rmse, intervals[3], icc, intervals[4],
    )  # fmt: skip


def _figures(sums: Array) -> Array:
    """(..., 5) bias, lower and upper limit, RMSE, ICC(A,1) of (..., 5) sums."""
    n, off, off2, middle, middle2 = np.moveaxis(sums, -1, 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        bias = off / n
        variance = np.maximum(off2 - n * bias**2, 0.0) / (n - 1)
        of_rows = 2.0 * np.maximum(middle2 - middle**2 / n, 0.0) / (n - 1)
        error, of_methods = 0.5 * variance, 0.5 * n * bias**2
        icc = (of_rows - error) / (of_rows + error + 2.0 / n * (of_methods - error))
        reach = _LIMITS * np.sqrt(variance)
        return np.stack([bias, bias - reach, bias + reach, np.sqrt(off2 / n), icc], axis=-1)


_Scale = Callable[[Any], Any]
_SAME: tuple[_Scale, _Scale] = np.asarray, np.asarray
_SCALES: tuple[tuple[_Scale, _Scale], ...] = (_SAME,) * 3 + ((np.log, np.exp), (np.arctanh, np.tanh))
"""On which each figure's error is even, and back."""


class StepAgreement(NamedTuple):
    """How the steps of a gait agree with the true ones.

    Attributes:
        of_each: By the parameter's name, with its unit.
        missed: How many true steps, within the time of the steps that both have, were not found.
        extra: How many steps there are no true ones.
    """

    of_each: dict[str, tuple[str, Agreement]]
    missed: int
    extra: int


def step_agreement(found: Gait, true: Gait) -> StepAgreement | None:
    """Compares steps of one foot whose heel strikes are near each other; None without five such steps."""
    seconds = [step.seconds for step in true.steps if math.isfinite(step.seconds)]
    if not seconds:
        return None
    usual = float(np.median(seconds))
    pairs = [
        (step, nearest)
        for step in true.steps
        if (nearest := min(found.of_side(step.side), key=lambda s: abs(s.strike - step.strike), default=None))
        and abs(nearest.strike - step.strike) < _NEAR * usual
    ]
    if len(pairs) < _FEWEST_BLOCKS:
        return None
    first, last = (pairs[k][0].strike - side * _NEAR * usual for k, side in ((0, 1.0), (-1, -1.0)))
    extra, missed = (
        sum(first < step.strike < last for step in gait.steps) - len(pairs) for gait in (found, true)
    )
    stances = _stances(found), _stances(true)
    values = [
        [dict(_parameters(step, of)) for step, of in zip((own, of_truth), stances, strict=True)]
        for of_truth, own in pairs
    ]
    of_each = {}
    for name, unit in _UNITS.items():
        both = np.array([[own[name], of_truth[name]] for own, of_truth in values])
        both = both[np.isfinite(both).all(axis=1)]
        if len(both) >= _FEWEST_BLOCKS:
            of = agreement(*both.T)
            if name in _EVENTS:  # later and later, which is no agreement
                of = of._replace(icc=math.nan, icc_interval=_UNKNOWN)
            of_each[name] = unit, of
    return StepAgreement(of_each, missed, extra)


_EVENTS = "heel strike", "toe-off"
_UNITS = {
    **dict.fromkeys(_EVENTS, "s"),
    "step time": "s",
    "step length": "m",
    "step width": "m",
    "clearance": "m",
    "stance": "%",
    "cadence": "1/min",
    "speed": "m/s",
}
"""The parameters of a step, and their units."""


def _parameters(step: Step, stances: Mapping[Step, float]) -> Iterator[tuple[str, float]]:
    yield "heel strike", step.strike
    yield "toe-off", step.toe_off
    yield "step time", step.seconds
    yield "step length", step.length
    yield "step width", step.width
    yield "clearance", step.clearance
    yield "stance", 100.0 * stances.get(step, math.nan)
    yield "cadence", 60.0 / step.seconds
    yield "speed", step.progress / step.seconds


def _stances(gait: Gait) -> dict[Step, float]:
    """The share of its gait cycle in which a foot stands, by the step that begins the cycle."""
    return {
        a: (b.toe_off - a.strike) / (b.strike - a.strike)
        for side in SIDES
        for a, b in pairwise(gait.of_side(side))
        if a.walk == b.walk
    }
