"""No length is trusted: joints of another body than described give a BodyError, and reach no kernel."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion import (
    AZURE_KINECT,
    BODIES,
    BodyError,
    Calibrator,
    Fuser,
    FuserSettings,
    FusionError,
    FusionSetup,
    Skeleton,
    SkeletonPair,
    StartUpPose,
    calibrate,
    find_start_up_pose,
    nominal_calibration,
)
from fusion.calibration.online import CalibrationLearner
from fusion.facing.labels import Labels
from fusion.movement.angles import angle_sigma, joint_angles
from fusion.movement.joint_rotations import rotations_of
from fusion.pair_arrays import Pairs, view_of
from fusion.plan import plan_recording

OWN = AZURE_KINECT
SETUP = FusionSetup(nominal_calibration(OWN))


def standing(body):
    return Skeleton.of(body, np.ones((len(body), 3)))


def fuser(method="duplex"):
    return Fuser(FusionSetup(SETUP.calibration, FuserSettings(method=method)))


BORDERS = {
    "Fuser.update": lambda pair: fuser().update(pair),
    "Fuser.update, paper": lambda pair: fuser("paper").update(pair),
    "Fuser.fuse_sequence": lambda pair: fuser().fuse_sequence([pair]),
    "Fuser.smooth_sequence": lambda pair: fuser().smooth_sequence([pair]),
    "fuse_sequence of another recording": lambda pair: fuser().fuse_sequence(
        Pairs.of(next(seen.body for seen in (pair.a, pair.b) if seen and seen.body is not OWN), [])
    ),
    "calibrate": lambda pair: calibrate(OWN, [pair], "x"),
    "Calibrator": lambda pair: Calibrator(OWN).watch(pair),
    "CalibrationLearner": lambda pair: CalibrationLearner(OWN, SETUP.calibration).observe(pair),
    "StartUpPose": lambda pair: StartUpPose(OWN).watch(pair),
    "find_start_up_pose": lambda pair: find_start_up_pose(OWN, [pair]),
    "plan_recording": lambda pair: plan_recording(OWN, [pair], FuserSettings(), SETUP.calibration),
    "view_of": lambda pair: view_of(OWN, [seen for seen in (pair.a, pair.b) if seen]),
}


@pytest.mark.parametrize("border", BORDERS)
@given(
    other=st.sampled_from([body for body in BODIES.values() if body is not OWN]),
    sides=st.sampled_from(["a", "b", "ab", "a alone", "b alone"]),
)
def test_a_skeleton_of_another_body_is_refused(border, other, sides):
    a = standing(other) if "a" in sides.split()[0] else standing(OWN)
    b = standing(other) if "b" in sides.split()[0] else standing(OWN)
    pair = SkeletonPair(*{"a alone": (a, None), "b alone": (None, b)}.get(sides, (a, b)), 0)
    with pytest.raises(
        BodyError, match=f"the {len(other)} joints of {other.name}, not the 32 of azure_kinect"
    ):
        BORDERS[border](pair)


@given(joints=st.integers(0, 60).filter(lambda joints: joints != len(OWN)))
def test_arrays_of_another_number_of_joints_are_refused(joints):
    positions, states = np.ones((joints, 3), np.float32), np.full(joints, 2, np.uint8)
    right = standing(OWN)
    view = view_of(OWN, [right])
    frames = np.zeros((1, 2), np.int64)
    for make in (
        lambda: Skeleton.of(OWN, positions),
        lambda: Skeleton(OWN, positions, states, 0),
        lambda: Skeleton(OWN, right.positions, states, 0),
        lambda: replace(right, witness=np.zeros((joints, 4), np.float32)),
        lambda: right.with_witness(np.zeros((joints, 4), np.float32)),
        lambda: Pairs(OWN, (view, view._replace(positions=positions[None])), *np.zeros((2, 1), int), frames),
        lambda: Pairs(OWN, (view._replace(states=states[None]), view), *np.zeros((2, 1), int), frames),
        lambda: FusionSetup(replace(SETUP.calibration, bone_lengths=np.ones(joints))),
        lambda: joint_angles(OWN, positions),
        lambda: angle_sigma(OWN, positions, positions[:, 0]),
        lambda: rotations_of(OWN, positions[None].astype(float), np.zeros(1, np.int64)),
    ):
        with pytest.raises(BodyError):
            make()


@given(rows=st.integers(0, 5), pairs=st.integers(0, 5))
def test_labels_of_another_number_of_pairs_are_refused(rows, pairs):
    given_pairs = [SkeletonPair(standing(OWN), None, k) for k in range(pairs)]
    arrays = Pairs.of(OWN, given_pairs).arrays
    if rows == pairs:
        assert len(arrays(Labels.unknown(rows)).time_ns) == pairs
    else:
        with pytest.raises(FusionError, match=f"Labels of {rows} pairs are given for {pairs}"):
            arrays(Labels.unknown(rows))
    if rows != 1:
        with pytest.raises(FusionError, match="Labels of"):
            fuser().update(SkeletonPair(standing(OWN), None, 0), Labels.unknown(rows))
