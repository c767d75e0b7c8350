"""Claims about motion capture read from BVH."""

import os
from pathlib import Path

import numpy as np
import pytest

from devices.sensor import DeviceError
from devices.simulated.kinect import simulated_pair
from devices.simulated.person.anatomy import INDEX, landmarks_of
from devices.simulated.person.captured_motion import BEGINS, read_bvh
from devices.simulated.tracking.tracker_errors import TrackerErrors
from fusion.body import BODIES

pytest.importorskip("bvhio", reason="reading BVH needs the extra 'mocap'")
SHARED = Path(os.environ.get("DUPLEX_SHARED", Path(__file__).parents[4] / "shared"))

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


def test_real_motion_capture_plays_through_the_pair():
    path = SHARED / "mocap" / "02_01.bvh"
    if not path.exists():
        pytest.skip(f"no motion capture at {path.parent}: set DUPLEX_SHARED")
    a, _, truth = simulated_pair(motion=path, seconds=5.0, errors=TrackerErrors())
    frames = list(a.frames())
    assert len(frames) == 150
    joints = np.stack([f.people["1"].positions for f in frames])
    assert np.ptp(joints, axis=0).max() > 0.5  # it moves
    feet = truth.scene.motion.landmarks(np.linspace(4.0, 5.0, 30))[
        :, [INDEX["FOOT_LEFT"], INDEX["FOOT_RIGHT"]]
    ]
    assert np.abs(feet[..., 1].max(axis=1) + 0.02).max() < 0.06  # one foot is near the floor
