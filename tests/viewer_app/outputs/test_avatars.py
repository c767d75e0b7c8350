"""VMC and VRChat, read back by python-osc: bones, trackers and an avatar's proportions."""

import json
import math
import socket
import struct
from dataclasses import replace
from itertools import chain, pairwise
from uuid import uuid4

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from devices.simulated.kinect import Scene, Truth, movement
from devices.simulated.rig import Rig
from fusion.body import AZURE_KINECT, BODIES, KINECT_V2
from fusion.calibration.calibration import nominal_calibration
from fusion.movement.angles import ANGLES, joint_angles
from fusion.setup import FusionSetup
from recordings.appearance.floor import floor_under
from recordings.gait.events import _LABELLED, find_gait
from recordings.replaying import Replay
from recordings.session import Session
from tests.helpers.demonstrations import fused_demonstration
from tests.helpers.footfalls import contacts
from tests.helpers.live_frames import frames
from tests.helpers.osc import messages
from tests.helpers.poses import (
    BACK,
    DOWN,
    FRONT,
    LEFT,
    RIGHT,
    T_POSE,
    UP,
    posed,
    turned_about,
    world_of_local,
)
from tests.helpers.three_vrm import avatar_page
from tests.helpers.two_views import FRAME_NS, moving
from viewer_app.commands.replay import as_recorded
from viewer_app.errors import UsageError
from viewer_app.outputs.avatars import vrm as vrm_module
from viewer_app.outputs.avatars.osc import Address, OscOutput, bundled
from viewer_app.outputs.avatars.vmc import VmcEncoder
from viewer_app.outputs.avatars.vrchat import VRChatEncoder, euler_degrees
from viewer_app.outputs.avatars.vrm import read_avatar
from viewer_app.outputs.lab_streaming import LabStreamingOutput
from viewer_app.outputs.live_movement import LiveMovement
from viewer_app.outputs.skeleton_json import SkeletonJson
from viewer_app.sinks.item_queue import QueuedFrame

PARENTS = {
    "Spine": "Hips", "Chest": "Spine", "Neck": "Chest", "Head": "Neck",
    **{s + b: (s if a not in ("Chest", "Hips") else "") + a for s in ("Left", "Right") for b, a in (
        ("Shoulder", "Chest"), ("UpperArm", "Shoulder"), ("LowerArm", "UpperArm"), ("Hand", "LowerArm"),
        ("UpperLeg", "Hips"), ("LowerLeg", "UpperLeg"), ("Foot", "LowerLeg"), ("Toes", "Foot"),
    )},
}  # fmt: skip
"""Unity's humanoid, as its manual shows it."""
BEGINS = {
    "LeftUpperArm": "ShoulderLeft", "LeftLowerArm": "ElbowLeft", "LeftHand": "WristLeft",
    "RightUpperArm": "ShoulderRight", "RightLowerArm": "ElbowRight", "RightHand": "WristRight",
    "LeftUpperLeg": "HipLeft", "LeftLowerLeg": "KneeLeft", "LeftFoot": "AnkleLeft", "LeftToes": "FootLeft",
    "RightUpperLeg": "HipRight", "RightLowerLeg": "KneeRight", "RightFoot": "AnkleRight",
    "RightToes": "FootRight", "Head": "Head",
}  # fmt: skip
"""Where a bone begins, in every body."""


def bones(datagrams):
    found = {}
    for address, arguments in messages(datagrams):
        if address == "/VMC/Ext/Bone/Pos":
            name, *values = arguments
            found[str(name)] = np.array(values[:3]), np.array(values[3:])
    return found


