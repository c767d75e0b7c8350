"""Which joints a body tracker reports, and the tree of bones between them.

A bone belongs to the joint at its far end, so that every joint but the root has exactly one. Left and right
are the person's own.
"""

import re
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion.errors import BodyError, FusionError, UnknownNameError
from fusion.support.read_only import ReadOnlyArrays, cached_array, read_only

# Directions in a sensor frame (x right, y down, z forward) of a person who faces the sensor:
# the person's left is then on the sensor's right.
_REST_DIRECTIONS = {
    "root": (0.0, 0.0, 0.0),
    "up": (0.0, -1.0, 0.0),
    "down": (0.0, 1.0, 0.0),
    "left": (1.0, 0.0, 0.0),
    "right": (-1.0, 0.0, 0.0),
    "front": (0.0, 0.0, -1.0),
}


ADULT_HEIGHT = 1.75  # metres


@dataclass(frozen=True, eq=False)
class Body(ReadOnlyArrays):
    """The joints of one body tracker and the bones between them.

    Attributes:
        name: The tracker's family: ``kinect_v1``, ``kinect_v2``, ``azure_kinect`` or ``blazepose``.
        joints: J joint names in the tracker's own order and spelling.
        parents: (J,) index of each joint's parent; the root has -1. A parent may follow its child.
        bones: (J,) name of the bone that ends in the joint; empty for the root.
        torso: Joints of the main body, whose centre carries t from frame to frame (sec. 4).
        rest: (J, 3) unit direction parent → joint at rest, facing the sensor; zero for the root.
        nominal_lengths: (J,) metres, the bones of an adult of ADULT_HEIGHT, for bones that were never seen;
            zero for the root.
    """

    name: str
    joints: tuple[str, ...]
    parents: tuple[int, ...]
    bones: tuple[str, ...]
    torso: tuple[int, ...]
    rest: NDArray[np.float64]
    nominal_lengths: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.joints)

    def __repr__(self) -> str:
        return f"Body({self.name}, {len(self)} joints)"

    def __reduce__(self) -> str | tuple[Any, ...]:
        """A known body is the same object after pickling and copying, also in another process."""
        known = BODIES.get(self.name) is self
        return (_known_body, (self.name,)) if known else super().__reduce__()

    @cached_property
    def root(self) -> int:
        """The joint without a parent."""
        return self.parents.index(-1)

    @cached_array
    def order(self) -> NDArray[np.int64]:
        """(J,) joints sorted so that every parent precedes its children."""
        order = [self.root]
        for joint in order:
            order.extend(child for child, parent in enumerate(self.parents) if parent == joint)
        return np.array(order, dtype=np.int64)

    @cached_array
    def parent_indices(self) -> NDArray[np.int64]:
        """(J,) ``parents`` as an array."""
        return np.array(self.parents, dtype=np.int64)

    @cached_array
    def bone_joints(self) -> NDArray[np.int64]:
        """(J-1,) the joints that end a bone: all but the root, in joint order."""
        return np.array([j for j, parent in enumerate(self.parents) if parent >= 0], dtype=np.int64)

    @cached_array
    def linked(self) -> NDArray[np.bool_]:
        """(J, J) whether two joints are the same or share a bone; such a joint cannot mislead (sec. 3)."""
        linked = np.eye(len(self), dtype=bool)
        for child in self.bone_joints:
            parent = self.parents[child]
            linked[child, parent] = linked[parent, child] = True
        return linked

    @cached_array
    def mirror(self) -> NDArray[np.int64]:
        """(J,) the joint on the other side of the body; a joint on the midline is its own mirror."""
        index = {name: j for j, name in enumerate(self.joints)}
        return np.array([index[_other_side(name)] for name in self.joints], dtype=np.int64)

    @cached_array
    def sided(self) -> NDArray[np.bool_]:
        """(J,) whether a joint has a counterpart on the other side of the body."""
        return np.asarray(self.mirror != np.arange(len(self)))

    @cached_property
    def midpoints(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """(M,), (M,) pairs of joints whose midpoints an exchange of left and right does not move.

        On the midline both are the same joint; otherwise they are a joint and its mirror.
        """
        own = read_only(np.flatnonzero(np.arange(len(self)) <= self.mirror))
        return own, read_only(self.mirror[own])

    def joint(self, name: str) -> int:
        """The index of a joint by name, in any spelling: ``ElbowLeft``, ``ELBOW_LEFT``, ``elbow left``.

        Raises:
            UnknownNameError: The body has no such joint.
        """
        found = self.find(name)
        if found is None:
            raise UnknownNameError(f"{self.name} joint", name, self.joints)
        return found

    def find(self, name: str) -> int | None:
        """Like :meth:`joint`, but returns None if the body has no such joint."""
        return self._index_by_plain_name.get(_plain(name))

    def bone(self, name: str) -> int:
        """The joint at the far end of a bone, by the bone's name.

        Raises:
            UnknownNameError: The body has no such bone.
        """
        if name and name in self.bones:
            return self.bones.index(name)
        raise UnknownNameError(f"{self.name} bone", name, filter(None, self.bones))

    def require(self, other: "Body", whose: str = "A skeleton") -> None:
        """Checks that another object has these joints, because kernels take their arrays' lengths from here.

        Raises:
            BodyError: The joints differ. ``whose`` begins the message.
        """
        if other is not self and other.joints != self.joints:  # a body that was pickled is the same body
            raise BodyError(
                f"{whose} has the {len(other)} joints of {other.name}, not the {len(self)} of {self.name}, "
                f"which were described."
            )

    def require_shape(self, shape: tuple[int, ...], frames: tuple[int, ...] = (), columns: int = 3) -> None:
        """Checks the shape (frames, J, columns) of an array of these joints.

        Raises:
            BodyError: The shape differs.
        """
        if shape != (*frames, len(self), columns):
            raise BodyError(f"{self.name} has {len(self)} joints; an array of them has shape {shape}.")

    @cached_property
    def _index_by_plain_name(self) -> dict[str, int]:
        return {_plain(name): j for j, name in enumerate(self.joints)}


def _plain(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.lower().removeprefix("k4abt_joint_"))


def _other_side(name: str) -> str:
    for left, right in (("Left", "Right"), ("LEFT", "RIGHT"), ("left", "right")):
        if left in name:
            return name.replace(left, right)
        if right in name:
            return name.replace(right, left)
    return name


def _body(name: str, torso: str, table: str) -> Body:
    """A body from rows ``joint parent bone rest-direction length`` in the tracker's joint order.

    The left joints of a block come again, on the right, at its end.
    """
    rows: list[list[str]] = []
    for block in table.strip().split("\n\n"):
        own = [line.split() for line in block.splitlines()]
        rows += own + [[_other_side(word) for word in row] for row in own if "left" in row[0].lower()]
    joints = tuple(row[0] for row in rows)
    return Body(
        name=name,
        joints=joints,
        parents=tuple(-1 if row[1] == "-" else joints.index(row[1]) for row in rows),
        bones=tuple("" if row[2] == "-" else row[2] for row in rows),
        torso=tuple(joints.index(joint) for joint in torso.split()),
        rest=np.array([_REST_DIRECTIONS[row[3]] for row in rows]),
        nominal_lengths=np.array([float(row[4]) for row in rows]),
    )


KINECT_V1 = _body(
    "kinect_v1",
    "HipCenter Spine ShoulderCenter ShoulderLeft ShoulderRight HipLeft HipRight",
    """
    HipCenter       -               -                root   0.00
    Spine           HipCenter       lower_spine      up     0.12
    ShoulderCenter  Spine           upper_spine      up     0.33
    Head            ShoulderCenter  neck             up     0.21
    ShoulderLeft    ShoulderCenter  collar_left      left   0.17
    ElbowLeft       ShoulderLeft    upper_arm_left   down   0.29
    WristLeft       ElbowLeft       forearm_left     down   0.25
    HandLeft        WristLeft       hand_left        down   0.08

    HipLeft         HipCenter       pelvis_left      left   0.09
    KneeLeft        HipLeft         thigh_left       down   0.42
    AnkleLeft       KneeLeft        shin_left        down   0.41
    FootLeft        AnkleLeft       foot_left        front  0.13
    """,
)
"""Kinect for Xbox 360: the paper's 20 joints."""

KINECT_V2 = _body(
    "kinect_v2",
    "SpineBase SpineMid SpineShoulder ShoulderLeft ShoulderRight HipLeft HipRight",
    """
    SpineBase      -              -                root   0.00
    SpineMid       SpineBase      lower_spine      up     0.20
    Neck           SpineShoulder  neck             up     0.09
    Head           Neck           head             up     0.16
    ShoulderLeft   SpineShoulder  collar_left      left   0.17
    ElbowLeft      ShoulderLeft   upper_arm_left   down   0.29
    WristLeft      ElbowLeft      forearm_left     down   0.25
    HandLeft       WristLeft      hand_left        down   0.08

    HipLeft        SpineBase      pelvis_left      left   0.09
    KneeLeft       HipLeft        thigh_left       down   0.42
    AnkleLeft      KneeLeft       shin_left        down   0.41
    FootLeft       AnkleLeft      foot_left        front  0.13

    SpineShoulder  SpineMid       upper_spine      up     0.24
    HandTipLeft    HandLeft       fingers_left     down   0.08
    ThumbLeft      WristLeft      thumb_left       front  0.06
    """,
)
"""Kinect for Xbox One: 25 joints."""

AZURE_KINECT = _body(
    "azure_kinect",
    "PELVIS SPINE_NAVEL SPINE_CHEST CLAVICLE_LEFT SHOULDER_LEFT CLAVICLE_RIGHT SHOULDER_RIGHT "
    "HIP_LEFT HIP_RIGHT",
    """
    PELVIS          -               -                root   0.00
    SPINE_NAVEL     PELVIS          lower_spine      up     0.20
    SPINE_CHEST     SPINE_NAVEL     upper_spine      up     0.24
    NECK            SPINE_CHEST     neck             up     0.09
    CLAVICLE_LEFT   SPINE_CHEST     clavicle_left    up     0.10
    SHOULDER_LEFT   CLAVICLE_LEFT   collar_left      left   0.14
    ELBOW_LEFT      SHOULDER_LEFT   upper_arm_left   down   0.29
    WRIST_LEFT      ELBOW_LEFT      forearm_left     down   0.25
    HAND_LEFT       WRIST_LEFT      hand_left        down   0.08
    HANDTIP_LEFT    HAND_LEFT       fingers_left     down   0.08
    THUMB_LEFT      WRIST_LEFT      thumb_left       front  0.06

    HIP_LEFT        PELVIS          pelvis_left      left   0.09
    KNEE_LEFT       HIP_LEFT        thigh_left       down   0.42
    ANKLE_LEFT      KNEE_LEFT       shin_left        down   0.41
    FOOT_LEFT       ANKLE_LEFT      foot_left        front  0.13

    HEAD            NECK            head             up     0.16
    NOSE            HEAD            nose             front  0.17
    EYE_LEFT        HEAD            eye_left         front  0.14
    EAR_LEFT        HEAD            ear_left         left   0.09
    """,
)
"""Azure Kinect body tracking (libk4abt), and Orbbec's cameras with it: 32 joints."""

BLAZEPOSE = _body(
    "blazepose",
    "PELVIS SPINE_NAVEL NECK SHOULDER_LEFT SHOULDER_RIGHT HIP_LEFT HIP_RIGHT",
    """
    PELVIS          -               -                root   0.00
    SPINE_NAVEL     PELVIS          lower_spine      up     0.18
    NECK            SPINE_NAVEL     upper_spine      up     0.35
    SHOULDER_LEFT   NECK            collar_left      left   0.19
    ELBOW_LEFT      SHOULDER_LEFT   upper_arm_left   down   0.29
    WRIST_LEFT      ELBOW_LEFT      forearm_left     down   0.25
    HAND_LEFT       WRIST_LEFT      hand_left        down   0.08
    THUMB_LEFT      WRIST_LEFT      thumb_left       front  0.09

    HIP_LEFT        PELVIS          pelvis_left      left   0.09
    KNEE_LEFT       HIP_LEFT        thigh_left       down   0.42
    ANKLE_LEFT      KNEE_LEFT       shin_left        down   0.41
    HEEL_LEFT       ANKLE_LEFT      heel_left        down   0.07
    FOOT_LEFT       ANKLE_LEFT      foot_left        front  0.16

    HEAD            NECK            head             up     0.12
    NOSE            HEAD            nose             front  0.12
    EYE_LEFT        HEAD            eye_left         front  0.12
    EAR_LEFT        HEAD            ear_left         left   0.09
    """,
)
"""The program's own tracker (:mod:`devices.blazepose`): 29 joints with the names of Azure's.

The network has no joints on the middle line but the nose. PELVIS, SPINE_NAVEL, NECK and HEAD are derived from
the hips, the shoulders and the ears. HAND is the middle of the knuckles of the index and little finger, FOOT
the base of the large toe."""

BODIES = {body.name: body for body in (KINECT_V1, KINECT_V2, AZURE_KINECT, BLAZEPOSE)}


def _known_body(name: str) -> Body:
    return BODIES[name]


def body_of(joint_names: set[str]) -> Body:
    """Finds the body that has these joints; the first in the order of :data:`BODIES` where several have.

    Raises:
        FusionError: No body has all of these joints; the message lists the unknown names.
    """
    fitting = [b for b in BODIES.values() if all(b.find(name) is not None for name in joint_names)]
    if fitting:
        return fitting[0]
    nearest = min(BODIES.values(), key=lambda b: sum(b.find(name) is None for name in joint_names))
    strangers = sorted(name for name in joint_names if nearest.find(name) is None)
    raise FusionError(
        f"Unknown joint {', '.join(repr(name[:40]) for name in strangers[:4])}: the nearest body, "
        f"{nearest.name}, has {', '.join(nearest.joints)}. Name yours in a table: `names=FILE.toml`."
    )
