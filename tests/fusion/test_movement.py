"""Joint angles and rotations of the bones."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fusion.body import AZURE_KINECT, BODIES, KINECT_V2
from fusion.movement.angles import ANGLES, UP, angle_sigma, joint_angles
from fusion.movement.joint_rotations import JointRotations, joint_bones, rotations_of
from tests.helpers.poses import BACK, DOWN, FRONT, LEFT, posed, turned_about
from tests.helpers.two_views import FRAME_NS, moving, standing

# --- Joint angles: the frames of another library, and their uncertainty.


each_body = pytest.mark.parametrize("body", BODIES.values(), ids=str)


def towards(start, end, degrees):
    """The direction at this angle from one direction to one across it."""
    angle = np.radians(degrees)
    return tuple(np.cos(angle) * np.array(start) + np.sin(angle) * np.array(end))


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


# --- Rotations of the bones: exact swing, twist by the stated convention, continuous in time.


ROUNDING = 1e-12  # some hundred operations on numbers of size 1


def angle(p, q):
    """Between two quaternions, radians."""
    return float((Rotation.from_quat(p).inv() * Rotation.from_quat(q)).magnitude())


@pytest.mark.parametrize("body", BODIES.values(), ids=str)
def test_forward_kinematics_reproduces_every_joint(body):
    joints = moving(body, 90)
    rotations = rotations_of(body, joints, np.arange(90) * FRAME_NS)
    for j in body.bone_joints:
        bones = joints[:, j] - joints[:, body.parents[j]]
        length = np.linalg.norm(bones, axis=1, keepdims=True)
        made = Rotation.from_quat(rotations[:, j]).apply(body.rest[j].copy()) * length
        np.testing.assert_allclose(made, bones, atol=ROUNDING)


@pytest.mark.parametrize("body", BODIES.values(), ids=str)
def test_at_rest_nothing_is_rotated_and_a_turned_person_is_turned_as_a_whole(body):
    rest = posed(body, {})
    np.testing.assert_allclose(
        JointRotations(body).update(rest, 0), [[0, 0, 0, 1]] * len(body), atol=ROUNDING
    )
    turn = Rotation.from_rotvec([0.3, -2.5, 0.4])
    rotations = JointRotations(body).update(turned_about(rest, turn, body.root), 0)
    for each in rotations:
        assert angle(each, turn.as_quat()) < 1e-7  # the arc cosine near 1 halves the digits


def test_a_forearm_bent_forward_or_sideways_twists_the_upper_arm():
    # The elbow's axis is the person's left at rest. A hanging arm whose forearm points to the front has that
    # axis. If it points to the left, the axis has turned by a quarter turn about the upper arm: left → back.
    body = AZURE_KINECT
    elbow, wrist = body.joint("ElbowLeft"), body.joint("WristLeft")
    bent = JointRotations(body).update(posed(body, {"WristLeft": FRONT}), 0)
    assert angle(bent[elbow], np.array([0.0, 0.0, 0.0, 1.0])) < 1e-7
    np.testing.assert_allclose(Rotation.from_quat(bent[wrist]).apply(LEFT), LEFT, atol=ROUNDING)
    bent = JointRotations(body).update(posed(body, {"WristLeft": LEFT}), 0)
    np.testing.assert_allclose(Rotation.from_quat(bent[elbow]).apply(LEFT), BACK, atol=ROUNDING)
    np.testing.assert_allclose(Rotation.from_quat(bent[wrist]).apply(LEFT), BACK, atol=ROUNDING)


def test_the_head_turns_with_the_ears():
    body = AZURE_KINECT
    yaw = Rotation.from_rotvec([0.0, 0.6, 0.0])
    joints = posed(body, {})
    head = body.joint("Head")
    for name in ("Nose", "EyeLeft", "EyeRight", "EarLeft", "EarRight"):
        j = body.joint(name)
        joints[j] = joints[head] + yaw.apply(joints[j] - joints[head])
    rotations = JointRotations(body).update(joints, 0)
    assert angle(rotations[head], yaw.as_quat()) < 1e-7
    assert angle(rotations[body.joint("Neck")], np.array([0.0, 0.0, 0.0, 1.0])) < 1e-7


def test_the_twist_of_a_straight_arm_ignores_the_noise_of_its_plane():
    body = KINECT_V2
    rng = np.random.default_rng(5)
    rotations = JointRotations(body)
    elbow = body.joint("ElbowLeft")
    still = standing(body)
    before = rotations.update(still, 0)[elbow]
    for k in range(1, 60):
        joints = still.copy()
        # 20 mm across a forearm of 250 mm: below the 10 degrees from which on its plane counts
        joints[body.joint("WristLeft")] += rng.uniform(-0.02, 0.02, 3)
        now = rotations.update(joints, k * FRAME_NS)[elbow]
        assert angle(before, now) < 1e-6
        before = now


def test_an_elbow_s_plane_that_flips_turns_the_arm_at_a_limited_speed():
    body = KINECT_V2
    rotations = JointRotations(body)
    elbow = body.joint("ElbowLeft")
    rotations.update(posed(body, {"WristLeft": FRONT}), 0)
    flipped = posed(body, {"WristLeft": BACK})
    steps = []
    before = rotations.update(posed(body, {"WristLeft": FRONT}), FRAME_NS)[elbow]
    for k in range(2, 12):
        now = rotations.update(flipped, k * FRAME_NS)[elbow]
        steps.append(angle(before, now))
        before = now
    assert max(steps) <= 20.0 * FRAME_NS * 1e-9 + 1e-9
    assert sum(steps) == pytest.approx(np.pi, abs=1e-6)  # and arrives


@pytest.mark.parametrize("body", BODIES.values(), ids=str)
def test_signs_and_rotations_are_continuous_in_time(body):
    joints = moving(body, 240)
    rotations = rotations_of(body, joints, np.arange(240) * FRAME_NS)
    cosine = np.einsum("tjc,tjc->tj", rotations[1:], rotations[:-1])
    directions = joints - joints[:, body.parent_indices]
    directions /= np.maximum(np.linalg.norm(directions, axis=2, keepdims=True), 1e-9)
    swing = np.arccos(np.clip(np.einsum("tjc,tjc->tj", directions[1:], directions[:-1]), -1.0, 1.0))
    step = 2.0 * np.arccos(np.clip(cosine, -1.0, 1.0))
    # a rotation is the bone's own swing after a twist of 20 rad/s at most; the arc cosine has 1e-7
    spine = step[:, body.root] <= 20.0 * FRAME_NS * 1e-9 + swing.max(axis=1) + 1e-6
    assert spine.all()
    each = swing[:, body.bone_joints] + 20.0 * FRAME_NS * 1e-9 + 1e-6
    assert (step[:, body.bone_joints] <= each).all()
    assert (cosine > 0.0).all()


def test_without_a_person_there_are_no_rotations_and_the_twist_outlasts_a_short_gap():
    body = KINECT_V2
    rotations = JointRotations(body)
    elbow = body.joint("ElbowLeft")
    twisted = rotations.update(posed(body, {"WristLeft": LEFT}), 0)[elbow]
    nobody = np.full((len(body), 3), np.nan)
    assert np.isnan(rotations.update(nobody, FRAME_NS)).all()
    straight = posed(body, {})
    assert angle(rotations.update(straight, 2 * FRAME_NS)[elbow], twisted) < 0.2  # 1/s over 67 ms of 1.6 rad
    rotations.update(nobody, 3 * FRAME_NS)
    later = rotations.update(straight, 3 * FRAME_NS + 600_000_000)[elbow]
    assert angle(later, np.array([0.0, 0.0, 0.0, 1.0])) < 1e-7


@pytest.mark.parametrize("body", BODIES.values(), ids=str)
def test_each_joint_shows_one_bone(body):
    shown = joint_bones(body)
    assert shown[body.root] == body.root
    assert shown[body.joint("ElbowLeft")] == body.joint("WristLeft")
    assert shown[body.joint("WristLeft")] == body.joint("HandLeft")
    assert shown[body.joint("AnkleRight")] == body.joint("FootRight")
    assert shown[body.joint("Head")] == body.joint("Head")