def write_vrm(path, version, hips=1.0):
    """A GLB with five bones: Hips under a raised node, UpperChest between Chest and Neck."""
    front = -1.0 if version == 0 else 1.0
    nodes = [
        {"name": "root", "children": [1], "translation": [0, 0.1, 0]},
        {"name": "hips", "children": [2, 5], "translation": [0, hips - 0.1, 0]},
        {"name": "chest", "children": [3], "translation": [0, 0.3, 0.02 * front]},
        {"name": "upper chest", "children": [4], "translation": [0, 0.1, 0]},
        {"name": "neck", "translation": [0, 0.1, 0]},
        {"name": "thigh", "translation": [0.08 * front, -0.05, 0]},
    ]
    where = {"hips": 1, "chest": 2, "upperChest": 3, "neck": 4, "leftUpperLeg": 5}
    if version == 0:
        humanoid = {"VRM": {"humanoid": {"humanBones": [{"bone": b, "node": n} for b, n in where.items()]}}}
    else:
        humanoid = {"VRMC_vrm": {"humanoid": {"humanBones": {b: {"node": n} for b, n in where.items()}}}}
    return _write_glb(path, {"nodes": nodes, "extensions": humanoid})


def write_figure(path, rest):
    """A VRM 1.0 of boxes, one for each bone, in the T-pose.

    Args:
        rest: By Unity's name of a bone, parents first: (3,) metres from the bone above, in Unity's axes.
    """
    names = list(rest)
    nodes = [{"name": name, "translation": _to_gltf(rest[name]), "children": []} for name in names]
    for name, above in PARENTS.items():
        end = names.index(name)
        nodes[names.index(above)]["children"].append(end)
        along = np.array(nodes[end]["translation"])
        wide = 0.12 if above in ("Hips", "Spine", "Chest") else 0.07
        box = {"mesh": 0, "translation": (0.5 * along).tolist(), "scale": (np.abs(along) + wide).tolist()}
        nodes[names.index(above)]["children"].append(len(nodes))
        nodes.append(box)
    for node in nodes:
        if not node.get("children"):
            node.pop("children", None)
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)], np.float32)
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([(a, b, c, a, c, d) for a, b, c, d in sides], np.uint16).ravel()
    blob = corners.tobytes() + faces.tobytes()
    meta = {"name": "boxes", "authors": ["nobody"], "licenseUrl": "https://vrm.dev/licenses/1.0/"}
    bones_of = {name[0].lower() + name[1:]: {"node": k} for k, name in enumerate(names)}
    return _write_glb(
        path,
        {
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": nodes,
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
            "accessors": [
                {
                    "bufferView": 0,
                    "componentType": 5126,
                    "count": 8,
                    "type": "VEC3",
                    "min": [-0.5, -0.5, -0.5],
                    "max": [0.5, 0.5, 0.5],
                },
                {"bufferView": 1, "componentType": 5123, "count": len(faces), "type": "SCALAR"},
            ],
            "bufferViews": [
                {"buffer": 0, "byteLength": corners.nbytes},
                {"buffer": 0, "byteOffset": corners.nbytes, "byteLength": faces.nbytes},
            ],
            "buffers": [{"byteLength": len(blob)}],
            "extensionsUsed": ["VRMC_vrm"],
            "extensions": {
                "VRMC_vrm": {"specVersion": "1.0", "meta": meta, "humanoid": {"humanBones": bones_of}}
            },
        },
        blob,
    )


def _to_gltf(place):
    """Unity's left-handed axes to glTF's, as UniVRM does for VRM 1.0."""
    return (np.array(place) * [-1.0, 1.0, 1.0]).tolist()


def _write_glb(path, content, blob=b""):
    text = json.dumps({"asset": {"version": "2.0"}, **content}).encode()
    text += b" " * (-len(text) % 4)
    blob += bytes(-len(blob) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    if blob:
        chunks += struct.pack("<I4s", len(blob), b"BIN\0") + blob
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)
    return path


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


LIMBS = {
    "LowerArm": "UpperArm",
    "Hand": "LowerArm",
    "LowerLeg": "UpperLeg",
    "Foot": "LowerLeg",
    "Toes": "Foot",
}


