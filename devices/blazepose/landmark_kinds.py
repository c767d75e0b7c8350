"""The network's landmarks, and constants of their depth by kind."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

LANDMARK_NAMES = (
    "NOSE",
    *("EYE_INNER_LEFT", "EYE_LEFT", "EYE_OUTER_LEFT", "EYE_INNER_RIGHT", "EYE_RIGHT", "EYE_OUTER_RIGHT"),
    *("EAR_LEFT", "EAR_RIGHT", "MOUTH_LEFT", "MOUTH_RIGHT"),
    *("SHOULDER_LEFT", "SHOULDER_RIGHT", "ELBOW_LEFT", "ELBOW_RIGHT", "WRIST_LEFT", "WRIST_RIGHT"),
    *("PINKY_LEFT", "PINKY_RIGHT", "INDEX_LEFT", "INDEX_RIGHT", "THUMB_LEFT", "THUMB_RIGHT"),
    *("HIP_LEFT", "HIP_RIGHT", "KNEE_LEFT", "KNEE_RIGHT", "ANKLE_LEFT", "ANKLE_RIGHT"),
    *("HEEL_LEFT", "HEEL_RIGHT", "FOOT_LEFT", "FOOT_RIGHT"),
)
"""The network's landmarks in its order. PINKY and INDEX are knuckles, FOOT is the base of the large
toe."""

INDEX = {name: j for j, name in enumerate(LANDMARK_NAMES)}
KINDS = tuple(dict.fromkeys(name.split("_")[0] for name in LANDMARK_NAMES))


class Kind(NamedTuple):
    """How the landmarks of one kind lie under the surface, and when they count as seen."""

    beneath: float  # metres of the landmark beneath the surface that the sensor sees, for a person of size 1
    visibility: float  # least visibility that the network must state
    turned: float
    """Largest component of the landmark's outward direction along the line of sight: -1 towards the sensor, 1
    away from it. An ear of the far side is hidden, whatever lies before it."""
    front: float
    back: float
    """Metres by which the surface may lie before or behind the place where the whole body expects it. What
    lies farther in front covers it; what lies farther behind is not the body."""


CONSTANTS = {
    "NOSE": Kind(0.003, 0.3, 0.3, 0.06, 0.10),
    "EYE": Kind(0.009, 0.3, 0.0, 0.06, 0.20),
    "MOUTH": Kind(0.005, 0.3, 0.3, 0.06, 0.10),
    "EAR": Kind(0.019, 0.3, -0.1, 0.08, 0.20),
    "SHOULDER": Kind(0.066, 0.3, 0.6, 0.10, 0.10),
    "ELBOW": Kind(0.043, 0.7, 1.0, 0.10, 0.20),
    "WRIST": Kind(0.026, 0.6, 1.0, 0.25, 0.25),
    "PINKY": Kind(0.019, 0.7, 1.0, 0.25, 0.25),
    "INDEX": Kind(0.019, 0.7, 1.0, 0.25, 0.25),
    "THUMB": Kind(0.000, 0.9, 1.0, 0.25, 0.25),
    "HIP": Kind(0.099, 0.3, 0.5, 0.15, 0.20),
    "KNEE": Kind(0.057, 0.7, 1.0, 0.25, 0.25),
    "ANKLE": Kind(0.058, 0.8, 1.0, 0.25, 0.20),
    "HEEL": Kind(0.038, 0.7, 0.3, 0.10, 0.10),
    "FOOT": Kind(0.028, 0.8, 0.3, 0.20, 0.10),
}
"""The constants, fitted on the simulated person: ``python -m tests.experiments.fit_blazepose``. That person
wears thin clothes and has the median build. The limits of ears, shoulders, hands and feet were then changed
on the scenes of ``tests.experiments.own_tracker`` with seed 100, to let fewer hidden joints pass."""


def column(field: str) -> NDArray[np.float64]:
    """(33,) one constant of each landmark."""
    return np.array([getattr(CONSTANTS[name.split("_")[0]], field) for name in LANDMARK_NAMES])


def opposite() -> NDArray[np.int64]:
    """(33,) the landmark from which each one's outward direction is measured; itself where it has none.

    Ears, shoulders and hips point away from the other side; heel and toes away from each other.
    """
    to = np.arange(len(LANDMARK_NAMES))
    for name, j in INDEX.items():
        kind = name.split("_")[0]
        if kind in ("EAR", "SHOULDER", "HIP"):
            other = "RIGHT" if name.endswith("LEFT") else "LEFT"
            to[j] = INDEX[f"{kind}_{other}"]
        elif kind in ("HEEL", "FOOT"):
            to[j] = INDEX[name.replace(kind, "FOOT" if kind == "HEEL" else "HEEL")]
    return to


FACE = np.array([j for name, j in INDEX.items() if name.split("_")[0] in ("NOSE", "EYE", "MOUTH")])
"""Landmarks of the face; their outward direction is away from the middle of the ears."""
EARS = np.array([INDEX["EAR_LEFT"], INDEX["EAR_RIGHT"]])
_LONG_BONES = (
    ("SHOULDER", "ELBOW", 0.29),
    ("ELBOW", "WRIST", 0.25),
    ("HIP", "KNEE", 0.42),
    ("KNEE", "ANKLE", 0.41),
)
LONG_BONES = np.array(
    [(INDEX[f"{a}_{side}"], INDEX[f"{b}_{side}"]) for a, b, _ in _LONG_BONES for side in ("LEFT", "RIGHT")]
)
"""(8, 2) the landmarks at the ends of the limbs' bones, the nearer to the trunk first."""
LONG_BONE_LENGTHS = np.repeat([length for _, _, length in _LONG_BONES], 2)
"""(8,) their lengths in an adult 1.75 m tall, metres."""
TRUNK = np.array([INDEX[f"{name}_{side}"] for name in ("SHOULDER", "HIP") for side in ("LEFT", "RIGHT")])
"""Shoulders and hips."""
