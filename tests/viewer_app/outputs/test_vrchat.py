"""VRChat's OSC trackers, read back by python-osc."""

import math
import socket

import numpy as np
import pytest
from pythonosc import osc_packet
from scipy.spatial.transform import Rotation

from fusion.body import BODIES, KINECT_V2
from tests.helpers.live_frames import frames
from tests.helpers.poses import FRONT, T_POSE, posed, turned_about
from tests.helpers.two_views import FRAME_NS, moving
from viewer_app.outputs.osc import Address, OscOutput
from viewer_app.outputs.vrchat import VRChatEncoder, euler_degrees

JOINTS = {"2": "AnkleLeft", "3": "AnkleRight", "4": "KneeLeft", "5": "KneeRight", "7": "ElbowLeft",
          "8": "ElbowRight", "head": "Head"}  # fmt: skip


def trackers(datagrams):
    """Values by ``slot/what``."""
    read = [m.message for d in datagrams for m in osc_packet.OscPacket(d).messages]
    for message in read:
        assert message.address.startswith("/tracking/trackers/")
        assert len(message.params) == 3
    return {m.address.removeprefix("/tracking/trackers/"): np.array(m.params) for m in read}


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
