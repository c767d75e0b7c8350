"""S* as messages of ROS 2, for robots: frames, markers, angles, uncertainty.

Frames have the axes of REP 103: x forward, y left, z up, but optical ones x right, y down, z forward. ``map``
lies on the floor below the first sensor and looks where it looks. The frames of the body are named as in REP
155 (ROS4HRI), and end in :data:`BODY_ID`: ``body_duplex`` in the middle of the hips, and as its
children ``waist``, ``torso`` and one for each joint, which turns with the bone that begins there. All are
upright where the person stands with hanging arms.
"""

import re
from collections.abc import Iterator, Mapping
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from devices.events import Event
from fusion.body import Body
from fusion.movement.angles import ANGLES
from fusion.movement.humanoid import human_bones
from fusion.movement.joint_rotations import joint_bones
from fusion.rigid import RigidTransform
from fusion.support.types import Array

BODY_ID = "duplex"
"""Identifier of the person, at the end of the names of frames."""
_HUMANS = f"/humans/bodies/{BODY_ID}"
TOPICS = {
    "/tf": "tf2_msgs/msg/TFMessage",
    "/tf_static": "tf2_msgs/msg/TFMessage",
    "/humans/bodies/tracked": "hri_msgs/msg/IdsList",
    f"{_HUMANS}/pose": "geometry_msgs/msg/PoseWithCovarianceStamped",
    f"{_HUMANS}/joint_covariances": "std_msgs/msg/Float32MultiArray",
    f"{_HUMANS}/angles": "sensor_msgs/msg/JointState",
    f"{_HUMANS}/markers": "visualization_msgs/msg/MarkerArray",
    "/duplex/events": "rcl_interfaces/msg/Log",
}
"""The type of the messages of each topic."""
_IDS_LIST = "std_msgs/Header header\nstring[] ids\n"
_FROM_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""From x right, y down, z forward to x forward, y left, z up."""
_OF_PERSON = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])
"""Columns: forward, left and up of a person at rest, who faces the sensor, in its optical frame."""
_ANY_ANGLE = np.pi**2 / 3.0
"""rad², the variance of an angle of which nothing is known."""
_LIFETIME_NS = 1_000_000_000
_LEVELS = {"INFO": 20, "WARN": 30, "ERROR": 40}
_SPHERES, _LINES, _ADD, _DELETE = 7, 5, 0, 2  # visualization_msgs/Marker


class RosFrame(NamedTuple):
    """What the messages of a frame tell; J joints, in K_A's optical frame."""

    time_ns: int  # of the capture, since 1970 UTC; where that is not known since the first frame
    positions: Array  # (J, 3) metres; NaN without a person
    rotations: Array  # (J, 4) x, y, z, w, of :class:`fusion.movement.joint_rotations.JointRotations`
    seen: NDArray[np.bool_]  # (J,) which joints are told
    covariance: Array | None  # (J, 3, 3) m²
    angles: Array  # (K,) degrees; NaN where unknown
    a_from_b: RigidTransform | None  # None before a calibration
    a_from_floor: RigidTransform


@cache
def _store() -> Any:
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(_IDS_LIST, "hri_msgs/msg/IdsList"))
    return store


def definition(message_type: str) -> str:
    """The definition of a type of messages, with those of all types that it consists of."""
    return str(_store().generate_msgdef(message_type, ros_version=2)[0])


