import numpy as np
import pytest

from fusion.body import AZURE_KINECT, BLAZEPOSE, BODIES, KINECT_V1, KINECT_V2, body_of
from fusion.errors import FusionError


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
    with pytest.raises(FusionError, match=r"no joint 'Tail'.*SpineBase"):
        KINECT_V2.joint("Tail")
    with pytest.raises(FusionError, match=r"no bone 'tail'.*forearm_left"):
        KINECT_V2.bone("tail")


def test_the_body_follows_from_the_joint_names():
    for body in BODIES.values():
        assert body_of(set(body.joints)) is body
    assert body_of(set(KINECT_V2.joints) - {"ThumbLeft"}) is KINECT_V2
    assert body_of(set(AZURE_KINECT.joints) & set(BLAZEPOSE.joints)) is AZURE_KINECT
    assert body_of(set(BLAZEPOSE.joints) - {"HEEL_LEFT"}) is BLAZEPOSE
    with pytest.raises(FusionError, match="Unknown joint 'Tail'"):
        body_of({*KINECT_V1.joints, "Tail"})
    with pytest.raises(FusionError, match=r"table\['joint'\].replace\({'l_ankle': 'NAME'}\)\.$"):
        body_of({*KINECT_V1.joints, "l_ankle"})
