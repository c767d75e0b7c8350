"""Robust registration on evidence with known truth."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fusion.body import AZURE_KINECT, KINECT_V2
from fusion.errors import CalibrationError
from fusion.joint_kinds import limbs
from fusion.registration.error_model import RobustFitSettings, disagreement
from fusion.registration.keyframes import Evidence, KeyframeSet, evidence_of, match_sides
from fusion.registration.refinement import held_out_gain
from fusion.registration.rigid_fit import fit_rigid
from fusion.registration.robust_fit import fit_robust
from fusion.rigid import RigidTransform
from fusion.skeleton import Skeleton, SkeletonPair
from tests.helpers.two_views import A_FROM_B, FRAME_NS, moving, pair_of

SETTINGS = RobustFitSettings()


def turned(degrees, shift=0.0):
    """A_FROM_B, turned about the vertical and shifted."""
    off = RigidTransform.of(Rotation.from_euler("y", degrees, degrees=True).as_matrix(), [shift, 0.0, 0.0])
    return off @ A_FROM_B


def evidence(body, frames=120, noise=0.0):
    rng = np.random.default_rng(1)
    pairs = []
    for k, truth in enumerate(moving(body, frames)):
        a, b = (
            Skeleton.of(body, at + rng.normal(0.0, noise, at.shape), None, k * FRAME_NS)
            for at in (truth, A_FROM_B.inverse().apply(truth))
        )
        pairs.append(SkeletonPair(a, b, k * FRAME_NS))
    return evidence_of(body, pairs)


def joints_of(a, b):
    """(K, J, 3) joints that both views track, of a person who does not turn."""
    count = len(a)
    heading = np.tile([1.0, 0.0, 0.0], (count, 1))
    return Evidence(a, b, np.ones(a.shape[:2]), heading, np.arange(count) * FRAME_NS)


@pytest.mark.parametrize("body", [KINECT_V2, AZURE_KINECT], ids=str)
def test_flawless_views_give_the_transform_from_a_start_20_degrees_off(body):
    fit = fit_robust(body, evidence(body), turned(20.0, 0.2), SETTINGS, iterations=20)
    # float32 at 4 m is exact to 2.4e-7 m
    assert fit.a_from_b.angle_to(A_FROM_B) < 1e-5
    np.testing.assert_allclose(fit.a_from_b.translation, A_FROM_B.translation, atol=3e-5)


def test_a_third_of_the_frames_with_a_limb_elsewhere_moves_plain_least_squares_only():
    seen = evidence(KINECT_V2, noise=0.005)
    arm = [KINECT_V2.joint(name) for name in ("ElbowLeft", "WristLeft", "HandLeft", "HandTipLeft")]
    seen.b[::3, arm] += [0.0, 0.4, 0.2]
    plain = fit_rigid(seen.a.reshape(-1, 3), seen.b.reshape(-1, 3))
    robust = fit_robust(KINECT_V2, seen, turned(5.0), SETTINGS)
    assert np.degrees(plain.angle_to(A_FROM_B)) > 2.0
    assert np.degrees(robust.a_from_b.angle_to(A_FROM_B)) < 0.3


def test_many_frames_of_one_pose_do_not_drown_a_few_of_a_better_one():
    """A constant bias of each joint: 300 frames with the arms down, 20 in the start-up pose."""
    errors = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        still = moving(KINECT_V2, 1)[0]
        centre = still.mean(axis=0)
        narrow = centre + (still - centre) * [0.15, 1.0, 0.15]  # close to a vertical line
        bias = rng.normal(0.0, 0.03, still.shape)
        truth = np.array([narrow] * 300 + [still] * 20)
        truth += rng.normal(0.0, 0.003, truth.shape)
        seen = joints_of(truth + bias, A_FROM_B.inverse().apply(truth))
        plain = fit_rigid(seen.a.reshape(-1, 3), seen.b.reshape(-1, 3))
        robust = fit_robust(KINECT_V2, seen, A_FROM_B, SETTINGS)
        errors.append([plain.angle_to(A_FROM_B), robust.a_from_b.angle_to(A_FROM_B)])
    plain_error, robust_error = np.degrees(np.sqrt(np.mean(np.square(errors), axis=0)))
    assert robust_error < 0.6 * plain_error


def test_a_bias_of_the_trunk_counts_no_more_than_that_of_the_limbs():
    """Lasting biases: the fit is that of the joints' mean positions with equal weights."""
    still = moving(KINECT_V2, 1)[0]
    trunk = [KINECT_V2.joint(name) for name in ("SpineBase", "SpineMid", "SpineShoulder", "Neck", "Head")]
    biased = still.copy()
    biased[trunk] += [0.0, 0.0, -0.03]
    count = 4000  # so many frames that the noise's weights (1 to 4²) are small beside those of the biases
    b = A_FROM_B.inverse().apply(still)
    seen = joints_of(np.tile(biased, (count, 1, 1)), np.tile(b, (count, 1, 1)))
    equal = fit_rigid(biased, b)
    fit = fit_robust(KINECT_V2, seen, A_FROM_B, SETTINGS, iterations=20)
    middle = b.mean(axis=0)
    moved = np.linalg.norm(equal.apply(middle) - A_FROM_B.apply(middle))
    # A trunk that counts twice as much as a limb would move the person by 0.6 of this more.
    assert np.linalg.norm(fit.a_from_b.apply(middle) - equal.apply(middle)) < 0.1 * moved


