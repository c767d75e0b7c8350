"""Measurements in a depth image, against brute force on images with known surfaces."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from devices.depth.witness import depth_witness, with_witness
from devices.sensor import SensorFrame
from devices.simulated.imaging.rendering import halved
from devices.simulated.kinect import PERSON
from fusion.body import KINECT_V2
from fusion.errors import FusionError
from fusion.intrinsics import NOMINAL_INTRINSICS, Intrinsics
from fusion.skeleton import Skeleton
from fusion.witness import REACH, SEEN_PAST

LENS = halved(NOMINAL_INTRINSICS["azure_kinect"])
BODY = KINECT_V2
WRIST = BODY.joint("WristLeft")


def skeleton_with(at):
    """Only the left wrist has a place."""
    positions = np.full((len(BODY), 3), np.nan)
    positions[WRIST] = at
    return Skeleton.of(BODY, positions)


def bar(left, right):
    """An upright bar 2 m away in front of a wall. Its edges are in metres to the right of the sensor."""
    columns = (np.arange(LENS.width) - LENS.cx) / LENS.fx * 2.0
    image = np.full((LENS.height, LENS.width), 3500, dtype=np.uint16)
    image[:, (columns >= left) & (columns <= right)] = 2000
    return image


def brute_force(image, at):
    """The definitions of ``fusion.witness``, over all pixels of an image of LENS."""
    x, y, z = (float(np.float32(c)) for c in at)
    along = np.sqrt(x * x + y * y + z * z) / z
    u, v = LENS.fx * x / z + LENS.cx, LENS.fy * y / z + LENS.cy
    centre_u, centre_v = int(np.floor(u + 0.5)), int(np.floor(v + 0.5))
    rows, columns = np.indices(image.shape)
    read = image > 0
    gaps = (0.001 * image - z) * along
    near = read & (abs(columns - centre_u) <= 1) & (abs(rows - centre_v) <= 1)  # 12 mm are 1.5 pixels
    gap = np.sort(gaps[near])[near.sum() // 2]
    outside = gap > SEEN_PAST
    other = read & ((gaps < SEEN_PAST) == outside)
    pixels = np.hypot(columns - centre_u, rows - centre_v)[other]
    distance = min(float(pixels.min(initial=np.inf)) * z / LENS.fx, REACH)
    disc = read & (np.hypot(columns - u, rows - v) <= 0.09 * LENS.fx / z) & (abs(gaps - gap) <= 0.06)
    scale = z / LENS.fx
    offset = (columns[disc] - u).mean() * scale, (rows[disc] - v).mean() * scale
    return gap, -distance if outside else distance, *offset


@pytest.mark.parametrize("x", [0.0, 0.02, -0.03, 0.055, -0.09, 0.3])
def test_a_bar_is_measured_as_by_brute_force(x):
    position = (x, 0.1, 2.02)
    image = bar(-0.04, 0.04)
    found = depth_witness(image, LENS, skeleton_with(position))[WRIST]
    expected = brute_force(image, position)
    # float16 keeps 11 bits: half a millimetre of a metre; the kernel searches no farther than whole pixels
    pixel = 2.02 / LENS.fx
    np.testing.assert_allclose(found[0], expected[0], rtol=1e-3)
    assert found[1] == pytest.approx(expected[1], abs=0.0005 if abs(expected[1]) < REACH - pixel else pixel)
    np.testing.assert_allclose(found[2:], expected[2:], atol=0.3 * pixel)  # which pixels the disc's rim has


def test_in_the_middle_of_a_limb_and_beside_it():
    pixel = 2.03 / LENS.fx
    gap, edge, x, y = depth_witness(bar(-0.04, 0.04), LENS, skeleton_with((0.0, 0.0, 2.03)))[WRIST]
    assert gap == pytest.approx(-0.03, abs=1e-4)
    assert edge == pytest.approx(0.04, abs=pixel)
    assert (x, y) == pytest.approx((0.0, 0.0), abs=0.5 * pixel)
    gap, edge, _, _ = depth_witness(bar(-0.04, 0.04), LENS, skeleton_with((0.10, 0.0, 2.0)))[WRIST]
    assert (gap, edge) == pytest.approx((1.5, -0.06), rel=0.01, abs=pixel)


def test_nothing_is_said_without_a_reading_a_place_or_an_image():
    image = bar(-0.04, 0.04)
    found = depth_witness(image, LENS, skeleton_with((0.0, 0.0, 2.0)))
    assert np.isnan(found[np.arange(len(BODY)) != WRIST]).all()
    assert np.isnan(depth_witness(image, LENS, skeleton_with((9.0, 0.0, 2.0)))).all()
    assert np.isnan(depth_witness(np.zeros_like(image), LENS, skeleton_with((0.0, 0.0, 2.0)))).all()
    frame = SensorFrame(0, {PERSON: skeleton_with((0.0, 0.0, 2.0))})
    assert with_witness(frame, LENS) is frame
    wrong_size = SensorFrame(0, frame.people, image[:10])
    assert with_witness(wrong_size, LENS) is wrong_size
    seen = with_witness(SensorFrame(0, frame.people, image), LENS).people[PERSON]
    assert seen.witness is not None
    assert with_witness(SensorFrame(0, {PERSON: seen}, image), LENS).people[PERSON] is seen


def test_the_lens_is_opencvs():
    """Each column has its own depth, so that the gap tells which pixel was read."""
    lens = Intrinsics(640, 576, 504.0, 505.0, 320.5, 330.5, (0.5, -0.3, 3e-4, -2e-4, 0.01, 0.8, -0.2, 0.05))
    position = np.array([[0.7, -0.5, 1.9]])
    camera = np.array([[lens.fx, 0, lens.cx], [0, lens.fy, lens.cy], [0, 0, 1.0]])
    pixel, _ = cv2.projectPoints(position, np.zeros(3), np.zeros(3), camera, np.array(lens.distortion))
    u, v = np.round(pixel.reshape(2))
    along = np.linalg.norm(position) / position[0, 2]
    for axis, expected in ((1, u), (0, v)):
        image = (1500 + np.indices((lens.height, lens.width))[axis]).astype(np.uint16)
        gap = depth_witness(image, lens, skeleton_with(tuple(position[0])))[WRIST, 0]
        assert (gap / along + position[0, 2]) * 1e3 - 1500 == pytest.approx(expected, abs=0.3)  # float16


def test_a_witness_has_four_numbers_a_joint():
    skeleton = skeleton_with((0.0, 0.0, 2.0))
    with pytest.raises(FusionError, match=r"kinect_v2 has 25 joints; an array of them has shape \(25, 2\)"):
        skeleton.with_witness(np.zeros((25, 2), dtype=np.float32))
    assert replace(skeleton, witness=None).witness is None
