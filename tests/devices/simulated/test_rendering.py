"""Claims about the simulated depth images and what is seen in them."""

import numpy as np
import pytest

from devices.depth.camera import project
from devices.simulated.imaging.body_surface import capsules, flesh_over, visibility
from devices.simulated.imaging.infrared import (
    REFLECTANCE,
    InfraredModel,
    Material,
    clothed_capsules,
    infrared_image,
)
from devices.simulated.imaging.rendering import (
    FLOOR,
    NOTHING,
    WALL,
    WALL_Z,
    DepthErrors,
    depth_image,
    halved,
    surface,
)
from devices.simulated.person import anatomy
from devices.simulated.person.movements import MOTIONS
from devices.simulated.rig import Rig
from fusion.body import AZURE_KINECT
from fusion.intrinsics import NOMINAL_INTRINSICS
from fusion.rigid import RigidTransform

LENS = NOMINAL_INTRINSICS["azure_kinect"]
HALF = halved(LENS)
# The world's floor and wall out of sight: far below and far behind.
NOWHERE = RigidTransform.of(np.eye(3), (0.0, 1000.0, 1000.0))
# float32 holds 3 m to 3 × 2⁻²⁴ × 2 m; a few operations on it.
FLOAT32 = 1e-6


def rays():
    v, u = np.mgrid[: HALF.height, : HALF.width]
    return np.stack(((u - HALF.cx) / HALF.fx, (v - HALF.cy) / HALF.fy, np.ones(u.shape)), axis=-1)


@pytest.mark.parametrize("end", [(0.4, 0.3, 2.2), (-0.1, 0.5, 3.1), (0.01, 0.0, 2.0)])
def test_a_capsule_has_its_surface_at_its_radius_from_its_axis(end):
    start, stop, radius = np.array((-0.3, -0.2, 2.6)), np.array(end), 0.12
    z, label, cosine = surface(np.array([(*start, *stop, radius)]), NOWHERE, HALF)
    hit = label == 0
    assert hit.sum() > 300
    points = rays()[hit] * z[hit, None]
    share = np.clip((points - start) @ (stop - start) / np.sum((stop - start) ** 2), 0.0, 1.0)
    off = points - start - share[:, None] * (stop - start)
    np.testing.assert_allclose(np.linalg.norm(off, axis=1), radius, atol=4 * FLOAT32)
    # The side that faces the sensor, not the far one.
    normal_to_ray = -np.sum(off * points, axis=1) / radius / np.linalg.norm(points, axis=1)
    np.testing.assert_allclose(normal_to_ray, cosine[hit], atol=1e-4)
    # No ray passes through the capsule without a hit (sampled along the rays).
    for step in np.linspace(1.8, 3.4, 60):
        landmarks = rays() * step
        share = np.clip((landmarks - start) @ (stop - start) / np.sum((stop - start) ** 2), 0.0, 1.0)
        deep = np.linalg.norm(landmarks - start - share[..., None] * (stop - start), axis=-1) < radius - 1e-6
        assert hit[deep].all()


def test_floor_and_wall_are_where_the_world_has_them():
    rig = Rig()
    sensor_from_world = rig.world_from_sensor(0).inverse()
    z, label, _ = surface(np.zeros((0, 7)), sensor_from_world, HALF)
    seen = np.isfinite(z)
    assert np.isin(label[seen], (FLOOR, WALL)).all()
    assert (label[~seen] == NOTHING).all()
    world = rig.world_from_sensor(0).apply(rays()[seen] * z[seen, None])
    floor = np.abs(world[:, 1])
    wall = np.abs(world[:, 2] - WALL_Z)
    near = np.minimum(floor, wall) < 1e-5 * np.maximum(1.0, z[seen])
    assert near.all()
    assert (floor < 1e-4).any()
    assert (wall < 1e-4).any()
    assert ((floor < wall) == (label[seen] == FLOOR))[np.abs(floor - wall) > 1e-3].all()
    assert (world[:, 1] < 1e-3).all()
    assert (world[:, 2] < WALL_Z + 1e-3).all()


def test_a_perfect_depth_image_is_the_surface_to_the_millimetre():
    z = np.linspace(0.5, 5.0, 320 * 288, dtype=np.float32).reshape(288, 320)
    image = depth_image(z, np.ones_like(z), DepthErrors.none(), np.random.default_rng(0))
    np.testing.assert_allclose(image * 1e-3, z, atol=0.0005 + FLOAT32)


def test_the_same_point_is_in_the_same_place_of_the_halved_image():
    # Pixel centres: the first half pixel covers full pixels 0 and 1, centre 0.5.
    point = np.array((0.2, -0.1, 2.0))
    full, half = project(LENS, point), project(HALF, point)
    np.testing.assert_allclose(full, 2.0 * half + 0.5, atol=1e-12)


