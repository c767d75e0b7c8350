"""VMC and VRChat, read back by python-osc: bones, trackers and an avatar's proportions."""

import math
import socket
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fusion.body import BODIES, KINECT_V2
from tests.helpers.avatars import BEGINS, PARENTS, bones, write_vrm
from tests.helpers.live_frames import frames
from tests.helpers.osc import messages
from tests.helpers.poses import BACK, DOWN, FRONT, T_POSE, posed, turned_about, world_of_local
from tests.helpers.two_views import FRAME_NS, moving
from viewer_app.errors import UsageError
from viewer_app.outputs.avatars import vrm as vrm_module
from viewer_app.outputs.avatars.osc import Address, OscOutput, bundled
from viewer_app.outputs.avatars.vmc import VmcEncoder
from viewer_app.outputs.avatars.vrchat import VRChatEncoder, euler_degrees
from viewer_app.outputs.avatars.vrm import read_avatar

FLOAT32 = 1e-6  # of values up to 3 m, a few roundings


def world(sent):
    """What Unity makes of local positions and rotations; a bone that is not sent has neither."""
    order = list(sent)
    parents = []
    for name in order:
        above = PARENTS.get(name)
        while above is not None and above not in sent:
            above = PARENTS[above]
        parents.append(-1 if above is None else order.index(above))
    assert all(above < n for n, above in enumerate(parents))
    at, turns = world_of_local(parents, *(np.array([sent[n][k] for n in order]) for k in (0, 1)))
    return dict(zip(order, at, strict=True)), dict(zip(order, turns, strict=True))


@pytest.mark.parametrize("body", BODIES.values(), ids=str)
def test_a_receiver_s_forward_kinematics_gives_the_joints_of_s(body):
    encoder = VmcEncoder(body)
    for t, joints in enumerate(moving(body, 120)[::4]):
        at, _ = world(bones(encoder.encode(joints, t * 4 * FRAME_NS)))
        offset = at["Hips"] + joints[body.root]  # the place of the origin, the same for all joints
        for name, joint in BEGINS.items():
            np.testing.assert_allclose(at[name], offset - joints[body.joint(joint)], atol=4 * FLOAT32)


@pytest.mark.parametrize("body", BODIES.values(), ids=str)
def test_the_t_pose_has_no_rotation_and_faces_plus_z_with_its_left_at_minus_x(body):
    sent = bones(VmcEncoder(body).encode(posed(body, T_POSE), 0))
    for name, (_, rotation) in sent.items():
        np.testing.assert_allclose(np.abs(rotation), [0, 0, 0, 1], atol=FLOAT32, err_msg=name)
    at, _ = world(sent)
    assert at["LeftHand"][0] < -0.6 < 0.6 < at["RightHand"][0]
    assert at["LeftToes"][2] > at["LeftFoot"][2] + 0.1
    assert -FLOAT32 <= at["LeftToes"][1] <= 0.02  # on the floor, or their heels are
    np.testing.assert_allclose(at["Hips"][[0, 2]], 0.0, atol=FLOAT32)  # above the origin
    assert at["Head"][1] > at["Hips"][1] > 0.7


HALF = math.sqrt(0.5)


@pytest.mark.parametrize(
    ("directions", "bone", "expected"),
    [
        # left forearm from −x to +z: Unity's Quaternion.Euler(0, 90, 0) takes −x there
        ({"WristLeft": FRONT, "HandLeft": FRONT}, "LeftLowerArm", (0.0, HALF, 0.0, HALF)),
        # right forearm from +x to +z: Euler(0, −90, 0)
        ({"WristRight": FRONT, "HandRight": FRONT}, "RightLowerArm", (0.0, -HALF, 0.0, HALF)),
        # right shin from −y to −z: Euler(90, 0, 0)
        ({"AnkleRight": BACK}, "RightLowerLeg", (HALF, 0.0, 0.0, HALF)),
        # left thigh from −y to +z, the shin hanging: Euler(−90, 0, 0)
        ({"KneeLeft": FRONT}, "LeftUpperLeg", (-HALF, 0.0, 0.0, HALF)),
        # left arm hanging, from −x to −y: Euler(0, 0, 90)
        (dict.fromkeys(("ElbowLeft", "WristLeft", "HandLeft"), DOWN), "LeftUpperArm", (0, 0, HALF, HALF)),
    ],
)  # fmt: skip
@pytest.mark.parametrize("body", BODIES.values(), ids=str)
def test_bent_limbs_have_the_rotations_computed_by_hand(body, directions, bone, expected):
    sent = bones(VmcEncoder(body).encode(posed(body, T_POSE | directions), 0))
    rotation = sent[bone][1]
    np.testing.assert_allclose(rotation * np.sign(rotation @ expected), expected, atol=FLOAT32)


