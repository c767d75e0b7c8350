"""Depth images: lossless as RVL, thinned, and as points by the lens's model."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from devices.azure.mkv import MkvRecording
from devices.depth.camera import in_image, project, rays, turned
from devices.depth.image_thinning import (
    pair_has_images,
    pair_without_images,
    thinned,
    thinned_camera,
    with_depth,
)
from devices.depth.point_cloud import depth_to_points, ray_table
from devices.depth.rvl import decode_depth, encode_depth
from devices.depth.witness import depth_witness, with_witness
from devices.sensor import DeviceError, SensorFrame
from devices.simulated.imaging.rendering import halved
from devices.simulated.kinect import PERSON
from fusion.body import AZURE_KINECT, KINECT_V2
from fusion.intrinsics import NOMINAL_INTRINSICS, Intrinsics
from fusion.skeleton import Skeleton
from fusion.witness import REACH, SEEN_PAST
from tests.helpers.frame_pairs import frame_pairs
from tests.helpers.rendered_people import WIDE


def wall(height=576, width=640):
    """A slanted wall with 2 mm noise, a missing stripe and missing pixels."""
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:height, :width]
    depth = (1500 + 1.5 * x + y + rng.normal(0, 2, x.shape)).astype(np.uint16)
    depth[:, : width // 8] = 0
    depth[rng.random(depth.shape) < 0.02] = 0
    return depth


@given(
    arrays(np.uint16, array_shapes(min_dims=2, max_dims=2, max_side=40))
    | arrays(np.uint16, (20, 30), elements=st.sampled_from([0, 0, 1, 65535, 32768]))
)
def test_nothing_is_lost(depth):
    np.testing.assert_array_equal(decode_depth(encode_depth(depth)), depth)


def test_a_depth_image_shrinks_to_less_than_half():
    assert len(encode_depth(wall())) < 0.5 * wall().nbytes


@given(st.binary(max_size=400), st.integers(0, 399), st.integers(0, 255))
def test_bytes_that_are_no_image_are_refused(junk, at, value):
    blob = bytearray(encode_depth(wall(24, 32)))
    blob[at % len(blob)] = value
    nothing = encode_depth(np.ones((1, 1), np.uint16))[:-4] + b"\0\0\0\1"  # no zeros, one reading, which is 0
    for damaged in (encode_depth(wall(24, 32))[:-8], nothing):
        with pytest.raises(DeviceError, match="damaged"):
            decode_depth(damaged)
    for bad in (junk, bytes(blob), bytes(blob[: at // 4 * 4])):
        try:
            assert decode_depth(bad).dtype == np.uint16
        except DeviceError as error:
            assert "depth image" in str(error)  # noqa: PT017


LENS = Intrinsics(33, 26, 27.1, 26.9, 15.8, 12.3, (0.5, -2.6, 1e-4, -2e-4, 1.5, 0.4, -2.4, 1.4))


@pytest.mark.parametrize("depth", ["half", "full"])
def test_a_thinned_image_gives_the_points_of_the_pixels_that_are_kept(depth):
    image = np.random.default_rng(0).integers(500, 4000, (LENS.height, LENS.width)).astype(np.uint16)
    kept, camera = thinned(image, depth), thinned_camera(LENS, depth)
    assert kept.shape == (camera.height, camera.width)
    step = {"half": 2, "full": 1}[depth]
    expected = depth_to_points(image[::step, ::step], ray_table(LENS)[::step, ::step])
    # float32 rays, at 4 m
    np.testing.assert_allclose(depth_to_points(kept, ray_table(camera)), expected, atol=4 * 2.4e-7)


def test_a_pair_keeps_its_skeletons_whatever_becomes_of_its_images():
    (pair,) = frame_pairs(AZURE_KINECT, 1, depth=True)
    shapes = {}
    depths = ("none", "half", "full")
    for depth in depths:
        kept = with_depth(pair, depth)
        assert kept.skeletons == pair.skeletons
        shapes[depth] = None if kept.a.depth is None else kept.a.depth.shape
    assert shapes == {"none": None, "half": (12, 16), "full": (24, 32)}
    assert pair_has_images(pair)
    assert not pair_has_images(pair_without_images(pair))


IDEAL = Intrinsics(64, 48, 50.0, 50.0, 31.5, 23.5)


def _project(points, lens):
    """OpenCV's rational model, from its definition."""
    k1, k2, p1, p2, k3, k4, k5, k6 = lens.distortion
    x, y = points[:, 0] / points[:, 2], points[:, 1] / points[:, 2]
    r2 = x * x + y * y
    radial = (1 + k1 * r2 + k2 * r2**2 + k3 * r2**3) / (1 + k4 * r2 + k5 * r2**2 + k6 * r2**3)
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    v = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return np.stack((lens.fx * u + lens.cx, lens.fy * v + lens.cy), axis=-1)


def test_real_points_project_back_onto_their_pixels(shared):
    with MkvRecording(shared / "azure" / "recording.mkv") as recording:
        (frame,) = recording.frames()
        lens = recording.intrinsics
    points = depth_to_points(frame.depth, ray_table(lens)).astype(np.float64)
    rows, columns = np.nonzero(frame.depth)
    # float32 rays keep 24 bits: 1e-7 of 1.5 times a focal length of 505 pixels is below 1e-3 pixels.
    np.testing.assert_allclose(_project(points, lens), np.stack((columns, rows), -1), atol=1e-3)
    np.testing.assert_allclose(points[:, 2], frame.depth[rows, columns] / 1000, rtol=1e-6)


