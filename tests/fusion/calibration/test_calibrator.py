"""Calibration while pairs come in: on the whole pose, on a pose seen in part, and on movement."""

import numpy as np
import pytest

from devices.simulated.kinect import simulated_pair
from fusion.body import AZURE_KINECT, BLAZEPOSE, KINECT_V2
from fusion.calibration.calibrator import Calibrator
from fusion.registration import robust_fit
from fusion.skeleton import SkeletonPair
from tests.helpers.frame_pairs import paired
from tests.helpers.two_views import FRAME_NS, calibration_of, moving, pair_of


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


@pytest.mark.parametrize(("body", "angle", "seed"), [(KINECT_V2, 90.0, 5), (AZURE_KINECT, 180.0, 3)], ids=str)
def test_a_person_who_walks_needs_no_pose(body, angle, seed):
    """The recording begins after the pose. 16 keyframes 0.2 s apart and a second fit take 4 s; with other
    seeds of Kinect v2, whose views lean, R becomes certain after up to 30 s."""
    calibrator, seconds, truth = watched(body, "walk", angle, 17.0, from_second=5.0, seed=seed)
    assert calibrator.final
    assert calibrator.calibration.how.startswith("movement, ")
    assert 3.9 < seconds < 12.0
    turn, shift = errors(calibrator.calibration.a_from_b, truth)
    assert turn < 5.0
    assert shift < 0.1


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
