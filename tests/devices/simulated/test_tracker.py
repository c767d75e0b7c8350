"""Claims about the simulated body tracker: each parameter causes one error of the stated size."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from devices.simulated.kinect import PERSON, simulated_pair
from devices.simulated.tracking.tracker import Tracker
from devices.simulated.tracking.tracker_errors import TrackerErrors
from fusion.body import AZURE_KINECT, KINECT_V2
from fusion.calibration.bone_lengths import bone_lengths_of
from fusion.intrinsics import NOMINAL_INTRINSICS
from fusion.skeleton import TrackingState
from tests.helpers.pair_statistics import run_lengths

NONE = TrackerErrors()
LENS = NOMINAL_INTRINSICS["azure_kinect"]
FLOAT32 = 2.0**-23
FRAME = 1 / 30


def watch(motion, errors, seconds=20.0, seed=0, body=AZURE_KINECT):
    """Sensor A's skeletons, and (T, J, 3) the truth in its frame."""
    a, _, truth = simulated_pair(motion=motion, seconds=seconds, seed=seed, body=body, errors=errors)
    frames = list(a.frames())
    return ([f.people.get(PERSON) for f in frames], truth.positions_at([f.time_ns for f in frames]))


def errors_of(skeletons, true):
    """(T, J, 3) reported minus true; every frame must have a person."""
    assert all(s is not None for s in skeletons)
    return np.stack([s.positions for s in skeletons if s is not None]) - true


def tracker(errors, seed=0):
    flesh = np.full(len(AZURE_KINECT), 0.05)
    return Tracker(AZURE_KINECT, errors, flesh, LENS, FRAME, np.random.default_rng(seed))


def stand(errors, frames):
    """The report of a tracker about a person who stands still with all joints visible, and the truth."""
    watching, joints = tracker(errors), standing()
    return [watching.report(joints, np.ones(32), k) for k in range(frames)], np.tile(joints, (frames, 1, 1))


def standing():
    _, _, truth = simulated_pair(motion="startup", seconds=1.0)
    return truth.positions_at(0)


SHAPES = ("inferred_error", "inferred_jitter", "mistracked", "snap", "not_tracked", "outlier_size",
          "rescale_seconds", "jitter_memory", "lost_seconds")  # fmt: skip


@pytest.mark.parametrize(
    "errors",
    [NONE, TrackerErrors(**{name: getattr(TrackerErrors.of(KINECT_V2), name) for name in SHAPES})],
    ids=["none", "knobs that shape other errors"],
)
def test_without_errors_the_truth_is_reported_and_all_is_tracked(errors):
    skeletons, true = watch("walk", errors, 6.0)
    assert np.abs(errors_of(skeletons, true)).max() <= 4 * FLOAT32
    assert errors is not NONE or all(s.tracked.all() for s in skeletons)


def test_jitter_has_the_size_the_knob_says_by_kind_of_joint():
    jitter = NONE.jitter | {"spine": 0.001, "hand": 0.008, "thumb": 0.02}
    skeletons, true = stand(replace(NONE, jitter=jitter, jitter_memory=0.0), 1800)
    spread = errors_of(skeletons, true).std(axis=(0, 2))
    for name, size in (("SPINE_CHEST", 0.001), ("HAND_LEFT", 0.008), ("THUMB_RIGHT", 0.02)):
        # 5400 samples: known to 1/√(2·5400) = 1 %; five times that.
        assert spread[AZURE_KINECT.joint(name)] == pytest.approx(size, rel=0.05)
    assert spread[AZURE_KINECT.joint("KNEE_LEFT")] < FLOAT32


@pytest.mark.parametrize("memory", [0.0, 0.7])
def test_jitter_remembers_from_frame_to_frame(memory):
    jitter = NONE.jitter | dict.fromkeys(("spine", "elbow", "knee", "hand"), 0.01)
    skeletons, true = stand(replace(NONE, jitter=jitter, jitter_memory=memory), 1200)
    error = errors_of(skeletons, true)[
        :, [AZURE_KINECT.joint(n) for n in ("PELVIS", "ELBOW_LEFT", "KNEE_LEFT")]
    ]
    correlation = np.mean(error[1:] * error[:-1]) / np.mean(error**2)
    assert correlation == pytest.approx(memory, abs=5 / np.sqrt(error.size / 3))


def test_moving_joints_jitter_more():
    errors = replace(NONE, moving_jitter=0.01)
    still, true = watch("still", errors, 10.0)
    at_rest = np.abs(errors_of(still, true)).mean()
    walking, true = watch("walk", errors, 10.0)
    assert np.abs(errors_of(walking, true)[120:]).mean() > 10 * at_rest