@pytest.mark.parametrize("body", BODIES.values(), ids=str)
def test_a_receiver_s_forward_kinematics_gives_the_limbs_of_s_and_nothing_wanders(body):
    """Where bones share a joint, at hips and chest, they are as in the T-pose: there is one rotation."""
    encoder, kept = VmcEncoder(body), {}
    for t, joints in enumerate(moving(body, 120)[::4]):
        sent = bones(encoder.encode(joints, t * 4 * FRAME_NS))
        at, _ = world(sent)
        for name, joint in BEGINS.items():
            last = name.removeprefix("Left").removeprefix("Right")
            if last in LIMBS:
                above = name.removesuffix(last) + LIMBS[last]
                way = joints[body.joint(joint)] - joints[body.joint(BEGINS[above])]
                np.testing.assert_allclose(at[name] - at[above], -way, atol=4 * FLOAT32)
            if name != "Hips":
                place = kept.setdefault(name, sent[name][0])
                np.testing.assert_allclose(sent[name][0], place, atol=4 * FLOAT32, err_msg=name)


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


# --- An avatar that VMC moves, in pixiv's three-vrm: its limbs point where those of S* do.


POSES = {
    "arms_down": dict.fromkeys(
        (f"{joint}{side}" for joint in ("Elbow", "Wrist", "Hand") for side in ("Left", "Right")), DOWN
    ),
    "greets": {
        "ElbowRight": RIGHT,
        "WristRight": UP,
        "HandRight": UP,
        **dict.fromkeys(("ElbowLeft", "WristLeft", "HandLeft"), DOWN),
    },
    "steps": {
        "KneeLeft": FRONT,
        "AnkleLeft": DOWN,
        **dict.fromkeys(("ElbowRight", "WristRight", "HandRight"), FRONT),
        **dict.fromkeys(("ElbowLeft", "WristLeft", "HandLeft"), LEFT),
    },
}
LIMBS = [(above, name) for name, above in PARENTS.items() if above in BEGINS and name in BEGINS]


@pytest.mark.parametrize("body", BODIES.values(), ids=str)
def test_limbs_of_an_avatar_point_where_those_of_the_person_do(body, tmp_path):
    """The avatar has other proportions: legs are a third longer, arms a quarter shorter."""
    rest = {name: at for name, (at, _) in bones(VmcEncoder(body).encode(posed(body, T_POSE), 0)).items()}
    for name in rest:
        rest[name] = rest[name] * (
            1.33 if "Leg" in name or "Foot" in name else 0.75 if "Arm" in name else 1.0
        )
    rest["Hips"][1] *= 1.33
    path = write_figure(tmp_path / "boxes.vrm", rest)
    encoder = VmcEncoder(body, read_avatar(path))
    poses = {name: posed(body, directions) for name, directions in POSES.items()}
    every = [*poses.items(), *((None, joints) for joints in moving(body, 60)[::12])]
    with avatar_page(path) as page:
        for number, (picture, joints) in enumerate(every):
            sent = bones(encoder.encode(joints, number * 30 * FRAME_NS))
            told = [(name, at.tolist(), turn.tolist()) for name, (at, turn) in sent.items()]
            found = {name: np.array(at) for name, at in page.evaluate("bones => pose(bones)", told).items()}
            for above, name in LIMBS:
                limb = found[name] - found[above]
                begin, end = (joints[body.joint(BEGINS[bone])] for bone in (above, name))
                person = (end - begin) * [1.0, -1.0, -1.0]  # y up, z towards the sensor
                lengths = np.linalg.norm(limb), np.linalg.norm(person)
                # VMC has float32, three.js matrices of float32: 1e-5 of each of six bones
                np.testing.assert_allclose(limb / lengths[0], person / lengths[1], atol=6e-5, err_msg=name)
                np.testing.assert_allclose(lengths[0], np.linalg.norm(rest[name]), rtol=6e-5)
            if picture:
                page.screenshot(path=str(tmp_path / f"{picture}.png"))


