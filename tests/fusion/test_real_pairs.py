"""The method on real recordings, against an independent solver."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import minimize

from devices.pairing import pair_recordings
from devices.skeletons.recording import SkeletonRecording
from fusion.body import Body
from fusion.calibration.calibration import Calibration, calibrate, find_start_up_pose
from fusion.fuser import FusedFrame, Fuser
from fusion.setup import FusionSetup
from fusion.skeleton import SkeletonPair


@pytest.fixture
def walk(shared: Path) -> tuple[Calibration, list[SkeletonPair]]:
    folder = shared / "real" / "kinect_v2_90deg_walk"
    with SkeletonRecording(folder / "a.csv") as a, SkeletonRecording(folder / "b.csv") as b:
        paired = pair_recordings(list(a.frames()), list(b.frames()), "0", "0")
        pairs = [pair.skeletons for pair in paired.pairs]
        return calibrate(a.body, *find_start_up_pose(a.body, pairs)), pairs


def slsqp(
    body: Body, lengths: NDArray[np.float64], targets: NDArray[np.float64], weights: NDArray[np.float64],
    start: NDArray[np.float64],
) -> NDArray[np.float64]:  # fmt: skip
    """The optimum of eq. (1), one constraint a bone, by scipy."""
    joints, parents = body.bone_joints, body.parent_indices[body.bone_joints]
    count = len(body)

    def constraint(x: NDArray[np.float64]) -> NDArray[np.float64]:
        at = x.reshape(count, 3)
        return 0.5 * (np.sum((at[joints] - at[parents]) ** 2, axis=1) - lengths[joints] ** 2)

    def jacobian(x: NDArray[np.float64]) -> NDArray[np.float64]:
        at = x.reshape(count, 3)
        J = np.zeros((len(joints), count, 3))
        rows = np.arange(len(joints))
        J[rows, joints] = at[joints] - at[parents]
        J[rows, parents] = at[parents] - at[joints]
        return J.reshape(len(joints), -1)

    found = minimize(
        lambda x: float(np.sum(weights[:, None] * (x.reshape(count, 3) - targets) ** 2)),
        start.ravel(),
        jac=lambda x: (2.0 * weights[:, None] * (x.reshape(count, 3) - targets)).ravel(),
        constraints=[{"type": "eq", "fun": constraint, "jac": jacobian}],
        method="SLSQP",
        options={"maxiter": 500, "ftol": 1e-15},
    )
    return np.asarray(found.x).reshape(count, 3)


def test_fused_is_slsqps_optimum_on_50_frames_of_a_real_walk(
    walk: tuple[Calibration, list[SkeletonPair]],
) -> None:
    calibration, pairs = walk
    body = calibration.body
    frames = Fuser(FusionSetup(calibration)).fuse_sequence(pairs)
    for k in np.random.default_rng(0).choice(len(pairs), 50, replace=False):
        pair, frame = pairs[k], frames[k]
        assert pair.a is not None
        assert pair.b is not None
        targets, weights = blend(pair, frame)
        other = slsqp(body, calibration.bone_lengths, targets, weights, targets)
        near = slsqp(body, calibration.bone_lengths, targets, weights, frame.positions)
        assert np.abs(near - frame.positions).max() < 1e-5, "S* is a local optimum"
        cost = [float(np.sum(weights[:, None] * (x - targets) ** 2)) for x in (frame.positions, other)]
        assert cost[0] <= cost[1] * (1.0 + 1e-9), "and scipy from its own start finds none better"


def blend(pair: SkeletonPair, frame: FusedFrame) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    assert pair.a is not None
    assert pair.b is not None
    p = pair.a.positions.astype(np.float64)
    q = frame.a_from_b.apply(pair.b.positions)
    weights = frame.weights_a + frame.weights_b
    return (frame.weights_a[:, None] * p + frame.weights_b[:, None] * q) / weights[:, None], weights