def test_the_views_bias_is_constant_for_one_view_and_changes_with_it():
    errors = replace(NONE, view_bias=0.03)
    skeletons, true = watch("turn", errors, 16.0)
    error = errors_of(skeletons, true)
    assert error[:60].std(axis=0).max() < 0.002  # facing one way: a constant, but for the sway's few degrees
    assert np.ptp(error, axis=0).mean() > 0.02  # turning: it changes
    assert np.abs(np.diff(error, axis=0)).max() < 0.02  # smoothly
    assert error.std() == pytest.approx(0.03, rel=0.4)  # one draw for each of some 32 · 3 coordinates


def test_the_skin_pulls_joints_towards_the_sensor_along_the_ray():
    joints = standing()
    reported = tracker(replace(NONE, skin=0.5)).report(joints, np.ones(32), 0)
    shift = reported.positions - joints
    np.testing.assert_allclose(np.linalg.norm(shift, axis=1), 0.5 * 0.05, atol=4 * FLOAT32)
    ray = joints / np.linalg.norm(joints, axis=1, keepdims=True)
    np.testing.assert_allclose(np.sum(shift * ray, axis=1), -0.5 * 0.05, atol=4 * FLOAT32)


def test_the_whole_skeleton_rescales_by_one_factor():
    skeletons, true = stand(replace(NONE, rescale=0.04, rescale_seconds=0.2), 1800)
    body = AZURE_KINECT
    joints = errors_of(skeletons, true) + true
    lengths, true_lengths = (bone_lengths_of(body, at)[:, body.bone_joints] for at in (joints, true))
    ratio = (lengths / true_lengths).T
    assert np.ptp(ratio, axis=0).max() < 1e-4  # the same for all bones, to float32 over 3 cm
    # 60 s hold about 60 / (2 · 0.2) = 150 independent scales: known to 1/√300 = 6 %; five times that.
    assert ratio[0].std() == pytest.approx(0.04, rel=0.3)
    # From frame to frame it keeps exp(−1/30 / 0.2) of its deviation.
    kept = np.corrcoef(ratio[0][1:], ratio[0][:-1])[0, 1]
    assert kept == pytest.approx(np.exp(-FRAME / 0.2), abs=0.05)


def test_hidden_joints_are_inferred_and_their_guess_errs_smoothly():
    errors = replace(NONE, seen_share=0.35, inferred_error=0.08)
    skeletons, true = watch("arms", errors, 14.0)
    error = np.linalg.norm(errors_of(skeletons, true), axis=2)
    inferred = np.stack([s.states == TrackingState.INFERRED for s in skeletons if s is not None])
    hand = AZURE_KINECT.joint("HAND_RIGHT")  # sensor A stands on the person's right
    behind_the_back = slice(int(11.6 * 30), int(13.2 * 30))
    assert inferred[behind_the_back, hand].all()
    assert error[behind_the_back, hand].mean() > 0.05
    assert not inferred[:60, AZURE_KINECT.joint("KNEE_LEFT")].any()
    assert np.median(error[inferred]) > 20 * np.median(error[~inferred])
    # From one frame to the next a guess moves by a fraction of its error.
    assert np.abs(np.diff(error[behind_the_back, hand])).max() < 0.06


def test_a_hidden_joint_jitters_more_by_the_factor_the_knob_says():
    jitter = NONE.jitter | {"elbow": 0.01, "knee": 0.01}
    joints, visible = standing(), np.ones(32)
    elbow, knee = AZURE_KINECT.joint("ELBOW_LEFT"), AZURE_KINECT.joint("KNEE_LEFT")
    visible[elbow] = 0.0
    watching = tracker(replace(NONE, seen_share=0.35, jitter=jitter, jitter_memory=0.0, inferred_jitter=3.0))
    reported = [watching.report(joints, visible, k) for k in range(1860)][
        60:
    ]  # many times a guess takes over
    spread = errors_of(reported, np.tile(joints, (1800, 1, 1))).std(axis=(0, 2))
    # 5400 samples each: known to 1/√(2·5400) = 1 %; five times that.
    assert spread[elbow] == pytest.approx(0.03, rel=0.05)
    assert spread[knee] == pytest.approx(0.01, rel=0.05)


