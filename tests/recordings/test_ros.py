"""Recordings of ROS 2, read back by rosbags, mcap-ros2-support and Rerun."""

import re
import sys
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from devices.events import Event
from fusion.body import BODIES, KINECT_V2
from fusion.rigid import RigidTransform
from recordings.appearance.floor import floor_under
from recordings.errors import RecordingError
from recordings.export.ros_messages import TOPICS, RosFrame, RosMessages, definition
from recordings.session import Session
from tests.helpers.command_line import duplex, one_line
from tests.helpers.frame_pairs import frame_pairs
from tests.helpers.fused_runs import GAP, record_fused, record_with_a_gap
from tests.helpers.machine import lacks
from tests.helpers.ros import OPTICAL, Frames, messages, nanoseconds, rosbags
from tests.helpers.two_views import calibration_of

HUMANS = "/humans/bodies/duplex"
LINKS = {"body", "waist", "torso", "head"} | {
    f"{side}_{joint}" for side in "lr" for joint in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
}
"""Of REP 155, those that are in the middle of what turns."""
PRIMITIVES = re.compile(r"(bool|byte|char|string|float(32|64)|u?int(8|16|32|64))(\[\d*\])?")


@pytest.fixture
def session(request, tmp_path):
    """A moving person, whom no sensor sees in three frames."""
    rosbags()
    return record_with_a_gap(
        tmp_path / "s.rrd", getattr(request, "param", KINECT_V2), GAP[-1] + 3, jitter_ns=0
    )


OF_EVERY_BODY = pytest.mark.parametrize("session", BODIES.values(), indirect=True, ids=str)


def export(session, **about):
    said = {**session.about["session"], **about}
    path = session.path.with_suffix(".mcap")
    words = replace(session, about={**session.about, "session": said}).export(path)
    return path, words


@OF_EVERY_BODY
def test_frames_are_where_the_session_has_them(session):
    path, words = export(session)
    assert "does not say when" in words
    read = messages(path)
    static = [of for topic, _, message in read if topic == "/tf_static" for of in message.transforms]
    moving = [message.transforms for topic, _, message in read if topic == "/tf"]
    assert len(moving) == len(session)
    floor = floor_under(session.rows).inverse()
    for k, transforms in enumerate(moving):
        assert {nanoseconds(of.header.stamp) for of in transforms} == {int(session.time_ns[k])}
        frames = Frames([*static, *transforms])
        turned, place = frames.pose("sensor_b_optical", "sensor_a")
        np.testing.assert_allclose(turned.as_matrix(), OPTICAL @ session.rotation[k], atol=1e-9)
        np.testing.assert_allclose(place, OPTICAL @ session.translation[k], atol=1e-9)
        if k in GAP:
            assert not any(name.endswith("_duplex") for name in frames.names())
            continue
        assert {f"{link}_duplex" for link in LINKS} <= frames.names()
        for name in ("l_elbow", "r_ankle", "head"):
            words = {"l": "left", "r": "right"}
            side, _, joint = name.rpartition("_")
            at = session.fused[k, session.body.joint(f"{joint} {words.get(side, '')}".strip())]
            for seen_from, there in (("sensor_a", at), ("map", floor.apply(at))):
                place = frames.pose(f"{name}_duplex", seen_from)[1]
                np.testing.assert_allclose(place, OPTICAL @ there, atol=1e-9)


@OF_EVERY_BODY
def test_axes_are_forward_left_and_up(session):
    """The z axis of a limb points from its end to its beginning; x of the body is where the person faces."""
    read = messages(export(session)[0])
    of_pelvis = session.rotations.quaternions[:, session.body.root]
    for k, transforms in enumerate(message.transforms for topic, _, message in read if topic == "/tf"):
        if k in GAP:
            continue
        frames, at = Frames(transforms), session.fused[k]
        turned, place = frames.pose("body_duplex", "sensor_a")
        hips = [OPTICAL @ at[session.body.joint(f"hip {side}")] for side in ("left", "right")]
        np.testing.assert_allclose(place, np.mean(hips, axis=0), atol=1e-9)
        # at rest the front is towards the sensor, and the person's left where the sensor has its right
        for axis, at_rest in (([1.0, 0.0, 0.0], [0.0, 0.0, -1.0]), ([0.0, 1.0, 0.0], [1.0, 0.0, 0.0])):
            there = OPTICAL @ Rotation.from_quat(of_pelvis[k]).apply(at_rest)
            np.testing.assert_allclose(turned.apply(axis), there, atol=1e-9)
        for side, name in (("l", "left"), ("r", "right")):
            for begin, end in (("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle")):
                upper, lower = (at[session.body.joint(f"{joint} {name}")] for joint in (begin, end))
                up = frames.pose(f"{side}_{begin}_duplex", "sensor_a")[0].apply([0.0, 0.0, 1.0])
                bone = OPTICAL @ (upper - lower)
                np.testing.assert_allclose(up, bone / np.linalg.norm(bone), atol=1e-6)