ARGUMENTS = st.one_of(st.integers(-9, 9), st.floats(0, 1, width=32))


@given(
    sent=st.lists(st.tuples(st.integers(1, 60), st.lists(ARGUMENTS, max_size=4)), min_size=40, max_size=60)
)
def test_any_messages_come_in_order_in_the_fewest_datagrams_that_they_fit_into(sent):
    sent = [("/" + "x" * length, arguments) for length, arguments in sent]
    datagrams = bundled(sent)
    assert messages(datagrams) == sent
    assert all(len(datagram) <= 1472 for datagram in datagrams)
    for one, following in pairwise(datagrams):
        first = len(bundled(messages([following])[:1])[0]) - 16
        assert len(one) + first > 1472


@pytest.mark.parametrize("body", BODIES.values(), ids=str)
def test_a_frame_fits_into_datagrams_and_has_what_the_protocol_wants(body):
    encoder = VmcEncoder(body)
    datagrams = encoder.encode(posed(body, {}), 1_500_000_000)
    assert max(map(len, datagrams)) <= 1472
    assert len(datagrams) <= 2
    read = messages(datagrams)
    assert read[0] == ("/VMC/Ext/OK", [1, 3, 0, 1])
    assert read[1] == ("/VMC/Ext/T", [1.5])
    assert read[2] == ("/VMC/Ext/Root/Pos", ["root", 0, 0, 0, 0, 0, 0, 1])
    nobody = messages(encoder.encode(np.full((len(body), 3), np.nan), 2_000_000_000))
    assert nobody == [("/VMC/Ext/OK", [1, 3, 0, 0]), ("/VMC/Ext/T", [2.0])]


def test_a_jump_does_not_move_the_floor_and_an_outlier_hardly():
    body = KINECT_V2
    encoder = VmcEncoder(body)
    standing = posed(body, T_POSE)

    def hips(joints, frame):
        return float(bones(encoder.encode(joints, frame * FRAME_NS))["Hips"][0][1])

    height = hips(standing, 0)
    for frame in range(1, 16):  # half a second in the air, 0.4 m high
        assert hips(standing - [0.0, 0.4, 0.0], frame) == pytest.approx(height + 0.4, abs=0.01 * 0.5 + 1e-6)
    outlier = standing.copy()
    outlier[body.joint("FootLeft"), 1] += 0.5
    assert hips(outlier, 16) == pytest.approx(height, abs=0.3 / 30 + 0.006)


@pytest.mark.parametrize("version", [0, 1])
def test_an_avatar_keeps_its_proportions_and_moves_at_the_hips(tmp_path, version):
    body = KINECT_V2
    avatar = read_avatar(write_vrm(tmp_path / "a.vrm", version, hips=0.5))
    encoder, plain = VmcEncoder(body, avatar), VmcEncoder(body)
    standing = posed(body, T_POSE)
    sent = bones(encoder.encode(standing, 0))
    # both versions: the front of the file's person is +z in Unity, its left −x
    np.testing.assert_allclose(sent["Chest"][0], [0.0, 0.3, 0.02], atol=FLOAT32)
    np.testing.assert_allclose(sent["Neck"][0], [0.0, 0.1, 0.0], atol=FLOAT32)  # relative to UpperChest
    np.testing.assert_allclose(sent["LeftUpperLeg"][0], [-0.08, -0.05, 0.0], atol=FLOAT32)
    np.testing.assert_allclose(sent["LeftLowerLeg"][0], 0.0, atol=FLOAT32)  # which the file lacks
    moved = standing + [0.3, 0.0, -0.4]
    plain.encode(standing, 0)
    there, walked = (bones(each.encode(moved, FRAME_NS))["Hips"][0] for each in (encoder, plain))
    scale = 0.5 / (0.42 + 0.41 + 0.08)  # the avatar's hips above the floor over the person's leg
    np.testing.assert_allclose(there + [0.0, 0.1, 0.0], scale * walked, atol=1e-5)


def test_a_file_that_is_no_avatar_gives_one_line(tmp_path):
    whole = write_vrm(tmp_path / "a.vrm", 1).read_bytes()
    bad = tmp_path / "bad.vrm"
    rng = np.random.default_rng(3)
    for k in range(300):
        damaged = bytearray(whole[: rng.integers(0, len(whole))] if k % 2 else whole)
        for at in rng.integers(0, max(len(damaged), 1), 5):
            if damaged:
                damaged[at] = rng.integers(0, 256)
        bad.write_bytes(bytes(damaged))
        try:
            read_avatar(bad)
        except UsageError as fault:
            assert "\n" not in str(fault)  # noqa: PT017
    no_hips = whole.replace(b'"hips": {', b'"lips": {')
    for content, words in ((b"", "shorter than a header"), (no_hips, "no 'hips'")):
        bad.write_bytes(content)
        with pytest.raises(UsageError, match=words):
            read_avatar(bad)
    with pytest.raises(UsageError, match=r"--avatar .*none\.vrm"):
        read_avatar(tmp_path / "none.vrm")


