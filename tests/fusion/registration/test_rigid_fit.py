"""Rigid and robust registration, knocked sensors, and what must not be taken for a knock."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from devices.recorded.two_recordings import RecordingChoice, read_two
from devices.simulated.kinect import simulated_pair
from devices.simulated.rig import Rig
from fusion.body import AZURE_KINECT, KINECT_V1, KINECT_V2
from fusion.calibration.calibration import Calibration
from fusion.calibration.calibrator import Calibrator
from fusion.calibration.offline import learn_from_recording
from fusion.calibration.online import CalibrationLearner
from fusion.errors import CalibrationError, FusionError
from fusion.joint_kinds import limbs
from fusion.registration.error_model import RobustFitSettings, disagreement
from fusion.registration.keyframes import Evidence, KeyframeSet, evidence_of, match_sides
from fusion.registration.knock import KnockSettings, fit_knock
from fusion.registration.lasting_errors import COMMON_SD, FrontalTurn, opposition, turned_back
from fusion.registration.refinement import held_out_gain
from fusion.registration.rigid_fit import Registration, fit_recording, fit_rigid, register, robust_fits
from fusion.registration.robust_fit import Prior, fit_robust
from fusion.rigid import RigidTransform, rotation_of, rotation_vector, through_quaternion
from fusion.skeleton import Skeleton, SkeletonPair
from tests.helpers.laws import pairs_at
from tests.helpers.two_views import A_FROM_B, FRAME_NS, moving, noisy, pair_of, standing

SEEDS = st.integers(0, 2**32 - 1)


@given(SEEDS)
def test_the_fit_finds_the_optimum_of_horns_quaternion(seed):
    rng = np.random.default_rng(seed)
    q = rng.normal(size=(20, 3))
    p = Rotation.random(rng=rng).apply(q) + rng.normal(size=3) + rng.normal(0, 0.05, (20, 3))
    weights = rng.uniform(0.1, 1.0, 20)
    centre_p, centre_q = weights @ p / weights.sum(), weights @ q / weights.sum()
    M = (weights[:, None] * (q - centre_q)).T @ (p - centre_p)
    cross = M - M.T
    vector = np.array((cross[1, 2], cross[2, 0], cross[0, 1]))
    N = np.block([[np.trace(M), vector], [vector[:, None], M + M.T - np.trace(M) * np.eye(3)]])
    w, x, y, z = np.linalg.eigh(N)[1][:, -1]
    fit = fit_rigid(p, q, weights)
    np.testing.assert_allclose(fit.rotation, Rotation.from_quat([x, y, z, w]).as_matrix(), atol=1e-12)
    np.testing.assert_allclose(fit.apply(centre_q), centre_p, atol=1e-12)


@given(
    st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3).filter(lambda axis: np.linalg.norm(axis) > 0.1),
    st.one_of(st.floats(0.0, np.pi), st.floats(0.0, 1e-6), st.floats(np.pi - 1e-6, np.pi)),
)
def test_rotations_about_vectors_are_scipys(axis, angle):
    vector = angle * np.array(axis) / np.linalg.norm(axis)
    R = rotation_of(vector)
    np.testing.assert_allclose(R, Rotation.from_rotvec(vector).as_matrix(), atol=1e-12)
    np.testing.assert_allclose(rotation_of(rotation_vector(R)), R, atol=1e-9)
    np.testing.assert_array_equal(rotation_of([vector, vector]), [R, R])
    np.testing.assert_array_equal(through_quaternion(R), Rotation.from_matrix(R).as_matrix())
    if angle < np.pi - 1e-3:
        np.testing.assert_allclose(rotation_vector(R), vector, atol=1e-9)


@given(SEEDS)
def test_a_mirrored_person_is_not_fitted_by_a_reflection(seed):
    rng = np.random.default_rng(seed)
    q = rng.normal(size=(20, 3))
    assert np.linalg.det(fit_rigid(q * [-1.0, 1.0, 1.0], q).rotation) == pytest.approx(1.0)


@pytest.mark.parametrize("body", [KINECT_V1, KINECT_V2, AZURE_KINECT], ids=str)
def test_the_sensors_place_is_recovered_to_the_precision_of_their_floats(body):
    pairs = [pair_of(body, truth) for truth in moving(body, 60)]
    found = register(pairs)
    # float32 at 4 m is exact to 2.4e-7 m; a body of 1 m turns that into at most as many radians
    assert found.a_from_b.angle_to(A_FROM_B) < 1e-6
    np.testing.assert_allclose(found.a_from_b.translation, A_FROM_B.translation, atol=3e-6)
    assert found.residual_median < 1e-6
    assert found.frames == 60


def test_joints_only_inferred_do_not_count():
    pair = pair_of(KINECT_V1, standing(KINECT_V1))
    wrong = np.array(pair.a.positions)
    wrong[5] += 0.5
    states = np.full(20, 2)
    states[5] = 1
    found = register([SkeletonPair(Skeleton.of(KINECT_V1, wrong, states), pair.b, 0)])
    assert found.residual_rms < 1e-6
    assert np.isnan(found.joint_residuals[5])


def test_the_joints_that_disagree_most_are_named():
    pairs = []
    for pair in (pair_of(KINECT_V1, truth) for truth in moving(KINECT_V1, 40)):
        wrong = np.array(pair.a.positions)
        wrong[KINECT_V1.joint("HandLeft")] += [0.0, 0.2, 0.0]
        pairs.append(SkeletonPair(Skeleton.of(KINECT_V1, wrong), pair.b, 0))
    (name, distance), *_ = register(pairs).worst_joints()
    assert name == "HandLeft"
    assert 0.1 < distance < 0.2


def test_the_stated_certainty_is_the_error_seen_over_many_trials():
    # joints with independent errors, one frame each: the standard error must describe the real errors
    rng = np.random.default_rng(3)
    truth, errors, stated = standing(KINECT_V1), [], []
    for _ in range(300):
        found = register([noisy(pair_of(KINECT_V1, truth), rng, 0.02)])
        rotation_error = found.a_from_b.rotation @ A_FROM_B.rotation.T
        errors.append(Rotation.from_matrix(rotation_error).as_rotvec())
        where = opposition(found.a_from_b, truth.mean(axis=0))
        lasting = FrontalTurn.of(KINECT_V1).sd_where(*where, known=False)
        opposed = np.hypot(1.0, 0.5 * (1.0 - where[1]))  # for whole limbs that are off; here no joint is
        stated.append(np.sqrt(found.rotation_sd**2 - lasting**2) / opposed)
    worst_axis = np.sqrt(np.linalg.eigvalsh(np.cov(np.array(errors).T))[-1])
    assert np.mean(stated) == pytest.approx(worst_axis, rel=0.12)  # 300 trials tell it to 4 %: three times


@given(SEEDS, st.sampled_from([KINECT_V1, KINECT_V2, AZURE_KINECT]))
def test_which_sensor_is_a_makes_no_difference(seed, body):
    rng = np.random.default_rng(seed)
    pairs = [noisy(pair_of(body, truth), rng, 0.02) for truth in moving(body, 5, seed % 100)]
    one = register(pairs, frontal=True)
    other = register([SkeletonPair(pair.b, pair.a, 0) for pair in pairs], frontal=True)
    assert one.a_from_b.angle_to(other.a_from_b.inverse()) < 1e-6
    np.testing.assert_allclose(one.a_from_b.translation, other.a_from_b.inverse().translation, atol=1e-6)
    assert one.translation_sd == pytest.approx(other.translation_sd)


@pytest.mark.parametrize("body", [KINECT_V1, KINECT_V2], ids=str)
def test_a_person_shown_too_frontal_is_turned_back(body):
    pose = evidence_of(body, [pair_of(body, standing(body))])
    turn = FrontalTurn.of(body).turn
    shown = turned_back(pose, A_FROM_B, -turn)  # as the trackers show it
    pair = SkeletonPair(Skeleton.of(body, shown.a[0]), Skeleton.of(body, shown.b[0]), 0)
    as_shown, found = (register([pair], frontal=frontal) for frontal in (False, True))
    sine, _ = opposition(A_FROM_B, standing(body).mean(axis=0))
    assert as_shown.a_from_b.angle_to(A_FROM_B) == pytest.approx(turn * sine, rel=1e-3)
    # the sensors' place as the pose shows it tells the axis: an error of second order
    assert found.a_from_b.angle_to(A_FROM_B) < turn**2
    assert as_shown.a_from_b.angle_to(A_FROM_B) < as_shown.rotation_sd
    np.testing.assert_allclose(turned_back(shown, A_FROM_B, turn).b, pose.b, atol=1e-6)


def test_the_depth_errors_of_sensors_that_face_each_other_add_up():
    truth = standing(AZURE_KINECT)
    truth[:, 1] -= truth[:, 1].mean()  # at the sensors' height
    middle = truth.mean(axis=0)
    stated = []
    for angle in (0.0, 90.0, 180.0):
        R = Rotation.from_euler("y", angle, degrees=True).as_matrix()
        a_from_b = RigidTransform.of(R, middle - R @ middle)
        b = Skeleton.of(AZURE_KINECT, a_from_b.inverse().apply(truth))
        stated.append(register([SkeletonPair(Skeleton.of(AZURE_KINECT, truth), b, 0)]).translation_sd)
    assert stated == pytest.approx([COMMON_SD, COMMON_SD * 1.5**0.5, COMMON_SD * 3.0], rel=1e-3)


def test_an_implausible_fit_is_reported():
    rng = np.random.default_rng(0)
    one = pair_of(KINECT_V1, standing(KINECT_V1))
    other = Skeleton.of(KINECT_V1, rng.normal(0, 1, (20, 3)))
    with pytest.raises(CalibrationError, match="cannot be right"):
        register([SkeletonPair(one.a, other, 0)])
    with pytest.raises(CalibrationError, match="No frame shows a person to both"):
        register([SkeletonPair(one.a, None, 0)])
    states = np.zeros(20)
    states[:4] = 2
    few = Skeleton.of(KINECT_V1, standing(KINECT_V1), states)
    with pytest.raises(CalibrationError, match="4, and registration needs 5"):
        register([SkeletonPair(few, one.b, 0)])
    line = np.linspace(0, 1, 20)[:, None] * [[1.0, 2.0, 3.0]]
    with pytest.raises(CalibrationError, match="one line"):
        fit_rigid(line, line)


def test_transforms_form_a_group():
    rng = np.random.default_rng(1)
    x, y = (RigidTransform.of(Rotation.random(rng=rng).as_matrix(), rng.normal(size=3)) for _ in range(2))
    points = rng.normal(size=(7, 3))
    np.testing.assert_allclose((x @ y).apply(points), x.apply(y.apply(points)), atol=1e-12)
    np.testing.assert_allclose(x.inverse().apply(x.apply(points)), points, atol=1e-12)
    assert (x @ x.inverse()).angle_to(RigidTransform.identity()) == pytest.approx(0.0, abs=1e-7)
    with pytest.raises(FusionError, match="reflection"):
        RigidTransform.of(np.diag([1.0, 1.0, -1.0]), np.zeros(3))


def test_outliers_and_missing_joints_hardly_move_it():
    p = moving(KINECT_V2, 120)
    rng = np.random.default_rng(0)
    q = A_FROM_B.inverse().apply(p) + rng.normal(0.0, 0.01, p.shape)
    bad = rng.random(p.shape[:2]) < 0.15
    q[bad] += np.array([0.3, 0.1, 0.0])
    q[rng.random(p.shape[:2]) < 0.1] = np.nan
    fit = fit_recording(p, q)
    # 10 mm of noise on 3000 points gives 0.2 mm; a fit that includes the outliers is 45 mm off
    assert np.linalg.norm(fit.apply(q[~bad]) - p[~bad], axis=1)[np.isfinite(q[~bad, 0])].mean() < 0.018
    assert np.linalg.norm(fit.apply(A_FROM_B.inverse().apply(p)) - p, axis=2).max() < 0.004


def test_too_few_points_of_a_recording_are_an_error():
    with pytest.raises(CalibrationError, match="at least 3 points; there are 2"):
        fit_recording(np.ones((2, 3)), np.ones((2, 3)))


@given(st.lists(st.integers(0, 40), min_size=1, max_size=5), SEEDS)
def test_fits_at_once_are_the_fits_one_by_one(known, seed):
    """The first ``known[k]`` points of set k are known; fewer than three leave the rotation open."""
    rng = np.random.default_rng(seed)
    p = rng.normal(size=(1, 40, 3))
    q = A_FROM_B.inverse().apply(p) + rng.normal(0.0, 0.01, (len(known), 40, 3))
    q[np.arange(40) >= np.array(known)[:, None]] = np.nan
    rotations, translations = robust_fits(p, q)
    for k, count in enumerate(known):
        if count < 3:
            assert np.isnan(rotations[k]).all()
            assert np.isnan(translations[k]).all()
        else:
            alone = fit_recording(p[0], q[k])
            np.testing.assert_allclose(rotations[k], alone.rotation, atol=1e-12)
            np.testing.assert_allclose(translations[k], alone.translation, atol=1e-12)


def test_points_on_a_line_leave_the_rotation_open():
    line = np.arange(9.0)[:, None] * np.array([[1.0, 2.0, 0.5]])
    assert np.isnan(robust_fits(line[None], line[None])[0]).all()
    assert np.isfinite(robust_fits(line[None], line[None] + np.eye(9, 3)[None])[0]).all()


# --- Robust registration on evidence with known truth.


SETTINGS = RobustFitSettings()


def turned(degrees, shift=0.0):
    """A_FROM_B, turned about the vertical and shifted."""
    off = RigidTransform.of(Rotation.from_euler("y", degrees, degrees=True).as_matrix(), [shift, 0.0, 0.0])
    return off @ A_FROM_B


def evidence(body, frames=120, noise=0.0):
    return evidence_of(
        body, pairs_at(np.arange(frames) * FRAME_NS, moving(body, frames), body, sd=noise, seed=1)
    )


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


def test_the_keyframe_set_stays_small_keeps_the_whole_volume_and_favours_no_sensor():
    frames, exchanged = (KeyframeSet(KINECT_V2, capacity=32) for _ in range(2))
    walk = moving(KINECT_V2, 40)
    for k in range(4000):
        at = walk[k % 40] + ([1.5, 0.0, 0.0] if k < 300 else [0.0, 0.0, 0.0])
        pair = pair_of(KINECT_V2, at, k * FRAME_NS)
        frames.add(pair)
        exchanged.add(SkeletonPair(pair.b, pair.a, pair.time_ns))
    assert len(frames) == 32
    assert frames.evidence.time_ns.tolist() == exchanged.evidence.time_ns.tolist()
    away = frames.evidence.a[:, KINECT_V2.root, 0] > 1.0
    assert 4 <= away.sum() <= 28  # a two-minute stay elsewhere did not push out the first place


def test_inferred_joints_count_less_and_untracked_ones_nothing():
    pair = pair_of(KINECT_V2, moving(KINECT_V2, 1)[0])
    states = np.full(25, 2)
    states[3], states[4] = 1, 0
    pair = SkeletonPair(Skeleton.of(KINECT_V2, pair.a.positions, states), pair.b, 0)
    weights = evidence_of(KINECT_V2, [pair]).weights[0]
    assert weights[4] == 0.0 < weights[3] < weights[5] == 1.0


# --- What counts as a knock: one rigid movement of a sensor, and no change of the views' biases.


KNOCK = RigidTransform.of(Rotation.from_euler("y", 2.0, degrees=True).as_matrix(), [0.0, 0.0, 0.0])
NEEDED = KnockSettings().needed(24)


def seen(first, bias, knock=None, turn=1.6, walks=1.0):
    """24 pairs of a person who walks about and turns; B has a bias by heading, and may be knocked."""
    rng = np.random.default_rng(first)
    pairs = []
    for k in range(first, first + 24):
        angle = turn * np.sin(0.3 * k)
        at = moving(KINECT_V2, 1)[0]
        centre = at.mean(axis=0)
        at = (at - centre) @ Rotation.from_euler("y", angle).as_matrix().T + centre
        at = at + walks * np.array([0.5 * np.sin(0.4 * k), 0.0, 0.4 * np.cos(0.25 * k)])
        b = at + bias(angle)
        views = [at, A_FROM_B.inverse().apply(b)]
        if knock is not None:
            views[1] = knock.inverse().apply(views[1])
        a, b = (Skeleton.of(KINECT_V2, view + rng.normal(0.0, 0.01, view.shape)) for view in views)
        pairs.append(SkeletonPair(a, b, 6 * k * FRAME_NS))
    return evidence_of(KINECT_V2, pairs)


def judged(before, after, in_force=A_FROM_B):
    prior = Prior(in_force, 0.035, 0.05)
    return fit_knock(KINECT_V2, before, after, in_force, RobustFitSettings(), prior)


def none(_):
    return np.zeros((25, 3))


def by_heading(angle):
    """A bias of 40 mm per joint that changes its sign where the person turns round."""
    lasting = np.random.default_rng(1).normal(0.0, 0.023, (25, 3))
    return np.asarray(lasting * np.sin(angle))


def test_a_turn_of_two_degrees_alone_is_a_knock_and_is_measured():
    found = judged(seen(0, by_heading), seen(24, by_heading, KNOCK))
    assert found.gain > NEEDED
    assert np.degrees(found.turn) == pytest.approx(2.0, abs=0.5)
    assert np.degrees(found.fit.a_from_b.angle_to(A_FROM_B @ KNOCK)) < 0.5


def test_biases_that_change_with_the_heading_are_no_knock():
    """Before, the person faces A; after, the person turns: the offset changes at all joints, not rigidly."""
    found = judged(seen(0, by_heading, turn=0.3), seen(24, by_heading, turn=1.6))
    assert found.gain < 0.5 * NEEDED


def test_a_registration_that_was_never_right_is_no_knock():
    turn = Rotation.from_euler("y", 6.0, degrees=True).as_matrix()
    off = RigidTransform.of(turn, [0.05, 0.0, 0.0]) @ A_FROM_B
    found = judged(seen(0, none), seen(24, none), off)
    assert found.gain < 0.1 * NEEDED


@given(st.floats(-8.0, 8.0), st.floats(0.0, 0.4), st.integers(0, 1))
def test_how_frontal_a_tracker_shows_somebody_who_stands_is_no_knock_and_hides_none(turn, place, moved):
    """B's view of who stands still after a walk is turned about the person, as Kinects v2 do."""
    still = seen(24, none, turn=0.0, walks=place)
    still = turned_back(still, A_FROM_B, np.radians(turn))
    if moved:
        still = still._replace(b=still.b + (0.0, 0.0, 0.25))
    found = judged(seen(0, by_heading), still)
    assert (KnockSettings().excess(found) > 1.0) == bool(moved)