# --- Angles and gait events of live frames, as LSL, WebSocket and Zenoh send them.


SETUP = FusionSetup(nominal_calibration(AZURE_KINECT))


@pytest.fixture
def walk(fuser):
    """Twelve seconds of a person who starts to walk; S* is the truth."""
    template = frames(fuser, 1)[0]
    times = np.arange(360) * 33_333_333
    joints = Truth(Scene(movement("walk"), AZURE_KINECT), Rig()).positions_at(times + 2_000_000_000)
    sigma = np.full(len(AZURE_KINECT), 0.02)
    return [
        QueuedFrame(
            k, replace(template, fused=replace(template.fused, positions=at, sigma=sigma)), time_ns, time_ns
        )
        for k, (time_ns, at) in enumerate(zip(times.tolist(), joints, strict=True))
    ]


def test_every_event_of_a_walk_is_reported_once_and_soon(walk):
    live, told = LiveMovement(AZURE_KINECT), []
    for frame in walk:
        live.angles(frame)
        told += [(event, frame.time_ns) for event in live.new_events()]
    times = np.array([frame.time_ns for frame in walk])
    joints = np.array([frame.fused.positions for frame in walk])
    whole = find_gait(AZURE_KINECT, times, joints, (0.0, -1.0, 0.0))
    due = [(at, name.replace("_", " ")) for at, name in whole.events if at < times[-1] * 1e-9 - 0.6]
    found = sorted((event.time_ns * 1e-9, event.text) for event, _ in told)[: len(due)]
    assert [name for _, name in found] == [name for _, name in due]
    np.testing.assert_allclose([at for at, _ in found], [at for at, _ in due], atol=0.03)
    third = whole.steps[2].strike
    strikes = [(event, now) for event, now in told if event.text.startswith("heel")]
    assert max(now - event.time_ns for event, now in strikes if event.time_ns * 1e-9 > third) < 0.6e9


def test_live_toe_offs_and_strikes_are_those_of_laboratories(walk):
    live, late = LiveMovement(AZURE_KINECT), {"heel strike": [], "toe off": []}
    true = contacts("walk", 14.0)
    for frame in walk:
        live.angles(frame)
        for event in live.new_events():
            kind, _, side = event.text.rpartition(" ")
            touched = true[side][kind == "toe off"] - 2.0  # the walk is without its first two seconds
            off = event.time_ns * 1e-9 - _LABELLED - touched
            late[kind].append(off[np.abs(off).argmin()])
    for of_kind in late.values():
        assert len(of_kind) > 12
        assert abs(np.mean(of_kind)) < 0.02
        assert np.abs(of_kind).max() < 0.05


def test_json_has_the_angles_and_their_uncertainty_and_null_where_unknown(walk):
    encoder = SkeletonJson(SETUP)
    assert json.loads(encoder.hello(SETUP))["angles"] == list(ANGLES)
    frame = walk[0]
    said = json.loads(encoder.frame(frame))
    expected = joint_angles(AZURE_KINECT, frame.fused.positions)
    np.testing.assert_allclose(said["angles"][:-2], expected[:-2], atol=0.006)
    assert all(0.0 < sigma < 180.0 for sigma in said["angle_sigma"])
    frame.fused.positions[AZURE_KINECT.joint("WRIST_LEFT")] = np.nan
    said = json.loads(encoder.frame(frame))
    assert said["angles"][ANGLES.index("elbow_flexion_left")] is None


@pytest.fixture(scope="module")
def live_run(tmp_path_factory):
    """A demonstration as the live loop fuses it, and its session."""
    run = fused_demonstration(AZURE_KINECT, 14.0, motion="walk")
    path = tmp_path_factory.mktemp("live") / "s.rrd"
    Session.of(run.parts).save(path)
    return run.frames, Session.open(path)


