"""From landmarks in an image to landmarks in space, on made-up bodies."""

import numpy as np
import pytest

from devices.blazepose.joints import joints_of
from devices.blazepose.landmark_kinds import INDEX, LANDMARK_NAMES, LONG_BONES, column
from devices.blazepose.lifting import BodyLandmarks, Lifted, lift
from devices.blazepose.limbs import LimbLengths, with_lengths
from devices.blazepose.networks.files import DETECTOR, checked_content
from devices.blazepose.networks.inference import Detector
from devices.blazepose.regions import Region, transformed, whole_image
from devices.depth.camera import project
from fusion.body import BLAZEPOSE
from fusion.skeleton import TrackingState
from tests.helpers.machine import need_networks
from tests.helpers.rendered_people import CAMERA, WIDE

SEEN = np.ones(len(LANDMARK_NAMES))


def body():
    """(33, 3) a person 2.5 m before the camera who faces it, metres: x to the right of the image."""
    at = np.zeros((len(LANDMARK_NAMES), 3))
    places = {
        "NOSE": (0.0, -0.62, -0.10), "EYE": (0.03, -0.65, -0.08), "EAR": (0.08, -0.63, 0.0),
        "MOUTH": (0.02, -0.58, -0.08), "SHOULDER": (0.18, -0.48, 0.0), "ELBOW": (0.25, -0.20, 0.02),
        "WRIST": (0.28, 0.05, 0.0), "PINKY": (0.29, 0.13, 0.0), "INDEX": (0.28, 0.14, -0.02),
        "THUMB": (0.26, 0.10, -0.04), "HIP": (0.10, 0.0, 0.0), "KNEE": (0.11, 0.42, -0.01),
        "ANKLE": (0.11, 0.83, 0.03), "HEEL": (0.11, 0.88, 0.07), "FOOT": (0.12, 0.90, -0.12),
    }  # fmt: skip
    for name, j in INDEX.items():
        x, y, z = places[name.split("_")[0]]
        at[j] = (-x if name.endswith("RIGHT") else x, y, z)
    return at + (0.0, 0.0, 2.5)


def depth_of(points, beneath=None, radius=8, camera=CAMERA):
    """A depth image with a patch over each landmark, as deep above it as its kind says; a wall at 4 m."""
    depth = np.full((CAMERA.height, CAMERA.width), 4000, dtype=np.uint16)
    surface = points[:, 2] - (column("beneath") if beneath is None else beneath)
    for j in np.argsort(-points[:, 2]):
        u, v = np.rint(project(camera, points[j])).astype(int)
        depth[v - radius : v + radius + 1, u - radius : u + radius + 1] = round(1000 * surface[j])
    return depth


def of_kinds(*kinds):
    return [j for name, j in INDEX.items() if name.split("_")[0] in kinds]


def world_of(points):
    """The body as the network states it: relative to the middle of the hips."""
    return points - 0.5 * (points[INDEX["HIP_LEFT"]] + points[INDEX["HIP_RIGHT"]])


@pytest.mark.parametrize("size", [0.6, 1.0, 1.3])
def test_the_place_and_the_size_of_a_body_come_from_the_depth(size):
    """Patches of neighbouring landmarks overlap; arms, knees and ankles stand alone. The depth is in mm."""
    points = body()
    real = size * points  # a person of another size, at another distance, in the same image
    alone = of_kinds("SHOULDER", "ELBOW", "WRIST", "KNEE", "ANKLE")
    depth = depth_of(real, beneath=size * column("beneath"))
    lifted = lift(BodyLandmarks(project(CAMERA, real), SEEN, SEEN, world_of(points)), depth, CAMERA)
    assert lifted.size == pytest.approx(size, rel=0.03)
    assert lifted.seen[alone].all()
    np.testing.assert_allclose(lifted.positions[alone], real[alone], atol=0.004)


def test_a_landmark_behind_something_is_not_seen_and_keeps_its_place():
    """A board 40 cm before the left arm covers elbow, wrist and hand."""
    points = body()
    depth = depth_of(points)
    arm = [j for j in of_kinds("ELBOW", "WRIST") if LANDMARK_NAMES[j].endswith("LEFT")]
    for u, v in np.rint(project(CAMERA, points[arm])).astype(int):
        depth[v - 20 : v + 21, u - 20 : u + 21] = 2100
    lifted = lift(BodyLandmarks(project(CAMERA, points), SEEN, SEEN, world_of(points)), depth, CAMERA)
    assert not lifted.seen[arm].any()
    # the body is laid onto patches that are up to 2 cm from its landmarks' own, where they overlap
    np.testing.assert_allclose(lifted.positions[arm], points[arm], atol=0.04)


@pytest.mark.parametrize("why", ["the network calls it hidden", "the thigh points at the camera"])
def test_a_landmark_that_cannot_be_measured_is_not_seen(why):
    points, visibility = body(), SEEN.copy()
    pixels = project(CAMERA, points)
    if why.startswith("the network"):
        visibility[INDEX["KNEE_LEFT"]] = 0.1
    else:
        pixels[INDEX["KNEE_LEFT"]] = pixels[INDEX["HIP_LEFT"]] + (0.0, 6.0)
    lifted = lift(BodyLandmarks(pixels, visibility, SEEN, world_of(points)), depth_of(points), CAMERA)
    assert not lifted.seen[INDEX["KNEE_LEFT"]]
    assert lifted.seen[INDEX["KNEE_RIGHT"]]