def test_few_keyframes_before_need_a_greater_gain():
    settings = KnockSettings(gain=30.0, few=3.0)
    assert settings.needed(3) == 60.0
    assert settings.needed(300) == pytest.approx(30.3)


@pytest.mark.parametrize("name", ["real/kinect_v2_90deg_walk", "real_more/kinect_v2_90deg_steps_2"])
def test_nothing_was_moved_before_two_real_kinects(name, shared):
    """Offsets of 58 mm and more for seconds: the person turned, and a Kinect v2's biases with it."""
    folder = shared / name
    read = read_two(RecordingChoice(folder / "a.csv"), RecordingChoice(folder / "b.csv"))
    pairs = [pair.skeletons for pair in read.pairing.pairs]
    learned = learn_from_recording(read.body, pairs)
    assert learned.events == ()
    assert len(learned.spans) == 1

    calibrator = Calibrator(read.body)  # as live
    settled = next(k for k, pair in enumerate(pairs) if calibrator.watch(pair) and calibrator.final)
    learner = CalibrationLearner(read.body, calibrator.calibration)
    assert "knocked" not in kinds_of(observed(learner, pairs[settled:]))


def observed(learner, pairs):
    """What the learner changes with the pairs, of which repeated skeletons are stale."""
    found, before = [], SkeletonPair(None, None, -1)
    for pair in pairs:
        views = (pair.a, before.a), (pair.b, before.b)
        stale = tuple(now is not None and now.repeats(last) for now, last in views)
        found += learner.observe(pair, stale=stale)
        before = pair
    return found


