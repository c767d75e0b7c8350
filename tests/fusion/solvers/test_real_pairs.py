"""The method on real recordings, against an independent solver."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from devices.pairing import pair_recordings
from devices.skeletons.file_sensor import SkeletonRecording
from fusion.calibration.calibration import Calibration, calibrate
from fusion.calibration.start_up_pose import find_start_up_pose
from fusion.fuser import FusedFrame, Fuser
from fusion.setup import FuserSettings, FusionSetup
from fusion.skeleton import SkeletonPair
from tests.helpers.slsqp import slsqp_optimum


@pytest.fixture
def walk(shared: Path) -> tuple[Calibration, list[SkeletonPair]]:
    folder = shared / "real" / "kinect_v2_90deg_walk"
    with SkeletonRecording(folder / "a.csv") as a, SkeletonRecording(folder / "b.csv") as b:
        paired = pair_recordings(list(a.frames()), list(b.frames()), "0", "0")
        pairs = [pair.skeletons for pair in paired.pairs]
        return calibrate(a.body, *find_start_up_pose(a.body, pairs)), pairs


def test_the_papers_fused_is_slsqps_optimum_on_50_frames_of_a_real_walk(
    walk: tuple[Calibration, list[SkeletonPair]],
) -> None:
    calibration, pairs = walk
    body = calibration.body
    frames = Fuser(FusionSetup(calibration, FuserSettings(method="paper"))).fuse_sequence(pairs)
    for k in np.random.default_rng(0).choice(len(pairs), 50, replace=False):
        pair, frame = pairs[k], frames[k]
        targets, weights = blend(pair, frame)
        other = slsqp_optimum(body, targets, weights, calibration.bone_lengths, targets).positions
        near = slsqp_optimum(body, targets, weights, calibration.bone_lengths, frame.positions).positions
        assert np.abs(near - frame.positions).max() < 1e-5, "S* is a local optimum"
        cost = [float(np.sum(weights[:, None] * (x - targets) ** 2)) for x in (frame.positions, other)]
        assert cost[0] <= cost[1] * (1.0 + 1e-9), "and scipy from its own start finds none better"


def blend(pair: SkeletonPair, frame: FusedFrame) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    p = pair.a.positions.astype(np.float64)
    q = frame.a_from_b.apply(pair.b.positions)
    weights = frame.weights_a + frame.weights_b
    return (frame.weights_a[:, None] * p + frame.weights_b[:, None] * q) / weights[:, None], weights
