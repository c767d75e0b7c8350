"""Limits of what is good and usable, and how a figure is stated beside its limit."""

import re
from typing import Literal

import numpy as np

from fusion.intrinsics import Intrinsics

GOOD_ANGLES = (60.0, 120.0)
"""Range of the angle between the sensors, degrees, in which they complement each other best."""
GOOD, USABLE = 40.0, 80.0
"""Thresholds for the median distance between the calibrated views, mm; real Kinects v2 reach 44 to 77 mm."""
FARTHEST_PERSON = {"kinect_v1": 4.0, "kinect_v2": 4.5, "azure_kinect": 3.9, "blazepose": 3.9}
"""Specified depth range in metres, by body (Azure: NFOV, not binned; BlazePose: as on an Azure Kinect)."""
POSSIBLE = {
    "hip_flexion": (-45.0, 165.0),
    "knee_flexion": (-15.0, 165.0),
    "hip_abduction": (-50.0, 80.0),
    "shoulder_flexion": (-90.0, 185.0),
    "shoulder_abduction": (-60.0, 185.0),
    "elbow_flexion": (-15.0, 165.0),
}
"""Degrees that a joint reaches, with room for very mobile people; those of the trunk depend on the pose."""
PLOTTED_DEGREES = {
    "hip_flexion": (-45.0, 125.0),
    "knee_flexion": (-15.0, 155.0),
    "hip_abduction": (-32.0, 32.0),
    "elbow_flexion": (-15.0, 155.0),
    "shoulder_flexion": (-65.0, 185.0),
    "shoulder_abduction": (-65.0, 185.0),
    "trunk": (-32.0, 32.0),
}
"""Axes of the viewer's plots. Rerun numbers whole tens or hundreds: an axis has two on a small screen."""
TALL = 2.0
"""Metres that must fit into the image: a tall adult, and some room."""


def nearest(camera: Intrinsics) -> float:
    """The smallest distance in metres at which a tall person fits into the image."""
    return TALL * camera.fy / camera.height


def graded(value: float, limits: tuple[float, float]) -> Literal["good", "usable", "poor"]:
    """Good below the first limit, usable below the second."""
    return "good" if value < limits[0] else "usable" if value < limits[1] else "poor"


def beside(value: float, *limits: float, digits: int = 0) -> str:
    """A number with so many digits, or as many more as keep it on its side of the limits."""
    sides = [np.sign(value - each) for each in limits]
    return next(
        text
        for more in range(digits, 18)
        for text in [f"{value:.{more}f}"]
        if more == 17 or [np.sign(float(text) - each) for each in limits] == sides
    )


def spoken(joint: str) -> str:
    """A joint's name as one says it: "left hand" for HAND_LEFT and HandLeft."""
    words = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", joint).replace("_", " ").lower().split()
    return " ".join(sorted(words, key=lambda word: word not in ("left", "right")))