@given(degrees=st.floats(0.0, 62.0), way=st.floats(0.0, 2.0 * np.pi))
def test_rays_undo_the_lens_to_the_edge_of_a_wide_image(degrees, way):
    point = np.append(np.tan(np.radians(degrees)) * np.array((np.cos(way), np.sin(way))), 1.0)[None]
    pixel = project(WIDE, point)
    np.testing.assert_allclose(pixel, _project(point, WIDE), atol=1e-9)
    np.testing.assert_allclose(rays(WIDE, pixel), point[:, :2], atol=1e-4)


@given(degrees=st.floats(0.0, 62.0), way=st.floats(0.0, 2.0 * np.pi))
def test_a_turned_camera_images_turned_points_at_turned_pixels(degrees, way):
    lens = replace(WIDE, height=400, fy=250.0, cx=250.0, cy=190.0)
    point = np.array((*np.tan(np.radians(degrees)) * np.array((np.cos(way), np.sin(way))), 1.0))
    u, v = project(lens, point)
    clockwise = project(turned(lens), (-point[1], point[0], 1.0))
    np.testing.assert_allclose(clockwise, (lens.height - 1 - v, u), atol=1e-9)
    assert in_image(turned(lens), clockwise) == in_image(lens, np.array((u, v)))
    assert turned(turned(turned(turned(lens)))) == lens


def test_a_depth_image_of_another_mode_is_refused():
    with pytest.raises(DeviceError, match="ray table"):
        depth_to_points(np.zeros((24, 32), np.uint16), ray_table(IDEAL))


# --- Measurements in a depth image, against brute force on images with known surfaces.


NARROW = halved(NOMINAL_INTRINSICS["azure_kinect"])
BODY = KINECT_V2
WRIST = BODY.joint("WristLeft")


def skeleton_with(at):
    """Only the left wrist has a place."""
    positions = np.full((len(BODY), 3), np.nan)
    positions[WRIST] = at
    return Skeleton.of(BODY, positions)


def bar(left, right):
    """An upright bar 2 m away in front of a wall. Its edges are in metres to the right of the sensor."""
    columns = (np.arange(NARROW.width) - NARROW.cx) / NARROW.fx * 2.0
    image = np.full((NARROW.height, NARROW.width), 3500, dtype=np.uint16)
    image[:, (columns >= left) & (columns <= right)] = 2000
    return image


def brute_force(image, at):
    """The definitions of ``fusion.witness``, over all pixels of an image of LENS."""
    x, y, z = (float(np.float32(c)) for c in at)
    along = np.sqrt(x * x + y * y + z * z) / z
    u, v = NARROW.fx * x / z + NARROW.cx, NARROW.fy * y / z + NARROW.cy
    centre_u, centre_v = int(np.floor(u + 0.5)), int(np.floor(v + 0.5))
    rows, columns = np.indices(image.shape)
    read = image > 0
    gaps = (0.001 * image - z) * along
    near = read & (abs(columns - centre_u) <= 1) & (abs(rows - centre_v) <= 1)  # 12 mm are 1.5 pixels
    gap = np.sort(gaps[near])[near.sum() // 2]
    outside = gap > SEEN_PAST
    other = read & ((gaps < SEEN_PAST) == outside)
    pixels = np.hypot(columns - centre_u, rows - centre_v)[other]
    distance = min(float(pixels.min(initial=np.inf)) * z / NARROW.fx, REACH)
    disc = read & (np.hypot(columns - u, rows - v) <= 0.09 * NARROW.fx / z) & (abs(gaps - gap) <= 0.06)
    scale = z / NARROW.fx
    offset = (columns[disc] - u).mean() * scale, (rows[disc] - v).mean() * scale
    return gap, -distance if outside else distance, *offset


@pytest.mark.parametrize("x", [0.0, 0.02, -0.03, 0.055, -0.09, 0.3])
def test_a_bar_is_measured_as_by_brute_force(x):
    position = (x, 0.1, 2.02)
    image = bar(-0.04, 0.04)
    found = depth_witness(image, NARROW, skeleton_with(position))[WRIST]
    expected = brute_force(image, position)
    # float16 keeps 11 bits: half a millimetre of a metre; the kernel searches no farther than whole pixels
    pixel = 2.02 / NARROW.fx
    np.testing.assert_allclose(found[0], expected[0], rtol=1e-3)
    assert found[1] == pytest.approx(expected[1], abs=0.0005 if abs(expected[1]) < REACH - pixel else pixel)
    np.testing.assert_allclose(found[2:], expected[2:], atol=0.3 * pixel)  # which pixels the disc's rim has


def test_nothing_is_said_without_a_reading_a_place_or_an_image():
    image = bar(-0.04, 0.04)
    found = depth_witness(image, NARROW, skeleton_with((0.0, 0.0, 2.0)))
    assert np.isnan(found[np.arange(len(BODY)) != WRIST]).all()
    assert np.isnan(depth_witness(image, NARROW, skeleton_with((9.0, 0.0, 2.0)))).all()
    assert np.isnan(depth_witness(np.zeros_like(image), NARROW, skeleton_with((0.0, 0.0, 2.0)))).all()
    frame = SensorFrame(0, {PERSON: skeleton_with((0.0, 0.0, 2.0))})
    assert with_witness(frame, NARROW) is frame
    wrong_size = SensorFrame(0, frame.people, image[:10])
    assert with_witness(wrong_size, NARROW) is wrong_size
    seen = with_witness(SensorFrame(0, frame.people, image), NARROW).people[PERSON]
    assert seen.witness is not None
    assert with_witness(SensorFrame(0, {PERSON: seen}, image), NARROW).people[PERSON] is seen