def test_a_person_who_faces_the_sensor_faces_backwards_in_its_frame(tmp_path):
    rosbags()
    session = record_fused(tmp_path / "s.rrd", frame_pairs(KINECT_V2, 10), calibration_of(KINECT_V2))
    read = messages(export(session)[0])
    frames = Frames(next(message.transforms for topic, _, message in read if topic == "/tf"))
    turned = frames.pose("body_duplex", "map")[0]
    assert turned.apply([1.0, 0.0, 0.0]) @ [-1.0, 0.0, 0.0] > 0.7
    assert turned.apply([0.0, 0.0, 1.0]) @ [0.0, 0.0, 1.0] > 0.9
    assert frames.pose("head_duplex", "map")[1][2] > 1.3  # metres above the floor


@OF_EVERY_BODY
def test_markers_angles_and_uncertainty_are_those_of_the_session(session):
    read = messages(export(session)[0])
    body, never = session.body, session.rows.never_seen
    of = {topic: [message for each, _, message in read if each == topic] for topic in TOPICS}
    for k, message in enumerate(of[f"{HUMANS}/markers"]):
        joints, bones = message.markers
        assert (joints.ns, bones.ns, joints.header.frame_id) == ("joints", "bones", "sensor_a")
        assert joints.lifetime.sec >= 1
        if k in GAP:
            assert (joints.action, bones.action) == (joints.DELETE, bones.DELETE)
            continue
        assert (joints.action, joints.type, bones.type) == (joints.ADD, joints.SPHERE_LIST, joints.LINE_LIST)
        points, ends = (np.array([[p.x, p.y, p.z] for p in each.points]) for each in (joints, bones))
        np.testing.assert_allclose(points, session.fused[k][~never] @ OPTICAL.T, atol=1e-9)
        lengths = [
            session.bone_lengths[k, j] for j in body.bone_joints if not (never[j] or never[body.parents[j]])
        ]
        np.testing.assert_allclose(np.linalg.norm(ends[1::2] - ends[::2], axis=1), lengths, atol=1e-5)
    there = np.isfinite(session.fused[:, body.root, 0])
    for k, message in zip(np.flatnonzero(there), of[f"{HUMANS}/angles"], strict=True):
        for name, radians in zip(message.name, message.position, strict=True):
            np.testing.assert_allclose(radians, np.radians(session.angles[name][k]), atol=1e-12)
    assert [list(message.ids) for message in of["/humans/bodies/tracked"]] == [
        ["duplex"] if one else [] for one in there
    ]
    for k, message, pose in zip(
        np.flatnonzero(there), of[f"{HUMANS}/joint_covariances"], of[f"{HUMANS}/pose"], strict=True
    ):
        told = message.data.reshape([of.size for of in message.layout.dim])
        label, *names = message.layout.dim[0].label.split()
        assert (label, len(names)) == ("joints", len(body))
        np.testing.assert_allclose(
            np.sqrt(np.trace(told, axis1=1, axis2=2)), np.where(never, np.nan, session.sigma[k]), rtol=1e-5
        )
        both = pose.pose.covariance.reshape(6, 6)
        hips = [session.sigma[k, body.joint(f"hip {side}")] ** 2 for side in ("left", "right")]
        np.testing.assert_allclose(np.trace(both[:3, :3]), np.mean(hips), rtol=1e-5)


def test_another_decoder_and_rerun_read_the_same(session):
    path, _ = export(session, recorded=["2026-03-01T10:00:00.250+00:00"])
    first_ns = 1_772_359_200_250_000_000
    places = [
        [(of.child_frame_id, of.transform.translation.x) for of in message.transforms]
        for topic, _, message in messages(path)
        if topic == "/tf"
    ]
    try:
        from mcap_ros2.reader import read_ros2_messages
    except ImportError:
        lacks("mcap-ros2-support", "pip install mcap-ros2-support")
    decoded = list(read_ros2_messages(path))
    assert places == [
        [(of.child_frame_id, of.transform.translation.x) for of in one.ros_msg.transforms]
        for one in decoded
        if one.channel.topic == "/tf"
    ]
    assert {one.log_time_ns for one in decoded} == set((first_ns + session.time_ns).tolist())

    import rerun.chunk as rerun_chunk

    found, times = {}, set()
    for chunk in rerun_chunk.McapReader(path).stream():
        batch = chunk.to_record_batch()
        if chunk.entity_path == "/tf" and "Transform3D:translation" in batch.schema.names:
            times |= set(batch["message_log_time"].cast("int64").to_pylist())
            names, where = (batch[f"Transform3D:{of}"].to_pylist() for of in ("child_frame", "translation"))
            for (child,), (place,) in zip(names, where, strict=True):
                found.setdefault(child, []).append(place[0])
    assert times == set((first_ns + session.time_ns).tolist())
    wanted = {}
    for frame in places:
        for child, x in frame:
            wanted.setdefault(child, []).append(x)
    assert {child: len(xs) for child, xs in found.items()} == {c: len(xs) for c, xs in wanted.items()}
    for child, xs in wanted.items():
        np.testing.assert_allclose(found[child], xs, atol=1e-6, err_msg=child)  # Rerun keeps float32


