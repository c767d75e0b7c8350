"""Poses whose rotations can be computed by hand, and forward kinematics that is not the program's."""

import numpy as np
from scipy.spatial.transform import Rotation

LEFT, RIGHT = (1.0, 0.0, 0.0), (-1.0, 0.0, 0.0)
UP, DOWN = (0.0, -1.0, 0.0), (0.0, 1.0, 0.0)
FRONT, BACK = (0.0, 0.0, -1.0), (0.0, 0.0, 1.0)
"""Directions in K_A's frame of a person who faces the sensor."""

_TOES = np.array([0.0, 0.055, -0.150]) / np.linalg.norm([0.055, 0.150])
T_POSE = {
    **{f"{joint}Left": LEFT for joint in ("Elbow", "Wrist", "Hand")},
    **{f"{joint}Right": RIGHT for joint in ("Elbow", "Wrist", "Hand")},
    **{f"Foot{side}": tuple(_TOES) for side in ("Left", "Right")},
}
"""Unity's T-pose: arms sideways, toes in front of the ankles and below."""


def posed(body, directions):
    """(J, 3) joints 2.5 m before the sensor: bones by the name of their end joint, the others at rest."""
    turned = {body.joint(name): np.array(direction) for name, direction in directions.items()}
    joints = np.zeros((len(body), 3))
    joints[body.root] = [0.2, 0.1, 2.5]
    for joint in body.order[1:]:
        direction = turned.get(int(joint), body.rest[joint])
        joints[joint] = joints[body.parents[joint]] + body.nominal_lengths[joint] * direction
    return joints


def turned_about(joints, rotation, about):
    """The joints rotated about one of them."""
    return np.asarray(rotation.apply(joints - joints[about]) + joints[about])


def world_of_local(parents, positions, rotations):
    """World positions (N, 3) and rotations of bones given relative to their parents, as in a scene graph."""
    world = np.empty((len(parents), 3))
    turns = []
    for n, above in enumerate(parents):
        own = Rotation.from_quat(rotations[n])
        world[n] = positions[n] if above < 0 else world[above] + turns[above].apply(positions[n])
        turns.append(own if above < 0 else turns[above] * own)
    return world, turns