def kinds_of(changes):
    return [change.kind for change in changes]


# --- Knocked sensors in simulated recordings, and situations that must not be taken for a knock.


TRUTH = Rig(angle_deg=90.0).a_from_b
KNOCK_NS = 8_000_000_000


@cache
def recorded(body, motion="walk", seed=3004, seconds=16.0):
    a, b, _ = simulated_pair(motion=motion, seed=seed, body=body, angle_deg=90.0, seconds=seconds)
    return [
        SkeletonPair(next(iter(x.people.values()), None), next(iter(y.people.values()), None), x.time_ns)
        for x, y in zip(a.frames(), b.frames(), strict=True)
    ]


def moved(pairs, old_from_new):
    """B's frames from ``KNOCK_NS`` on as the moved sensor sees them; it moves within 0.2 s."""
    turn, out = Rotation.from_matrix(old_from_new.rotation).as_rotvec(), []
    for pair in pairs:
        share = min(max((pair.time_ns - KNOCK_NS) / 2e8, 0.0), 1.0)
        if pair.b is None or share == 0.0:
            out.append(pair)
            continue
        now = RigidTransform.of(
            Rotation.from_rotvec(share * turn).as_matrix(), share * old_from_new.translation
        )
        b = Skeleton.of(pair.b.body, now.inverse().apply(pair.b.positions), pair.b.states, pair.b.time_ns)
        out.append(SkeletonPair(pair.a, b, pair.time_ns))
    return out


