"""Sensors on their side and upside down: turned upright, they give what a sensor that stands gives."""

from dataclasses import replace

import numpy as np
import pytest

from devices.azure.mkv_writer import MkvWriter
from devices.capture.settings import CaptureSettings
from devices.depth.camera import in_image, project
from devices.recorded.two_recordings import RecordingChoice, read_two
from devices.sensor import ORIENTATIONS, ColorCamera, ColorImage, Sensor
from devices.simulated.kinect import PERSON, simulated_pair
from devices.simulated.person.movements import MOTIONS
from devices.simulated.rig import Rig
from devices.simulated.tracking.tracker_errors import TrackerErrors
from devices.upright import UprightSensor, orientation_of, rotation, turned_camera, upright
from fusion.body import AZURE_KINECT
from fusion.calibration.bone_lengths import bone_lengths_of
from fusion.calibration.calibration import Calibration
from fusion.fuser import Fuser
from fusion.intrinsics import Intrinsics
from fusion.rigid import RigidTransform
from fusion.setup import FusionSetup
from fusion.skeleton import SkeletonPair

ON_THEIR_SIDE = ORIENTATIONS[1:]
LENS = Intrinsics(64, 48, 50.0, 51.0, 30.0, 20.0, (0.1, -0.02, 3e-3, -2e-3, 0.01))


class Given(Sensor):
    name, body = "given", AZURE_KINECT

    def __init__(self, frames, intrinsics):
        self._frames, self.intrinsics = frames, intrinsics

    def frames(self):
        yield from self._frames


def pair(roll=(0, 0), **settings):
    """Of somebody who walks at once: who stands before a sensor on its side looks like who lies."""
    walks = replace(MOTIONS["walk"], startup=False)
    return simulated_pair(rig=Rig(roll_deg=roll), motion=walks, errors=TrackerErrors(), **settings)


