"""Jitter measures noise and not motion; the placement's figures start at zero."""

from __future__ import annotations

import numpy as np
import pytest

from recordings.writing.quality_log import jitter


def test_even_motion_has_no_jitter() -> None:
    steps = np.arange(30.0)[:, None, None] * np.array([0.01, -0.02, 0.03])
    assert jitter((steps + np.ones((1, 20, 3))).astype(np.float32)) < 1e-6


@pytest.mark.parametrize("sigma", [0.002, 0.02])
def test_white_noise_has_a_jitter_of_3_8_sigma(sigma: float) -> None:
    """p(t−1) − 2p(t) + p(t+1) has variance 6 σ² per axis; the norm's median is 1.538 such deviations."""
    noise = np.random.default_rng(0).normal(0.0, sigma, (2000, 20, 3)).astype(np.float32)
    # 40 000 correlated samples: the median is certain to about 1 %
    assert jitter(noise) == pytest.approx(np.sqrt(6.0) * 1.538 * sigma, rel=0.03)


def test_missing_joints_are_left_out() -> None:
    still = np.zeros((10, 5, 3), dtype=np.float32)
    still[3, 2] = np.nan
    assert jitter(still) == 0.0
    assert np.isnan(jitter(np.full((10, 5, 3), np.nan, dtype=np.float32)))
