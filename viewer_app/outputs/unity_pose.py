"""S* as a humanoid of Unity: its bones, its axes, its T-pose.

Unity's axes are left-handed: x right, y up, z forward. K_A's are right-handed: x right, y down, z forward.
Where K_A's p is −p in Unity, all three axes are reversed: a rotation matrix, and so a quaternion, stays the
same. A person who faces the sensor then faces +z. In Unity's T-pose, which has no rotation anywhere, the arms
point sideways and the palms down.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fusion.body import Body
from fusion.joint_rotations import JointRotations, joint_bones

Array = NDArray[np.float64]

_TOES_DOWN = math.atan2(0.055, 0.150)
"""rad. From the ankle, a standing person's foot joint lies in front and below; at rest it lies in front."""
_RISES, _SINKS = 0.01, 0.3
"""m/s. The floor follows the lowest joint: down fast, up slowly, so that a jump does not lift it."""

# name, parent, names of the joint where the bone begins
_TRUNK: tuple[tuple[str, str | None, tuple[str, ...]], ...] = (
    ("Hips", None, ()),
    ("Spine", "Hips", ("SpineNavel", "SpineMid", "Spine")),
    ("Chest", "Spine", ("SpineChest", "SpineShoulder", "ShoulderCenter")),
    ("Neck", "Chest", ("Neck",)),
    ("Head", "Neck", ("Head",)),
)
# name, parent, joint where the bone ends; each without its side
_LIMBS = (
    ("Shoulder", "Chest", "Shoulder"),
    ("UpperArm", "Shoulder", "Elbow"),
    ("LowerArm", "UpperArm", "Wrist"),
    ("Hand", "LowerArm", "Hand"),
    ("UpperLeg", "Hips", "Knee"),
    ("LowerLeg", "UpperLeg", "Ankle"),
    ("Foot", "LowerLeg", "Foot"),
)
_ARM = ("UpperArm", "LowerArm", "Hand")


@dataclass(frozen=True, eq=False)
class UnityPose:
    """One pose, in Unity's axes above the floor."""

    positions: Array  # (N, 3) metres, where each bone begins
    rotations: Array  # (N, 4) x, y, z, w, of each bone from the T-pose
    local: Array  # (N, 7) position and rotation of each bone relative to its parent; of Hips to the floor
    leg: float  # metres from hip to sole


class UnitySkeleton:
    """Which bones of a humanoid a body has, and their pose frame by frame.

    The origin lies on the floor, beneath the pelvis of the first person who was seen.

    Attributes:
        names: N names of ``HumanBodyBones``; a parent precedes its children.
        parents: (N,) index of each bone's parent; -1 for Hips.
        rest: (N, 3) direction of each bone in the T-pose, in Unity's axes; zero for Hips.
    """

    def __init__(self, body: Body) -> None:
        self.body = body
        self._rotations = JointRotations(body)
        shown = joint_bones(body)
        rows: list[tuple[str, str | None, int, int]] = []  # name, parent, joint where it begins, bone
        for name, above, joints in _TRUNK:
            found = [j for j in map(body.find, joints) if j is not None] if joints else [body.root]
            if found:
                rows.append((name, above, found[0], int(shown[found[0]])))
        for side in ("Left", "Right"):
            for name, above, end in _LIMBS:
                bone = body.joint(end + side)
                parent = above if above in ("Chest", "Hips") else side + above
                rows.append((side + name, parent, body.parents[bone], bone))
            foot = body.joint("Foot" + side)
            rows.append((side + "Toes", side + "Foot", foot, foot))
        self.names = tuple(row[0] for row in rows)
        self.parents = np.array([self._parent(row[1]) for row in rows])
        self.begins = np.array([row[2] for row in rows])
        self.bones = np.array([row[3] for row in rows])
        self._unturned = Rotation.from_quat([_from_t_pose(name) for name in self.names])  # T-pose → rest
        rest = self._unturned.inv().apply(-body.rest[self.bones])
        self.rest = np.where(self.parents[:, None] < 0, 0.0, rest)
        feet = [body.find(j + s) for j in ("Foot", "Ankle", "Heel") for s in ("Left", "Right")]
        self._feet = [j for j in feet if j is not None]
        self._leg = [
            (body.joint(above + side), body.joint(below + side))
            for above, below in (("Hip", "Knee"), ("Knee", "Ankle"))
            for side in ("Left", "Right")
        ]
        self._origin: Array | None = None
        self._time_ns = 0

    def update(self, positions: Array, time_ns: int) -> UnityPose | None:
        """The pose of (J, 3) joints of S* in K_A's frame; None without a person."""
        if not np.isfinite(positions).all():
            return None
        rotations = self._rotations.update(positions, time_ns)
        lowest = max(float(positions[joint, 1]) for joint in self._feet)
        if self._origin is None:
            root = positions[self.body.root]
            self._origin = np.array([root[0], lowest, root[2]])
        else:
            elapsed = max((time_ns - self._time_ns) * 1e-9, 0.0)
            step = lowest - self._origin[1]
            self._origin[1] += min(max(step, -_RISES * elapsed), _SINKS * elapsed)
        self._time_ns = time_ns
        turned = Rotation.from_quat(rotations[self.bones]) * self._unturned
        begins, turns = self._origin - positions[self.begins], turned.as_quat()
        topmost = self.parents[:, None] < 0
        back = Rotation.from_quat(np.where(topmost, (0.0, 0.0, 0.0, 1.0), turns[self.parents])).inv()
        offsets = back.apply(begins - np.where(topmost, 0.0, begins[self.parents]))
        local = np.concatenate((offsets, (back * turned).as_quat()), axis=1)
        legs = sum(math.dist(positions[i], positions[j]) for i, j in self._leg)
        return UnityPose(begins, turns, local, 0.5 * legs + _ANKLE_HEIGHT)

    def _parent(self, name: str | None) -> int:
        """The index of the nearest bone above that the body has; v1 has no neck."""
        while name is not None and name not in self.names:
            name = next(above for trunk, above, _ in _TRUNK if trunk == name)
        return -1 if name is None else self.names.index(name)


_ANKLE_HEIGHT = 0.08  # metres


def _from_t_pose(name: str) -> Array:
    """(4,) the rotation from the T-pose to the rest of :attr:`fusion.body.Body.rest`, where arms hang."""
    half = math.sqrt(0.5)
    if name.removeprefix("Left") in _ARM:
        return np.array([0.0, 0.0, half, half])  # left → down: a quarter turn about K_A's z
    if name.removeprefix("Right") in _ARM:
        return np.array([0.0, 0.0, -half, half])
    if name.endswith(("Foot", "Toes")):
        return np.array([-math.sin(0.5 * _TOES_DOWN), 0.0, 0.0, math.cos(0.5 * _TOES_DOWN)])
    return np.array([0.0, 0.0, 0.0, 1.0])
