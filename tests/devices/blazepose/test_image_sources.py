"""The own tracker on the images of sensors and of any depth camera."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from devices.blazepose.blazepose import BlazePose
from devices.blazepose.depth_camera import DepthCamera
from devices.blazepose.settings import BlazePoseSettings
from devices.blazepose.tracked_images import TrackedImages
from devices.capture.sensor_state import TimeLimits
from devices.capture.sensor_thread import SensorThread
from devices.sensor import ColorCamera, ColorImage, DeviceError, Sensor, SensorFrame
from devices.simulated.kinect import simulated_pair
from fusion.body import BLAZEPOSE
from fusion.intrinsics import Intrinsics
from fusion.rigid import RigidTransform
from fusion.skeleton import Skeleton
from tests.helpers.command_line import duplex, one_line
from tests.helpers.machine import need_networks
from tests.helpers.rendered_people import CAMERA, FRAME_NS, images_of, landmarks_at
from tests.helpers.waiting import eventually


class Images(Sensor):
    """A sensor that gives prepared frames."""

    name, body, warnings = "prepared", BLAZEPOSE, ("a warning",)
    intrinsics: Intrinsics | None = CAMERA

    def __init__(self, *frames):
        self._frames = frames
        self.opened = False
        self.interrupted = False

    def __enter__(self):
        self.opened = True
        return self

    def __exit__(self, *exc_info):
        self.opened = False

    def frames(self):
        yield from self._frames

    def interrupt(self):
        self.interrupted = True


def tracked(source):
    return TrackedImages(source, BlazePoseSettings(models=need_networks()))


def frame_of(ir, depth, *, color=None):
    return SensorFrame(FRAME_NS, depth=depth, ir=None if color else ir, color=color)


def color_of(ir, move=None):
    """The infrared image as a colour image of the depth camera, or of one that is moved against it."""
    grey = np.clip(np.sqrt(ir) * 8.0, 0, 255).astype(np.uint8)
    jpeg = cv2.imencode(".jpg", grey)[1].tobytes()
    return ColorImage(jpeg, ColorCamera(CAMERA, move or RigidTransform.of(np.eye(3), np.zeros(3))))


def test_frames_of_a_simulated_kinect_get_people_and_keep_their_images():
    a, _, _ = simulated_pair(seconds=0.1, depth="half", infrared=True)
    with tracked(a) as sensor:
        frames = list(sensor.frames())
    assert sensor.body is BLAZEPOSE
    assert len(frames) == 3
    assert frames[-1].people["1"].body is BLAZEPOSE
    assert frames[-1].people["1"].time_ns == frames[-1].time_ns
    assert frames[-1].ir is not None
    assert frames[-1].depth is not None


def test_only_images_with_depth_in_its_place_give_people():
    """Colour serves where there is no infrared and it is registered to depth; the source's people do not."""
    ir, depth = images_of([landmarks_at("startup", 1.0)])
    moved = color_of(ir, RigidTransform.of(np.eye(3), (0.03, 0.0, 0.0)))
    a, _, _ = simulated_pair(seconds=0.05)
    empty_infrared, empty_depth = images_of([])
    frames = [frame_of(ir, depth, color=color) for color in (color_of(ir), moved)]
    frames += [SensorFrame(0, ir=ir), SensorFrame(1, depth=depth), SensorFrame(2)]
    frames.append(SensorFrame(3, depth=depth, ir=ir[::2]))
    with tracked(Images(*frames)) as sensor:
        assert [len(frame.people) for frame in sensor.frames()] == [1, 0, 0, 0, 0, 0]
    people = replace(next(iter(a.frames())), depth=empty_depth, ir=empty_infrared)
    with tracked(Images(people)) as sensor:
        assert [frame.people for frame in sensor.frames()] == [{}]


def test_another_person_is_reported_once_live_and_with_all_times_in_a_recording():
    here, empty = images_of([landmarks_at("startup", 1.0)]), images_of([])
    times = (0, 1, 50, 51, 52)  # frames; between 1 and 50 nobody is seen for more than a second
    frames = [SensorFrame(FRAME_NS * k, depth=here[1], ir=here[0]) for k in times]
    frames.insert(2, SensorFrame(2 * FRAME_NS, depth=empty[1], ir=empty[0]))
    news = []
    with tracked(Images(*frames)) as sensor:
        for _ in sensor.frames():
            news += sensor.take_news()
        said = "prepared: another person is followed, or the same one after a second out of sight"
        assert news == [f"{said}."]
        assert list(sensor.warnings) == ["a warning", f"{said}, from 1.7 s on."]


def test_a_source_without_a_known_camera_is_reported():
    source = Images(frame_of(*images_of([])))
    source.intrinsics = None
    with tracked(source) as sensor, pytest.raises(DeviceError, match="does not know its depth camera"):
        list(sensor.frames())