@pytest.mark.parametrize(
    ("name", "time", "which"), [("arms", 6.9, 0), ("arms", 12.4, 1), ("walk", 8.6, 1), ("sit", 8.0, 0)]
)
def test_visibility_without_an_image_agrees_with_the_depth_image(name, time, which):
    sensor_from_world = Rig().world_from_sensor(which).inverse()
    points = sensor_from_world.apply(MOTIONS[name].landmarks(time)[0])
    shapes, joints = capsules(points), points[anatomy.landmarks_of(AZURE_KINECT)]
    flesh = flesh_over(AZURE_KINECT)
    seen = visibility(joints, shapes, flesh, LENS)
    z, _, _ = surface(shapes, sensor_from_world, LENS)
    u, v = np.rint(project(LENS, joints)).astype(int).T
    before = joints[:, 2] - z[v, u]
    # Fully seen or fully hidden joints: the surface before them is their own skin, or is not. Half a pixel
    # beside the joint the surface may be another; the slack is the slope of a sphere of their flesh.
    slack = 1.4 * flesh + 0.03
    assert (before[seen == 1.0] < slack[seen == 1.0] + 0.03).all()
    assert (before[seen == 0.0] > slack[seen == 0.0] - 0.03).all()
    assert (seen < 0.5).any()
    assert (seen == 1.0).sum() > 15


def seen_from_in_front(marks):
    """Share of each joint that is seen of a person with these landmarks in the world."""
    points = Rig(angle_deg=0.0).world_from_sensor(0).inverse().apply(marks)
    joints = points[anatomy.landmarks_of(AZURE_KINECT)]
    seen = visibility(joints, capsules(points), flesh_over(AZURE_KINECT), LENS)
    return dict(zip(AZURE_KINECT.joints, seen, strict=True))


def test_hands_behind_the_back_are_hidden_from_the_front_and_the_nose_from_behind():
    arms = MOTIONS["arms"]
    marks = arms.landmarks(arms.begins + 8.7)[0]
    front = seen_from_in_front(marks)
    assert max(front["HAND_LEFT"], front["HAND_RIGHT"]) == 0.0
    assert min(front["NOSE"], front["KNEE_LEFT"], front["SPINE_CHEST"], front["ELBOW_LEFT"]) > 0.6
    behind = seen_from_in_front(marks * (-1.0, 1.0, -1.0))  # half a turn about the vertical
    assert max(behind["NOSE"], behind["EYE_LEFT"]) == 0.0
    assert min(behind["HAND_LEFT"], behind["HAND_RIGHT"]) > 0.4


def test_all_joints_are_seen_from_in_front_and_none_outside_the_image():
    marks = MOTIONS["startup"].landmarks(1.0)[0]
    assert min(seen_from_in_front(marks).values()) > 0.5
    assert not any(seen_from_in_front(marks + (5.0, 0.0, 0.0)).values())


# --- Claims about the simulated infrared images and the dressed person in them.


SILENT = InfraredModel(read_noise=0.0, shot_noise=0.0)
NO_CAPSULES = np.zeros(0, np.int8)


def exposed(z, cosine, label, model=SILENT):
    """An image of one surface that fills the view."""
    size = (LENS.height, LENS.width)
    surface = np.full(size, z, np.float32), np.full(size, label, np.int8), np.full(size, cosine, np.float32)
    return infrared_image(*surface, NO_CAPSULES, model.illumination(LENS), model, np.random.default_rng(0))


def test_brightness_follows_from_material_distance_angle_and_place_in_the_image():
    middle = round(LENS.cy), round(LENS.cx)
    gain, wall = SILENT.gain, float(REFLECTANCE[Material.WALL])
    # Rounding to whole counts; the middle pixel is half a pixel off the axis.
    assert exposed(1.0, 1.0, WALL)[middle] == pytest.approx(gain * wall, abs=0.6)
    assert exposed(2.0, 1.0, WALL)[middle] == pytest.approx(gain * wall / 4.0, abs=0.6)
    assert exposed(2.0, 0.5, WALL)[middle] == pytest.approx(gain * wall / 8.0, abs=0.6)
    floor = float(REFLECTANCE[Material.FLOOR])
    assert exposed(2.0, 1.0, FLOOR)[middle] == pytest.approx(gain * floor / 4.0, abs=0.6)
    assert not exposed(2.0, 1.0, NOTHING).any()
    # A corner is farther away than z, and the illuminator is weaker there.
    x, y = -LENS.cx / LENS.fx, -LENS.cy / LENS.fy
    cosine = 1.0 / np.sqrt(1.0 + x * x + y * y)
    corner = gain * wall * cosine**2 * cosine**SILENT.vignetting
    assert exposed(1.0, 1.0, WALL)[0, 0] == pytest.approx(corner, abs=0.6)


@pytest.mark.parametrize(
    ("name", "time", "which"), [("startup", 1.0, 0), ("arms", 6.9, 1), ("walk", 8.6, 0), ("sit", 8.0, 1)]
)
def test_the_dressed_surface_lies_about_the_plain_one(name, time, which):
    """Depth differs by clothes and fingers only: the tracker's errors were fitted to the plain surface."""
    sensor_from_world = Rig().world_from_sensor(which).inverse()
    marks = sensor_from_world.apply(MOTIONS[name].landmarks(time)[0])
    plain, plain_label, _ = surface(capsules(marks), sensor_from_world, HALF)
    dressed, dressed_label, _ = surface(clothed_capsules(marks), sensor_from_world, HALF)
    both = (plain_label >= 0) & (dressed_label >= 0)
    assert both.sum() > 0.9 * (plain_label >= 0).sum()
    # Sleeves and trousers are at most 15 mm thicker than the limb in them.
    assert np.percentile(np.abs(plain - dressed)[both], 90) < 0.020