class RosMessages:
    """Encodes the frames of one body, as topics and messages in CDR."""

    def __init__(self, body: Body) -> None:
        self._types: Mapping[str, Any] = _store().types
        self._body, self._shown = body, joint_bones(body)
        bones = {bone.name: bone.bone for bone in human_bones(body)}
        self._trunk = bones["Spine"], bones["Chest"]
        self._hips, self._shoulders = (
            [body.joint(f"{name} {side}") for side in ("left", "right")] for name in ("hip", "shoulder")
        )
        self._names = [f"{_frame_name(joint)}_{BODY_ID}" for joint in body.joints]
        self._layout = self._array_layout()

    def constant(self, time_ns: int) -> Iterator[tuple[str, bytes]]:
        """The optical frames of the sensors."""
        turn, nowhere = Rotation.from_matrix(_FROM_OPTICAL).as_quat(), np.zeros(3)
        yield self._transforms(
            "/tf_static",
            time_ns,
            [(f"sensor_{side}", f"sensor_{side}_optical", nowhere, turn) for side in "ab"],
        )

    def of_frame(self, frame: RosFrame) -> Iterator[tuple[str, bytes]]:
        """The messages of a frame; without a person the sensors' frames and an empty list of bodies."""
        there = bool(np.isfinite(frame.positions).any())
        transforms = [("map", "sensor_a", *_axes(frame.a_from_floor.inverse()))]
        if frame.a_from_b is not None:
            transforms.append(("sensor_a", "sensor_b", *_axes(frame.a_from_b)))
        poses = list(self._poses(frame)) if there else []
        yield self._transforms("/tf", frame.time_ns, [*transforms, *poses])
        header = self._header(frame.time_ns, "sensor_a")
        ids = [BODY_ID] if there else []
        yield self._encoded("/humans/bodies/tracked", header=header, ids=ids)
        yield self._markers(frame, header)
        if not there:
            return
        known = np.isfinite(frame.angles)
        yield self._encoded(
            f"{_HUMANS}/angles",
            header=header,
            name=[name for name, one in zip(ANGLES, known, strict=True) if one],
            position=np.radians(frame.angles[known]),
            velocity=np.zeros(0),
            effort=np.zeros(0),
        )
        if frame.covariance is not None:
            turned = _FROM_OPTICAL @ frame.covariance @ _FROM_OPTICAL.T
            yield self._pose(poses[0], turned, header)
            turned[~frame.seen] = np.nan
            data = turned.astype(np.float32).ravel()
            yield self._encoded(f"{_HUMANS}/joint_covariances", layout=self._layout, data=data)

    def event(self, time_ns: int, event: Event) -> tuple[str, bytes]:
        """An event as a line of a log."""
        return self._encoded(
            "/duplex/events",
            stamp=self._stamp(time_ns),
            level=_LEVELS[event.level],
            name="duplex",
            msg=event.text,
            file="",
            function="",
            line=0,
        )

    def _poses(self, frame: RosFrame) -> Iterator[tuple[str, str, Array, Array]]:
        """Parent, child, metres and quaternion of each frame of the body; the body's is first."""
        places = frame.positions @ _FROM_OPTICAL.T
        turned = Rotation.from_quat(frame.rotations).as_matrix()
        turns = Rotation.from_matrix(_FROM_OPTICAL @ turned @ _OF_PERSON)
        middle, neck = places[self._hips].mean(axis=0), places[self._shoulders].mean(axis=0)
        of_body = turns[self._body.root]
        yield "sensor_a", f"body_{BODY_ID}", middle, of_body.as_quat()
        places = of_body.inv().apply(np.vstack([middle, neck, places]) - middle)
        quaternions = (of_body.inv() * turns[[*self._trunk, *self._shown]]).as_quat()
        told = [True, True, *frame.seen]
        names = [f"waist_{BODY_ID}", f"torso_{BODY_ID}", *self._names]
        for name, place, quaternion, one in zip(names, places, quaternions, told, strict=True):
            if one:
                yield f"body_{BODY_ID}", name, place, quaternion

    def _pose(self, body: tuple[str, str, Array, Array], covariance: Array, header: Any) -> tuple[str, bytes]:
        """The body's frame. The errors of the hips may be alike, so that their mean is no better than one."""
        both = np.zeros((6, 6))
        both[:3, :3] = covariance[self._hips].mean(axis=0)
        both[3:, 3:] = _ANY_ANGLE * np.eye(3)
        made, (_, _, place, quaternion) = self._made, body
        pose = made(
            "geometry_msgs/msg/Pose",
            made("geometry_msgs/msg/Point", *place.tolist()),
            made("geometry_msgs/msg/Quaternion", *quaternion.tolist()),
        )
        uncertain = made("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=both.ravel())
        return self._encoded(f"{_HUMANS}/pose", header=header, pose=uncertain)

    def _markers(self, frame: RosFrame, header: Any) -> tuple[str, bytes]:
        made = self._made
        point = made("geometry_msgs/msg/Point", x=0.0, y=0.0, z=0.0)
        still = made("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0)
        pose = made("geometry_msgs/msg/Pose", position=point, orientation=still)
        nothing = np.zeros(0, dtype=np.uint8)
        told = frame.seen & np.isfinite(frame.positions).all(axis=1)
        places = (frame.positions @ _FROM_OPTICAL.T).tolist()
        joints = [made("geometry_msgs/msg/Point", *places[joint]) for joint in np.flatnonzero(told)]
        ends = [
            made("geometry_msgs/msg/Point", *places[end])
            for joint in self._body.bone_joints
            if told[joint] and told[self._body.parents[joint]]
            for end in (self._body.parents[joint], joint)
        ]

        def marker(name: str, kind: int, points: list[Any], size: float) -> Any:
            return made(
                "visualization_msgs/msg/Marker",
                header=header,
                ns=name,
                id=0,
                type=kind,
                action=_ADD if points else _DELETE,
                pose=pose,
                scale=made("geometry_msgs/msg/Vector3", size, size, size),
                color=made("std_msgs/msg/ColorRGBA", 0.2, 0.6, 1.0, 1.0),
                lifetime=made("builtin_interfaces/msg/Duration", *divmod(_LIFETIME_NS, 10**9)),
                frame_locked=False,
                points=points,
                colors=[],
                texture_resource="",
                texture=made("sensor_msgs/msg/CompressedImage", header, "", nothing),
                uv_coordinates=[],
                text="",
                mesh_resource="",
                mesh_file=made("visualization_msgs/msg/MeshFile", "", nothing),
                mesh_use_embedded_materials=False,
            )

        markers = [marker("joints", _SPHERES, joints, 0.05), marker("bones", _LINES, ends, 0.02)]
        return self._encoded(f"{_HUMANS}/markers", markers=markers)

    def _transforms(
        self, topic: str, time_ns: int, transforms: list[tuple[str, str, Array, Array]]
    ) -> tuple[str, bytes]:
        made = self._made
        stamped = [
            made(
                "geometry_msgs/msg/TransformStamped",
                header=self._header(time_ns, parent),
                child_frame_id=child,
                transform=made(
                    "geometry_msgs/msg/Transform",
                    made("geometry_msgs/msg/Vector3", *place.tolist()),
                    made("geometry_msgs/msg/Quaternion", *quaternion.tolist()),
                ),
            )
            for parent, child, place, quaternion in transforms
        ]
        return self._encoded(topic, transforms=stamped)

    def _array_layout(self) -> Any:
        J = len(self._body)
        sizes = ("joints " + " ".join(self._names), J, 9 * J), ("row", 3, 9), ("column", 3, 3)
        dimensions = [self._made("std_msgs/msg/MultiArrayDimension", *each) for each in sizes]
        return self._made("std_msgs/msg/MultiArrayLayout", dim=dimensions, data_offset=0)

    def _header(self, time_ns: int, frame: str) -> Any:
        return self._made("std_msgs/msg/Header", stamp=self._stamp(time_ns), frame_id=frame)

    def _stamp(self, time_ns: int) -> Any:
        return self._made("builtin_interfaces/msg/Time", *divmod(time_ns, 10**9))

    def _made(self, name: str, /, *values: Any, **named: Any) -> Any:
        return self._types[name](*values, **named)

    def _encoded(self, topic: str, **values: Any) -> tuple[str, bytes]:
        kind = TOPICS[topic]
        return topic, bytes(_store().serialize_cdr(self._made(kind, **values), kind))


def _axes(transform: RigidTransform) -> tuple[Array, Array]:
    """Metres and quaternion of a transform between optical frames, between those of REP 103."""
    rotation = _FROM_OPTICAL @ transform.rotation @ _FROM_OPTICAL.T
    return _FROM_OPTICAL @ transform.translation, Rotation.from_matrix(rotation).as_quat()


def _frame_name(joint: str) -> str:
    """``l_elbow`` of ``ElbowLeft`` and of ``ELBOW_LEFT``."""
    name = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", joint).lower()
    for side in ("left", "right"):
        if name.endswith(f"_{side}"):
            return f"{side[0]}_{name.removesuffix(f'_{side}')}"
    return name
