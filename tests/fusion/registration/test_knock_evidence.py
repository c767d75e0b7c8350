"""What counts as a knock: one rigid movement of a sensor, and no change of the views' biases."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from devices.recorded.two_recordings import RecordingChoice, read_two
from fusion.body import KINECT_V2
from fusion.calibration.calibrator import Calibrator
from fusion.calibration.offline import learn_from_recording
from fusion.calibration.online import CalibrationLearner
from fusion.registration.error_model import RobustFitSettings
from fusion.registration.keyframes import evidence_of
from fusion.registration.knock import KnockSettings, fit_knock
from fusion.registration.robust_fit import Prior
from fusion.rigid import RigidTransform
from fusion.skeleton import Skeleton, SkeletonPair
from tests.helpers.two_views import A_FROM_B, FRAME_NS, moving

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