def changes(body, pairs, surface=None):
    """The learner after the pairs, and its changes. `surface`: what depth images show at first."""
    learner = CalibrationLearner(body, Calibration(body, TRUTH, body.nominal_lengths, "truth"))
    found = []
    if surface is not None:
        known = learner.known
        exact = Registration(surface, 0.0, 0.0, np.zeros(len(body)), 0.003, 4, body, 0.003, np.zeros(3))
        errors = np.array((0.02, 0.02))
        by_surface = replace(known.calibration, a_from_b=surface, registration=exact, depth_errors=errors)
        found += learner.see_surface(by_surface, known, 0)
    return learner, found + observed(learner, pairs)


KNOCKS = {
    "5 cm and 3°": RigidTransform.of(Rotation.from_euler("y", 3, degrees=True).as_matrix(), [0.05, 0, 0]),
    "10 cm and 5°": RigidTransform.of(
        Rotation.from_euler("yx", [-5, 1], degrees=True).as_matrix(), [0, 0.02, -0.1]
    ),
    "20 cm and 10°": RigidTransform.of(
        Rotation.from_euler("y", -10, degrees=True).as_matrix(), [-0.2, 0, 0.02]
    ),
}


@pytest.mark.parametrize("body", [KINECT_V2, AZURE_KINECT], ids=str)
@pytest.mark.parametrize("knock", KNOCKS)
def test_a_knocked_sensor_is_followed_within_two_seconds(body, knock):
    learner, found = changes(body, moved(recorded(body), KNOCKS[knock]))
    knocks = [change for change in found if change.kind == "knocked"]
    assert len(knocks) == 1
    assert KNOCK_NS < knocks[0].time_ns < KNOCK_NS + 2_000_000_000
    truth = TRUTH @ KNOCKS[knock]
    centre = truth.inverse().apply([0.0, 0.0, 2.6])
    # The skin offset that both trackers share leaves 20 mm (Azure) to 40 mm (v2) at the person; three seconds
    # of view bias leave 1 to 2 degrees.
    assert np.degrees(learner.calibration.a_from_b.angle_to(truth)) < 3.0
    before = np.linalg.norm(TRUTH.apply(centre) - truth.apply(centre))
    after = np.linalg.norm(learner.calibration.a_from_b.apply(centre) - truth.apply(centre))
    assert after < min(0.07, 0.6 * before)


