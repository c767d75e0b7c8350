"""The calibration learner: refinements, bones, and that the calibration does not get worse."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fusion.body import AZURE_KINECT as BODY
from fusion.calibration import comparison
from fusion.calibration.bone_lengths import bone_lengths_of, robust_bone_lengths
from fusion.calibration.calibration import Calibration
from fusion.calibration.comparison import RecentPlacement
from fusion.calibration.offline import learn_from_recording
from fusion.calibration.online import CalibrationLearner, LearnerSettings
from fusion.registration import refinement
from fusion.registration.keyframes import evidence_of
from fusion.registration.refinement import RefinementSettings
from fusion.registration.rigid_fit import Registration
from fusion.rigid import RigidTransform
from fusion.skeleton import Skeleton, SkeletonPair
from tests.helpers.laws import COSTLY
from tests.helpers.two_views import A_FROM_B, FRAME_NS, moving

OFF = (
    RigidTransform.of(Rotation.from_euler("y", 5.0, degrees=True).as_matrix(), [0.06, 0.0, -0.04]) @ A_FROM_B
)


def walk(count=450, noise=0.01, mirrored=False):
    rng = np.random.default_rng(6)
    pairs = []
    for k, truth in enumerate(moving(BODY, count)):
        place = truth + [0.6 * np.sin(0.02 * k), 0.0, 0.5 * np.cos(0.03 * k)]
        a, b = (
            view + rng.normal(0.0, noise, view.shape) for view in (place, A_FROM_B.inverse().apply(place))
        )
        if mirrored and (k // 60) % 2:
            b = b[BODY.mirror]
        time_ns = k * FRAME_NS
        pairs.append(
            SkeletonPair(
                Skeleton.of(BODY, a, None, time_ns),
                Skeleton.of(BODY, b, None, time_ns),
                time_ns,
            )
        )
    return pairs


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
    rng = np.random.default_rng(3)
    still = moving(BODY, 1)[0]
    pairs = []
    for k in range(300):
        a, b = (
            Skeleton.of(BODY, at + rng.normal(0.0, 0.003, at.shape), None, k * FRAME_NS)
            for at in (still, A_FROM_B.inverse().apply(still))
        )
        pairs.append(SkeletonPair(a, b, k * FRAME_NS))
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
