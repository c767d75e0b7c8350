"""Bones at the lengths that a person has shown, on made-up bodies."""

import numpy as np
import pytest

from devices.blazepose.landmark_kinds import INDEX, LANDMARK_NAMES, LONG_BONES
from devices.blazepose.limbs import LimbLengths, with_lengths
from tests.devices.blazepose.test_lifting import body

SHOULDER, ELBOW, WRIST, HAND = (INDEX[f"{name}_LEFT"] for name in ("SHOULDER", "ELBOW", "WRIST", "INDEX"))
ALL = np.ones(len(LANDMARK_NAMES), dtype=bool)


def lengths_of(points):
    return np.linalg.norm(points[LONG_BONES[:, 1]] - points[LONG_BONES[:, 0]], axis=1)


def rays_of(points):
    return points[:, :2] / points[:, 2:]


def unseen(*landmarks):
    seen = ALL.copy()
    seen[list(landmarks)] = False
    return seen


def pointing(length=0.3):
    """The body with its left arm stretched towards the camera."""
    points = body()
    sight = points[SHOULDER] / np.linalg.norm(points[SHOULDER])
    points[ELBOW] = points[SHOULDER] - length * sight
    points[WRIST] = points[ELBOW] - 0.25 * sight
    points[HAND] = points[WRIST] - 0.08 * sight
    return points


def test_a_length_is_that_seen_from_the_side_on_either_side_of_the_body():
    side, known = body(), LimbLengths()
    for _ in range(4):
        known.observe(side, ALL)
    folded = pointing(0.1)
    for _ in range(40):  # an arm that points at the camera says little of its length
        known.observe(folded, unseen(INDEX["SHOULDER_RIGHT"]))
    np.testing.assert_allclose(known.lengths(), lengths_of(side), rtol=1e-6)


def test_too_few_or_hidden_bones_give_no_length():
    points, known = body(), LimbLengths()
    known.observe(points, ALL)
    assert np.isnan(known.lengths()).all()
    for _ in range(20):
        known.observe(points, unseen(INDEX["KNEE_LEFT"], INDEX["KNEE_RIGHT"]))
    assert np.isnan(known.lengths()[4:]).all()
    assert np.isfinite(known.lengths()[:4]).all()


def test_the_newest_lengths_replace_the_oldest():
    small, known = 0.5 * body(), LimbLengths()
    for points in (small, body()):
        for _ in range(400):
            known.observe(points, ALL)
    np.testing.assert_allclose(known.lengths(), lengths_of(body()), rtol=1e-6)


@pytest.mark.parametrize("off", [-0.15, 0.15])
def test_a_hidden_elbow_before_the_shoulder_gets_its_depth_from_the_length(off):
    true = pointing()
    points, rays = true.copy(), rays_of(true)
    for j in (ELBOW, WRIST, HAND):
        points[j] = np.append(rays[j], 1.0) * (true[j, 2] + off)
    moved, seen = with_lengths(points, unseen(ELBOW, WRIST, HAND), rays, lengths_of(true))
    np.testing.assert_allclose(moved[[ELBOW, WRIST]], true[[ELBOW, WRIST]], atol=0.02)
    np.testing.assert_allclose(rays_of(moved), rays, atol=1e-9)  # in the image nothing moves
    assert moved[HAND, 2] - points[HAND, 2] == pytest.approx(moved[WRIST, 2] - points[WRIST, 2])
    assert not seen[[ELBOW, WRIST, HAND]].any()


def test_a_bone_across_the_line_of_sight_hardly_moves():
    """Its length in the image is wrong by a tenth; its depth cannot mend that."""
    points = body()
    moved, seen = with_lengths(points, ALL, rays_of(points), 0.9 * lengths_of(points))
    assert np.abs(moved - points).max() < 0.02
    assert seen.all()


def test_a_seen_end_whose_length_is_impossible_counts_as_hidden_with_its_hand():
    """The wrist has the depth of the trunk behind it, 12 cm too far."""
    true = pointing()
    points, rays = true.copy(), rays_of(true)
    points[WRIST] = np.append(rays[WRIST], 1.0) * (true[WRIST, 2] + 0.12)
    moved, seen = with_lengths(points, ALL, rays, lengths_of(true))
    assert not seen[[WRIST, HAND]].any()
    assert seen[ELBOW]
    assert np.linalg.norm(moved[WRIST] - true[WRIST]) < 0.04


def test_nothing_moves_without_known_lengths():
    points = pointing()
    moved, seen = with_lengths(points, ALL, rays_of(points), np.full(8, np.nan))
    np.testing.assert_array_equal(moved, points)
    assert seen.all()
