"""The capsules of S*: from each joint to its parent, at every body."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fusion.body import BODIES, KINECT_V2
from recordings.appearance.body_shape import (
    bone_vectors,
    capsule_lengths,
    capsule_rotations,
    pelvis_rotations,
)
from tests.helpers.two_views import standing

STEP = 1.0 / 256.0
"""Of the stored values; each is off by half of it at most."""


@pytest.fixture
def poses():
    """(200, J, 3): joints anywhere, so that bones point anywhere."""
    return np.random.default_rng(0).normal(size=(200, len(KINECT_V2), 3))


def test_a_rotation_turns_the_z_axis_towards_the_parent(poses):
    rotations = capsule_rotations(KINECT_V2, poses)
    child = KINECT_V2.bone_joints
    bones = poses[:, KINECT_V2.parent_indices[child]] - poses[:, child]
    bones /= np.linalg.norm(bones, axis=2, keepdims=True)
    turned = Rotation.from_quat(rotations[:, child].reshape(-1, 4)).apply([0.0, 0.0, 1.0])
    # a quaternion off by √3 · STEP / 2 turns by twice that; −z is replaced within 0.8°
    off = np.arccos(np.clip((turned * bones.reshape(-1, 3)).sum(axis=1), -1.0, 1.0))
    assert off.max() <= 2.0 * np.sqrt(3.0) * STEP / 2.0 + 0.015


def test_straight_down_the_axis_is_turned_round():
    poses = np.zeros((1, len(KINECT_V2), 3))
    poses[0, KINECT_V2.root] = (0.0, 0.0, -1.0)
    child = KINECT_V2.joint("hip left")
    rotation = Rotation.from_quat(capsule_rotations(KINECT_V2, poses)[0, child])
    np.testing.assert_allclose(rotation.apply([0.0, 0.0, 1.0]), [0.0, 0.0, -1.0], atol=1e-6)


def test_a_missing_joint_gets_finite_values():
    poses = np.full((2, len(KINECT_V2), 3), np.nan)
    assert np.isfinite(capsule_rotations(KINECT_V2, poses)).all()
    assert np.isfinite(bone_vectors(KINECT_V2, poses)).all()
    np.testing.assert_array_equal(pelvis_rotations(KINECT_V2, poses), [np.eye(3)] * 2)


def test_vectors_lead_to_the_parent(poses):
    reached = poses + bone_vectors(KINECT_V2, poses)
    child = KINECT_V2.bone_joints
    parents = poses[:, KINECT_V2.parent_indices[child]]
    np.testing.assert_allclose(reached[:, child], parents, rtol=0, atol=0.51 * STEP)


@pytest.mark.parametrize("body", BODIES.values(), ids=lambda body: body.name)
def test_capsules_have_the_lengths_of_their_bones_except_head_and_face(body):
    lengths = capsule_lengths(body, body.nominal_lengths)
    face = [j for j, bone in enumerate(body.bones) if bone.split("_")[0] in ("nose", "eye", "ear")]
    assert (lengths[face] == 0.0).all()
    assert lengths[body.root] == 0.0
    head = body.joint("head")
    assert 0.0 < lengths[head] < body.nominal_lengths[head]
    others = np.delete(np.arange(len(body)), [*face, head])
    np.testing.assert_allclose(lengths[others], body.nominal_lengths[others], rtol=1e-6)


def test_the_pelvis_frame_has_x_to_the_right_and_z_forward():
    """The standing person is turned 45° from K_A: their front is half-way between −z and −x."""
    frame = pelvis_rotations(KINECT_V2, standing(KINECT_V2)[None])[0]
    c = np.sqrt(0.5)
    np.testing.assert_allclose(frame, [[-c, 0.0, -c], [0.0, 1.0, 0.0], [c, 0.0, -c]], atol=STEP)