def test_a_knock_after_the_surface_was_seen_is_the_same_knock():
    pairs = moved(recorded(AZURE_KINECT), KNOCKS["10 cm and 5°"])
    plain, _ = changes(AZURE_KINECT, pairs)
    learner, found = changes(AZURE_KINECT, pairs, RigidTransform.of(np.eye(3), [0.01, 0.0, -0.02]) @ TRUTH)
    assert kinds_of(found).count("knocked") == 1
    found, expected = learner.calibration.a_from_b, plain.calibration.a_from_b
    np.testing.assert_array_equal(found.rotation, expected.rotation)
    np.testing.assert_array_equal(found.translation, expected.translation)
    assert not learner.calibration.depth_errors.any()


@pytest.mark.parametrize(
    ("body", "motion"),
    [(KINECT_V2, "walk"), (AZURE_KINECT, "walk"), (AZURE_KINECT, "turn"), (KINECT_V2, "squat")],
    ids=str,
)
def test_an_untouched_sensor_is_not_taken_for_a_knocked_one(body, motion):
    assert "knocked" not in kinds_of(changes(body, recorded(body, motion))[1])


def test_a_mirrored_view_is_not_taken_for_a_knock():
    source = np.where(limbs(KINECT_V2) > 0, KINECT_V2.mirror, np.arange(25))
    pairs = []
    for pair in recorded(KINECT_V2):
        b = pair.b
        if b is not None and pair.time_ns > KNOCK_NS:
            b = Skeleton.of(KINECT_V2, b.positions[source], b.states[source], b.time_ns)
        pairs.append(SkeletonPair(pair.a, b, pair.time_ns))
    assert "knocked" not in kinds_of(changes(KINECT_V2, pairs)[1])


