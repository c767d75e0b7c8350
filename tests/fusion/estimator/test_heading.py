"""Shoulders and hips turned towards the heading."""

import numpy as np
import pytest

from fusion.body import AZURE_KINECT, KINECT_V2
from fusion.calibration.calibration import Calibration
from fusion.compiling.kernels import kernel
from fusion.estimator.arrays import Views
from fusion.estimator.constants import Constants
from fusion.estimator.measurements.heading import turn_girdles
from fusion.facing.model import new_facing_model
from fusion.fuser import Fuser
from fusion.rigid import RigidTransform
from fusion.setup import FusionSetup
from fusion.skeleton import Skeleton, SkeletonPair
from fusion.support.array_fields import new_arrays
from tests.helpers.labelled_views import heading, simulated_views
from tests.helpers.two_views import standing


@kernel
def turn(model, up, sensors, views):
    turn_girdles(model, up, sensors, views)


def turned(body, to, confidence):
    """(J, 3) a person before and after, whose back is turned to both sensors, with the heading ``to``."""
    views = new_arrays(Views, J=len(body))
    before = standing(body)
    views.positions[:], views.states[:] = before, 2
    views.heading[:] = confidence * to
    sensors = np.stack([before.mean(axis=0) - 100.0 * to] * 2)
    turn(new_facing_model(body), np.array((0.0, -1.0, 0.0)), sensors, views)
    np.testing.assert_array_equal(views.positions[0], views.positions[1])
    return before, views.positions[0]


def test_a_certain_heading_turns_a_kinect_v2s_shoulders_and_hips():
    to = np.array((0.6, 0.0, 0.8))
    before, after = turned(KINECT_V2, to, 1.0)
    np.testing.assert_allclose(heading(KINECT_V2, after[None])[0], to, atol=1e-4)
    girdles = [[KINECT_V2.joint(n + side) for side in ("Left", "Right")] for n in ("Shoulder", "Hip")]
    for pair in girdles:
        np.testing.assert_allclose(after[pair].mean(axis=0), before[pair].mean(axis=0), atol=1e-12)
        widths = [np.linalg.norm(x[pair[0]] - x[pair[1]]) for x in (before, after)]
        assert widths[0] == pytest.approx(widths[1], abs=1e-12)
    rest = np.setdiff1d(np.arange(len(KINECT_V2)), np.ravel(girdles))
    np.testing.assert_array_equal(after[rest], before[rest])


def test_an_uncertain_heading_turns_them_little_and_other_trackers_not_at_all():
    to = np.array((0.6, 0.0, 0.8))
    for body, confidence, limit in ((KINECT_V2, 0.0, 0.25), (AZURE_KINECT, 1.0, 1e-5)):
        before, after = (heading(body, x[None])[0] for x in turned(body, to, confidence))
        assert np.arccos(min(before @ after, 1.0)) <= limit * np.arccos(before @ to)


def test_the_trunk_follows_a_walk_that_kinects_v2_report_askew():
    views = simulated_views("walk", seconds=20.0, seed=4002)
    calibration = Calibration(
        KINECT_V2, RigidTransform.of(np.eye(3), views.sensor_b), KINECT_V2.nominal_lengths, "known"
    )
    pairs = [
        SkeletonPair(
            Skeleton.of(KINECT_V2, views.a[t], views.states_a[t], time),
            Skeleton.of(KINECT_V2, views.b_in_a[t] - views.sensor_b, views.states_b[t], time),
            time,
        )
        for t, time in enumerate(views.time_ns.tolist())
    ]
    off = []
    for on in (True, False):
        fuser = Fuser(FusionSetup(calibration), Constants.of(KINECT_V2)._replace(heading=on))
        fused = np.array([fuser.update(pair).positions for pair in pairs])
        along = np.sum(heading(KINECT_V2, fused) * heading(KINECT_V2, views.truth), axis=1)
        off.append(np.degrees(np.arccos(np.clip(along[60:], -1.0, 1.0))))
    assert off[0].mean() < 0.8 * off[1].mean()