def sent(frames):
    """(T, K) angles of the stream; NaN where they are null."""
    encoder, start_ns = SkeletonJson(SETUP), None
    for k, frame in enumerate(frames):
        start_ns = frame.pair.time_ns if start_ns is None else start_ns
        queued = QueuedFrame(k, frame, frame.pair.time_ns - start_ns, 0)
        yield json.loads(encoder.frame(queued))["angles"] or [None] * len(ANGLES)


# rounded to 0.01; S* in the file to 1e-7 m, of bones of 0.1 m
NEAR = 0.006


def test_angles_sent_live_are_those_of_the_session(live_run):
    frames, session = live_run
    found = np.array(list(sent(frames)), dtype=float)
    np.testing.assert_allclose(found, session.angles.degrees, atol=NEAR)
    of_all = joint_angles(AZURE_KINECT, session.fused, session.up)
    assert np.nanmax(np.abs(of_all - session.angles.degrees)) > 0.5  # of another vertical


@pytest.mark.parametrize("live", [True, False])
def test_angles_sent_by_a_replay_are_those_of_its_session(live_run, live):
    session = live_run[1]
    if not live:  # as of recordings
        session = replace(session, rows=replace(session.rows, up=None))
    replay = Replay.of(session)
    blocks = list(replay.blocks())
    found = np.array(list(sent(as_recorded(chain.from_iterable(blocks), session))), dtype=float)
    again = replay.fused(iter(blocks))
    for each in (session, again):
        np.testing.assert_allclose(found, each.angles.degrees, atol=NEAR)


@pytest.mark.parametrize("higher", [0.0, 1.5])
def test_the_floor_of_a_replay_is_that_of_its_session_also_above_the_sensors(live_run, higher):
    some, session = live_run
    fused = session.fused + higher * session.up
    session = replace(session, rows=replace(session.rows, fused=fused, up=None))
    floor = next(as_recorded(some, session)).floor
    np.testing.assert_allclose(floor.translation, floor_under(session.rows).translation, atol=1e-9)
    assert (floor.translation @ session.up > 0.0) == (higher > 0.0)


@pytest.mark.parametrize("damage", [np.nan, 0.0, 1e30])
def test_a_damaged_vertical_is_that_of_all_frames(live_run, damage):
    session = live_run[1]
    up = session.rows.up.copy()
    up[100:200] = damage
    odd = replace(session, rows=replace(session.rows, up=up))
    expected = joint_angles(AZURE_KINECT, session.fused[100:200], session.up)
    np.testing.assert_allclose(odd.angles.degrees[100:200], expected, atol=1e-9)
    np.testing.assert_array_equal(odd.angles.degrees[200:], session.angles.degrees[200:])


def test_an_inlet_reads_angles_and_heel_strikes_at_their_times(walk):
    pylsl = pytest.importorskip("pylsl", exc_type=ImportError)
    name = f"test-{uuid4().hex[:8]}"
    output = LabStreamingOutput(name, AZURE_KINECT, 30.0)
    try:
        angles, events = (
            pylsl.StreamInlet(pylsl.resolve_byprop("name", f"{name}-{of}", timeout=30.0)[0])
            for of in ("angles", "events")
        )
        for inlet in (angles, events):
            inlet.open_stream(timeout=30.0)
        for frame in walk:
            output.send_frame(frame)
        sample, stamp = angles.pull_sample(timeout=30.0)
        assert len(sample) == 2 * len(ANGLES)
        np.testing.assert_allclose(
            sample[: 2 * 12 : 2], joint_angles(AZURE_KINECT, walk[0].fused.positions)[:12], atol=1e-3
        )
        text, happened = events.pull_sample(timeout=30.0)
        assert text == ["INFO: toe off right"]
        assert 0.0 < happened - stamp < 4.0
    finally:
        output.close()
