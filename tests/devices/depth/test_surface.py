"""The person's surface and the floor in rendered depth images, and what two sensors have in common."""

from dataclasses import replace

import numpy as np
import pytest

from devices.depth.point_cloud import ray_table
from devices.depth.surface import floor_plane, person_surface, shared_surface
from devices.pairing import pair_views
from devices.people.recorded_people import RecordedPeople
from devices.simulated.imaging.rendering import DepthErrors
from devices.simulated.kinect import PERSON, simulated_pair
from devices.simulated.rig import Rig
from devices.simulated.tracking.tracker_errors import TrackerErrors
from fusion.body import AZURE_KINECT
from fusion.calibration.surface_fit import fit_surface
from tests.fusion.calibration.test_surface_fit import errors, joints_of


def recorded(seconds, begin=0, **settings):
    """Pairs, images from a frame on by number of the frame, cameras, and the truth."""
    a, b, truth = simulated_pair(depth="half", seconds=seconds, errors=TrackerErrors(), **settings)
    frames = [[], []]
    for sensor, seen in zip((a, b), frames, strict=True):
        sensor.imaging = begin == 0
        for frame in sensor.frames():
            seen.append(frame)
            sensor.imaging = len(seen) >= begin
    people = (RecordedPeople.of(AZURE_KINECT, each) for each in frames)
    pairs = pair_views(AZURE_KINECT, *(each.view([PERSON]) for each in people)).pairs.skeletons
    images = [{k: frame.depth for k, frame in enumerate(each)} for each in frames]
    return pairs, images, (a.intrinsics, b.intrinsics), truth


@pytest.mark.parametrize("motion", ["walk", "squat"])
def test_points_are_the_persons_and_normals_face_the_sensor(motion):
    pairs, images, (camera, _), truth = recorded(0.1, motion=motion)
    rays, at = ray_table(camera), truth.positions_at(pairs.time_ns)
    floor = floor_plane([images[0][0]], rays, AZURE_KINECT, at)
    place = truth.rig.world_from_sensor(0)
    assert floor[:3] @ -place.rotation[1] > np.cos(np.radians(0.3))
    assert floor[3] == pytest.approx(place.translation[1], abs=0.01)  # the camera's own offset has sd 4 mm
    points, normals = person_surface(images[0][0], rays, at[0], AZURE_KINECT, floor)
    assert len(points) > 500
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-5)
    assert ((normals * points).sum(axis=1) < 0.0).all()
    nearest = np.linalg.norm(points[:, None] - at[0], axis=2).min(axis=1)
    assert nearest.max() < 0.4
    assert (points @ floor[:3] - floor[3]).min() > 0.05


def test_points_of_another_person_are_left_out():
    pairs, images, (camera, _), truth = recorded(0.1, motion="still")
    rays, at = ray_table(camera), truth.positions_at(pairs.time_ns)[0]
    beside = at + (0.25, 0.0, 0.0)  # where nobody stands: half of the person is nearer to them
    alone, (points, _) = (
        person_surface(images[0][0], rays, at, AZURE_KINECT, others=others) for others in ((), (beside,))
    )
    assert 0.2 * len(alone.points) < len(points) < 0.9 * len(alone.points)
    assert np.isin(points.view("f8,f8,f8"), alone.points.view("f8,f8,f8")).all()
    outside = (np.nan, (9.0, 0.0, 0.0), (0.0, 9.0, 0.0), (0.0, 0.0, -9.0))
    for aside in outside:
        assert len(person_surface(images[0][0], rays, at + aside, AZURE_KINECT).points) == 0


@pytest.mark.parametrize("angle", [60.0, 90.0])
def test_what_moves_between_the_captures_is_moved_back(angle):
    """A person walks at 1 m/s; B captures 16 ms later."""
    rig = Rig(angle_deg=angle, skew_seconds=0.016)
    pairs, images, cameras, truth = recorded(  # who stands for three seconds
        5.0, 100, motion="walk", rig=rig, depth_errors=DepthErrors.none()
    )
    moments = pairs[np.arange(100, 144, 7)]
    joints, _ = joints_of(truth.a_from_b, 1)
    off = []
    for given in (moments, replace(moments, skew_ns=0 * moments.skew_ns)):
        fit = fit_surface(shared_surface(given, images, cameras), joints).fit
        turn, there = errors(fit.a_from_b, truth.a_from_b, joints.centre)
        off.append(turn + np.linalg.norm(there) / 0.010)
    assert off[0] < 0.5 * off[1]


def test_moments_without_both_images_are_left_out():
    pairs, images, cameras, _ = recorded(0.2, motion="still")
    moments = pairs[np.arange(4)]
    shared = shared_surface(moments, images, cameras)
    assert len(shared.moments) == 4
    assert all(floor is not None for floor in shared.floors)
    small = images[1] | {1: np.zeros((3, 3), np.uint16), 2: np.zeros_like(images[1][2])}
    assert len(shared_surface(moments, ({0: images[0][0]} | images[0], small), cameras).moments) == 2
    nothing = shared_surface(moments, ({}, {}), cameras)
    assert nothing.moments == []
    assert nothing.floors == (None, None)
