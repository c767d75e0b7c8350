"""The baseline's registration is exact on clean data and robust against outliers."""

from __future__ import annotations

import numpy as np
import pytest

from fusion.body import KINECT_V2
from fusion.errors import CalibrationError
from fusion.evaluation.fixed_registration import fit_recording
from tests.benchmarks.baselines import oracle
from tests.helpers.two_views import A_FROM_B, moving


def test_clean_views_give_the_transform_to_rounding() -> None:
    p = moving(KINECT_V2, 60)
    fit = fit_recording(p, A_FROM_B.inverse().apply(p))
    assert fit.angle_to(A_FROM_B) < 1e-7  # arccos of 1 - 1e-16 is 1.5e-8
    np.testing.assert_allclose(fit.translation, A_FROM_B.translation, atol=1e-9)


def test_outliers_and_missing_joints_hardly_move_it() -> None:
    p = moving(KINECT_V2, 120)
    rng = np.random.default_rng(0)
    q = A_FROM_B.inverse().apply(p) + rng.normal(0.0, 0.01, p.shape)
    bad = rng.random(p.shape[:2]) < 0.15
    q[bad] += np.array([0.3, 0.1, 0.0])
    q[rng.random(p.shape[:2]) < 0.1] = np.nan
    fit = fit_recording(p, q)
    # 10 mm of noise on 3000 points: 0.2 mm; a mean over all would be off by 15 % of 300 mm
    assert np.linalg.norm(fit.apply(q[~bad]) - p[~bad], axis=1)[np.isfinite(q[~bad, 0])].mean() < 0.018
    assert np.linalg.norm(fit.apply(A_FROM_B.inverse().apply(p)) - p, axis=2).max() < 0.004


def test_too_few_points_are_an_error() -> None:
    with pytest.raises(CalibrationError, match="at least 3 points; there are 2"):
        fit_recording(np.ones((2, 3)), np.ones((2, 3)))


def test_the_oracle_takes_the_nearer_view_of_each_joint() -> None:
    truth = np.zeros((4, 3, 3))
    a, b = truth + 0.02, truth + 0.01
    a[:, 0] = 0.0
    b[2, 1] = np.nan  # holds its last position
    a[3, 2] = np.nan
    found = oracle(a, b, truth)
    np.testing.assert_array_equal(found[:, 0], 0.0)
    np.testing.assert_array_equal(found[:, 1:], 0.01)
