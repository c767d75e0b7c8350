"""The fit of the registration's constants measures what it says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fusion.body import KINECT_V2
from fusion.rigid import RigidTransform
from fusion.skeleton import SkeletonPair
from tests.experiments.fit_registration import KNOCK, Recording, errors_of, knocked
from tests.helpers.two_views import A_FROM_B, calibration_of, pair_of, standing

SECOND = 1_000_000_000


def recording() -> Recording:
    """Four seconds of a person who stands still."""
    pairs: list[SkeletonPair] = [pair_of(KINECT_V2, standing(KINECT_V2), k * SECOND // 10) for k in range(41)]
    return Recording("still", KINECT_V2, pairs, A_FROM_B, calibration_of(KINECT_V2))


def test_errors_are_those_of_the_transform() -> None:
    one = recording()
    assert errors_of(one, one.start)[:2] == pytest.approx((0.0, 0.0), abs=1e-6)
    turned = RigidTransform.of(
        Rotation.from_euler("y", 2.0, degrees=True).as_matrix() @ A_FROM_B.rotation,
        A_FROM_B.translation + [0.03, 0.0, 0.04],
    )
    degrees, millimetres, _ = errors_of(one, replace(one.start, a_from_b=turned))
    assert degrees == pytest.approx(2.0, abs=1e-6)
    assert millimetres == pytest.approx(50.0, abs=1e-6)


def test_after_a_knock_the_moved_sensor_sees_the_same_person() -> None:
    one = recording()
    pairs, at_ns = knocked(one)
    assert at_ns == 2 * SECOND
    assert pairs[20] == one.pairs[20]
    seen, before = pairs[-1].b, one.pairs[-1].b
    assert seen is not None
    assert before is not None
    # float32 metres at 3 m
    np.testing.assert_allclose(KNOCK.apply(seen.positions), before.positions, rtol=0, atol=1e-6)
