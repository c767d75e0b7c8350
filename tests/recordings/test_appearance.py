"""The capsules of S*, colours that people with red-green colour blindness tell apart, and the floor."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from skimage.color import deltaE_ciede2000, rgb2lab

from fusion.body import BODIES, KINECT_V2
from fusion.rigid import RigidTransform
from recordings.appearance.body_shape import (
    bone_vectors,
    capsule_lengths,
    capsule_rotations,
    nose_vectors,
    pelvis_rotations,
)
from recordings.appearance.colors import (
    MARK_COLORS,
    PREDICTED_COLOR,
    SIDE_COLORS,
    SKELETON_COLORS,
    STATE_COLORS,
    VIEW_COLORS,
)
from recordings.appearance.floor import ANKLE, CAMERA_HEIGHT, FloorFinder, find_floor, floor_frame
from tests.helpers.pictures import contrast, linear
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


def test_pelvis_and_nose_point_forward():
    """The standing person is turned 45° from K_A: their front is half-way between −z and −x."""
    frame = pelvis_rotations(KINECT_V2, standing(KINECT_V2)[None])[0]
    c = np.sqrt(0.5)
    np.testing.assert_allclose(frame, [[-c, 0.0, -c], [0.0, 1.0, 0.0], [c, 0.0, -c]], atol=STEP)
    for body in BODIES.values():
        (nose,) = nose_vectors(body, standing(body)[None])[0]
        np.testing.assert_allclose(nose, 0.15 * np.array([-c, 0.0, -c]), atol=0.02)  # the neck may lean by 8°


PROTAN = (0.152286, 1.052583, -0.204868), (0.114503, 0.786281, 0.099216), (-0.003882, -0.048116, 1.051998)
DEUTAN = (0.367322, 0.860646, -0.227968), (0.280085, 0.672501, 0.047413), (-0.011820, 0.042940, 0.968881)
VISION = np.eye(3), np.array(PROTAN), np.array(DEUTAN)
"""Linear RGB as seen without colour blindness, with protanopia and with deuteranopia: Machado et al. 2009."""
BODY = {**{key: SKELETON_COLORS[key] for key in ("a", "b", "fused")}, "predicted": PREDICTED_COLOR}
DARK, LIGHT = (13, 16, 17), (255, 255, 255)
"""Backgrounds of the viewer's themes and of the page."""


def least_distance(first, second):
    """CIEDE2000 between two colours, the least of all kinds of colour vision."""
    found = []
    for matrix in VISION:
        seen = [np.clip(matrix @ linear(each), 0.0, 1.0) for each in (first, second)]
        srgb = [np.where(rgb <= 0.0031308, 12.92 * rgb, 1.055 * rgb ** (1 / 2.4) - 0.055) for rgb in seen]
        found.append(float(deltaE_ciede2000(*(rgb2lab(rgb) for rgb in srgb))))
    return min(found)


@pytest.mark.parametrize(
    "colors",
    [{"truth": SKELETON_COLORS["truth"], **BODY}, MARK_COLORS, dict(enumerate(STATE_COLORS)), SIDE_COLORS],
    ids=["body and truth", "marks", "states", "sides"],
)
def test_colors_that_stand_side_by_side_differ_for_everyone(colors):
    for one, other in itertools.combinations(colors, 2):
        assert least_distance(colors[one], colors[other]) > 20.0, (one, other)


@pytest.mark.parametrize("side", "ab")
def test_an_exchanged_view_differs_from_its_own_and_from_the_other(side):
    for exchanged in (VIEW_COLORS[side][2], SKELETON_COLORS[f"exchanged_{side}"]):
        assert all(least_distance(exchanged, VIEW_COLORS[other][0]) > 12.0 for other in "ab")


@pytest.mark.parametrize("name", MARK_COLORS)
def test_a_mark_differs_from_the_body(name):
    assert all(least_distance(MARK_COLORS[name], color) > 10.0 for color in BODY.values())


@pytest.mark.parametrize("name", [*BODY, *SIDE_COLORS])
def test_a_color_is_seen_on_dark_and_on_light(name):
    color = {**BODY, **SIDE_COLORS}[name]
    assert contrast(color, DARK) > 3.0
    assert contrast(color, LIGHT) > 2.0


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


@given(roll=st.floats(-180.0, 180.0), tilt=st.floats(-75.0, 75.0))
def test_the_floor_of_a_rolled_sensor_lies_as_that_of_one_that_stands(roll, tilt):
    turn = Rotation.from_euler("z", roll, degrees=True).as_matrix()
    fused, _ = seen_by(tilt)
    rolled = RigidTransform.of(turn, np.zeros(3)).apply(fused)
    upright, found = find_floor(KINECT_V2, fused), find_floor(KINECT_V2, rolled)
    # heights are rounded to centimetres
    np.testing.assert_allclose(found.inverse().apply(rolled), upright.inverse().apply(fused), atol=0.0101)
    assert found.rotation[2, 2] > 0.0  # z is where the sensor looks


@pytest.mark.parametrize("up", [(0.0, 0.0, 1.0), (0.0, 0.0, -1.0), (0.0, 0.02, -0.9998)])
def test_a_sensor_that_looks_straight_down_or_up_has_a_floor(up):
    up = np.array(up) / np.linalg.norm(up)
    floor = floor_frame(up, 2.0)
    np.testing.assert_allclose(floor.rotation.T @ floor.rotation, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(floor.rotation[:, 1], -up, atol=1e-12)


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
