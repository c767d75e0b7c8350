"""Any depth camera as a sensor: a generator of images with a tracker that the tests make up."""

import numpy as np
import pytest

from devices.blazepose.blazepose import BlazePose
from devices.blazepose.depth_camera import DepthCamera
from devices.capture.sensor_state import TimeLimits
from devices.capture.sensor_thread import SensorThread
from devices.sensor import DeviceError
from fusion.body import BLAZEPOSE
from fusion.intrinsics import Intrinsics
from fusion.skeleton import Skeleton
from tests.helpers.waiting import eventually

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
