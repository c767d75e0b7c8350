"""None"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fusion.body import AZURE_KINECT, KINECT_V1, KINECT_V2
from fusion.errors import CalibrationError, FusionError
from fusion.joint_kinds import limbs
from fusion.registration.error_model import RobustFitSettings, disagreement
from fusion.registration.keyframes import Evidence, KeyframeSet, evidence_of, match_sides
from fusion.registration.lasting_errors import COMMON_SD, FrontalTurn, opposition, turned_back
from fusion.registration.refinement import held_out_gain
from fusion.registration.rigid_fit import fit_recording, fit_rigid, register, robust_fits
from fusion.registration.robust_fit import fit_robust
from fusion.rigid import RigidTransform, rotation_of, rotation_vector, through_quaternion
from fusion.skeleton import Skeleton, SkeletonPair
from tests.helpers.two_views import A_FROM_B, FRAME_NS, moving, pair_of, standing

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
    truth = standing(KINECT_V1)
    pair = pair_of(KINECT_V1, truth)
    assert pair.a is not None
    wrong = np.array(pair.a.positions)
    wrong[5] += 0.5
    states = np.full(20, 2)
    states[5] = 1
    found = register([SkeletonPair(Skeleton.of(KINECT_V1, wrong, states), pair.b, 0)])
    assert found.residual_rms < 1e-6
    assert np.isnan(found.joint_residuals[5])


def test_the_joints_that_disagree_most_are_named():
    pairs = []
    for truth in moving(KINECT_V1, 40):
        pair = pair_of(KINECT_V1, truth)
        assert pair.a is not None
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
        pair = pair_of(KINECT_V1, truth)
        assert pair.a is not None
        assert pair.b is not None
        noisy = SkeletonPair(
            Skeleton.of(KINECT_V1, pair.a.positions + rng.normal(0, 0.02, (20, 3))),
            Skeleton.of(KINECT_V1, pair.b.positions + rng.normal(0, 0.02, (20, 3))),
            0,
        )
        found = register([noisy])
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
    views = [(pair.a, pair.b) for pair in (pair_of(body, truth) for truth in moving(body, 5, seed % 100))]
    noisy = [
        [Skeleton.of(body, view.positions + rng.normal(0, 0.02, (len(body), 3))) for view in pair]
        for pair in views
    ]
    one = register([SkeletonPair(a, b, 0) for a, b in noisy], frontal=True)
    other = register([SkeletonPair(b, a, 0) for a, b in noisy], frontal=True)
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
    assert pair.a is not None
    states = np.full(25, 2)
    states[3], states[4] = 1, 0
    pair = SkeletonPair(Skeleton.of(KINECT_V2, pair.a.positions, states), pair.b, 0)
    weights = evidence_of(KINECT_V2, [pair]).weights[0]
    assert weights[4] == 0.0 < weights[3] < weights[5] == 1.0
