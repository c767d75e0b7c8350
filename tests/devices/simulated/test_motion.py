"""Claims about the simulated person's movements."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from devices.simulated.person import anatomy
from devices.simulated.person.anatomy import INDEX, landmarks_of, offset, two_bones
from devices.simulated.person.motion import STARTUP_SECONDS
from devices.simulated.person.movements import MOTIONS
from fusion.body import BODIES
from tests.helpers.footfalls import contacts, stood

HEEL_HEIGHT = anatomy.FOOT_HEIGHT + (offset("FOOT_LEFT") - offset("HEEL_LEFT"))[1]
EVERY_MOTION = pytest.mark.parametrize("motion", MOTIONS.values(), ids=MOTIONS.keys())


def times(motion, rate=60.0):
    """A round and a half of the movement, its beginning included."""
    return np.arange(0.0, motion.begins + min(1.5 * motion.period, 40.0), 1.0 / rate)


@EVERY_MOTION
@pytest.mark.parametrize("body", BODIES.values(), ids=BODIES.keys())
def test_every_bone_of_every_body_keeps_its_length(motion, body):
    points = motion.landmarks(times(motion))[:, landmarks_of(body)]
    for joint in body.bone_joints:
        lengths = np.linalg.norm(points[:, joint] - points[:, body.parents[joint]], axis=1)
        assert lengths.min() > 0.02
        # A dozen roundings along the chain of segments, each of a metre's last bit.
        assert np.ptp(lengths) < 50 * np.finfo(float).eps, body.bones[joint]


@EVERY_MOTION
def test_movements_begin_in_the_startup_pose_and_hold_it(motion):
    if not motion.startup:
        pytest.skip("begins at once: there is nothing to calibrate on")
    points = motion.landmarks(np.linspace(0.0, STARTUP_SECONDS, 60))
    wrists = points[:, [INDEX["WRIST_LEFT"], INDEX["WRIST_RIGHT"]]]
    shoulders = points[:, [INDEX["SHOULDER_LEFT"], INDEX["SHOULDER_RIGHT"]]]
    assert (np.abs(wrists - shoulders)[..., 0] > 0.3).all()  # arms apart
    assert np.all(points[:, INDEX["ANKLE_LEFT"], 0] - points[:, INDEX["ANKLE_RIGHT"], 0] > 0.3)  # legs apart
    assert np.ptp(points, axis=0).max() < 0.04  # breathing and swaying only
    assert np.all(points[:, INDEX["NOSE"], 2] < points[:, INDEX["HEAD"], 2])  # facing −z, between the sensors


@EVERY_MOTION
def test_movements_are_smooth(motion):
    rate = 240.0
    points = motion.landmarks(times(motion, rate))
    speed = np.linalg.norm(np.diff(points, axis=0), axis=2) * rate
    acceleration = np.linalg.norm(np.diff(points, 2, axis=0), axis=2) * rate**2
    # A smash moves the hand at some 15 m/s and a few hundred m/s²; a jump between two frames of 1 cm
    # would be 576 m/s².
    assert speed.max() < 15.0
    assert acceleration.max() < 400.0
    trunk = [INDEX["PELVIS"], INDEX["SPINE_CHEST"]]
    assert acceleration[:, trunk].max() < 45.0


@EVERY_MOTION
def test_planted_toes_do_not_slide_and_feet_stay_above_the_floor(motion):
    rate = 120.0
    points = motion.landmarks(times(motion, rate))
    for foot in ("FOOT_LEFT", "FOOT_RIGHT"):
        toes = points[:, INDEX[foot]]
        assert (toes[:, 1] < -anatomy.FOOT_HEIGHT + 0.005).all()
        down = toes[:, 1] > -anatomy.FOOT_HEIGHT - 0.0015
        planted = down[1:] & down[:-1]
        assert planted.any()
        speed = np.linalg.norm(np.diff(toes[:, [0, 2]], axis=0), axis=1) * rate
        assert np.max(speed[planted], initial=0.0) < 0.05  # a twentieth of walking speed
        heel = -points[:, INDEX[foot.replace("FOOT", "HEEL")], 1]
        assert heel.min() > HEEL_HEIGHT - 0.002


def test_the_walk_bends_its_knees_as_people_do():
    """Ranges of healthy adults who walk slowly: Perry and Burnfield (2010), Schwartz et al. (2008)."""
    for side, (strikes, offs) in contacts("walk", 20.0).items():
        assert 0.60 < stood(strikes, offs).mean() < 0.66
        cycles = strikes[1:-1, None] + np.linspace(0.0, 1.0, 101) * np.diff(strikes[1:])[:, None]
        points = MOTIONS["walk"].landmarks(cycles.ravel())
        hip, knee, ankle, toes = (
            points[:, INDEX[f"{part}_{side.upper()}"]] for part in ("HIP", "KNEE", "ANKLE", "FOOT")
        )
        bones = [anatomy.unit(bone) for bone in (knee - hip, ankle - knee)]
        flexion = np.degrees(np.arccos(np.sum(np.multiply(*bones), axis=1))).reshape(cycles.shape)
        typical = np.median(flexion, axis=0)
        assert typical[0] < typical[5:25].max() - 4.0 < 16.0  # bends as it takes the weight
        assert 5 < typical[:40].argmax() < 25
        assert typical[25:50].min() < 10.0  # nearly straight behind the body
        assert 50.0 < typical.max() < 65.0  # swings
        assert 65 < typical.argmax() < 78
        clearance = -toes[:, 1].reshape(cycles.shape)[:, 70:90] - anatomy.FOOT_HEIGHT
        assert 0.01 < clearance.min() < 0.025


@pytest.mark.parametrize("height", [1.2, 1.75, 2.0])
def test_the_body_is_scaled_by_height(height):
    points = MOTIONS["still"].landmarks([0.0], height)[0]
    assert -points[INDEX["HEAD_TOP"], 1] == pytest.approx(height, rel=0.03)


def test_any_time_may_be_asked_for_in_any_order():
    walk = MOTIONS["walk"]
    together = walk.landmarks([3.0, 50.0, 7.0])
    for k, t in enumerate((3.0, 50.0, 7.0)):
        np.testing.assert_allclose(walk.landmarks(t)[0], together[k], atol=1e-12)


@given(
    st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3),
    st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3),
)
def test_two_bones_have_their_lengths_wherever_they_reach(target, pole):
    goal, side = np.array([target]), np.array([pole])
    if np.linalg.norm(np.cross(goal, side)) < 1e-3:
        return  # the pole says nothing about the side
    middle, end, axis = two_bones(goal, side, 0.3, 0.25)
    assert np.linalg.norm(middle) == pytest.approx(0.3, abs=1e-12)
    assert np.linalg.norm(end - middle) == pytest.approx(0.25, abs=1e-12)
    assert np.sum(middle * axis) == pytest.approx(0.0, abs=1e-12)
    distance = np.linalg.norm(goal)
    if 0.08 < distance < 0.97 * 0.55:
        np.testing.assert_allclose(end, goal, atol=1e-12)