def test_the_stated_uncertainty_does_not_shrink_with_frames_of_one_pose():
    still = moving(KINECT_V2, 1)[0]
    sds = []
    for count in (200, 2000):
        truth = np.array([still] * count)
        rng = np.random.default_rng(2)
        a, b = (at + rng.normal(0.0, 0.005, at.shape) for at in (truth, A_FROM_B.inverse().apply(truth)))
        seen = joints_of(a, b)
        sds.append(fit_robust(KINECT_V2, seen, A_FROM_B, SETTINGS).rotation_sd)
    # Ten times as many independent frames would divide it by √10 = 3.2. Jitter of the reported positions
    # counts as movement and therefore reduces the error a little.
    assert sds[1] > 0.6 * sds[0]


def test_exchanged_limbs_are_matched_to_the_other_views():
    seen = evidence(KINECT_V2, noise=0.01)
    part, mirror = limbs(KINECT_V2), KINECT_V2.mirror
    clean = seen.b.copy()
    arms, legs = np.flatnonzero(part == 1), np.flatnonzero(part == 2)
    seen.b[20:60, arms[:, None]] = seen.b[20:60, mirror[arms][:, None]]
    seen.b[40:90, legs[:, None]] = seen.b[40:90, mirror[legs][:, None]]
    codes = match_sides(KINECT_V2, seen, turned(3.0, 0.03))
    expected = np.zeros(len(codes), dtype=int)
    expected[20:60] |= 1
    expected[40:90] |= 2
    np.testing.assert_array_equal(codes, expected)
    np.testing.assert_array_equal(seen.b, clean)


def test_a_transform_does_not_gain_by_absorbing_noise_on_held_out_pairs():
    seen = evidence(KINECT_V2, frames=600, noise=0.01).chosen(slice(0, None, 6))
    fit = fit_robust(KINECT_V2, seen, A_FROM_B, SETTINGS)
    assert held_out_gain(KINECT_V2, seen, A_FROM_B, fit, SETTINGS) < 3.0
    assert held_out_gain(KINECT_V2, seen, turned(3.0, 0.05), fit, SETTINGS) > 3.0


def test_the_right_transform_disagrees_least():
    seen = evidence(KINECT_V2, noise=0.01)
    costs = [disagreement(KINECT_V2, seen, turned(off), SETTINGS, 0.01) for off in (-2.0, 0.0, 2.0)]
    assert costs[1] == min(costs)


def test_no_joint_in_common_is_an_error():
    seen = evidence(KINECT_V2)
    nothing = seen._replace(weights=np.zeros_like(seen.weights))
    with pytest.raises(CalibrationError, match="No joint"):
        fit_robust(KINECT_V2, nothing, A_FROM_B, SETTINGS)


def test_the_keyframe_set_stays_small_and_keeps_the_whole_volume():
    frames = KeyframeSet(KINECT_V2, capacity=32)
    walk = moving(KINECT_V2, 40)
    for k in range(4000):
        at = walk[k % 40] + ([1.5, 0.0, 0.0] if k < 300 else [0.0, 0.0, 0.0])
        frames.add(pair_of(KINECT_V2, at, k * FRAME_NS))
    assert len(frames) == 32
    away = frames.evidence.a[:, KINECT_V2.root, 0] > 1.0
    assert 4 <= away.sum() <= 28  # a two-minute stay elsewhere did not push out the first place


def test_inferred_joints_count_less_and_untracked_ones_nothing():
    pair = pair_of(KINECT_V2, moving(KINECT_V2, 1)[0])
    assert pair.a is not None
    states = np.full(25, 2)
    states[3], states[4] = 1, 0
    pair = SkeletonPair(Skeleton.of(KINECT_V2, pair.a.positions, states), pair.b, 0)
    weights = evidence_of(KINECT_V2, [pair]).weights[0]
    assert weights[4] == 0.0 < weights[3] < weights[5] == 1.0