@pytest.mark.parametrize(
    ("knob", "state"), [("not_tracked", TrackingState.NOT_TRACKED), ("mistracked", TrackingState.TRACKED)]
)
def test_hidden_spells_meet_their_fate_in_the_share_the_knob_says(knob, state):
    joints, share, spells = standing(), 0.3, 100
    watching = tracker(replace(NONE, seen_share=0.35, **{knob: share}))
    found = []
    for k in range(2 * spells):
        reported = watching.report(joints, np.full(32, (0.1, 1.0)[k % 2]), k)  # all hide in every other frame
        if k % 2 == 0:
            found.append(reported.states == state)
        else:
            assert reported.tracked.all()
    # 3200 spells: known to √(0.3 · 0.7 / 3200) = 0.8 %; four times that.
    assert np.mean(found) == pytest.approx(share, abs=0.033)


def test_a_mistracked_joint_is_reported_as_tracked_at_the_joint_in_front_of_it_if_there_is_one():
    joints = standing()
    body = AZURE_KINECT
    hand, elbow = body.joint("HAND_LEFT"), body.joint("ELBOW_RIGHT")
    # The left hand goes straight behind the right elbow, seen from the sensor; nothing is before the foot.
    joints[hand] = joints[elbow] * 1.15
    visible = np.ones(32)
    visible[[hand, body.joint("FOOT_RIGHT")]] = 0.0
    watching = tracker(replace(NONE, seen_share=0.35, mistracked=1.0, snap=1.0))
    for _ in range(60):  # many times the time a guess takes over
        reported = watching.report(joints, visible, 0)
    assert reported.tracked.all()
    others = np.arange(32) != hand
    np.testing.assert_allclose(reported.positions[hand], joints[elbow], atol=1e-5)
    np.testing.assert_allclose(reported.positions[others], joints[others], atol=4 * FLOAT32)


def test_unsure_joints_are_inferred_for_the_share_of_time_the_knob_says():
    errors = replace(NONE, unsure=NONE.jitter | {"thumb": 0.3})
    skeletons, _ = stand(errors, 3600)
    inferred = np.stack([s.states == TrackingState.INFERRED for s in skeletons if s is not None])
    thumbs = [AZURE_KINECT.joint(n) for n in ("THUMB_LEFT", "THUMB_RIGHT")]
    # 240 s of thumbs in spells of 0.4 s every 1.33 s: 180 spells; known to about 1/√180 = 7.5 %, times four.
    assert inferred[:, thumbs].mean() == pytest.approx(0.3, rel=0.3)
    assert inferred[:, [j for j in range(32) if j not in thumbs]].sum() == 0


def test_the_stale_share_of_frames_repeats_the_one_before_with_a_new_time():
    skeletons, _ = watch("walk", replace(NONE, stale=0.1), 20.0)
    repeats = [s.repeats(before) for before, s in pairwise(skeletons) if s]
    # 599 draws of 10 %: standard deviation 1.2 %; four times that.
    assert np.mean(repeats) == pytest.approx(0.1, abs=0.05)
    times = [s.time_ns for s in skeletons if s]
    assert len(set(times)) == len(times)


def test_the_person_is_lost_for_the_share_of_frames_and_comes_back():
    skeletons, _ = stand(replace(NONE, lost=0.1, lost_seconds=0.4), 3600)
    lost = np.array([s is None for s in skeletons])
    assert lost.mean() == pytest.approx(0.1, rel=0.6)  # 30 spells: known to 18 %, three times that
    assert np.mean(run_lengths(lost)) == pytest.approx(12, rel=0.6)
    assert not lost[-200:].all()


def test_outliers_stand_elsewhere_for_a_moment_though_tracked():
    skeletons, true = stand(replace(NONE, outliers=0.02, outlier_size=0.2), 1800)
    away = np.abs(errors_of(skeletons, true)).max(axis=2)
    out = away > 1e-5
    assert out.mean() == pytest.approx(0.02, rel=0.2)
    assert away.max() <= 0.2 + 4 * FLOAT32
    assert all(s is not None and s.tracked.all() for s in skeletons)


def test_a_small_stretch_keeps_bones_near_their_length_where_joints_err():
    loose = replace(NONE, view_bias=0.05)
    body = AZURE_KINECT

    def bone_errors(errors):
        skeletons, true = watch("startup", errors, 0.2)
        joints = errors_of(skeletons, true) + true
        lengths = [
            np.linalg.norm(x[:, body.bone_joints] - x[:, body.parent_indices[body.bone_joints]], axis=2)
            for x in (joints, true)
        ]
        return np.abs(lengths[0] - lengths[1])

    freely, held = bone_errors(loose), bone_errors(replace(loose, stretch=0.25))
    assert np.median(freely) > 0.01
    # A held bone's parent has moved too, so its own error is another one; a quarter of something like it.
    assert np.median(held) < 0.5 * np.median(freely)
    assert bone_errors(replace(loose, stretch=0.0)).max() < 1e-6
