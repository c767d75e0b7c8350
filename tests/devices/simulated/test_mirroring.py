"""The simulated tracker that mistakes a back for a front."""

from dataclasses import replace

import numpy as np
import pytest

from devices.simulated.kinect import PERSON, simulated_pair
from devices.simulated.tracking.mirroring import Mirroring, MirroringTracker
from devices.simulated.tracking.tracker_errors import TrackerErrors
from fusion.body import AZURE_KINECT, KINECT_V2
from tests.helpers.labelled_views import heading, swapped

BACK = np.array((0.0, 0.0, 1.0))  # the way that a person faces whose back is turned


def standing(body=KINECT_V2):
    """(J, 3) a person who stands with the back turned to the sensor, in its frame."""
    _, _, truth = simulated_pair(
        motion="startup", seconds=1.0, body=body, angle_deg=0.0, errors=TrackerErrors()
    )
    joints = truth.positions_at(0)
    root = joints[body.root]
    return (joints - root) * (-1.0, 1.0, -1.0) + root  # half a turn about the vertical


def watch(mirroring, frames, angle, body=KINECT_V2):
    joints, states = standing(body), np.full(len(body), 2, dtype=np.uint8)
    tracker = MirroringTracker(body, mirroring, 1 / 30, np.random.default_rng(0))
    return np.array([tracker.apply(joints, states, BACK, angle)[0] for _ in range(frames)])


@pytest.mark.parametrize("cosine", [-1.0, -0.55, -0.3])
def test_the_share_of_mirrored_frames_is_what_the_knob_says(cosine):
    mirroring = Mirroring(back=0.9, seconds=0.1, crossing_seconds=0.0, legs_later=0.0)
    truth = standing()
    wrong = swapped(KINECT_V2, watch(mirroring, 9000, np.arccos(cosine)), np.tile(truth, (9000, 1, 1)))
    # 300 s in spells of 0.1 s: at least 1500 independent ones, known to √(¼ / 1500) = 1.3 %; four times.
    assert wrong.mean() == pytest.approx(mirroring.share(cosine), abs=0.052)


def test_places_stay_and_labels_are_exchanged_but_for_what_depth_hardly_shows():
    mirroring = Mirroring(back=1.0, centre=1.0, width=0.01, seconds=0.01, legs_later=0.0)
    truth = standing()
    last = watch(mirroring, 60, np.pi)[-1]
    foot, ankle = KINECT_V2.joint("FootLeft"), KINECT_V2.joint("AnkleLeft")
    for name in ("ShoulderLeft", "HipRight", "Head", "SpineBase", "AnkleLeft"):
        j = KINECT_V2.joint(name)
        np.testing.assert_allclose(
            last[j], truth[KINECT_V2.mirror[j]], atol=0.03
        )  # knees keep 90 % of their bend
    # Feet point to the sensor (−z), by the share that is believed: 1 − 2 · 0.9.
    ahead = truth[KINECT_V2.mirror[foot]] - truth[KINECT_V2.mirror[ankle]]
    assert ahead[2] > 0.05
    assert (last[foot] - last[ankle])[2] == pytest.approx(-0.8 * ahead[2], abs=1e-9)


def test_the_tracker_changes_over_smoothly_and_the_legs_later():
    mirroring = Mirroring(
        back=1.0, centre=1.0, width=0.01, seconds=1e-3, crossing_seconds=0.3, legs_later=0.5
    )
    joints = watch(mirroring, 60, np.pi)
    # 3 w² − 2 w³ is at most 1.5 times as steep as its mean: 9 frames for the way from one side to the other.
    width = np.linalg.norm(
        joints[0, KINECT_V2.joint("HandTipLeft")] - joints[0, KINECT_V2.joint("HandTipRight")]
    )
    step = np.linalg.norm(np.diff(joints, axis=0), axis=2)
    assert step.max() <= 1.5 * 1.1 * width / 9 + 0.03
    truth = np.tile(standing(), (60, 1, 1))
    trunk = swapped(KINECT_V2, joints, truth, "shoulder", "hip")
    legs = swapped(KINECT_V2, joints, truth, "knee", "ankle")
    assert trunk.argmax() < legs.argmax()
    assert legs[-1]


def test_a_person_who_faces_the_sensor_is_never_mirrored():
    for body in (KINECT_V2, AZURE_KINECT):
        errors = TrackerErrors.of(body)
        assert errors.mirroring.share(0.0) < 0.01
        assert errors.mirroring.share(1.0) < 1e-5
        joints = watch(replace(errors.mirroring, heading_sd=0.0), 300, 0.0, body)
        np.testing.assert_array_equal(joints, np.tile(standing(body), (300, 1, 1)))


def test_turning_round_before_a_kinect_v2_is_reported_as_facing_it():
    errors = replace(TrackerErrors(), mirroring=TrackerErrors.of(KINECT_V2).mirroring)
    a, _, truth = simulated_pair(motion="walk", seconds=25.0, body=KINECT_V2, angle_deg=0.0, errors=errors)
    frames = list(a.frames())
    reported = np.array([frame.people[PERSON].positions for frame in frames], dtype=np.float64)
    true = truth.positions_at([frame.time_ns for frame in frames])
    toward = -true[:, KINECT_V2.root] * (1.0, 0.0, 1.0)
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    cosine, claimed = (np.sum(heading(KINECT_V2, at) * toward, axis=1) for at in (true, reported))
    assert np.mean(cosine < -0.8) > 0.2
    # Real walks: 93 to 99 % of the frames with the back turned so far, 0 to 2 % from the front.
    assert 0.75 <= np.mean(claimed[cosine < -0.8] > 0.0) <= 1.0
    assert np.mean(claimed[cosine > 0.5] < 0.0) <= 0.02