@pytest.mark.parametrize("fault", ["shift", "freeze", "snap"])
def test_a_trackers_fault_of_20_frames_is_not_taken_for_a_knock(fault):
    arm = [AZURE_KINECT.joint(n) for n in ("ELBOW_LEFT", "WRIST_LEFT", "HAND_LEFT", "HANDTIP_LEFT")]
    pairs = recorded(AZURE_KINECT)
    first = next(k for k, pair in enumerate(pairs) if pair.time_ns > KNOCK_NS and pair.b is not None)
    held, wrong = pairs[first].b, []
    for k, pair in enumerate(pairs):
        b = pair.b
        if b is not None and first <= k < first + 20:
            at = np.array(held.positions if fault == "freeze" else b.positions)
            if fault == "shift":
                at += [0.25, 0.0, 0.0]
            elif fault == "snap":
                at[arm] = at[AZURE_KINECT.root]
            b = Skeleton.of(AZURE_KINECT, at, b.states, b.time_ns)
        wrong.append(SkeletonPair(pair.a, b, pair.time_ns))
    assert "knocked" not in kinds_of(changes(AZURE_KINECT, wrong)[1])


def test_a_recording_with_a_knock_has_two_calibrations():
    knock = KNOCKS["10 cm and 5°"]
    start = Calibration(KINECT_V2, TRUTH, KINECT_V2.nominal_lengths, "truth")
    learned = learn_from_recording(KINECT_V2, moved(recorded(KINECT_V2), knock), start=start)
    assert kinds_of(learned.events) == ["knocked"]
    assert len(learned.spans) == 2
    assert abs(learned.spans[1].first_ns - KNOCK_NS) < 1_000_000_000
    for time_ns, truth in ((0, TRUTH), (15_000_000_000, TRUTH @ knock)):
        span = [span for span in learned.spans if span.first_ns <= time_ns][-1]
        # 2°, and what no upright person tells from a turn of R: each view leans away from its sensor by 1.7°
        assert np.degrees(span.calibration.a_from_b.angle_to(truth)) < 2.0 + np.sqrt(2.0) * 1.7
    first, second = (span.calibration.bone_lengths for span in learned.spans)
    np.testing.assert_array_equal(first, second)
