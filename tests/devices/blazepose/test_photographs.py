"""Landmarks on a real photograph that scikit-image ships, against marks made by hand."""

import numpy as np
import pytest

from devices.blazepose.blazepose import BlazePose
from devices.blazepose.settings import BlazePoseSettings
from fusion.body import BLAZEPOSE
from fusion.intrinsics import Intrinsics
from tests.helpers.machine import need_networks
from tests.helpers.rendered_people import FRAME_NS

HEAD_OF_STATURE = 0.130  # from crown to chin; Drillis and Contini (1966). The picture ends at the waist.
GOAL = 0.05  # of the person's height: the project's

# An astronaut in a space suit; public domain, by NASA. Read off the picture by eye, to about 10 pixels; the
# joints in the suit to about 20.
CROWN, CHIN = 15, 187
MARKS = {
    "NOSE": (223, 127),
    "EYE_RIGHT": (203, 102),
    "EYE_LEFT": (246, 103),
    "SHOULDER_RIGHT": (95, 262),
    "SHOULDER_LEFT": (318, 268),
    "ELBOW_RIGHT": (45, 410),
}


def test_landmarks_are_within_a_twentieth_of_the_height_of_marks_made_by_hand() -> None:
    data = pytest.importorskip("skimage.data", reason="scikit-image, which ships the photograph, is missing")
    photograph = data.astronaut()
    height = (CHIN - CROWN) / HEAD_OF_STATURE
    camera = Intrinsics(512, 512, 504.0, 504.0, 255.5, 255.5)
    # The picture has no depth: a wall at the distance at which a person of 1.7 m is as large.
    depth = np.full(photograph.shape[:2], round(1000 * 1.7 * camera.fy / height), dtype=np.uint16)
    with BlazePose(BlazePoseSettings(models=need_networks())) as tracker:
        for k in range(3):  # a region follows from the landmarks of the image before, and settles
            people = tracker.track(photograph, depth, camera, k * FRAME_NS)
    assert len(people) == 1
    pixels = camera.project(next(iter(people.values())).positions)
    misses = {
        joint: float(np.linalg.norm(pixels[BLAZEPOSE.joint(joint)] - mark)) / height
        for joint, mark in MARKS.items()
    }
    assert max(misses.values()) < GOAL, misses
