"""Whoever stands, sits, bows or lies: left and right stay where they are, and S* with them."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given

from devices.simulated.kinect import simulated_pair
from fusion.body import AZURE_KINECT, KINECT_V2
from fusion.calibration.bone_lengths import bone_lengths_of
from fusion.calibration.calibration import Calibration
from fusion.facing.evidence import upright_direction
from fusion.fuser import Fuser
from fusion.plan import plan_recording
from fusion.setup import FuserSettings, FusionSetup
from tests.helpers.exercises import POSES, UP, Exercise, exercises

TIMES = np.arange(0.0, 14.0, 1.0 / 15.0)


@cache
def scene(body):
    """Somebody who moves the arms, at 15 frames per second, and the true calibration."""
    *_, truth = simulated_pair(motion="arms", body=body, seed=3, seconds=16.0)
    standing = truth.positions_at((2e9 + 1e9 * TIMES).astype(np.int64))
    lengths = np.median(bone_lengths_of(body, standing), axis=0)
    return standing, Calibration(body, truth.a_from_b, lengths, "the truth")


def fused(body, exercise):
    """The truth, and S* with its frames' exchange codes: live, and of the recording."""
    standing, calibration = scene(body)
    truth = exercise.truth(body, standing, TIMES)
    pairs = exercise.pairs(body, truth, calibration.a_from_b, TIMES)
    settings = FuserSettings(hindsight="labels")
    labels = plan_recording(body, pairs, settings, calibration, refine=False).labels
    frames = [Fuser(FusionSetup(calibration)).fuse_sequence(pairs, given) for given in (None, labels)]
    codes = [np.array([frame.exchanged_a | frame.exchanged_b for frame in of]) for of in frames]
    return truth, [of.positions for of in frames], codes


@given(exercise=exercises())
def test_no_pose_exchanges_left_and_right(exercise):
    truth, found, codes = fused(AZURE_KINECT, exercise)
    stands = np.r_[0:25, -25:0]
    for at, exchanged in zip(found, codes, strict=True):
        assert not exchanged.any()
        error = np.linalg.norm(at - truth, axis=2).mean(axis=1)
        assert error.mean() < 1.5 * error[stands].mean() + 0.005


@pytest.mark.parametrize("pose", sorted(set(POSES) - {"cartwheel"}))
def test_a_kinect_v2_exchanges_them_at_most_while_the_pose_changes(pose):
    _, _, (live, recorded) = fused(KINECT_V2, Exercise(POSES[pose]))
    assert max(live.mean(), recorded.mean()) < 0.05


def test_the_vertical_is_that_of_a_person_who_mostly_lies():
    standing, _ = scene(AZURE_KINECT)
    times = np.where(np.arange(len(standing)) < 30, 0.0, 6.0)
    lying = Exercise(POSES["on the belly"]).truth(AZURE_KINECT, standing, times)
    assert upright_direction(AZURE_KINECT, lying) @ UP > np.cos(np.radians(8.0))