def test_opening_and_closing_reach_the_source(tmp_path):
    source = Images()
    with tracked(source) as sensor:
        assert source.opened
        sensor.interrupt()
        assert source.interrupted
        assert tuple(sensor.warnings) == ("a warning",)
    assert not source.opened
    with pytest.raises(DeviceError, match="duplex tracker fetch"):
        TrackedImages(source, BlazePoseSettings(models=tmp_path)).__enter__()
    assert not source.opened


def test_the_command_says_that_the_networks_are_there(capsys):
    folder = need_networks()
    assert duplex("tracker", "fetch", "--tracker-model", folder) == 0
    assert "already, and complete" in capsys.readouterr().out


def test_the_command_fails_in_one_line_without_a_package_index(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("PIP_INDEX_URL", "http://127.0.0.1:9/simple")  # nothing listens there
    monkeypatch.setenv("PIP_CONFIG_FILE", "/dev/null")
    assert duplex("tracker", "fetch", "--tracker-model", tmp_path) == 2
    assert "--tracker-model" in one_line(capsys)
    assert list(tmp_path.glob("*.tflite")) == []


LENS = Intrinsics(8, 6, 10.0, 10.0, 3.5, 2.5)
DEPTH = np.full((6, 8), 2000, np.uint16)
GREY = np.full((6, 8), 90, np.uint8)
RGB = np.full((6, 8, 3), 90, np.uint8)


@pytest.fixture
def seen(monkeypatch):
    """The images that the tracker gets; it finds one person in each."""
    images = []

    def track(_self, image, depth, _camera, time_ns):
        images.append((image, depth))
        return {"1": Skeleton.of(BLAZEPOSE, np.full((len(BLAZEPOSE), 3), 1.0), time_ns=time_ns)}

    monkeypatch.setattr(BlazePose, "__enter__", lambda self: self)
    monkeypatch.setattr(BlazePose, "track", track)
    return images


def _camera(*shots):
    return DepthCamera("left", lambda: iter(shots), LENS)


@pytest.mark.parametrize("image", [GREY, GREY.astype(np.uint16) + 3000, RGB], ids=["grey", "ir", "rgb"])
def test_images_become_frames_with_people(seen, image):
    took = []
    shots = (DEPTH, image, 7), (DEPTH, image, 8)
    with DepthCamera("left", lambda: iter(shots), LENS, took=took.append) as camera:
        frames = list(camera.frames())
    assert len(took) == 2
    assert min(took) > 0, "the tracker's time"
    assert [frame.time_ns for frame in frames] == [7, 8]
    assert all(frame.people["1"].time_ns == frame.time_ns for frame in frames)
    assert camera.body is BLAZEPOSE
    assert len(seen) == 2
    assert np.array_equal(seen[0][0], image)
    assert seen[0][1] is DEPTH


def test_depth_may_be_metres(seen):
    metres = np.full((6, 8), 1.2345, np.float32)
    metres[0, :4] = (np.nan, np.inf, -1.0, 70.0)
    with _camera((metres, GREY, 1)) as camera:
        list(camera.frames())
    depth = seen[0][1]
    assert depth.dtype == np.uint16
    assert depth[0].tolist() == [0, 0, 0, 0, 1234, 1234, 1234, 1234]


@pytest.mark.parametrize(
    ("depth", "image", "message"),
    [
        (DEPTH[:3], GREY, r"depth \(3, 8\).*register the image to depth"),
        (DEPTH, np.zeros((12, 16), np.uint8), "register the image to depth"),
        (np.full((6, 8), 1500.0, np.float32), GREY, r"depth of 1500 m \(median\).*millimetres as uint16"),
        (DEPTH.astype(np.int32), GREY, "depth of int32; needed: uint16 millimetres"),
        (DEPTH, GREY.astype(np.float32), "of float32; needed"),
        (DEPTH, np.zeros((6, 8, 3), np.uint16), "of uint16; needed"),
    ],
)
@pytest.mark.usefixtures("seen")
def test_other_images_are_refused_in_one_line(depth, image, message):
    with _camera((depth, image, 1)) as camera, pytest.raises(DeviceError, match=message) as fault:
        list(camera.frames())
    assert "\n" not in str(fault.value)


@pytest.mark.usefixtures("seen")
def test_a_camera_that_fails_is_opened_again():
    opened = 0

    def images():
        nonlocal opened
        opened += 1
        yield DEPTH, GREY, opened
        if opened == 1:
            raise OSError("the cable is out")

    with SensorThread(DepthCamera("left", images, LENS), limits=TimeLimits(retry_s=0.01)) as thread:
        assert eventually(lambda: thread.received == 2)
        told = " ".join(event.text for event in thread.events())
    assert "left failed: the cable is out." in told
    assert "left is back" in told