def test_a_long_chain_of_bones_is_multiplied_once(monkeypatch):
    chain = [{"children": [k + 1], "translation": [0, 0.001, 0]} for k in range(1000)]
    bones = {f"b{k}": {"node": k} for k in range(1, 1000)} | {"hips": {"node": 500}}
    gltf = {"nodes": [*chain, {}], "extensions": {"VRMC_vrm": {"humanoid": {"humanBones": bones}}}}
    computed = []
    matrix_of = vrm_module._matrix
    monkeypatch.setattr(vrm_module, "_matrix", lambda node: computed.append(node) or matrix_of(node))
    avatar = vrm_module._avatar(gltf)
    assert len(computed) <= 1001  # from the root for every bone it would be 500,000
    np.testing.assert_allclose(avatar.hips, [0.0, 0.501, 0.0], atol=1e-9)
    np.testing.assert_allclose(avatar.translations["B900"], [0.0, 0.001, 0.0], atol=1e-9)


JOINTS = {"2": "AnkleLeft", "3": "AnkleRight", "4": "KneeLeft", "5": "KneeRight", "7": "ElbowLeft",
          "8": "ElbowRight", "head": "Head"}  # fmt: skip


def trackers(datagrams):
    """Values by ``slot/what``."""
    read = messages(datagrams)
    for address, values in read:
        assert address.startswith("/tracking/trackers/")
        assert len(values) == 3
    return {address.removeprefix("/tracking/trackers/"): np.array(values) for address, values in read}


@pytest.mark.parametrize("body", BODIES.values(), ids=str)
def test_trackers_are_at_the_joints_in_unity_s_axes(body):
    encoder = VRChatEncoder(body)
    for t, joints in enumerate(moving(body, 60)[::10]):
        datagrams = encoder.encode(joints, t * 10 * FRAME_NS)
        sent = trackers(datagrams)
        assert len(sent) == 18
        assert max(map(len, datagrams)) <= 1472
        offset = sent["1/position"] + joints[body.root]
        for slot, joint in JOINTS.items():
            np.testing.assert_allclose(
                sent[f"{slot}/position"], offset - joints[body.joint(joint)], atol=4e-6
            )


def test_angles_are_unity_s_euler_angles():
    rng = np.random.default_rng(1)
    quaternions = Rotation.random(1000, rng).as_quat()
    # Unity applies z, then x, then y, about fixed axes: intrinsic y, x, z
    yxz = Rotation.from_quat(quaternions).as_euler("YXZ", degrees=True)
    np.testing.assert_allclose(euler_degrees(quaternions), yxz[:, [1, 0, 2]], atol=1e-5)


def test_hand_computed_angles():
    body = KINECT_V2
    sent = trackers(VRChatEncoder(body).encode(posed(body, T_POSE), 0))
    for slot in ("1", "2", "6", "7", "head"):
        np.testing.assert_allclose(sent[f"{slot}/rotation"], 0.0, atol=1e-3)
    quarter = Rotation.from_rotvec([0.0, -math.pi / 2, 0.0])  # to the person's left, which is −x in Unity
    turned = turned_about(posed(body, T_POSE), quarter, body.root)
    sent = trackers(VRChatEncoder(body).encode(turned, 0))
    np.testing.assert_allclose(sent["1/rotation"], [0.0, -90.0, 0.0], atol=1e-3)
    # a raised left thigh, from −y to +z: Euler(−90, 0, 0); at 90 degrees the other angles are not determined
    lifted = posed(body, T_POSE | {"KneeLeft": FRONT})
    assert trackers(VRChatEncoder(body).encode(lifted, 0))["4/rotation"][0] == pytest.approx(-90.0, abs=0.1)


def test_nobody_gives_no_trackers(fuser):
    assert VRChatEncoder(KINECT_V2).encode(np.full((25, 3), np.nan), 0) == []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(10.0)
        address = Address("127.0.0.1", receiver.getsockname()[1])
        output = OscOutput("VRChat", address, "--vrchat", VRChatEncoder(KINECT_V2).encode)
        for frame in frames(fuser, 5):
            output.write(frame)
            assert len(trackers([receiver.recv(2000)])) == 18
        output.close()
    assert output.counts.dropped == 0
