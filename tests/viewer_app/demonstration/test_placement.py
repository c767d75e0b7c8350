"""The demo's sensors are well placed in every movement, and badly where that is asked for."""

import numpy as np
import pytest

from devices.simulated.demonstration import bad_rig, demonstrated, good_rig
from devices.simulated.person.anatomy import landmarks_of
from devices.simulated.person.movements import MOTIONS
from fusion.body import AZURE_KINECT, BODIES
from fusion.intrinsics import NOMINAL_INTRINSICS
from tests.helpers.demonstrations import advice_over
from viewer_app.coach.advice import ANGLES

ANGLES_SHOWN = 45.0, 90.0, 135.0


def share_inside(rig, body, motion):
    """The share of frames in a minute in which both images show all joints."""
    joints = demonstrated(motion).landmarks(np.arange(0.0, 60.0, 0.1))[:, landmarks_of(body)]
    camera = NOMINAL_INTRINSICS[body.name]
    inside = np.ones(len(joints), dtype=bool)
    for which in (0, 1):
        pixels = camera.project(rig.world_from_sensor(which).inverse().apply(joints))
        inside &= ((pixels >= 0.0) & (pixels < (camera.width, camera.height))).all(axis=(1, 2))
    return float(inside.mean())


@pytest.mark.parametrize("body", BODIES.values(), ids=lambda body: body.name)
def test_both_images_show_the_whole_person_in_every_movement(body):
    for motion in MOTIONS:
        for angle in ANGLES_SHOWN:
            assert share_inside(good_rig(body, angle), body, motion) >= 0.99, (motion, angle)
    assert share_inside(bad_rig(), body, "badminton") == 0.0


@pytest.mark.parametrize(
    ("body", "angle"),
    [*((body, 90.0) for body in BODIES.values()), (AZURE_KINECT, 45.0), (AZURE_KINECT, 135.0)],
    ids=str,
)
def test_the_coach_finds_no_fault_with_the_placement_in_any_movement(body, angle):
    wrong = {
        motion: [topic for topic, said in advice_over(good_rig(body, angle), body, motion).items()
                 if said.level == "WARN"]
        for motion in MOTIONS
    }  # fmt: skip
    expected = [] if ANGLES[0] <= angle <= ANGLES[1] else ["angle"]  # the one that was asked for
    assert wrong == dict.fromkeys(MOTIONS, expected)


def test_the_walk_of_the_benchmarks_leaves_the_range_of_a_kinect_v1():
    assert demonstrated("walk") is not MOTIONS["walk"]
    assert all(demonstrated(motion) is MOTIONS[motion] for motion in MOTIONS if motion != "walk")


def test_a_bad_set_up_is_told_what_to_mend():
    said = advice_over(bad_rig(), AZURE_KINECT, "badminton", seconds=10.0)
    wrong = {topic: advice.text for topic, advice in said.items() if advice.level == "WARN"}
    assert set(wrong) == {"distance A", "distance B", "feet A", "feet B", "angle"}
    for side in "AB":
        assert wrong[f"distance {side}"].startswith(f"Too close to sensor {side}: 1.")
        assert wrong[f"feet {side}"].startswith(f"Sensor {side} does not see both feet in 100 % of frames")
    assert wrong["angle"].startswith("The sensors look 30° apart")
