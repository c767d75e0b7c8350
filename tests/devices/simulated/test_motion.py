"""Claims about the simulated person's movements."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from devices.sensor import DeviceError
from devices.simulated.kinect import OTHER, PERSON, Beside, movement, simulated_pair
from devices.simulated.person import anatomy
from devices.simulated.person.anatomy import INDEX, landmarks_of, offset, two_bones
from devices.simulated.person.captured_motion import BEGINS, read_bvh
from devices.simulated.person.motion import STARTUP_SECONDS
from devices.simulated.person.movements import MOTIONS
from fusion.body import BODIES, KINECT_V2
from tests.helpers.footfalls import contacts, stood

HEEL_HEIGHT = anatomy.FOOT_HEIGHT + (offset("FOOT_LEFT") - offset("HEEL_LEFT"))[1]
EVERY_MOTION = pytest.mark.parametrize("motion", MOTIONS.values(), ids=MOTIONS.keys())


def times(motion, rate):
    """A round and a half of the movement, its beginning included."""
    return np.arange(0.0, motion.begins + min(1.5 * motion.period, 40.0), 1.0 / rate)


@EVERY_MOTION
def test_every_bone_of_every_body_keeps_its_length(motion):
    landmarks = motion.landmarks(times(motion, 15.0))
    for body in BODIES.values():
        points = landmarks[:, landmarks_of(body)]
        bones = points[:, body.bone_joints] - points[:, np.array(body.parents)[body.bone_joints]]
        lengths = np.linalg.norm(bones, axis=2)
        assert lengths.min() > 0.02
        # A dozen roundings along the chain of segments, each of a metre's last bit.
        assert np.ptp(lengths, axis=0).max() < 50 * np.finfo(float).eps


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


# --- Claims about motion capture read from BVH.


pytest.importorskip("bvhio", reason="reading BVH needs the extra 'mocap'")

# A T-posed person of some other unit (1 = 10 cm), who raises the left forearm by 90 degrees in 12 frames.
_LIMB = """
    JOINT {S}Shoulder {{ OFFSET {x1} 4 0 CHANNELS 3 Zrotation Xrotation Yrotation
      JOINT {S}Arm {{ OFFSET {x1} 0 0 CHANNELS 3 Zrotation Xrotation Yrotation
        JOINT {S}ForeArm {{ OFFSET {x3} 0 0 CHANNELS 3 Zrotation Xrotation Yrotation
          JOINT {S}Hand {{ OFFSET {x25} 0 0 CHANNELS 3 Zrotation Xrotation Yrotation
            End Site {{ OFFSET {x1} 0 0 }} }} }} }} }}"""
_LEG = """
  JOINT {S}UpLeg {{ OFFSET {x1} 0 0 CHANNELS 3 Zrotation Xrotation Yrotation
    JOINT {S}Leg {{ OFFSET 0 -4 0 CHANNELS 3 Zrotation Xrotation Yrotation
      JOINT {S}Foot {{ OFFSET 0 -4 0 CHANNELS 3 Zrotation Xrotation Yrotation
        End Site {{ OFFSET 0 -0.5 1.5 }} }} }} }}"""


def _limb(template, side):
    sign = 1 if side == "Left" else -1
    return template.format(S=side, x1=sign, x3=3 * sign, x25=2.5 * sign)


def write_bvh(path, frames=40):
    text = (
        "HIERARCHY\nROOT Hips { OFFSET 0 0 0\n"
        "  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation\n"
        "  JOINT Spine { OFFSET 0 2 0 CHANNELS 3 Zrotation Xrotation Yrotation"
        + _limb(_LIMB, "Left")
        + _limb(_LIMB, "Right")
        + "\n    JOINT Neck { OFFSET 0 4.5 0 CHANNELS 3 Zrotation Xrotation Yrotation"
        "\n      JOINT Head { OFFSET 0 1 0 CHANNELS 3 Zrotation Xrotation Yrotation"
        " End Site { OFFSET 0 2 0 } } } }" + _limb(_LEG, "Left") + _limb(_LEG, "Right") + "\n}\n"
    )
    # One brace and one keyword a line: the format is read line by line.
    for word in ("{", "}", "CHANNELS", "JOINT", "End Site", "OFFSET"):
        text = text.replace(word, f"\n{word}")
    text = "\n".join(line.strip() for line in text.splitlines() if line.strip()).replace("{\n", "{\n")
    rows = []
    joints = ["Hips", "Spine"]
    joints += [f"{s}{n}" for s in ("Left", "Right") for n in ("Shoulder", "Arm", "ForeArm", "Hand")]
    joints += ["Neck", "Head"]
    joints += [f"{s}{n}" for s in ("Left", "Right") for n in ("UpLeg", "Leg", "Foot")]
    for k in range(frames):
        angles = np.zeros((len(joints), 3))
        angles[joints.index("LeftForeArm"), 0] = min(90.0, 90.0 * k / 12)  # about z: up
        rows.append(" ".join(map(str, (0, 8.7, 0, *angles.ravel()))))
    path.write_text(f"{text}\nMOTION\nFrames: {frames}\nFrame Time: 0.033333\n" + "\n".join(rows) + "\n")
    return path


def test_a_captured_forearm_is_raised_as_in_the_file(tmp_path):
    motion = read_bvh(write_bvh(tmp_path / "arm.bvh"))
    first, last = motion.landmarks([BEGINS, BEGINS + 1.2])
    elbow, wrist, shoulder = (INDEX[f"{n}_LEFT"] for n in ("ELBOW", "WRIST", "SHOULDER"))
    np.testing.assert_allclose(first[wrist] - first[elbow], (0.255, 0.0, 0.0), atol=1e-9)  # T pose: left
    np.testing.assert_allclose(last[wrist] - last[elbow], (0.0, -0.255, 0.0), atol=1e-9)  # up is −y
    np.testing.assert_allclose(last[elbow] - last[shoulder], (0.295, 0.0, 0.0), atol=1e-9)
    assert first[INDEX["NOSE"], 2] < first[INDEX["HEAD"], 2]  # faces −z
    assert first[INDEX["FOOT_LEFT"], 2] < first[INDEX["ANKLE_LEFT"], 2] - 0.1


def test_captured_bones_are_constant_and_scaled_by_height(tmp_path):
    motion = read_bvh(write_bvh(tmp_path / "arm.bvh"))
    t = np.linspace(0.0, motion.seconds, 200)
    for body in BODIES.values():
        joints = motion.landmarks(t)[:, landmarks_of(body)]
        for joint in body.bone_joints:
            lengths = np.linalg.norm(joints[:, joint] - joints[:, body.parents[joint]], axis=1)
            assert np.ptp(lengths) < 50 * np.finfo(float).eps
    np.testing.assert_allclose(motion.landmarks(1.0, 0.875), 0.5 * motion.landmarks(1.0), atol=1e-12)


def test_a_captured_movement_begins_with_the_startup_pose(tmp_path):
    joints = read_bvh(write_bvh(tmp_path / "arm.bvh")).landmarks(np.linspace(0.0, 2.0, 30))
    assert np.ptp(joints, axis=0).max() < 0.04


@pytest.mark.parametrize(
    ("cut", "what"),
    [
        (lambda text: text.replace("RightLeg", "Tail"), "right knee"),
        (lambda text: "hello\n", r"damaged\.bvh"),
        (lambda text: "", "skeleton is cut off"),
        (lambda text: text[:300], "skeleton is cut off"),
        (lambda text: text[:-1500], "frames are cut off"),
        (lambda text: text.replace("Time: 0.033333", "Time: 0"), "s per frame"),
        (lambda text: text.replace("Time: 0.033333", "Time: nan"), "s per frame"),
        (lambda text: text.replace("0 8.7 0", "0 nan 0"), "not finite"),
    ],
)
def test_a_damaged_file_is_refused_at_once(tmp_path, cut, what):
    path = write_bvh(tmp_path / "damaged.bvh")
    path.write_text(cut(path.read_text()))
    with pytest.raises(DeviceError, match=what):
        read_bvh(path)
    with pytest.raises(DeviceError, match=r"missing\.bvh"):
        read_bvh(tmp_path / "missing.bvh")


# --- A second simulated person hides the first one and is hidden, and trackers exchange the ids of the two.


ASIDE = Beside(movement("sit"), (1.5, 0.0, 0.3))
BEHIND = Beside(movement("still"), (0.0, 0.0, 0.8))


def frames(other, seconds=2.0, **options):
    a, _, _ = simulated_pair(motion="walk", body=KINECT_V2, seconds=seconds, seed=3, other=other, **options)
    return list(a.frames())


def torso(skeleton):
    return np.nanmean(skeleton.positions[list(KINECT_V2.torso)], axis=0)


def test_a_person_who_stands_aside_changes_nothing_of_the_first_one():
    alone, both = frames(None), frames(ASIDE)
    assert [frame.time_ns for frame in alone] == [frame.time_ns for frame in both]
    for one, two in zip(alone, both, strict=True):
        assert one.people.keys() <= {PERSON}
        assert (PERSON in one.people) == (PERSON in two.people)
        if PERSON in one.people:
            assert one.people[PERSON].repeats(two.people[PERSON])
    apart = [np.linalg.norm(torso(f.people[OTHER]) - torso(f.people[PERSON])) for f in both[5:]]
    assert np.median(apart) == pytest.approx(np.hypot(1.5, 0.3), abs=0.4)


def test_who_stands_behind_another_is_hidden():
    seen = [frame.people for frame in frames(BEHIND, angle_deg=0.0) if PERSON in frame.people]
    first = np.mean([people[PERSON].tracked.mean() for people in seen])
    other = np.mean([people[OTHER].tracked.mean() if OTHER in people else 0.0 for people in seen])
    assert other < first - 0.2
    depth = frames(BEHIND, 0.1, angle_deg=90.0, depth="half")[0].depth
    alone = frames(None, 0.1, angle_deg=90.0, depth="half")[0].depth
    assert (depth != alone).mean() > 0.01
