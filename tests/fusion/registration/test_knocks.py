"""Knocked sensors, and what must not be taken for a knock."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from devices.recorded.two_recordings import RecordingChoice, read_two
from devices.simulated.kinect import simulated_pair
from devices.simulated.rig import Rig
from fusion.body import AZURE_KINECT, KINECT_V2
from fusion.calibration.calibration import Calibration
from fusion.calibration.calibrator import Calibrator
from fusion.calibration.offline import learn_from_recording
from fusion.calibration.online import CalibrationLearner
from fusion.joint_kinds import limbs
from fusion.registration.error_model import RobustFitSettings
from fusion.registration.keyframes import evidence_of
from fusion.registration.knock import KnockSettings, fit_knock
from fusion.registration.rigid_fit import Registration
from fusion.registration.robust_fit import Prior
from fusion.rigid import RigidTransform
from fusion.skeleton import Skeleton, SkeletonPair
from tests.helpers.two_views import A_FROM_B, FRAME_NS, moving

# --- What counts as a knock: one rigid movement of a sensor, and no change of the views' biases.


KNOCK = RigidTransform.of(Rotation.from_euler("y", 2.0, degrees=True).as_matrix(), [0.0, 0.0, 0.0])
NEEDED = KnockSettings().needed(24)


def seen(first, bias, knock=None, turn=1.6):
    """24 pairs of a person who walks about and turns; B has a bias by heading, and may be knocked."""
    rng = np.random.default_rng(first)
    pairs = []
    for k in range(first, first + 24):
        angle = turn * np.sin(0.3 * k)
        at = moving(KINECT_V2, 1)[0]
        centre = at.mean(axis=0)
        at = (at - centre) @ Rotation.from_euler("y", angle).as_matrix().T + centre
        at = at + [0.5 * np.sin(0.4 * k), 0.0, 0.4 * np.cos(0.25 * k)]
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

    calibrator, learner = Calibrator(read.body), None  # as live
    before = SkeletonPair(None, None, -1)
    kinds = set()
    for pair in pairs:
        if learner is None:
            found = calibrator.watch(pair)
            learner = CalibrationLearner(read.body, found) if found and calibrator.final else None
        elif pair.a is not None and pair.b is not None:
            stale = pair.a.repeats(before.a), pair.b.repeats(before.b)
            kinds |= {change.kind for change in learner.observe(pair, stale=stale)}
        before = pair
    assert learner is not None
    assert "knocked" not in kinds


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
    before = SkeletonPair(None, None, -1)
    for pair in pairs:
        stale = (
            pair.a is not None and pair.a.repeats(before.a),
            pair.b is not None and pair.b.repeats(before.b),
        )
        found += learner.observe(pair, stale=stale)
        before = pair
    return learner, found


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
    assert [change.kind for change in found].count("knocked") == 1
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
    _, found = changes(body, recorded(body, motion))
    assert not [change for change in found if change.kind == "knocked"]


def test_a_mirrored_view_is_not_taken_for_a_knock():
    source = np.where(limbs(KINECT_V2) > 0, KINECT_V2.mirror, np.arange(25))
    pairs = []
    for pair in recorded(KINECT_V2):
        b = pair.b
        if b is not None and pair.time_ns > KNOCK_NS:
            b = Skeleton.of(KINECT_V2, b.positions[source], b.states[source], b.time_ns)
        pairs.append(SkeletonPair(pair.a, b, pair.time_ns))
    _, found = changes(KINECT_V2, pairs)
    assert not [change for change in found if change.kind == "knocked"]


@pytest.mark.parametrize("fault", ["shift", "freeze", "snap"])
def test_a_trackers_fault_of_20_frames_is_not_taken_for_a_knock(fault):
    arm = [AZURE_KINECT.joint(n) for n in ("ELBOW_LEFT", "WRIST_LEFT", "HAND_LEFT", "HANDTIP_LEFT")]
    pairs = recorded(AZURE_KINECT)
    first = next(k for k, pair in enumerate(pairs) if pair.time_ns > KNOCK_NS and pair.b is not None)
    held, wrong = pairs[first].b, []
    assert held is not None
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
    _, found = changes(AZURE_KINECT, wrong)
    assert not [change for change in found if change.kind == "knocked"]


def test_a_recording_with_a_knock_has_two_calibrations():
    knock = KNOCKS["10 cm and 5°"]
    start = Calibration(KINECT_V2, TRUTH, KINECT_V2.nominal_lengths, "truth")
    learned = learn_from_recording(KINECT_V2, moved(recorded(KINECT_V2), knock), start=start)
    assert [change.kind for change in learned.events] == ["knocked"]
    assert len(learned.spans) == 2
    assert abs(learned.spans[1].first_ns - KNOCK_NS) < 1_000_000_000
    for time_ns, truth in ((0, TRUTH), (15_000_000_000, TRUTH @ knock)):
        span = [span for span in learned.spans if span.first_ns <= time_ns][-1]
        # 2°, and what no upright person tells from a turn of R: each view leans away from its sensor by 1.7°
        assert np.degrees(span.calibration.a_from_b.angle_to(truth)) < 2.0 + np.sqrt(2.0) * 1.7
    first, second = (span.calibration.bone_lengths for span in learned.spans)
    np.testing.assert_array_equal(first, second)
