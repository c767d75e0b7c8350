"""From the simulated world through sensors, pairing, calibration and fusion, back to the truth."""

from itertools import cycle

import numpy as np
import pytest

from devices.pairing import pair_recordings
from devices.simulated.kinect import PERSON, simulated_pair
from devices.simulated.rig import Rig
from devices.simulated.tracking.tracker import TrackerErrors
from fusion.body import BODIES, KINECT_V2, Body
from fusion.calibration.calibration import calibrate
from fusion.calibration.start_up_pose import find_start_up_pose
from fusion.fuser import FusedFrame, Fuser
from fusion.setup import FuserSettings, FusionSetup, Method
from fusion.skeleton import SkeletonPair

TOLERANCE = 1e-5
"""0.01 mm. Positions leave the sensors as float32, exact to 2.4e-7 m at 4 m; R and the bone lengths are
fitted to those, and the longest chain of bones is 8."""


BODIES_IN_MOTION = list(zip(BODIES.values(), cycle(("badminton", "walk")), strict=False))


def frames_and_truth(
    body: Body, motion: str, rig: Rig, method: Method = "paper"
) -> tuple[list[FusedFrame], np.ndarray]:
    a, b, truth = simulated_pair(motion=motion, body=body, seconds=8.0, errors=TrackerErrors(), rig=rig)
    pairs = pair_recordings(list(a.frames()), list(b.frames()), PERSON, PERSON).pairs
    skeletons: list[SkeletonPair] = [pair.skeletons for pair in pairs]
    chosen, how = find_start_up_pose(body, skeletons)
    assert how.startswith("start-up pose")
    setup = FusionSetup(calibrate(body, chosen, how), FuserSettings(method=method))
    return (
        Fuser(setup).fuse_sequence(skeletons),
        np.array([truth.positions_at(pair.time_ns) for pair in pairs]),
    )


def distances(frames: list[FusedFrame], truth: np.ndarray) -> np.ndarray:
    """(T, J) metres of S* from the truth."""
    return np.linalg.norm([frame.positions for frame in frames] - truth, axis=2)


@pytest.mark.parametrize(("body", "motion"), BODIES_IN_MOTION, ids=str)
def test_without_errors_fusion_is_the_truth(body: Body, motion: str) -> None:
    frames, truth = frames_and_truth(body, motion, Rig(skew_seconds=0.0))
    assert distances(frames, truth).max() < TOLERANCE


@pytest.mark.parametrize(("body", "motion"), BODIES_IN_MOTION, ids=str)
def test_without_errors_the_estimator_lags_by_less_than_it_reports(body: Body, motion: str) -> None:
    """Only the estimator's smoothing is left. It stays below 2σ, which bounds 95 % of all errors."""
    frames, truth = frames_and_truth(body, motion, Rig(skew_seconds=0.0), method="duplex")
    off = distances(frames, truth)
    assert (off < 2.0 * np.array([frame.sigma for frame in frames])).all()
    # Lag is time: less than half a frame of the fastest joint.
    fastest = np.linalg.norm(np.diff(truth, axis=0), axis=2).max()
    assert off.max() < 0.5 * fastest


@pytest.mark.parametrize("angle", [20.0, 135.0, 180.0])
def test_without_errors_fusion_is_the_truth_at_any_angle(angle: float) -> None:
    frames, truth = frames_and_truth(KINECT_V2, "boxing", Rig(angle_deg=angle, skew_seconds=0.0))
    assert distances(frames, truth).max() < TOLERANCE


def test_a_skew_between_the_sensors_costs_what_the_person_moves_meanwhile() -> None:
    skew = 0.010
    frames, truth = frames_and_truth(KINECT_V2, "boxing", Rig(skew_seconds=skew))
    off = distances(frames, truth)
    speed = np.linalg.norm(np.diff(truth, axis=0), axis=2).max() * 30.0
    # t follows the torso, so an error is at most what joint and torso move in the skew
    assert TOLERANCE < off.max() < 2.0 * speed * skew
