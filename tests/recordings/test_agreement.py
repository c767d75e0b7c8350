"""Agreement of two methods: against scipy and an analysis of variance, and how often intervals cover."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import ttest_rel

from fusion.body import AZURE_KINECT
from recordings.comparing.agreement import agreement, step_agreement
from recordings.gait import SIDES, Gait
from recordings.gait.events import find_gait
from tests.helpers.footfalls import walker

SEEDS = st.integers(0, 2**32 - 1)
COUNTS = st.integers(6, 40)


def samples(seed, n, bias=1.0, noise=2.0, spread=8.0):
    random = np.random.default_rng(seed)
    true = spread * random.normal(size=n)
    return true + bias + noise * random.normal(size=n), true


def icc_by_variances(found, true):
    """ICC(A,1) by the mean squares of rows, columns and the rest (McGraw and Wong 1996)."""
    values = np.stack([found, true], axis=1)
    n, k = values.shape
    rows, columns = values.mean(axis=1), values.mean(axis=0)
    of_rows, of_columns = k * rows.var(ddof=1), n * columns.var(ddof=1)
    rest = values - rows[:, None] - columns + values.mean()
    error = np.sum(rest**2) / ((n - 1) * (k - 1))
    return (of_rows - error) / (of_rows + (k - 1) * error + k / n * (of_columns - error))


@given(seed=SEEDS, n=COUNTS)
def test_figures_are_those_of_the_sources(seed, n):
    found, true = samples(seed, n)
    of = agreement(found, true)
    off = found - true
    assert (of.n, of.bias) == (n, pytest.approx(off.mean()))
    assert of.limits == pytest.approx([off.mean() + side * 1.96 * off.std(ddof=1) for side in (-1, 1)])
    assert of.rmse == pytest.approx(math.sqrt(np.mean(off**2)))
    assert of.icc == pytest.approx(icc_by_variances(found, true))
    paired = ttest_rel(found, true).confidence_interval(0.95)
    assert of.bias_interval == pytest.approx((paired.low, paired.high))


@given(seed=SEEDS, n=COUNTS, factor=st.floats(0.1, 100.0), offset=st.floats(-100.0, 100.0))
def test_units_and_origin_do_not_matter(seed, n, factor, offset):
    found, true = samples(seed, n)
    one, other = agreement(found, true), agreement(factor * found + offset, factor * true + offset)
    for name in ("bias", "bias_interval", "limits", "rmse", "rmse_interval"):
        np.testing.assert_allclose(getattr(other, name), factor * np.array(getattr(one, name)), rtol=1e-6)
    np.testing.assert_allclose(other.icc_interval, one.icc_interval, rtol=1e-6)


@given(seed=SEEDS, n=COUNTS, repeats=st.integers(2, 5))
def test_values_of_a_block_count_once(seed, n, repeats):
    """Frames that repeat each other tell no more; as values of their own they seem to."""
    found, true = samples(seed, n)
    blocks = np.repeat(np.arange(n), repeats)
    one, many = agreement(found, true), agreement(found[blocks], true[blocks], blocks)
    np.testing.assert_allclose(many.bias_interval, one.bias_interval, rtol=1e-9)
    np.testing.assert_allclose(many.rmse_interval, one.rmse_interval, rtol=1e-9)
    alone = agreement(found[blocks], true[blocks])
    assert np.ptp(alone.rmse_interval) < np.ptp(many.rmse_interval)


def test_intervals_cover_the_true_figures():
    """Of 20 values; the jackknife covers a few per cent less than 95. One deviation of a share is 1.2 %."""
    bias, noise, spread = 1.0, 2.0, 8.0
    of_rows = 2.0 * (spread**2 + 0.25 * noise**2)
    error = 0.5 * noise**2
    true = {
        "bias_interval": bias,
        "rmse_interval": math.hypot(bias, noise),
        "icc_interval": (of_rows - error) / (of_rows + error + bias**2),
    }
    hits = dict.fromkeys(true, 0)
    for seed in range(400):
        of = agreement(*samples(seed, 20, bias, noise, spread))
        for name, value in true.items():
            low, high = getattr(of, name)
            hits[name] += low <= value <= high
    assert all(0.89 * 400 < count < 0.985 * 400 for count in hits.values()), hits


def test_few_values_have_no_interval():
    of = agreement(*samples(0, 4))
    assert np.isnan([of.bias_interval, of.rmse_interval, of.icc_interval, *of.limits_intervals]).all()
    assert np.isfinite([of.bias, of.rmse, of.icc, *of.limits]).all()


@pytest.fixture(scope="module")
def gait():
    times, positions = walker(12.0, 30.0)
    found = find_gait(AZURE_KINECT, times, positions, (0.0, -1.0, 0.0))
    assert len(found.steps) > 8
    return found


def test_steps_that_are_off_by_a_constant_have_it_as_bias(gait):
    off = Gait(
        tuple(
            step._replace(strike=step.strike + 0.03, toe_off=step.toe_off - 0.02, length=step.length + 0.05)
            for step in gait.steps
        )
    )
    found = step_agreement(off, gait)
    assert (found.missed, found.extra) == (0, 0)
    bias = {name: of.bias for name, (_, of) in found.of_each.items()}
    assert bias["heel strike"] == pytest.approx(0.03)
    assert bias["toe-off"] == pytest.approx(-0.02)
    assert bias["step length"] == pytest.approx(0.05)
    for name in ("step time", "step width", "speed", "cadence"):
        assert bias[name] == pytest.approx(0.0, abs=1e-12)
    cycles = [b.strike - a.strike for s in SIDES for a, b in pairwise(gait.of_side(s)) if a.walk == b.walk]
    assert bias["stance"] == pytest.approx(-5.0 * np.mean(1.0 / np.array(cycles)))
    assert math.isnan(found.of_each["heel strike"][1].icc)  # it grows with time, whatever a method finds
    assert {unit for unit, _ in found.of_each.values()} == {"s", "m", "%", "1/min", "m/s"}


def test_steps_of_one_of_both_are_counted(gait):
    fewer = replace(gait, steps=(*gait.steps[:4], *gait.steps[5:]))
    assert (step_agreement(fewer, gait).missed, step_agreement(fewer, gait).extra) == (1, 0)
    assert (step_agreement(gait, fewer).missed, step_agreement(gait, fewer).extra) == (0, 1)


def test_other_steps_do_not_agree(gait):
    apart = Gait(tuple(step._replace(strike=step.strike + 100.0) for step in gait.steps))
    assert step_agreement(apart, gait) is None
    assert step_agreement(Gait(()), gait) is step_agreement(gait, Gait(())) is None
