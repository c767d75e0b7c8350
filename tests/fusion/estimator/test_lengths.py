"""Bone lengths within a view, and doubt about a whole view, as evidence on outliers."""

from dataclasses import replace

import numpy as np
import pytest

from fusion.body import KINECT_V2
from fusion.estimator.arrays import State, Views, new_model
from fusion.estimator.constants import Constants
from fusion.estimator.duplex_fusion import DuplexFusion
from fusion.estimator.measurements import outliers
from fusion.estimator.measurements.evidence import length_evidence
from fusion.facing.labels import Labels
from fusion.fuser import Fuser
from fusion.setup import FusionSetup
from fusion.skeleton import Skeleton
from fusion.support.array_fields import new_arrays
from tests.helpers.interpreted import interpreted
from tests.helpers.two_views import A_FROM_B, FRAME_NS, calibration_of, moving, noisy, pair_of, standing

BODY = KINECT_V2
J = len(BODY)
ROUNDING = 1e-9  # of a length in metres over length_error, after some operations in double precision


def two_views(random):
    """A standing person in both views, with errors of centimetres and of decimetres."""
    lengths = np.linalg.norm(standing(BODY) - standing(BODY)[BODY.parent_indices], axis=1)
    model = new_model(BODY, lengths, A_FROM_B)
    seen = new_arrays(Views, J=J)
    seen.positions[:] = standing(BODY) + random.normal(0.0, 0.01, (2, J, 3))
    far = random.random((2, J)) < 0.2
    seen.positions[far] += random.normal(0.0, 0.2, (int(far.sum()), 3))
    seen.states[:] = random.integers(0, 3, (2, J))
    seen.states[:, ::2] = 2
    seen.positions[seen.states == 0] = np.nan
    return model, seen


def test_the_worst_tracked_bone_at_a_joint_counts_against_it():
    random = np.random.default_rng(3)
    model, seen = two_views(random)
    image = random.normal(0.0, 1.0, (2, J))
    seen.log_odds[:] = image
    interpreted(length_evidence)(model, seen)
    k = model.constants
    costs = []
    for v in range(2):
        for i in range(J):
            bones = [(j, p) for j, p in enumerate(BODY.parents) if p >= 0 and i in (j, p)]
            errors = [
                abs(np.linalg.norm(seen.positions[v, j] - seen.positions[v, p]) - model.bone_lengths[j])
                / k.length_error
                for j, p in bones
                if seen.states[v, j] == seen.states[v, p] == 2
            ]
            costs.append(min(max(errors, default=0.0), k.length_limit))
            assert seen.log_odds[v, i] == pytest.approx(image[v, i] - costs[-1], abs=ROUNDING)
    assert max(costs) == k.length_limit, "some bones are decimetres off"
    assert 0.0 in costs, "some joints have no tracked bone"


def with_arm_near_trunk(skeleton, share):
    """The arm on its way, by this share, to a place beside the trunk where its joints are 2 cm apart."""
    at = skeleton.positions.astype(np.float64)
    for n, part in enumerate(("Elbow", "Wrist", "Hand", "HandTip", "Thumb")):
        there = at[BODY.joint("SpineMid")] + (0.15, 0.02 * n, 0.0)
        at[BODY.joint(f"{part}Right")] += share * (there - at[BODY.joint(f"{part}Right")])
    return Skeleton.of(BODY, at, skeleton.states, skeleton.time_ns)


def test_the_bones_tell_which_view_of_a_wrist_is_wrong():
    """No jump tells it: the arm slides away in B, a few centimetres per frame, while A is right.

    The bones bring at least a fifth; 29 % when this was written.
    """
    random = np.random.default_rng(0)
    pairs = [noisy(pair_of(BODY, at, t * FRAME_NS), random, 0.004) for t, at in enumerate(moving(BODY, 90))]
    bad = [
        replace(p, b=with_arm_near_trunk(p.b, (t - 69) / 15)) if 70 <= t < 85 else p
        for t, p in enumerate(pairs)
    ]
    setup = FusionSetup(calibration_of(BODY))
    wrist = BODY.joint("WristRight")

    def moved(constants):
        found = []
        for some in (pairs, bad):
            fuser = Fuser(setup)
            fuser._fusion = DuplexFusion(setup, constants)
            frames = fuser.fuse_sequence(some, Labels.with_sides(np.zeros((len(some), 2))))
            found.append([frame.positions[wrist] for frame in frames])
        return float(np.linalg.norm(np.array(found[0]) - found[1], axis=1)[70:85].mean())

    default = Constants.of(BODY)
    assert moved(default) < 0.8 * moved(default._replace(length_limit=0.0))


def test_doubt_about_most_joints_of_a_view_is_doubt_about_the_others():
    model, state, seen = (
        two_views(np.random.default_rng(3))[0],
        new_arrays(State, J=J),
        new_arrays(Views, J=J),
    )
    seen.states[0] = 2
    seen.trust[0, : J - 5] = 0.0
    seen.trust[0, J - 5 :] = 1.0
    prior = interpreted(outliers.prior_outlier)
    lasts, frame = model.constants.outlier_lasts, 1.0 / 30.0
    before = prior(model, state, seen, 0, J - 1, lasts)
    interpreted(outliers.store_outlier_state)(model, state, seen, frame)
    assert state.view_outlier_probability[0] == pytest.approx((J - 5) / J)
    k = model.constants
    expected = k.outlier + (k.outlier_lasts - k.outlier) * (J - 5) / J
    assert before == pytest.approx(k.outlier)
    assert prior(model, state, seen, 0, J - 1, lasts) == pytest.approx(expected)
    seen.states[0] = 0
    interpreted(outliers.store_outlier_state)(model, state, seen, frame)
    assert state.view_outlier_probability[0] == pytest.approx(0.9 * (J - 5) / J), (
        "it fades while the view sees no one"
    )
