"""Depth images as points: against the lens's model written out, and an ideal lens by hand."""

import numpy as np
import pytest

from devices.azure.mkv import MkvRecording
from devices.depth.point_cloud import depth_to_points, ray_table
from devices.sensor import DeviceError
from fusion.intrinsics import Intrinsics

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


def test_a_pixel_right_and_below_the_centre_is_right_and_below():
    depth = np.zeros((48, 64), np.uint16)
    depth[40, 60] = 2000
    (point,) = depth_to_points(depth, ray_table(IDEAL))
    np.testing.assert_allclose(point, [2 * (60 - 31.5) / 50, 2 * (40 - 23.5) / 50, 2.0], rtol=1e-6)


def test_pixels_outside_the_lens_model_give_no_point():
    # With this k1 no ray reaches beyond r(1 - 0.5 r²) = 0.544, but the image's corner is at 0.78.
    lens = Intrinsics(64, 48, 50.0, 50.0, 31.5, 23.5, (-0.5, 0.0, 0.0, 0.0))
    rays = ray_table(lens)
    assert np.isnan(rays[0, 0]).all()
    assert np.isfinite(rays[23, 31]).all()
    points = depth_to_points(np.full((48, 64), 1000, np.uint16), rays)
    assert len(points) == np.isfinite(rays[..., 0]).sum() < 48 * 64
    assert np.isfinite(points).all()


def test_a_depth_image_of_another_mode_is_refused():
    with pytest.raises(DeviceError, match="ray table"):
        depth_to_points(np.zeros((24, 32), np.uint16), ray_table(IDEAL))
