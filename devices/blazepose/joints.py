"""Joints of the body ``blazepose`` from the network's landmarks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from devices.blazepose.lifting import Lifted
from devices.blazepose.networks import LANDMARKS
from fusion.body import BLAZEPOSE
from fusion.skeleton import TrackingState

Array = NDArray[np.float64]

LANDMARK_NAMES = (
    "NOSE",
    *("EYE_INNER_LEFT", "EYE_LEFT", "EYE_OUTER_LEFT", "EYE_INNER_RIGHT", "EYE_RIGHT", "EYE_OUTER_RIGHT"),
    *("EAR_LEFT", "EAR_RIGHT", "MOUTH_LEFT", "MOUTH_RIGHT"),
    *("SHOULDER_LEFT", "SHOULDER_RIGHT", "ELBOW_LEFT", "ELBOW_RIGHT", "WRIST_LEFT", "WRIST_RIGHT"),
    *("PINKY_LEFT", "PINKY_RIGHT", "INDEX_LEFT", "INDEX_RIGHT", "THUMB_LEFT", "THUMB_RIGHT"),
    *("HIP_LEFT", "HIP_RIGHT", "KNEE_LEFT", "KNEE_RIGHT", "ANKLE_LEFT", "ANKLE_RIGHT"),
    *("HEEL_LEFT", "HEEL_RIGHT", "FOOT_LEFT", "FOOT_RIGHT"),
)
"""The network's landmarks in its order. PINKY and INDEX are knuckles."""

INDEX = {name: j for j, name in enumerate(LANDMARK_NAMES)}


def _weights() -> Array:
    """(J, 33) shares of the landmarks in each joint.

    The shares of the derived joints follow from the proportions of an adult (Drillis and Contini, 1966), by
    which Azure's tracker places its joints: between the hips' and the shoulders' middle, PELVIS lies at 4 %,
    SPINE_NAVEL at 39 %, NECK at 110 %; HEAD lies between the ears, at 26 % of the way to NECK.
    """
    weights = np.zeros((len(BLAZEPOSE), LANDMARKS))
    for j, name in enumerate(BLAZEPOSE.joints):
        if name in INDEX:
            weights[j, INDEX[name]] = 1.0
    for side in ("LEFT", "RIGHT"):
        weights[BLAZEPOSE.joint(f"HAND_{side}"), [INDEX[f"PINKY_{side}"], INDEX[f"INDEX_{side}"]]] = 0.5
    hips = 0.5 * (weights[BLAZEPOSE.joint("HIP_LEFT")] + weights[BLAZEPOSE.joint("HIP_RIGHT")])
    shoulders = 0.5 * (weights[BLAZEPOSE.joint("SHOULDER_LEFT")] + weights[BLAZEPOSE.joint("SHOULDER_RIGHT")])
    ears = 0.5 * (weights[BLAZEPOSE.joint("EAR_LEFT")] + weights[BLAZEPOSE.joint("EAR_RIGHT")])
    for name, up in (("PELVIS", 0.04), ("SPINE_NAVEL", 0.39), ("NECK", 1.10)):
        weights[BLAZEPOSE.joint(name)] = (1.0 - up) * hips + up * shoulders
    weights[BLAZEPOSE.joint("HEAD")] = 0.74 * ears + 0.26 * weights[BLAZEPOSE.joint("NECK")]
    return weights


JOINT_WEIGHTS = _weights()
"""(J, 33) each joint of the body as an affine combination of landmarks; each row sums to 1."""

ESSENTIAL = JOINT_WEIGHTS != 0.0
"""(J, 33) the landmarks that a joint is made of."""


def joints_of(lifted: Lifted) -> tuple[Array, NDArray[np.uint8]]:
    """(J, 3) positions and (J,) states of the joints of the body ``blazepose``.

    A joint is tracked where all of its landmarks are seen, and inferred where all are known.
    """
    positions = JOINT_WEIGHTS @ np.where(lifted.known[:, None], lifted.positions, 0.0)
    states = np.full(len(positions), TrackingState.NOT_TRACKED, dtype=np.uint8)
    states[~(ESSENTIAL & ~lifted.known).any(axis=1)] = TrackingState.INFERRED
    states[~(ESSENTIAL & ~lifted.seen).any(axis=1)] = TrackingState.TRACKED
    return positions, states
