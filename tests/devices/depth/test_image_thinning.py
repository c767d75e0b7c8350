"""Thinned depth images: their size, and the values computed from them."""

from dataclasses import replace

import numpy as np
import pytest

from devices.depth.image_thinning import has_images, thinned, thinned_camera, with_depth, without_images
from devices.depth.point_cloud import depth_to_points, ray_table
from fusion.body import AZURE_KINECT
from fusion.intrinsics import Intrinsics
from tests.helpers.frame_pairs import frame_pairs

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
    assert has_images(pair)
    assert not has_images(without_images(pair))


def test_infrared_goes_with_the_depth_image_of_the_same_pixels():
    (pair,) = frame_pairs(AZURE_KINECT, 1, depth=True)
    pair = replace(pair, a=replace(pair.a, ir=np.arange(24 * 32, dtype=np.uint16).reshape(24, 32)))
    half, none, bare = with_depth(pair, "half"), with_depth(pair, "none"), without_images(pair)
    assert half.a.ir.shape == half.a.depth.shape
    assert half.a.ir[1, 1] == 2 * 32 + 2
    for kept in (none, bare):
        assert kept.a.ir is None
