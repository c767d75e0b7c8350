"""Calibration on the start-up pose of a recording and while pairs come in."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from devices.recorded.two_recordings import RecordingChoice, read_two
from devices.simulated.kinect import simulated_pair
from fusion.body import AZURE_KINECT, BLAZEPOSE, BODIES, KINECT_V1, KINECT_V2
from fusion.body import AZURE_KINECT as BODY
from fusion.calibration import comparison
from fusion.calibration.bone_lengths import bone_lengths_of, measure_bone_lengths, robust_bone_lengths
from fusion.calibration.calibration import Calibration, calibrate
from fusion.calibration.calibrator import Calibrator
from fusion.calibration.comparison import RecentPlacement
from fusion.calibration.offline import learn_from_recording
from fusion.calibration.online import CalibrationLearner, LearnerSettings
from fusion.calibration.start_up_pose import (
    StartUpPose,
    find_start_up_pose,
    limbs_apart,
)
from fusion.errors import CalibrationError
from fusion.registration import refinement, robust_fit
from fusion.registration.keyframes import evidence_of
from fusion.registration.refinement import RefinementSettings
from fusion.registration.rigid_fit import Registration
from fusion.rigid import RigidTransform
from fusion.skeleton import Skeleton, SkeletonPair, TrackingState
from tests.helpers.frame_pairs import paired
from tests.helpers.laws import COSTLY, exchanged, pairs_at
from tests.helpers.two_views import A_FROM_B, FRAME_NS, calibration_of, moving, pair_of, standing

# --- The pose, and bone lengths.


def pairs_of(truth, body=KINECT_V1):
    return [pair_of(body, at, t * FRAME_NS) for t, at in enumerate(truth)]


@COSTLY
@given(
    rate=st.sampled_from([5, 10, 15, 30, 60]),
    lost=st.sampled_from([0.0, 0.05, 0.2]),
    every=st.sampled_from([1, 2]),
    shift_ns=st.sampled_from([0, -(10**15), 2**61]),
    swap=st.booleans(),
    held=st.floats(0.5, 4.0),
    seed=st.integers(0, 999),
)
@example(rate=30, lost=0.05, every=1, shift_ns=0, swap=False, held=3.0, seed=0)
@example(rate=30, lost=0.0, every=2, shift_ns=0, swap=True, held=3.0, seed=0)
@example(rate=30, lost=0.0, every=1, shift_ns=0, swap=False, held=0.5, seed=0)
@example(rate=30, lost=0.0, every=1, shift_ns=0, swap=False, held=0.8, seed=0)
def test_a_recording_and_a_live_session_take_the_same_start_up_pose(
    rate, lost, every, shift_ns, swap, held, seed
):
    """Also where frames of a view are lost, at half the rate, exchanged, or at other times.

    The person stands, holds the pose, and stands again, with and without it moving on.
    """
    rng, apart = np.random.default_rng(seed), standing(KINECT_V1)
    pairs: list[SkeletonPair] = []
    for t in range(round(6.5 * rate)):
        posing = 1.0 <= t / rate < 1.0 + held
        at = (apart if posing else standing(KINECT_V1, arms_out=5.0)) + rng.normal(0.0, 0.003, (20, 3))
        pair = pair_of(KINECT_V1, at, shift_ns + round(t * 1e9 / rate))
        a, b = (pair.b, pair.a) if swap else (pair.a, pair.b)
        gone = rng.random(2) < lost
        a, b = None if gone[0] else a, None if gone[1] or t % every else b
        pairs.append(SkeletonPair(a, b, pair.time_ns))
    both = [pair for pair in pairs if pair.a is not None and pair.b is not None]
    start_ns, end_ns = (shift_ns + round(second * 1e9) for second in (1.0, 1.0 + held))
    posed = [pair for pair in both if start_ns <= pair.time_ns < end_ns]
    assume(np.diff([pair.time_ns for pair in posed]).max(initial=0) <= 10**9)
    found, how = find_start_up_pose(KINECT_V1, pairs)
    calibrator = Calibrator(KINECT_V1, frontal=False)
    told = [calibration for pair in pairs if (calibration := calibrator.watch(pair)) is not None]
    live = next((calibration for calibration in told if not calibration.provisional), None)
    if len(posed) < 15 or posed[-1].time_ns - posed[0].time_ns < 10**9:
        assert how.startswith("no start-up pose found")
        assert live is None or not live.how.startswith("start-up pose, ")
        return
    assert (
        how == f"start-up pose at {(found[0].time_ns - pairs[0].time_ns) * 1e-9:.1f} s, {len(found)} frames"
    )
    assert [pair.time_ns for pair in found] == [pair.time_ns for pair in posed[: len(found)]]
    lasts = posed[len(found) - 1].time_ns - posed[0].time_ns
    assert len(found) == len(posed) or (lasts >= 3 * 10**9 and len(found) >= 15)
    assert live.how == f"start-up pose, {len(found)} frames"
    a_from_b = A_FROM_B.inverse() if swap else A_FROM_B
    assert np.degrees(live.a_from_b.angle_to(a_from_b)) < 0.5


def test_a_second_without_both_views_ends_the_pose():
    pairs = pairs_of(np.array([standing(KINECT_V1)] * 60))
    late = [pair_of(KINECT_V1, standing(KINECT_V1), pair.time_ns + 3 * 10**9) for pair in pairs]
    alone = SkeletonPair(pairs[0].a, None, 61 * FRAME_NS)
    for tail in ([*late], [alone, *late]):
        found, _ = find_start_up_pose(KINECT_V1, [*pairs[:14], *tail])
        assert found[0].time_ns == late[0].time_ns, "fourteen pairs are too few"
        watcher = StartUpPose(KINECT_V1)
        held = [pose for pair in [*pairs, *tail] if (pose := watcher.watch(pair)) is not None]
        assert [pair.time_ns for pair in held[0]] == [pair.time_ns for pair in pairs]


def test_arms_hanging_down_are_no_start_up_pose():
    assert limbs_apart(Skeleton.of(KINECT_V1, standing(KINECT_V1)))
    assert not limbs_apart(Skeleton.of(KINECT_V1, standing(KINECT_V1, arms_out=5.0)))
    assert not limbs_apart(Skeleton.of(KINECT_V1, standing(KINECT_V1, legs_out=-4.0)))  # feet together
    pairs = pairs_of(np.array([standing(KINECT_V1, arms_out=5.0)] * 60))
    _, how = find_start_up_pose(KINECT_V1, pairs)
    assert how.startswith("no start-up pose found; calmest window")


def test_an_inferred_main_joint_breaks_the_pose():
    watcher = StartUpPose(KINECT_V1)
    states = np.full(20, 2)
    states[KINECT_V1.joint("KneeLeft")] = TrackingState.INFERRED
    for t in range(60):
        pair = pair_of(KINECT_V1, standing(KINECT_V1), t * FRAME_NS)
        hidden = Skeleton.of(KINECT_V1, standing(KINECT_V1), states)
        assert watcher.watch(SkeletonPair(hidden, pair.b, pair.time_ns)) is None


def test_without_a_start_up_pose_the_calmest_window_serves():
    rng = np.random.default_rng(1)
    truth = np.array([standing(KINECT_V1, arms_out=5.0)] * 150)
    truth[:60] += rng.normal(0, 0.05, (60, 20, 3))
    truth[125:] += rng.normal(0, 0.05, (25, 20, 3))
    held, how = find_start_up_pose(KINECT_V1, pairs_of(truth))
    assert held[0].time_ns >= 59 * FRAME_NS
    assert held[-1].time_ns <= 125 * FRAME_NS
    assert "no start-up pose" in how


@pytest.mark.parametrize("body", BODIES.values(), ids=str)
def test_bone_lengths_of_flawless_views_are_the_persons(body):
    calibration = calibrate(body, pairs_of(moving(body, 40), body), "test")
    np.testing.assert_allclose(calibration.bone_lengths, body.nominal_lengths, atol=2e-6)  # float32 at 4 m


def test_bone_lengths_average_both_views_before_measuring():
    # eq. (13): the length of the mean skeleton, not the mean of the lengths
    pair = pair_of(KINECT_V1, standing(KINECT_V1))
    elbow = KINECT_V1.joint("ElbowLeft")
    shifted = np.array(pair.a.positions)
    shift = np.array([0.0, 0.0, 0.2])
    shifted[elbow] += shift
    lengths = measure_bone_lengths(
        KINECT_V1, [SkeletonPair(Skeleton.of(KINECT_V1, shifted), pair.b, 0)], A_FROM_B
    )
    upper_arm = standing(KINECT_V1)[elbow] - standing(KINECT_V1)[KINECT_V1.parents[elbow]]
    assert lengths[elbow] == pytest.approx(np.linalg.norm(upper_arm + 0.5 * shift), abs=1e-6)


def test_an_unseen_bone_takes_its_mirror_image_or_an_adults_proportions():
    body = AZURE_KINECT
    scale = 0.9
    states = np.full(len(body), 2)
    states[[body.joint("FOOT_LEFT"), body.joint("HAND_LEFT"), body.joint("HAND_RIGHT")]] = 0
    truth = standing(body, scale * body.nominal_lengths)
    truth[body.joint("FOOT_RIGHT")] += [0.0, 0.05, 0.0]
    pairs = [
        SkeletonPair(
            Skeleton.of(body, truth, states), Skeleton.of(body, A_FROM_B.inverse().apply(truth), states), 0
        )
    ]
    lengths = measure_bone_lengths(body, pairs, A_FROM_B)
    assert lengths[body.bone("foot_left")] == lengths[body.bone("foot_right")]
    assert lengths[body.bone("hand_left")] == pytest.approx(
        scale * body.nominal_lengths[body.bone("hand_left")], rel=1e-4
    )


def test_no_person_in_both_views_is_reported():
    pair = pair_of(KINECT_V1, standing(KINECT_V1))
    with pytest.raises(CalibrationError, match="No frame shows a person to both sensors"):
        find_start_up_pose(KINECT_V1, [SkeletonPair(pair.a, None, 0)])


# --- Calibration while pairs come in: on the whole pose, on a pose seen in part, and on movement.


def watched(body, motion, angle, seconds, from_second=0.0, seed=3):
    """The calibrator after the recording or once it settled, the seconds until then, and the true R and t."""
    a, b, truth = simulated_pair(motion=motion, seed=seed, body=body, angle_deg=angle, seconds=seconds)
    pairs = [frame.skeletons for frame in paired(a.frames(), b.frames()).pairs]
    first_ns = pairs[0].time_ns + round(from_second * 1e9)
    calibrator = Calibrator(body)
    pair: SkeletonPair
    for pair in pairs:
        if pair.time_ns >= first_ns:
            calibrator.watch(pair)
            if calibrator.final:
                break
    return calibrator, (pair.time_ns - first_ns) * 1e-9, truth.a_from_b


def errors(found, truth):
    """Degrees, and metres at a person 2.6 m before both sensors."""
    centre = truth.inverse().apply(np.array([0.0, 0.0, 2.6]))
    apart = np.linalg.norm(found.apply(centre) - truth.apply(centre))
    return float(np.degrees(found.angle_to(truth))), float(apart)


@pytest.mark.parametrize(
    ("body", "angle", "most"),
    [(BLAZEPOSE, 120.0, 12.0), (AZURE_KINECT, 135.0, 12.0), (KINECT_V2, 120.0, 25.0)],
    ids=str,
)
def test_sensors_that_each_see_one_side_are_calibrated(body, angle, most):
    """On the pose after three seconds, or on the movement that follows: longer where the views lean."""
    calibrator, seconds, truth = watched(body, "badminton", angle, most)
    assert calibrator.final
    assert seconds < most
    turn, shift = errors(calibrator.calibration.a_from_b, truth)
    assert turn < 2.5 * np.degrees(calibrator.calibration.registration.rotation_sd)
    assert turn < 10.0  # a Kinect v2 turns a person at 60° by 15°
    assert shift < 0.1


@pytest.mark.parametrize(
    ("motion", "angle", "seed", "how"),
    [("squat", 120.0, 3400, "start-up pose seen in part, "), ("walk", 90.0, 3, "start-up pose, ")],
)
def test_a_pose_seen_in_part_is_enough_and_the_whole_pose_is_preferred(motion, angle, seed, how):
    calibrator, seconds, _ = watched(AZURE_KINECT, motion, angle, 5.0, seed=seed)
    assert seconds < 4.0
    assert calibrator.calibration.how.startswith(how)


@pytest.mark.parametrize(
    ("body", "angle", "seed"),
    [(KINECT_V2, 90.0, 5), (KINECT_V2, 120.0, 2), (KINECT_V2, 140.0, 0), (AZURE_KINECT, 180.0, 3)],
    ids=str,
)
def test_a_person_who_walks_needs_no_pose(body, angle, seed):
    """The recording begins after the pose. 16 keyframes 0.2 s apart and a second fit take 4 s. The views of
    Kinects v2 differ by up to 108 mm."""
    calibrator, seconds, truth = watched(body, "walk", angle, 17.0, from_second=5.0, seed=seed)
    assert calibrator.final
    assert calibrator.calibration.how.startswith("movement, ")
    assert 3.9 < seconds < 12.0
    turn, shift = errors(calibrator.calibration.a_from_b, truth)
    assert turn < 5.0
    assert shift < 0.1


@given(st.integers(0, 40), st.sets(st.integers(0, 29)), st.floats(0.6, 1.1))
def test_provisional_bones_are_a_persons_though_a_view_exchanges_sides(first, exchanges, size):
    """Of the average of both views, arms would be of 0.1 m."""
    calibrator, bones = Calibrator(KINECT_V2), KINECT_V2.bone_joints
    for k, at in enumerate(moving(KINECT_V2, 90)[first : first + 30] * size):
        pair = pair_of(KINECT_V2, at, k * FRAME_NS)
        if k in exchanges:
            a = Skeleton.of(KINECT_V2, pair.a.positions[KINECT_V2.mirror], None, pair.time_ns)
            pair = SkeletonPair(a, pair.b, pair.time_ns)
        calibrator.watch(pair)
        ratio = calibrator.calibration.bone_lengths[bones] / (size * KINECT_V2.nominal_lengths[bones])
        assert 0.6 < ratio.min() <= ratio.max() < 1.5


@pytest.mark.parametrize("late", [-9, 0, 9])
def test_movement_in_views_of_other_moments_is_not_accepted(late, shared):
    """0.3 s apart R would be wrong by 8 to 13°."""
    folder = shared / "real" / "kinect_v2_90deg_walk"
    read = read_two(RecordingChoice(folder / "a.csv"), RecordingChoice(folder / "b.csv"))
    pairs = [pair.skeletons for pair in read.pairing.pairs]
    calibrator = Calibrator(KINECT_V2)
    for now, other in zip(pairs[9:-9], pairs[9 + late : len(pairs) - 9 + late], strict=True):
        calibrator.watch(SkeletonPair(now.a, other.b, now.time_ns))
    assert calibrator.final == (late == 0)


def test_a_person_who_shows_too_little_leaves_the_calibration_provisional():
    """At 180° a squat seen from two sides leaves a solution turned by half a circle nearly as good."""
    calibrator, _, _ = watched(KINECT_V2, "squat", 180.0, 12.0)
    assert not calibrator.final


def test_no_pair_waits_for_more_than_one_start_of_the_fit(monkeypatch):
    """All starts together take longer than a frame; each is a rough fit and a better one."""
    fits, of_pairs = [0], []
    fit, watch = robust_fit.fit_robust, Calibrator.watch

    def counted(*given, **more):
        fits[0] += 1
        return fit(*given, **more)

    def watched_closely(calibrator, pair):
        fits[0] = 0
        found = watch(calibrator, pair)
        of_pairs.append(fits[0])
        return found

    monkeypatch.setattr(robust_fit, "fit_robust", counted)
    monkeypatch.setattr(Calibrator, "watch", watched_closely)
    watched(KINECT_V2, "walk", 90.0, 12.0, from_second=5.0)
    assert sum(of_pairs) >= 4
    assert max(of_pairs) <= 2


def test_calibration_is_provisional_at_first_and_settles_on_the_start_up_pose():
    calibrator = Calibrator(KINECT_V2, frontal=False)
    found = []
    for t, joints in enumerate(moving(KINECT_V2, 120)):
        calibration = calibrator.watch(pair_of(KINECT_V2, joints, t * FRAME_NS))
        if calibration is not None:
            found.append((t, calibration.how.split(",")[0]))
    assert [how for _, how in found] == ["provisional", "provisional", "start-up pose"]
    assert found[0][0] == 0
    assert calibrator.final
    np.testing.assert_allclose(calibrator.calibration.bone_lengths, KINECT_V2.nominal_lengths, atol=1e-5)


def test_an_earlier_calibration_is_kept():
    before = calibration_of(KINECT_V2)
    calibrator = Calibrator(KINECT_V2, before)
    for t, joints in enumerate(moving(KINECT_V2, 60)):
        assert calibrator.watch(pair_of(KINECT_V2, joints, t * FRAME_NS)) is None
    assert calibrator.calibration is before


# --- The calibration learner: refinements, bones, and that the calibration does not get worse.


OFF = (
    RigidTransform.of(Rotation.from_euler("y", 5.0, degrees=True).as_matrix(), [0.06, 0.0, -0.04]) @ A_FROM_B
)


def walk(count=450, noise=0.01, mirrored=False):
    """Pairs of a person who walks about; in B left and right are exchanged every other two seconds."""
    k = np.arange(count)
    way = np.stack([0.6 * np.sin(0.02 * k), 0.0 * k, 0.5 * np.cos(0.03 * k)], axis=1)
    pairs = pairs_at(k * FRAME_NS, moving(BODY, count) + way[:, None], BODY, sd=noise, seed=6)
    return [replace(p, b=exchanged(p.b)) if mirrored and (k // 60) % 2 else p for k, p in enumerate(pairs)]


def learned(pairs, start, settings=None):
    learner = CalibrationLearner(
        BODY, Calibration(BODY, start, BODY.nominal_lengths * 1.1, "start"), settings
    )
    return learner, [change for pair in pairs for change in learner.observe(pair)]


def test_a_start_5_degrees_off_is_refined_and_says_how_certain_it_is():
    learner, changes = learned(walk(), OFF)
    error = learner.calibration.a_from_b.angle_to(A_FROM_B)
    assert np.degrees(error) < 0.5
    registration = learner.calibration.registration
    assert error < 3.0 * registration.rotation_sd < np.radians(5.0)
    refined = [change for change in changes if change.kind == "refined"]
    assert 1 <= len(refined) <= 15  # at most one a second
    assert refined[-1].calibration.a_from_b.angle_to(A_FROM_B) == error
    assert "Registration refined" in refined[0].event


def test_mirrored_spells_of_one_view_do_not_mislead():
    learner, _ = learned(walk(mirrored=True), OFF)
    assert np.degrees(learner.calibration.a_from_b.angle_to(A_FROM_B)) < 0.7


def test_stale_and_one_sided_pairs_teach_nothing():
    learner = CalibrationLearner(BODY, Calibration(BODY, OFF, BODY.nominal_lengths, "start"))
    for pair in walk():
        assert learner.observe(pair, stale=(False, True)) == []
        assert learner.observe(SkeletonPair(pair.a, None, pair.time_ns)) == []
    assert learner.calibration.a_from_b is OFF


def test_the_bones_of_a_person_who_stands_still_are_learned_from_a_recording():
    """Ten seconds of one pose hold too few keyframes for a registration, but many moments."""
    still = moving(BODY, 1)[0]
    pairs = pairs_at(np.arange(300) * FRAME_NS, np.tile(still, (300, 1, 1)), BODY, sd=0.003, seed=3)
    start = Calibration(BODY, A_FROM_B, BODY.nominal_lengths * 1.1, "start")
    found = learn_from_recording(BODY, pairs, start=start).spans[0].calibration
    error = np.abs(found.bone_lengths - bone_lengths_of(BODY, still))[BODY.bone_joints]
    # Jitter of 3 mm per axis at both ends lengthens a bone of 0.1 m by (3² + 3²)/100 = 0.2 mm; the median of
    # some 250 pairs adds 1.25 · 4.2/√500 = 0.24 mm of noise; short bones (thumb, 4 cm) 0.5 mm.
    assert error.max() < 0.0015


def test_one_sides_outliers_do_not_lengthen_a_bone_and_sides_agree():
    pairs = walk(200, noise=0.003)
    evidence = evidence_of(BODY, pairs)
    evidence.a[::4, BODY.joint("WristLeft")] += [0.0, 0.5, 0.0]
    lengths = robust_bone_lengths(BODY, evidence, A_FROM_B, BODY.nominal_lengths)
    np.testing.assert_allclose(lengths, lengths[BODY.mirror])
    forearm = BODY.joint("WristLeft")
    true = bone_lengths_of(BODY, moving(BODY, 1)[0])[forearm]
    assert abs(lengths[forearm] - true) < 0.003


@pytest.mark.parametrize("longer", [1.049, 1.0518, 1.06])
def test_both_sides_of_a_bone_are_told_apart_or_neither(longer):
    """Two sides that differ by at most 5 % get one length; others get a length each."""
    pairs = walk(200, noise=0.0)
    evidence = evidence_of(BODY, pairs)
    elbow, wrist = BODY.joint("ElbowLeft"), BODY.joint("WristLeft")
    other = BODY.joint("WristRight")
    for view in (evidence.a, evidence.b):
        forearm = view[:, wrist] - view[:, elbow]
        right = np.linalg.norm(view[:, other] - view[:, BODY.joint("ElbowRight")], axis=1)
        forearm *= (longer * right / np.linalg.norm(forearm, axis=1))[:, None]
        view[:, wrist] = view[:, elbow] + forearm
    lengths = robust_bone_lengths(BODY, evidence, A_FROM_B, BODY.nominal_lengths)
    assert lengths[wrist] / lengths[other] == pytest.approx(longer if longer > 1.05 else 1.0, abs=1e-4)


def test_a_recording_whose_start_is_half_a_turn_off_is_registered_from_the_walk():
    wrong = RigidTransform.of(Rotation.from_euler("y", 150.0, degrees=True).as_matrix(), [0.0, 0.0, 4.0])
    start = Calibration(BODY, wrong, BODY.nominal_lengths, "wrong")
    found = learn_from_recording(BODY, walk(mirrored=True), start=start)
    assert np.degrees(found.spans[0].calibration.a_from_b.angle_to(A_FROM_B)) < 0.7


def test_learning_twice_gives_the_same_to_the_last_bit():
    first, _ = learned(walk(200), OFF)
    second, _ = learned(walk(200), OFF)
    np.testing.assert_array_equal(first.calibration.a_from_b.rotation, second.calibration.a_from_b.rotation)


@pytest.mark.parametrize(("surer", "later"), [(0.7, 1), (0.0, 2)])
def test_a_refinement_in_steps_is_the_same_some_pairs_later(monkeypatch, surer, later):
    fits = []
    fit = refinement.fit_robust
    monkeypatch.setattr(refinement, "fit_robust", lambda *of, **more: (fits.append(1), fit(*of, **more))[1])
    pairs = walk(180)
    start = Calibration(BODY, OFF, BODY.nominal_lengths, "start")
    in_steps, whole = (
        CalibrationLearner(
            BODY, start, LearnerSettings(refinement=RefinementSettings(in_steps=how, surer=surer))
        )
        for how in (True, False)
    )
    each, stepwise, at_once = [], [], []
    for pair in pairs:
        before = len(fits)
        stepwise += [change for change in in_steps.observe(pair) if change.kind == "refined"]
        each.append(len(fits) - before)
        if stepwise:
            break
    assert max(each) == 1, "one fit of the three with each pair"
    for pair in pairs:
        at_once += [change for change in whole.observe(pair) if change.kind == "refined"]
    assert stepwise[0].time_ns - at_once[0].time_ns == later * FRAME_NS
    np.testing.assert_array_equal(
        stepwise[0].calibration.a_from_b.rotation, at_once[0].calibration.a_from_b.rotation
    )
    np.testing.assert_array_equal(
        stepwise[0].calibration.a_from_b.translation, at_once[0].calibration.a_from_b.translation
    )


def test_a_walk_makes_a_right_calibration_certain_though_no_fit_of_half_of_it_is_better():
    """Else "walk a few steps" is said to somebody who walks."""
    unknown = np.full(len(BODY), np.nan)
    uncertain = Registration(A_FROM_B, 0.03, 0.03, unknown, np.radians(2.2), 60, BODY, 0.03, np.zeros(3))
    start = Calibration(BODY, A_FROM_B, BODY.nominal_lengths, "start-up pose", uncertain)
    learner = CalibrationLearner(BODY, start)
    for pair in walk(180):
        learner.observe(pair)
    found = learner.calibration
    assert found.registration.rotation_sd < 0.5 * uncertain.rotation_sd
    assert found.a_from_b.angle_to(A_FROM_B) < 2.5 * found.registration.rotation_sd


def with_surface(learner, a_from_b, sd=0.01):
    """What a fit of the surface would give the learner, and what it would start from."""
    known = learner.known
    exact = Registration(a_from_b, 0.003, 0.003, np.full(len(BODY), np.nan), sd, 4, BODY, 0.01, np.zeros(3))
    by_surface = replace(
        known.calibration, a_from_b=a_from_b, registration=exact, depth_errors=np.array((0.01, -0.02))
    )
    return by_surface, known


@given(
    turn=st.floats(-3.0, 3.0),
    shift=st.floats(-0.05, 0.05),
    at=st.integers(60, 400),
    sd=st.floats(0.003, 0.02),
)
@example(turn=0.5, shift=0.01, at=60, sd=0.006)
@COSTLY
def test_the_surface_is_in_force_until_a_sensor_is_moved(turn, shift, at, sd):
    """The joints are refined beside it, as if it were not there."""
    pairs = walk()
    plain, _ = learned(pairs, OFF)
    learner, _ = learned(pairs[:at], OFF)
    R = Rotation.from_euler("x", turn, degrees=True).as_matrix()
    found, known = with_surface(learner, RigidTransform.of(R, [0.0, shift, 0.004]) @ A_FROM_B, sd)
    changes = learner.see_surface(found, known, pairs[at].time_ns)
    assert [change.kind for change in changes] == ["refined"]
    assert learner.see_surface(found, known, pairs[at].time_ns) == []
    assert all(learner.observe(pair) == [] or learner.calibration.a_from_b is found.a_from_b
               for pair in pairs[at:])  # fmt: skip
    assert learner.calibration.a_from_b is found.a_from_b
    np.testing.assert_array_equal(learner.calibration.depth_errors, found.depth_errors)
    np.testing.assert_array_equal(learner.calibration.bone_lengths, plain.calibration.bone_lengths)
    joints = learner.known.calibration.a_from_b
    np.testing.assert_array_equal(joints.rotation, plain.calibration.a_from_b.rotation)
    np.testing.assert_array_equal(joints.translation, plain.calibration.a_from_b.translation)


def test_too_little_of_a_surface_changes_nothing():
    learner, _ = learned(walk(120), OFF)
    known, before = learner.known, learner.calibration
    few = replace(known.calibration, how="both sensors see too little of one surface")
    assert learner.see_surface(few, known, 0) == []
    assert learner.calibration is before


def test_depth_errors_that_a_calibration_knows_are_no_wrong_placement():
    """A fit of joints puts them into t."""
    far, known = np.array((0.03, 0.03)), Calibration(BODY, A_FROM_B, BODY.nominal_lengths, "by surfaces")
    found = []
    for errors in (np.zeros(2), far):
        recent = RecentPlacement(BODY)
        for pair in walk(120):
            views = (
                Skeleton.of(
                    BODY, at * (1.0 + by / np.linalg.norm(at, axis=1, keepdims=True)), None, pair.time_ns
                )
                for at, by in zip((pair.a.positions, pair.b.positions), far, strict=True)
            )
            recent.add(SkeletonPair(*views, pair.time_ns))
        found.append(recent.off(replace(known, depth_errors=errors)).shift)
    assert found[0] > 0.02
    assert found[1] < 0.005


def test_the_placement_of_the_last_seconds_is_found_with_one_fit_per_pair(monkeypatch):
    fits, most = [], 0
    for name in ("fit_robust", "with_frontal_sd"):
        fit = getattr(comparison, name)
        monkeypatch.setattr(comparison, name, lambda *of, _fit=fit: (fits.append(1), _fit(*of))[1])
    recent, at_once = RecentPlacement(BODY, in_steps=True), RecentPlacement(BODY)
    off_by = Calibration(BODY, OFF, BODY.nominal_lengths, "off")
    for pair in walk(120):
        recent.add(pair)
        at_once.add(pair)
        before = len(fits)
        off = recent.off(off_by)
        most = max(most, len(fits) - before)
    assert most == 1
    np.testing.assert_allclose(off.turn, A_FROM_B.angle_to(OFF), atol=np.radians(0.5))
    np.testing.assert_allclose(at_once.off(off_by).turn, off.turn, atol=np.radians(0.5))
