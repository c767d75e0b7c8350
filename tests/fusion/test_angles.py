"""Joint angles: known poses of every body, the frames of another library, and their uncertainty."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fusion.body import AZURE_KINECT, BODIES
from fusion.movement.angles import ANGLES, UP, angle_sigma, joint_angles
from tests.helpers.poses import BACK, DOWN, FRONT, LEFT, RIGHT, posed, turned_about

each_body = pytest.mark.parametrize("body", BODIES.values(), ids=str)


def towards(start, end, degrees):
    """The direction at this angle from one direction to one across it."""
    angle = np.radians(degrees)
    return tuple(np.cos(angle) * np.array(start) + np.sin(angle) * np.array(end))


POSES = {
    "upright": ({}, {}),
    "knee": ({"AnkleLeft": towards(DOWN, BACK, 70)}, {"knee_flexion_left": 70}),
    "sitting": (
        {**{f"Knee{side}": FRONT for side in ("Left", "Right")}},
        {f"{angle}_{side}": 90 for angle in ("hip_flexion", "knee_flexion") for side in ("left", "right")},
    ),
    "thigh back": (
        {"KneeRight": towards(DOWN, BACK, 20), "AnkleRight": towards(DOWN, BACK, 20)},
        {"hip_flexion_right": -20},
    ),
    "leg aside": (
        {"KneeRight": towards(DOWN, RIGHT, 35), "AnkleRight": towards(DOWN, RIGHT, 35)},
        {"hip_abduction_right": 35},
    ),
    "legs crossed": (
        {"KneeLeft": towards(DOWN, RIGHT, 10), "AnkleLeft": towards(DOWN, RIGHT, 10)},
        {"hip_abduction_left": -10},
    ),
    "elbow": ({"WristRight": towards(DOWN, FRONT, 100)}, {"elbow_flexion_right": 100}),
    "arm raised forwards": (
        {"ElbowLeft": towards(DOWN, FRONT, 130), "WristLeft": towards(DOWN, FRONT, 130)},
        {"shoulder_flexion_left": 130},
    ),
    "arm swung back": (
        {"ElbowRight": towards(DOWN, BACK, 25), "WristRight": towards(DOWN, BACK, 25)},
        {"shoulder_flexion_right": -25},
    ),
    "arm straight up": (
        {"ElbowLeft": towards(DOWN, FRONT, 180), "WristLeft": towards(DOWN, FRONT, 180)},
        {"shoulder_flexion_left": 180},
    ),
    "arms raised sideways": (
        {
            **{f"{joint}Left": towards(DOWN, LEFT, 150) for joint in ("Elbow", "Wrist")},
            **{f"{joint}Right": towards(DOWN, RIGHT, 90) for joint in ("Elbow", "Wrist")},
        },
        {"shoulder_abduction_left": 150, "shoulder_abduction_right": 90},
    ),
}


@each_body
@pytest.mark.parametrize("pose", POSES)
def test_known_poses(body, pose):
    directions, expected = POSES[pose]
    angles = joint_angles(body, posed(body, directions))
    np.testing.assert_allclose(angles, [expected.get(name, 0.0) for name in ANGLES], atol=1e-6)


@each_body
def test_a_trunk_that_bows_and_leans_while_the_legs_stay(body):
    joints = posed(body, {})
    hips = joints[[body.joint("HipLeft"), body.joint("HipRight")]].mean(axis=0)
    legs = [body.joint(f"{joint}{side}") for joint in ("Knee", "Ankle") for side in ("Left", "Right")]
    for turn, trunk in (
        (Rotation.from_rotvec([np.radians(30), 0, 0]), {"trunk_flexion": 30, "hip_flexion": 30}),
        (Rotation.from_rotvec([0, 0, np.radians(-12)]), {"trunk_lean": 12}),
    ):
        bowed = hips + turn.apply(joints - hips)
        bowed[legs] = joints[legs]
        angles = dict(zip(ANGLES, joint_angles(body, bowed), strict=True))
        for name in ("trunk_flexion", "trunk_lean"):
            assert angles[name] == pytest.approx(trunk.get(name, 0.0), abs=1e-6)
        for side in ("left", "right"):
            assert angles[f"hip_flexion_{side}"] == pytest.approx(trunk.get("hip_flexion", 0.0), abs=1e-6)
    lean = angles["hip_abduction_left"], angles["hip_abduction_right"]
    assert lean[0] < 0.0 < lean[1]  # the trunk leans to the right, over the right thigh


def random_poses(body, count, seed=1):
    random = np.random.default_rng(seed)
    poses = _near_rest(body, random, count)
    return np.array([posed(body, dict(zip(body.joints[1:], pose, strict=True))) for pose in poses])


def _near_rest(body, random, count):
    each = body.rest[1:] + 0.5 * random.normal(size=(count, len(body) - 1, 3))
    return each / np.linalg.norm(each, axis=2, keepdims=True)


@each_body
def test_angles_depend_neither_on_the_place_nor_on_the_sensor(body):
    joints = random_poses(body, 20)
    turn = Rotation.from_rotvec([0.4, 2.1, -0.7])
    moved = np.array([turned_about(each, turn, 0) for each in joints]) + [1.0, -2.0, 0.5]
    np.testing.assert_allclose(
        joint_angles(body, moved, turn.apply(UP)), joint_angles(body, joints), atol=1e-6
    )


def test_an_unknown_joint_takes_away_its_own_angles_only():
    joints = posed(AZURE_KINECT, {})
    joints[AZURE_KINECT.joint("WristLeft")] = np.nan
    sigma = np.full(len(AZURE_KINECT), 0.01)
    sigma[AZURE_KINECT.joint("KneeRight")] = np.nan
    missing = {
        name
        for name, angle in zip(ANGLES, joint_angles(AZURE_KINECT, joints), strict=True)
        if np.isnan(angle)
    }
    assert missing == {"elbow_flexion_left"}
    of_sigma = np.isnan(angle_sigma(AZURE_KINECT, joints, sigma))
    assert {name for name, unknown in zip(ANGLES, of_sigma, strict=True) if unknown} == {
        "elbow_flexion_left", "knee_flexion_right", "hip_flexion_right", "hip_abduction_right",
    }  # fmt: skip


def test_the_uncertainty_is_the_spread_of_angles_of_joints_that_err_so():
    directions = {"AnkleLeft": towards(DOWN, BACK, 40), "AnkleRight": towards(DOWN, BACK, 30)} | {
        f"{joint}{side}": towards(DOWN, FRONT, degrees)
        for joint, degrees in (("Elbow", 30), ("Wrist", 80))
        for side in ("Left", "Right")
    }
    joints = posed(AZURE_KINECT, directions)
    sigma = np.linspace(0.005, 0.015, len(AZURE_KINECT))
    random, count = np.random.default_rng(5), 40_000
    erring = joints + random.normal(size=(count, *joints.shape)) * sigma[:, None] / np.sqrt(3.0)
    spread = joint_angles(AZURE_KINECT, erring).std(axis=0)
    # the spread of so many is known within 0.4 %; the rest is curvature
    np.testing.assert_allclose(angle_sigma(AZURE_KINECT, joints, sigma, up_sd=0.0), spread, rtol=0.03)


@pytest.mark.parametrize("up", [(0.0, -1.0, 0.0), (0.1, -0.9, 0.4), (1.0, 0.0, 0.0)])
def test_an_uncertain_up_direction_makes_the_trunk_alone_uncertain(up):
    joints, nothing = posed(AZURE_KINECT, {}), np.zeros(len(AZURE_KINECT))
    joints = Rotation.align_vectors([up], [UP])[0].apply(joints)
    exact, found = (angle_sigma(AZURE_KINECT, joints, nothing, up, up_sd=sd) for sd in (0.0, 2.0))
    assert (exact == 0.0).all()
    trunk = np.array([name.startswith("trunk") for name in ANGLES])
    np.testing.assert_allclose(found[trunk], 2.0, rtol=1e-3)  # upright: each angle is a tilt about one axis
    np.testing.assert_allclose(found[~trunk], 0.0, atol=1e-6)


def test_the_rotation_sequences_of_another_library_give_the_same_angles():
    reference = pytest.importorskip("pytransform3d.rotations")
    body = AZURE_KINECT

    def frame(up, right):
        """Axes as ISB names them, x forwards, y up, z to the right; the direction of y stays."""
        return reference.matrix_from_two_vectors(up, right)[:, [2, 0, 1]]

    for joints in random_poses(body, 50):
        angles = dict(zip(ANGLES, joint_angles(body, joints), strict=True))

        def between(first, second, sequence):
            relative, axes = frame(*first).T @ frame(*second), ["xyz".index(axis) for axis in sequence]
            return np.degrees(reference.euler_from_matrix(relative, *axes, extrinsic=False))

        def joint(name):
            return joints[body.joint(name)]  # noqa: B023

        hips, shoulders = (joint(f"{part}Right") - joint(f"{part}Left") for part in ("Hip", "Shoulder"))
        middles = [0.5 * (joint(f"{part}Left") + joint(f"{part}Right")) for part in ("Hip", "Shoulder")]
        trunk = middles[1] - middles[0]
        extension, lean, _ = between((np.array(UP), hips + shoulders), (trunk, hips), "zxy")
        expected = {"trunk_flexion": -extension, "trunk_lean": lean}
        for side, adduction in (("left", 1.0), ("right", -1.0)):
            thigh = joint(f"Hip{side}") - joint(f"Knee{side}")
            shin = joint(f"Knee{side}") - joint(f"Ankle{side}")
            arm = joint(f"Shoulder{side}") - joint(f"Elbow{side}")
            forearm = joint(f"Elbow{side}") - joint(f"Wrist{side}")
            flexion, adduced, _ = between((trunk, hips + shoulders), (thigh, hips), "zxy")
            plane, elevation, _ = between((trunk, shoulders), (arm, shoulders), "yxy")
            expected |= {
                f"hip_flexion_{side}": flexion,
                f"hip_abduction_{side}": adduction * adduced,
                f"shoulder_flexion_{side}": -elevation * np.sin(np.radians(plane)),
                f"shoulder_abduction_{side}": adduction * elevation * np.cos(np.radians(plane)),
                f"knee_flexion_{side}": np.degrees(reference.angle_between_vectors(thigh, shin)),
                f"elbow_flexion_{side}": np.degrees(reference.angle_between_vectors(arm, forearm)),
            }
        assert angles == pytest.approx(expected, abs=1e-6)
