"""S* as a humanoid of animation programs: its bones, their names, the T-pose.

A bone of a humanoid begins at a joint and turns with a bone of the body. In the T-pose the arms point
sideways and the palms down.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion.body import Body
from fusion.movement.joint_rotations import joint_bones

_TOES_DOWN = math.atan2(0.055, 0.150)
"""rad. From the ankle, a standing person's foot joint lies in front and below; at rest it lies in front."""
_SIDES = ("Left", "Right")
_TRUNK: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("Spine", ("SpineNavel", "SpineMid", "Spine")),
    ("Chest", ("SpineChest", "SpineShoulder", "ShoulderCenter", "Neck")),
)
"""Unity's name, names of the joint where the bone begins."""
_LIMBS = (
    ("Shoulder", "Chest", "Shoulder"),
    ("UpperArm", "Shoulder", "Elbow"),
    ("LowerArm", "UpperArm", "Wrist"),
    ("Hand", "LowerArm", "Hand"),
    ("UpperLeg", "Hips", "Knee"),
    ("LowerLeg", "UpperLeg", "Ankle"),
    ("Foot", "LowerLeg", "Foot"),
)
"""Unity's name, its parent, the joint where the bone ends; each without its side."""
_PROGRAMS = {
    "humanoid": (
        "{0} {1}{0} Hips Spine Chest Neck Head "
        "Shoulder UpperArm LowerArm Hand UpperLeg LowerLeg Foot Toes MiddleProximal"
    ),
    "mixamo": (
        "mixamorig:{0} mixamorig:{1}{0} Hips Spine Spine2 Neck Head "
        "Shoulder Arm ForeArm Hand UpLeg Leg Foot ToeBase HandMiddle1"
    ),
    "ue5": (
        "{0} {0}_{2} pelvis spine_01 spine_05 neck_01 head "
        "clavicle upperarm lowerarm hand thigh calf foot ball middle_01"
    ),
    "rigify": (
        "{0} {0}.{3} spine spine.001 spine.003 spine.004 spine.006 "
        "shoulder upper_arm forearm hand thigh shin foot toe f_middle.01"
    ),
}
"""How bones are named in the middle and at a side, and their names: of Unity, Mixamo, Unreal's Manny and
MetaHumans, and Rigify's human in Blender."""


class HumanBone(NamedTuple):
    """A bone of a humanoid."""

    name: str  # of Unity's ``HumanBodyBones``
    parent: str | None  # None for Hips
    begin: int  # the joint where it begins
    bone: int  # the bone of the body with which it turns, by its end joint; the root for the pelvis


def human_bones(body: Body) -> tuple[HumanBone, ...]:
    """The 21 bones of a humanoid, from Hips on; a parent precedes its children."""
    shown, root = joint_bones(body), body.root
    bones, above = [HumanBone("Hips", None, root, root)], "Hips"
    for name, joints in _TRUNK:
        begin = next(j for j in map(body.find, joints) if j is not None)
        bones.append(HumanBone(name, above, begin, int(shown[begin])))
        above = name
    head = body.joint("Head")
    bones.append(HumanBone("Neck", above, body.parents[head], head))
    bones.append(HumanBone("Head", "Neck", head, int(shown[head])))
    for side in _SIDES:
        for name, parent, end in _LIMBS:
            bone = body.joint(end + side)
            parent = parent if parent in ("Chest", "Hips") else side + parent
            bones.append(HumanBone(side + name, parent, body.parents[bone], bone))
        foot = body.joint("Foot" + side)
        bones.append(HumanBone(side + "Toes", side + "Foot", foot, foot))
    return tuple(bones)


def name_in(program: str, bone: str) -> str:
    """The name of a bone of Unity's humanoid in ``humanoid``, ``mixamo``, ``ue5`` or ``rigify``."""
    side = next((side for side in _SIDES if bone.startswith(side)), "")
    middle, sided, *names = _PROGRAMS[program].split()
    name = names[_PROGRAMS["humanoid"].split()[2:].index(bone.removeprefix(side))]
    return (sided if side else middle).format(name, side, side[:1].lower(), side[:1])


def rest_from_t_pose(body: Body) -> NDArray[np.float64]:
    """(J, 4) quaternions x, y, z, w: the rotation of the bone that ends in each joint from the T-pose to the
    rest of :attr:`fusion.body.Body.rest`, where arms hang.
    """
    rotations = np.tile([0.0, 0.0, 0.0, 1.0], (len(body), 1))
    half, toes = math.sqrt(0.5), 0.5 * _TOES_DOWN
    for side, sign in zip(_SIDES, (1.0, -1.0), strict=True):
        for name in ("Elbow", "Wrist", "Hand", "HandTip", "Thumb"):
            joint = body.find(name + side)
            if joint is not None:
                rotations[joint] = 0.0, 0.0, sign * half, half  # left → down: a quarter turn about z
        rotations[body.joint("Foot" + side)] = -math.sin(toes), 0.0, 0.0, math.cos(toes)
    return rotations
