"""Joints of the body ``blazepose`` from the network's landmarks."""

import numpy as np
from numpy.typing import NDArray

from devices.blazepose.landmark_kinds import INDEX, LANDMARK_NAMES
from devices.blazepose.lifting import Lifted
from fusion.body import BLAZEPOSE
from fusion.skeleton import TrackingState
from fusion.support.types import Array

_SEEN_SHARE = 0.35  # of a joint's landmarks, by weight, that must be seen: one hip, or one ear
_DEEPEST = {"PELVIS": 0.25, "SPINE_NAVEL": 0.25, "NECK": 0.15, "HEAD": 0.25}
"""Metres of a derived joint beneath the skin of a person of size 1; what is nearer covers it."""
_WINDOW = 2  # pixels to each side of such a joint that are read


_MOVED = {
    "HIP": ("SHOULDER", 0.01),
    "SHOULDER": ("HIP", 0.04),
    "ELBOW": ("SHOULDER", -0.09),
    "HAND": ("WRIST", -0.28),
    "ANKLE": ("KNEE", -0.06),
    "HEEL": ("ANKLE", -0.25),
    "FOOT": ("ANKLE", 0.08),
}
"""How far a joint lies from its landmark towards another landmark, as a share of their distance.

The network was trained on marks that people set on photographs. On the simulated person its shoulders lie
20 mm above the joints, elbows 27 mm and ankles 24 mm towards the trunk, knuckles 20 mm towards the wrist:
means over nine scenes of five movements (seed 100). The shares undo that."""


def _weights() -> Array:
    """(J, 33) shares of the landmarks in each joint.

    Joints of the limbs are landmarks, moved by :data:`_MOVED`. The shares of the derived joints follow from
    the proportions of an adult (Drillis and Contini, 1966), by which Azure's tracker places its joints:
    between the hips' and the shoulders' middle, PELVIS lies at 4 %, SPINE_NAVEL at 39 %, NECK at 110 %; HEAD
    lies between the ears, at 26 % of the way to NECK.
    """
    landmark = {name: np.eye(len(LANDMARK_NAMES))[j] for name, j in INDEX.items()}
    for side in ("LEFT", "RIGHT"):
        landmark[f"HAND_{side}"] = 0.5 * (landmark[f"PINKY_{side}"] + landmark[f"INDEX_{side}"])
    weights = np.zeros((len(BLAZEPOSE), len(LANDMARK_NAMES)))
    joint = BLAZEPOSE.joint
    for name in set(BLAZEPOSE.joints) & set(landmark):
        kind, _, side = name.partition("_")
        other, share = _MOVED.get(kind, (kind, 0.0))
        towards = landmark[f"{other}_{side}" if side else name]
        weights[joint(name)] = (1.0 - share) * landmark[name] + share * towards
    hips, shoulders, ears = (
        0.5 * (weights[joint(f"{name}_LEFT")] + weights[joint(f"{name}_RIGHT")])
        for name in ("HIP", "SHOULDER", "EAR")
    )
    for name, up in (("PELVIS", 0.04), ("SPINE_NAVEL", 0.39), ("NECK", 1.10)):
        weights[joint(name)] = (1.0 - up) * hips + up * shoulders
    weights[joint("HEAD")] = 0.74 * ears + 0.26 * weights[joint("NECK")]
    return weights


JOINT_WEIGHTS = _weights()
"""(J, 33) each joint of the body as an affine combination of landmarks; each row sums to 1."""

_MAGNITUDES = np.abs(JOINT_WEIGHTS) / np.abs(JOINT_WEIGHTS).sum(axis=1, keepdims=True)
_DERIVED = np.array([BLAZEPOSE.joint(name) for name in _DEEPEST])
_PARTS: NDArray[np.bool_] = JOINT_WEIGHTS >= 0.3  # the landmarks of a joint, not those that it is moved along
_PARTS[_DERIVED] = JOINT_WEIGHTS[_DERIVED] != 0.0


def joints_of(lifted: Lifted, pixels: Array, depth: NDArray[np.uint16]) -> tuple[Array, NDArray[np.uint8]]:
    """(J, 3) positions and (J,) states of the joints of the body ``blazepose``.

    A joint is inferred where all of its landmarks are known, and tracked where they are seen. A derived joint
    is tracked where one side of the body is seen and the surface before the joint is the trunk's or head's.

    Args:
        pixels: (33, 2) the landmarks in the image.
        depth: (h, w) millimetres.
    """
    positions = JOINT_WEIGHTS @ lifted.positions
    states = np.full(len(positions), TrackingState.NOT_TRACKED, dtype=np.uint8)
    known: NDArray[np.bool_] = ~np.any(_PARTS & ~lifted.known, axis=1)
    states[known] = TrackingState.INFERRED
    states[known & ~(_PARTS & ~lifted.seen).any(axis=1)] = TrackingState.TRACKED
    seen_share = _MAGNITUDES @ lifted.seen
    for j, deepest in zip(_DERIVED, _DEEPEST.values(), strict=True):
        if not known[j]:
            continue
        u, v = np.rint(JOINT_WEIGHTS[j] @ pixels).astype(int)
        window = depth[
            max(0, v - _WINDOW) : max(0, v + _WINDOW + 1), max(0, u - _WINDOW) : max(0, u + _WINDOW + 1)
        ]
        readings = window[window > 0]
        above = positions[j, 2] - 0.001 * float(np.median(readings)) if readings.size else np.inf
        tracked = seen_share[j] >= _SEEN_SHARE and 0.0 < above < deepest * lifted.size
        states[j] = TrackingState.TRACKED if tracked else TrackingState.INFERRED
    return positions, states