@pytest.mark.parametrize("size", [0.1, 0.4, 1.8])
def test_an_impossible_size_is_no_person(size):
    points = body()
    depth = np.full((CAMERA.height, CAMERA.width), round(2500 * size), dtype=np.uint16)
    assert lift(BodyLandmarks(project(CAMERA, points), SEEN, SEEN, world_of(points)), depth, CAMERA) is None


@pytest.mark.parametrize("degrees", [45, 55, 60])
def test_b6_a_hand_at_the_edge_of_a_wide_image_is_lifted_along_its_ray(degrees):
    points, hand = body(), of_kinds("WRIST", "INDEX", "PINKY", "THUMB")
    left = [j for j in hand if points[j, 0] > 0.0]
    points[left] += (2.5 * np.tan(np.radians(degrees)) - points[left, 0].mean(), 0.0, 0.0)
    pixels = project(WIDE, points)
    lifted = lift(BodyLandmarks(pixels, SEEN, SEEN, world_of(points)), depth_of(points, camera=WIDE), WIDE)
    assert lifted.known[left].all()
    along, true = (at[left, :2] / at[left, 2:] for at in (lifted.positions, points))
    np.testing.assert_allclose(along, true, atol=2e-4)  # a ray is accepted where its pixel is within 0.05


def test_a_joint_is_moved_along_its_bone_and_keeps_its_own_state():
    """A landmark that is hidden, or out of sight, changes the state of its own joint only."""
    points = body()
    landmarks = len(LANDMARK_NAMES)
    seen, known = np.ones(landmarks, dtype=bool), np.ones(landmarks, dtype=bool)
    seen[INDEX["SHOULDER_LEFT"]] = seen[INDEX["PINKY_LEFT"]] = False
    known[INDEX["KNEE_LEFT"]] = seen[INDEX["KNEE_LEFT"]] = False
    lifted = Lifted(points, seen, known, 1.0)
    positions, states = joints_of(lifted, project(CAMERA, points), depth_of(points))
    for name, state in (
        ("SHOULDER_LEFT", TrackingState.INFERRED),
        ("ELBOW_LEFT", TrackingState.TRACKED),
        ("HAND_LEFT", TrackingState.INFERRED),
        ("HAND_RIGHT", TrackingState.TRACKED),
        ("KNEE_LEFT", TrackingState.NOT_TRACKED),
        ("ANKLE_LEFT", TrackingState.TRACKED),
    ):
        assert states[BLAZEPOSE.joint(name)] == state, name
    shoulder, elbow = points[INDEX["SHOULDER_LEFT"]], points[INDEX["ELBOW_LEFT"]]
    np.testing.assert_allclose(positions[BLAZEPOSE.joint("ELBOW_LEFT")], elbow + 0.09 * (elbow - shoulder))


def test_a_region_turns_the_person_upright():
    """A person who lies with the head to the right of the image: in the crop the head is above the hips."""
    hips, rim = np.array((300.0, 200.0)), np.array((400.0, 200.0))
    region = Region.around(hips, rim)
    assert region.side == pytest.approx(250.0)
    to_image = region.image_from_crop(256)
    middle = 127.5
    above = transformed(to_image, np.array([[middle, middle], [middle, middle - 256 / 2.5]]))
    np.testing.assert_allclose(above, [hips, rim], atol=1e-9)


@pytest.mark.parametrize("size", [64, 224])
def test_a_crop_shows_what_its_transform_says(size):
    """A bright spot in the image appears in the crop where the transform maps it, to half a pixel."""
    image = np.zeros((576, 640), dtype=np.uint16)
    image[396:405, 496:505] = 1000
    region = whole_image(576, 640)
    crop = region.crop(image, int(size)).astype(float)
    v, u = np.mgrid[: int(size), : int(size)]
    centroid = np.array([[(crop * u).sum(), (crop * v).sum()]]) / crop.sum()
    np.testing.assert_allclose(
        transformed(region.image_from_crop(int(size)), centroid), [[500.0, 400.0]], atol=0.5 * 640 / size
    )


@pytest.mark.parametrize("side", [1024, 2048])
def test_a_crop_of_a_large_image_skips_no_pixel(side):
    """Black and white columns, two pixels wide, are grey in a crop of a quarter of the size or less."""
    image = np.where(np.arange(side) % 4 < 2, 200, 0).astype(np.uint8)
    crop = whole_image(side, side).crop(np.tile(image, (side, 1)), 224)[8:-8, 8:-8]
    np.testing.assert_allclose(crop.astype(float), 100.0, atol=1.0)  # the rounding of uint8


def test_the_detector_has_an_anchor_for_each_output():
    detector = Detector(checked_content(DETECTOR, need_networks()))
    assert detector.detect(np.zeros((224, 224), dtype=np.float32)) == []


# --- Bones at the lengths that a person has shown, on made-up bodies.


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
