"""Tests of eqs. (10), (11)."""

import numpy as np
import pytest

from fusion.body import BODIES, KINECT_V2
from fusion.paper.reliability import ViewPixels, weigh_views
from fusion.setup import PAPER_H


def by_the_paper(pixels_a, pixels_b, states_a, states_b, linked, h):
    """A direct implementation of sec. 3, one joint at a time."""
    joints = range(len(pixels_a))
    has_a = [bool(np.isfinite(pixels_a[i]).all()) for i in joints]
    has_b = [bool(np.isfinite(pixels_b[i]).all()) for i in joints]
    result = []
    for i in joints:
        if not (has_a[i] and has_b[i]):
            result.append((float(has_a[i]), float(has_b[i]), -1))
            continue
        in_a = {j: np.linalg.norm(pixels_a[i] - pixels_a[j]) for j in joints if has_a[j] and has_b[j]}
        in_b = {j: np.linalg.norm(pixels_b[i] - pixels_b[j]) for j in in_a}
        candidates = [j for j in in_a if not linked[i, j]]
        basic_a = basic_b = 0.5
        m = -1
        if candidates:
            j, k = min(candidates, key=in_a.__getitem__), min(candidates, key=in_b.__getitem__)
            m = j if in_a[j] < in_b[k] else k
            if in_a[m] + in_b[m] > 0:
                basic_a, basic_b = in_a[m] / (in_a[m] + in_b[m]), in_b[m] / (in_a[m] + in_b[m])
        h_a, h_b = (h if states_a[i] == 2 else 1 - h), (h if states_b[i] == 2 else 1 - h)
        power_a, power_b = (h_a * basic_a) ** 4, (h_b * basic_b) ** 4
        result.append((power_a / (power_a + power_b), power_b / (power_a + power_b), m))
    return tuple(np.array(column) for column in zip(*result, strict=True))


def reliability_weights(pixels_a, pixels_b, states_a, states_b, linked, h=PAPER_H):
    joints = len(pixels_a)
    weights_a, weights_b, misleading = np.empty(joints), np.empty(joints), np.empty(joints, dtype=np.int64)
    views = ViewPixels(pixels_a, pixels_b, states_a, states_b, np.empty(joints, dtype=np.bool_))
    weigh_views(views, linked, h, weights_a, weights_b, misleading)
    return weights_a, weights_b, misleading


def random_views(rng, body):
    pixels_a, pixels_b = rng.uniform(0, 500, (2, len(body), 2))
    states_a, states_b = rng.choice([1, 2], (2, len(body)), p=[0.3, 0.7]).astype(np.uint8)
    for pixels, states in ((pixels_a, states_a), (pixels_b, states_b)):
        hole = rng.random(len(body)) < rng.choice([0.0, 0.2, 0.9])
        pixels[hole], states[hole] = np.nan, 0
    return pixels_a, pixels_b, states_a, states_b, body.linked.copy()


@pytest.mark.parametrize("body", BODIES.values(), ids=BODIES)
def test_weights_are_those_of_the_paper_word_by_word(body):
    rng = np.random.default_rng(0)
    for _ in range(60):
        views = random_views(rng, body)
        h = rng.uniform(0.5, 1.0)
        weights_a, weights_b, misleading = reliability_weights(*views, h)
        expected_a, expected_b, expected_misleading = by_the_paper(*views, h)
        np.testing.assert_allclose(weights_a, expected_a, rtol=0, atol=1e-12)
        np.testing.assert_allclose(weights_b, expected_b, rtol=0, atol=1e-12)
        np.testing.assert_array_equal(misleading, expected_misleading)


def test_a_joint_hidden_behind_another_in_one_view_is_taken_from_the_other():
    rng = np.random.default_rng(2)
    pixels_a, pixels_b = rng.uniform(0, 500, (2, len(KINECT_V2), 2))
    elbow, hip = KINECT_V2.joint("ElbowLeft"), KINECT_V2.joint("HipLeft")
    pixels_a[elbow] = pixels_a[hip] + 0.5
    tracked = np.full(len(KINECT_V2), 2, np.uint8)
    weights_a, weights_b, misleading = reliability_weights(
        pixels_a, pixels_b, tracked, tracked, KINECT_V2.linked.copy()
    )
    assert misleading[elbow] == hip
    assert weights_a[elbow] < 1e-4
    assert weights_b[elbow] > 1 - 1e-4


def test_joints_on_one_spot_in_both_views_share_equally():
    pixels = np.full((len(KINECT_V2), 2), 100.0)
    tracked = np.full(len(KINECT_V2), 2, np.uint8)
    weights_a, weights_b, _ = reliability_weights(pixels, pixels, tracked, tracked, KINECT_V2.linked.copy())
    np.testing.assert_array_equal(weights_a, 0.5)
    np.testing.assert_array_equal(weights_b, 0.5)
