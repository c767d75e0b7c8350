"""The own tracker on the images of sensors and of any depth camera."""

import itertools
import threading
import time
from contextlib import nullcontext
from dataclasses import replace

import cv2
import numpy as np
import pytest

from devices.blazepose.blazepose import BlazePose
from devices.blazepose.depth_camera import DepthCamera
from devices.blazepose.networks.files import DETECTOR, LANDMARK_NETWORKS
from devices.blazepose.pace import TrackingPace
from devices.blazepose.settings import BlazePoseSettings
from devices.blazepose.tracked_images import TrackedImages
from devices.sensor import ColorCamera, ColorImage, DeviceError, Sensor, SensorFrame
from devices.simulated.kinect import simulated_pair
from fusion.body import BLAZEPOSE
from fusion.intrinsics import Intrinsics
from fusion.rigid import RigidTransform
from fusion.skeleton import Skeleton
from tests.helpers.machine import need_networks
from tests.helpers.rendered_people import CAMERA, FRAME_NS, images_of, landmarks_at


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


# --- Two trackers on one processor: they skip the same frames, then report a change to the lighter network.


MS = 1_000_000


@pytest.fixture
def networks(tmp_path):
    """A folder with files of the networks' names; the pace looks at nothing else."""
    for file in (DETECTOR, *LANDMARK_NETWORKS.values()):
        (tmp_path / file.name).write_bytes(b"")
    return BlazePoseSettings(models=tmp_path)


class Clock:
    now_ns = 10**12

    def __call__(self):
        return self.now_ns


def paced(settings, **more):
    return TrackingPace(30.0, settings, Clock(), **more)


def work(pace, results, milliseconds):
    for _ in range(results):
        pace._clock.now_ns += pace.interval_ns
        for sensor in ("a", "b"):
            pace.tracked(sensor, milliseconds * MS)


def test_a_tracker_that_stays_slow_goes_on_with_lite_and_every_frame_again(networks):
    pace = paced(networks)
    work(pace, 10, 50)
    assert (pace.step, pace.network) == (2, "full"), "fewer frames first"
    assert pace.take_news() == []
    work(pace, 40, 50)
    assert pace.network == "lite"
    assert [news for news in pace.take_news() if "lite" in news]
    assert pace.take_news() == []
    work(pace, 40, 15)
    assert (pace.step, pace.network) == (1, "lite")


@pytest.mark.parametrize("lacks", ["the file", "a lighter one"])
def test_without_a_lighter_network_only_frames_are_left_out(networks, lacks):
    if lacks == "the file":
        (networks.models / LANDMARK_NETWORKS["lite"].name).unlink()
    else:
        networks = replace(networks, network="lite")
    pace = paced(networks)
    work(pace, 200, 50)
    assert (pace.step, pace.network) == (2, networks.network)
    assert ("fetch --network lite" in pace.advice) == (lacks == "the file")
    assert pace.take_news() == []


def test_who_simulates_sensors_is_not_told_to_record_them(networks):
    assert "track later" in paced(networks).advice
    advice = paced(networks, simulated=True).advice
    assert "track later" not in advice
    assert advice == advice.strip()


def simulated(seconds):
    a, _, _ = simulated_pair(
        motion="still", seconds=seconds, body=BLAZEPOSE, depth="half", infrared=True, seed=1
    )
    return a


class Source(Sensor):
    """A sensor with images; each comes when one is read."""

    name, body = "s", BLAZEPOSE

    def __init__(self, frames):
        self._frames, self.read = frames, threading.Semaphore(1)
        self.intrinsics = simulated(0.1).intrinsics

    def frames(self):
        for frame in self._frames:
            assert self.read.acquire(timeout=60.0)
            yield frame


def test_tracked_images_tell_the_pace_their_time_and_follow_its_network(networks, monkeypatch):
    moments = itertools.count(10**12, 2 * 33 * MS)
    pace, used, told = TrackingPace(30.0, networks, lambda: next(moments)), [], []
    image = np.ones((288, 320), np.uint16)
    frames = [SensorFrame(k * 33 * MS, depth=image if k else None, ir=image) for k in range(80)]
    ticks = iter(range(0, 10**12, 40 * MS))
    tracked = TrackedImages(Source(frames), networks, pace=pace, took=told.append, clock=lambda: next(ticks))
    monkeypatch.setattr(tracked.tracker, "track", lambda *_: {})

    def use(network):
        used.append(network)
        tracked.tracker.settings = replace(tracked.tracker.settings, network=network)

    monkeypatch.setattr(tracked.tracker, "use", use)
    given = [tracked.source.read.release() or frame for frame in tracked.frames()]
    assert [frame.time_ns for frame in given] == [frame.time_ns for frame in frames]
    assert tracked.missed == 0
    assert told == [40 * MS] * 79, "an image took one tick; a frame without one is not tracked"
    assert pace.choice.slowest_s == pytest.approx(0.040)
    assert used == ["lite"], "once"


class Endless(Source):
    """A sensor that gives images until it is interrupted; it notes when that ends and when it closes."""

    def __init__(self):
        super().__init__(())
        self.stopping, self.log = threading.Event(), []

    def frames(self):
        image = np.ones((288, 320), np.uint16)
        while not self.stopping.wait(0.001):
            yield SensorFrame(time.perf_counter_ns(), depth=image, ir=image)
        self.log.append("frames ended")

    def interrupt(self):
        self.stopping.set()

    def __exit__(self, *_):
        self.log.append("closed")


@pytest.mark.parametrize("fails", [True, False])
def test_a_sensor_closes_after_its_images_ended(networks, monkeypatch, fails):
    """Though the tracker fails, or nobody closes the frames; an SDK may crash."""
    source = Endless()
    tracked = TrackedImages(source, networks, pace=TrackingPace(30.0, networks))

    def track(*_):
        if fails:
            raise RuntimeError("the network is broken")
        return {}

    monkeypatch.setattr(tracked.tracker, "track", track)
    monkeypatch.setattr(tracked.tracker, "__enter__", lambda: None)
    with pytest.raises(RuntimeError, match="broken") if fails else nullcontext(), tracked:
        frames = tracked.frames()
        next(frames)
    assert source.log == ["frames ended", "closed"]


def test_a_damaged_lighter_network_does_not_end_the_session(tmp_path):
    for file in (DETECTOR, LANDMARK_NETWORKS["full"]):
        (tmp_path / file.name).write_bytes((need_networks() / file.name).read_bytes())
    (tmp_path / LANDMARK_NETWORKS["lite"].name).write_bytes(b"damaged")
    pace = paced(BlazePoseSettings(models=tmp_path))
    work(pace, 60, 50)
    assert pace.network == "lite"
    with TrackedImages(simulated(0.1), pace.settings, pace=pace) as sensor:
        assert len(list(sensor.frames())) + sensor.missed == 3
    assert pace.network == "full"
    assert "continues with its network full" in pace.take_news()[-1]
