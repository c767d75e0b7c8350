"""S* as a humanoid of Unity: its bones, its axes, its T-pose.

Unity's axes are left-handed: x right, y up, z forward. K_A's are right-handed: x right, y down, z forward.
Where K_A's p is −p in Unity, all three axes are reversed: a rotation matrix, and so a quaternion, stays the
same. A person who faces the sensor then faces +z. Unity's T-pose has no rotation anywhere.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from fusion.body import Body
from fusion.calibration.bone_lengths import bone_lengths_of
from fusion.movement.humanoid import human_bones, rest_from_t_pose
from fusion.movement.joint_rotations import JointRotations
from fusion.support.types import Array
from recordings.appearance.floor import ANKLE

_RISES, _SINKS = 0.01, 0.3
"""m/s. The floor follows the lowest joint: down fast, up slowly, so that a jump does not lift it."""


@dataclass(frozen=True, eq=False)
class UnityPose:
    """One pose, in Unity's axes above the floor."""

    positions: Array  # (N, 3) metres, where each bone begins
    rotations: Array  # (N, 4) x, y, z, w, of each bone from the T-pose
    local: Array  # (N, 7) position and rotation of each bone relative to its parent; of Hips to the floor.
    # Positions are those of the T-pose: they change with the lengths of the person's bones alone
    leg: float  # metres from hip to sole


class UnitySkeleton:
    """The pose of a humanoid's bones, frame by frame.

    The origin lies on the floor, beneath the pelvis of the first person who was seen.

    Attributes:
        names: N names of ``HumanBodyBones``; a parent precedes its children.
        parents: (N,) index of each bone's parent; -1 for Hips.
    """

    def __init__(self, body: Body) -> None:
        self.body = body
        self._rotations = JointRotations(body)
        bones = human_bones(body)
        self.names = tuple(bone.name for bone in bones)
        self.parents = np.array([-1 if b.parent is None else self.names.index(b.parent) for b in bones])
        self.begins = np.array([bone.begin for bone in bones])
        self.bones = np.array([bone.bone for bone in bones])
        rest_turns = Rotation.from_quat(rest_from_t_pose(body))
        self._unturned = rest_turns[self.bones]
        feet = [body.find(j + s) for j in ("Foot", "Ankle", "Heel") for s in ("Left", "Right")]
        self._feet = [j for j in feet if j is not None]
        self._leg = [body.joint(below + side) for below in ("Knee", "Ankle") for side in ("Left", "Right")]
        directions = rest_turns.inv().apply(-body.rest)
        ways = np.eye(len(body))  # of which bones the way to each joint consists
        for joint in body.order[1:]:
            ways[joint] += ways[body.parents[joint]]
        begins = ways[self.begins] - np.where(self.parents[:, None] < 0, 0.0, ways[self.begins[self.parents]])
        self._offsets = begins[..., None] * directions  # (N, J, 3), in bones' lengths
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
        lengths = np.nan_to_num(bone_lengths_of(self.body, positions))
        offsets = np.where(topmost, begins, np.einsum("njc,j->nc", self._offsets, lengths))
        local = np.concatenate((offsets, (back * turned).as_quat()), axis=1)
        return UnityPose(begins, turns, local, 0.5 * float(lengths[self._leg].sum()) + ANKLE)
