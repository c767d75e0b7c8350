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
from devices.sensor import DeviceError
from fusion.body import AZURE_KINECT
from fusion.intrinsics import Intrinsics
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


def test_infrared_goes_with_the_depth_image_of_the_same_pixels():
    (pair,) = frame_pairs(AZURE_KINECT, 1, depth=True)
    pair = replace(pair, a=replace(pair.a, ir=np.arange(24 * 32, dtype=np.uint16).reshape(24, 32)))
    half, none, bare = with_depth(pair, "half"), with_depth(pair, "none"), pair_without_images(pair)
    assert half.a.ir.shape == half.a.depth.shape
    assert half.a.ir[1, 1] == 2 * 32 + 2
    for kept in (none, bare):
        assert kept.a.ir is None


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


def test_a_pixel_right_and_below_the_centre_is_right_and_below():
    depth = np.zeros((48, 64), np.uint16)
    depth[40, 60] = 2000
    (point,) = depth_to_points(depth, ray_table(IDEAL))
    np.testing.assert_allclose(point, [2 * (60 - 31.5) / 50, 2 * (40 - 23.5) / 50, 2.0], rtol=1e-6)


def test_pixels_outside_the_lens_model_give_no_point():
    # With this k1 no ray reaches beyond r(1 - 0.5 r²) = 0.544, but the image's corner is at 0.78.
    lens = Intrinsics(64, 48, 50.0, 50.0, 31.5, 23.5, (-0.5, 0.0, 0.0, 0.0))
    table = ray_table(lens)
    assert np.isnan(table[0, 0]).all()
    assert np.isfinite(table[23, 31]).all()
    points = depth_to_points(np.full((48, 64), 1000, np.uint16), table)
    assert len(points) == np.isfinite(table[..., 0]).sum() < 48 * 64
    assert np.isfinite(points).all()


def test_a_depth_image_of_another_mode_is_refused():
    with pytest.raises(DeviceError, match="ray table"):
        depth_to_points(np.zeros((24, 32), np.uint16), ray_table(IDEAL))
