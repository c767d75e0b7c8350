"""Bodies and skeletons: parents, sides, names of joints, what a skeleton and each border accept."""

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
from fusion.body import BLAZEPOSE, KINECT_V1, KINECT_V2, body_of
from fusion.calibration.online import CalibrationLearner
from fusion.facing.handedness import mirrored_share
from fusion.facing.labels import Labels
from fusion.movement.angles import angle_sigma, joint_angles
from fusion.movement.joint_rotations import rotations_of
from fusion.pair_arrays import Pairs, view_of
from fusion.plan import plan_recording
from fusion.skeleton import TrackingState
from tests.helpers.labelled_views import simulated_views
from tests.helpers.two_views import moving

# --- Bodies and skeletons: parents, sides, names of joints, and what a skeleton accepts.


@pytest.mark.parametrize("body", BODIES.values(), ids=str)
def test_order_puts_parents_first_and_reaches_every_joint(body):
    assert sorted(body.order) == list(range(len(body)))
    place = {joint: k for k, joint in enumerate(body.order)}
    assert all(place[body.parents[j]] < place[j] for j in body.bone_joints)


@pytest.mark.parametrize("body", BODIES.values(), ids=str)
def test_mirror_swaps_left_and_right_and_keeps_the_bones(body):
    assert (body.mirror[body.mirror] == np.arange(len(body))).all()
    for joint in body.bone_joints:
        assert body.mirror[body.parents[joint]] == body.parents[body.mirror[joint]]
        assert body.nominal_lengths[joint] == body.nominal_lengths[body.mirror[joint]] > 0.0


@pytest.mark.parametrize("body", BODIES.values(), ids=str)
def test_bone_names_are_unique(body):
    names = [body.bones[j] for j in body.bone_joints]
    assert len(set(names)) == len(body) - 1
    assert body.bones[body.root] == ""


def test_joints_are_found_in_any_spelling():
    assert KINECT_V2.joint("ELBOW_LEFT") == KINECT_V2.joint("elbow left") == KINECT_V2.joint("ElbowLeft")
    assert AZURE_KINECT.joint("K4ABT_JOINT_ELBOW_LEFT") == 6


def test_an_unknown_joint_or_bone_is_named_with_what_there_is():
    with pytest.raises(FusionError, match=r"joint 'Tail'.*SpineBase"):
        KINECT_V2.joint("Tail")
    with pytest.raises(FusionError, match=r"bone 'tail'.*forearm_left"):
        KINECT_V2.bone("tail")


def test_the_body_follows_from_the_joint_names():
    for body in BODIES.values():
        assert body_of(set(body.joints)) is body
    assert body_of(set(KINECT_V2.joints) - {"ThumbLeft"}) is KINECT_V2
    assert body_of(set(AZURE_KINECT.joints) & set(BLAZEPOSE.joints)) is AZURE_KINECT
    assert body_of(set(BLAZEPOSE.joints) - {"HEEL_LEFT"}) is BLAZEPOSE
    with pytest.raises(FusionError, match="Unknown joint 'Tail'"):
        body_of({*KINECT_V1.joints, "Tail"})
    with pytest.raises(FusionError, match=r"'l_ankle'.* Name yours in a table: `names=FILE\.toml`\.$"):
        body_of({*KINECT_V1.joints, "l_ankle"})


def test_a_coordinate_that_is_no_number_makes_the_joint_not_tracked():
    positions = np.ones((20, 3))
    positions[3, 1], positions[5, 0] = np.nan, np.inf
    skeleton = Skeleton.of(KINECT_V1, positions)
    assert skeleton.states[[3, 5]].tolist() == [TrackingState.NOT_TRACKED] * 2
    assert np.isnan(skeleton.positions[[3, 5]]).all()
    assert skeleton.has_position.sum() == 18


def test_a_joint_that_is_not_tracked_has_no_position():
    states = np.full(20, 2)
    states[7] = 0
    assert np.isnan(Skeleton.of(KINECT_V1, np.ones((20, 3)), states).positions[7]).all()


def test_values_that_do_not_fit_the_body_are_refused():
    with pytest.raises(FusionError, match="20 joints"):
        Skeleton.of(KINECT_V1, np.ones((25, 3)))
    with pytest.raises(FusionError, match="0, 1 or 2"):
        Skeleton.of(KINECT_V1, np.ones((20, 3)), np.full(20, 3))


def test_arrays_of_a_callers_own_become_those_of_the_kernels():
    positions, states = np.ones((20, 3)), np.full(20, 2)
    skeleton = Skeleton(KINECT_V1, positions, states, 0)
    checked = Skeleton.of(KINECT_V1, positions, states)
    for array, other in ((skeleton.positions, checked.positions), (skeleton.states, checked.states)):
        assert array.dtype == other.dtype
        assert not array.flags.writeable
        assert array.flags.c_contiguous
    positions[0] = 0.0
    assert skeleton.positions[0].tolist() == [1.0, 1.0, 1.0]


def test_a_repeated_skeleton_is_noticed_holes_included():
    positions = np.ones((20, 3))
    positions[3] = np.nan
    first, again = Skeleton.of(KINECT_V1, positions, None, 0), Skeleton.of(KINECT_V1, positions, None, 33)
    positions[0, 0] += 1e-5
    assert again.repeats(first)
    assert not Skeleton.of(KINECT_V1, positions).repeats(first)
    assert not first.repeats(None)


@pytest.mark.parametrize("body", BODIES.values(), ids=BODIES)
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_one_reversed_axis_is_seen_in_every_frame(body, axis):
    positions = moving(body, 30)
    assert mirrored_share(body, positions) == 0.0
    reversed_ = positions.copy()
    reversed_[..., axis] *= -1.0
    assert mirrored_share(body, reversed_) == 1.0


def test_a_tracker_that_exchanges_sides_mirrors_no_body():
    views = simulated_views("walk", seconds=16.0)
    assert views.relabel().codes.any()
    for positions in (views.a, views.b_in_a):
        assert mirrored_share(views.body, positions) < 0.2


def test_nothing_is_said_of_a_body_without_feet():
    positions = moving(KINECT_V2, 5)
    positions[:, KINECT_V2.joint("FootLeft")] = np.nan
    assert mirrored_share(KINECT_V2, positions) is None


# --- No length is trusted: joints of another body than described give a BodyError, and reach no kernel.


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