@pytest.mark.parametrize("kind", sorted(set(TOPICS.values())))
def test_a_schema_defines_all_that_it_names(kind):
    """As Foxglove asks: each type that a field has is in the same text, after a line of 80 ``=``."""
    rosbags()
    own, *others = definition(kind).split("=" * 80 + "\n")
    known, used = set(), set()
    for section in others:
        head, _, own_lines = section.partition("\n")
        known.add(head.removeprefix("MSG: "))
        used |= types_of(own_lines)
    assert types_of(own) | used == known


def types_of(lines):
    named = (line.split()[0] for line in lines.splitlines() if line.strip() and "=" not in line)
    return {re.sub(r"\[.*\]", "", name) for name in named if not PRIMITIVES.fullmatch(name)}


def test_static_frames_are_offered_to_those_who_come_later(session):
    from rosbags.interfaces import QosDurability
    from rosbags.rosbag2 import Reader

    with Reader(export(session)[0]) as reader:
        offered = {of.topic: of.ext.offered_qos_profiles for of in reader.connections}
    assert [one.durability for one in offered["/tf_static"]] == [QosDurability.TRANSIENT_LOCAL]


def test_covariances_turn_with_the_axes_and_stay_covariances():
    rosbags()
    random = np.random.default_rng(0)
    J = len(KINECT_V2)
    roots = random.normal(size=(J, 3, 3))
    covariance = roots @ roots.transpose(0, 2, 1)
    frame = RosFrame(
        0,
        random.normal(size=(J, 3)),
        np.tile([0.0, 0.0, 0.0, 1.0], (J, 1)),
        np.arange(J) != 3,
        covariance,
        np.full(14, np.nan),
        RigidTransform.identity(),
        RigidTransform.identity(),
    )
    from rosbags.typesys import Stores, get_typestore

    data = dict(RosMessages(KINECT_V2).of_frame(frame))[f"{HUMANS}/joint_covariances"]
    kind = TOPICS[f"{HUMANS}/joint_covariances"]
    told = get_typestore(Stores.ROS2_JAZZY).deserialize_cdr(data, kind).data.reshape(J, 3, 3)
    assert np.isnan(told[3]).all()
    ahead, left, up = (axis @ OPTICAL for axis in np.eye(3))
    for row, direction in enumerate((ahead, left, up)):
        variance = np.einsum("i,jik,k->j", direction, covariance, direction)
        np.testing.assert_allclose(np.delete(told[:, row, row], 3), np.delete(variance, 3), rtol=1e-5)


def test_events_are_lines_of_a_log(session):
    lost = Event("saved no more").placed(len(session), int(session.time_ns[-1]) + 1)  # its frame is damaged
    events = (*session.events, Event("sensor B lost", "WARN").placed(5, int(session.time_ns[5])), lost)
    path, _ = export(replace(session, events=events))
    said = [(message.level, message.msg) for topic, _, message in messages(path) if topic == "/duplex/events"]
    assert (30, "sensor B lost") in said
    assert len(said) == len(events)


def test_a_missing_package_is_one_line(session, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "rosbags.typesys", None)
    with pytest.raises(RecordingError, match=r"needs the package rosbags: .* -m pip install"):
        export(session)
    to = session.path.with_name("t.mcap")
    assert duplex("export", session.path, "--to", to) == 2
    assert "duplex-kinects[ros]" in one_line(capsys)
    assert not to.exists()


def test_a_part_keeps_the_time_of_its_frames(session):
    about = {**session.about["session"], "recorded": ["2026-03-01T10:00:00.250+00:00"]}
    whole = replace(session, about={**session.about, "session": about})
    part = whole.part(np.arange(4, len(session))).part(np.arange(5, 18))
    assert part.first_unix_ns == pytest.approx(whole.first_unix_ns + int(session.time_ns[9]), abs=1e6)
    part.save(session.path.with_name("part.rrd"))
    assert Session.open(session.path.with_name("part.rrd")).first_unix_ns == part.first_unix_ns
    for said in ("", "yesterday", "1820-01-01T00:00:00Z", "9999-12-31T23:59:59-12:00"):
        odd = {**about, "recorded": [said]}
        assert replace(session, about={**session.about, "session": odd}).first_unix_ns is None
