"""The floor is found from a standing person, also by a tilted sensor."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fusion.body import KINECT_V2
from fusion.rigid import RigidTransform
from recordings.appearance.floor import ANKLE, CAMERA_HEIGHT, FloorFinder, find_floor
from tests.helpers.two_views import standing

ANKLES = [KINECT_V2.joint("ankle left"), KINECT_V2.joint("ankle right")]


def seen_by(tilt_deg, count=60):
    """(T, J, 3) a standing person as a sensor sees them that is turned about its x axis, and that turn."""
    turn = Rotation.from_euler("x", tilt_deg, degrees=True).as_matrix()
    tilted = RigidTransform.of(turn, np.zeros(3))
    return tilted.apply(np.repeat(standing(KINECT_V2)[None], count, axis=0)), tilted


@pytest.mark.parametrize("tilt_deg", [0.0, 12.0, -20.0])
def test_the_ankles_are_above_the_floor_and_down_is_down(tilt_deg):
    fused, tilted = seen_by(tilt_deg)
    floor = find_floor(KINECT_V2, fused)
    down = tilted.rotation @ [0.0, 1.0, 0.0]
    # trunk and legs of the standing person lean by less than 1°
    assert math.degrees(math.acos(min(1.0, float(floor.rotation[:, 1] @ down)))) < 1.0
    heights = floor.inverse().apply(fused[0, ANKLES])[:, 1]  # y is down: above the floor is negative
    # rounded to centimetres; 1° of lean at 2.6 m moves the floor by 45 mm at most
    np.testing.assert_allclose(heights.max(), -ANKLE, atol=0.005 + 0.045)


def test_the_origin_is_below_the_sensor():
    fused, _ = seen_by(12.0)
    floor = find_floor(KINECT_V2, fused)
    below = floor.inverse().apply(np.zeros(3))
    np.testing.assert_allclose(below[[0, 2]], 0.0, atol=1e-9)
    assert below[1] < 0.0


def test_a_floor_is_assumed_found_once_and_reported_again_when_the_sensor_moves():
    finder = FloorFinder(KINECT_V2)
    assert finder.a_from_floor.translation[1] == CAMERA_HEIGHT
    fused, _ = seen_by(0.0, 300)
    assert not finder.add(fused[:5])
    assert finder.add(fused[5:40])
    assert not any(finder.add(fused[k : k + 1]) for k in range(40, 240))
    tilted, _ = seen_by(10.0, 300)
    assert any(finder.add(tilted[k : k + 1]) for k in range(300))


def test_frames_without_feet_tell_nothing():
    finder = FloorFinder(KINECT_V2)
    fused, _ = seen_by(0.0)
    fused[:, ANKLES[0]] = np.nan
    assert not finder.add(fused)
    assert finder.a_from_floor.translation[1] == CAMERA_HEIGHT