def assert_equal(one, other):
    for name in ("depth", "ir"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    assert one.people.keys() == other.people.keys()
    for name, person in one.people.items():
        for values in ("positions", "states", "witness"):
            np.testing.assert_array_equal(getattr(person, values), getattr(other.people[name], values))


@pytest.mark.parametrize("orientation", ON_THEIR_SIDE)
def test_turned_and_turned_back_nothing_is_changed(orientation):
    a, _, _ = simulated_pair(seconds=0.1, depth="half", infrared=True)
    frames = list(a.frames())
    rolled = upright(Given(frames, a.intrinsics), 360 - orientation)
    again = upright(rolled, orientation)
    assert again.intrinsics == a.intrinsics
    for frame, same in zip(frames, again.frames(), strict=True):
        assert_equal(same, frame)
    assert upright(a, 0) is a


@pytest.mark.parametrize("orientation", ON_THEIR_SIDE)
def test_s_star_of_sensors_on_their_side_is_that_of_sensors_that_stand(orientation):
    """K_A lies on its side, K_B stands; both are simulated so, without errors."""
    stands, b, truth = pair(seconds=2.0)
    lies, _, _ = pair((orientation, 0), seconds=2.0)
    at = np.array([frame.people[PERSON].positions for frame in lies.frames()])
    assert orientation_of(AZURE_KINECT, np.arange(len(at)) / 30.0, at) == (orientation, orientation)
    lengths = bone_lengths_of(AZURE_KINECT, truth.positions_at(0))
    lengths[AZURE_KINECT.root] = 0.0
    setup = FusionSetup(Calibration(AZURE_KINECT, truth.a_from_b, lengths, "truth"))
    fusers = Fuser(setup), Fuser(setup)
    views = stands.frames(), upright(lies, orientation).frames(), b.frames()
    for frame, turned, other in zip(*views, strict=True):
        seen = [
            fuser.update(SkeletonPair(one.people[PERSON], other.people[PERSON], frame.time_ns))
            for fuser, one in zip(fusers, (frame, turned), strict=True)
        ]
        # float32 positions of 3 m, rolled by a matrix of floats: 4e-7 m
        np.testing.assert_allclose(seen[1].positions, seen[0].positions, atol=1e-5)


@pytest.mark.parametrize("orientation", ORIENTATIONS)
def test_the_turned_image_shows_the_person_where_the_turned_camera_says(orientation):
    lies, _, _ = pair((orientation, 0), seconds=0.04, depth="half")
    sensor = upright(lies, orientation)
    (frame,) = sensor.frames()
    at = frame.people[PERSON].positions
    assert at[AZURE_KINECT.joint("head"), 1] < at[AZURE_KINECT.joint("ankle left"), 1]
    pixels = project(sensor.intrinsics, at)
    inside = in_image(sensor.intrinsics, pixels)
    assert inside.sum() >= 15
    u, v = np.rint(pixels[inside]).astype(int).T
    # flesh over a joint is 0.13 m at most; the wall is a metre behind
    assert (np.abs(frame.depth[v, u] * 1e-3 - at[inside, 2]) < 0.2).mean() > 0.8


@pytest.mark.parametrize("orientation", ON_THEIR_SIDE)
def test_colour_is_turned_with_its_camera(orientation):
    rgb = np.zeros((LENS.height, LENS.width, 3), np.uint8)
    rgb[8:24, 40:56] = 255
    move = RigidTransform.of(np.eye(3), (-0.03, 0.01, 0.002))
    a, _, _ = pair(seconds=0.04)
    (frame,) = a.frames()
    given = replace(frame, color=ColorImage.of_rgb(rgb, ColorCamera(LENS, move)))
    (turned,) = upright(Given([given], LENS), orientation).frames()
    camera = turned.color.camera
    assert camera.intrinsics == turned_camera(LENS, orientation)
    point = np.array((0.2, -0.1, 1.0))
    np.testing.assert_allclose(
        camera.color_from_depth.apply(rotation(orientation) @ point),
        rotation(orientation) @ move.apply(point),
    )
    image = turned.color.rgb()
    assert image.shape[:2] == (camera.intrinsics.height, camera.intrinsics.width)
    np.testing.assert_array_equal(image > 127, np.rot90(rgb, -(orientation // 90)) > 127)


def write(folder, name, sensor):
    """A recording of a simulated sensor's images, and its skeletons."""
    frames = list(sensor.frames())
    with MkvWriter(folder / f"{name}.mkv", name, CaptureSettings(), sensor.intrinsics, frames[0]) as writer:
        for frame in frames:
            writer.write(frame)
    with (folder / f"{name}.csv").open("w") as file:
        file.write("time_us,body,joint,x,y,z\n")
        for frame in frames:
            for joint, (x, y, z) in zip(AZURE_KINECT.joints, frame.people[PERSON].positions, strict=True):
                file.write(f"{frame.time_ns // 1000},1,{joint},{x},{y},{z}\n")


def test_a_recording_in_which_the_person_may_lie_is_left_and_told(tmp_path):
    """Somebody who stands still before a sensor on its side."""
    for name, sensor in zip(
        "ab",
        simulated_pair(rig=Rig(roll_deg=(90, 0)), seconds=0.5, depth="half", infrared=True),
        strict=False,
    ):
        write(tmp_path, name, sensor)
    read = read_two(
        *(RecordingChoice(tmp_path / f"{s}.mkv", tmp_path / f"{s}.csv") for s in "ab"), offset_ns=0
    )
    assert read.orientations == (0, 0)
    (said,) = (line for line in read.warnings if "the person lies" in line)
    assert "a.mkv" in said
    assert "`orientation=90` turns it" in said


@pytest.mark.parametrize("stated", [None, 90])
def test_a_recording_of_a_sensor_on_its_side_is_turned_upright(stated, tmp_path):
    a, b, _ = pair((90, 0), seconds=2.0, depth="half", infrared=True)
    write(tmp_path, "a", a)
    write(tmp_path, "b", b)
    choices = [
        RecordingChoice(tmp_path / f"{name}.mkv", tmp_path / f"{name}.csv", orientation=of)
        for name, of in (("a", stated), ("b", None))
    ]
    read = read_two(*choices, offset_ns=0)
    said = [line for line in read.warnings if "turned clockwise by 90°" in line]
    assert len(said) == (stated is None)
    assert read.orientations == (90, 0)
    camera = read.cameras("full")[0]
    assert (camera.width, camera.height) == (a.intrinsics.height, a.intrinsics.width)
    view = read.pairing.pairs.skeletons.views[0]
    up, _ = orientation_of(AZURE_KINECT, view.time_ns * 1e-9, view.positions)
    assert up == 0
    number, image = next(iter(read.depth_images("a", "full")))
    (first,) = UprightSensor(Given([next(iter(a.frames()))], a.intrinsics), 90).frames()
    assert number == 0
    np.testing.assert_array_equal(image, first.depth)


def test_a_person_who_stands_first_and_then_lies_is_no_sensor_on_its_side():
    a, _, _ = pair(seconds=4.0)
    at = np.array([frame.people[PERSON].positions for frame in a.frames()])
    middle = np.nanmean(at, axis=(0, 1))
    lying = (at - middle) @ rotation(90).T + middle
    for first in (12, 40, 119):
        both = np.concatenate([at[:first], lying])
        assert orientation_of(AZURE_KINECT, np.arange(len(both)) / 30.0, both)[0] == 0
