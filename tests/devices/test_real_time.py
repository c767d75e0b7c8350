"""Simulated sensors in real time: each frame when it is due."""

import threading
import time
from dataclasses import replace

import numpy as np
import pytest

from devices.capture.frame_decimation import FrameDecimation
from devices.sensor import Sensor, SensorFrame
from devices.simulated.kinect import simulated_pair
from devices.simulated.real_time import Beat, PacedSensor, paced_together
from fusion.body import KINECT_V1


class Clock:
    """Time that passes only when someone waits or works."""

    def __init__(self):
        self.now = 100.0

    def __call__(self):
        return self.now

    def wait(self, stopping, seconds):
        self.now += seconds
        return stopping.is_set()


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def images_take(clock, monkeypatch):
    """Sets how many seconds an image takes; returns when the images were begun."""

    def set_seconds(seconds):
        begins = []

        def rendered(z, *_):
            begins.append(clock.now)
            clock.now += seconds
            return np.zeros(z.shape, dtype=np.uint16)

        monkeypatch.setattr("devices.simulated.kinect.depth_image", rendered)
        return begins

    return set_seconds


def simulated(seconds, **more):
    return simulated_pair(motion="still", seconds=seconds, body=KINECT_V1, **more)[0]


def paced(sensor, clock, decimation=None):
    return PacedSensor(sensor, None, decimation, clock=clock, wait=clock.wait)


def test_each_frame_is_given_when_it_is_due(clock):
    begun, frames = clock.now, []
    for frame in paced(simulated(0.5), clock).frames():
        frames.append(frame)
        assert clock.now - begun == pytest.approx((frame.time_ns - frames[0].time_ns) * 1e-9, abs=1e-9)
        assert frame.host_ns == round(clock.now * 1e9)
        clock.now += 0.001  # the reader's work does not accumulate
    assert len(frames) == 15


def test_a_sensor_that_is_late_leaves_images_out_and_no_skeleton(clock, images_take):
    takes = 0.08
    images_take(takes)
    sensor = simulated(3.0, depth="half")
    begun, frames = clock.now + takes, []
    for frame in paced(sensor, clock).frames():
        frames.append(frame)
        late = clock.now - begun - (frame.time_ns - frames[0].time_ns) * 1e-9
        assert late < 1.0 / 30.0 + takes  # what is tolerated, and one image more
    for frame, alone in zip(frames, simulated(3.0).frames(), strict=True):
        assert all(frame.people[who].repeats(alone.people[who]) for who in alone.people)
    assert sum(frame.depth is None for frame in frames) == sensor.images_left_out
    assert 0 < sensor.images_left_out < sensor.images_wanted == len(frames)


@pytest.mark.parametrize(
    ("takes", "ahead"), [(0.004, 1.0 / 60.0), (0.02, 0.03)], ids=["half a frame", "more than it takes"]
)
def test_a_frame_is_made_late_so_that_others_can_work_early(clock, images_take, takes, ahead):
    begins = images_take(takes)
    given = [clock.now for _ in paced(simulated(0.5, depth="half"), clock).frames()]
    assert np.array(given[1:]) - begins[1:] == pytest.approx(ahead)


@pytest.mark.parametrize("step", [1, 2, 3])
def test_images_are_made_and_given_of_the_kept_moments_only(clock, images_take, step):
    made = images_take(0.0)
    decimation = FrameDecimation(30.0)
    decimation.choice.step = step
    source = simulated(1.0, depth="half", infrared=True)
    frames = list(paced(source, clock, decimation).frames())
    gaps = np.diff([frame.time_ns for frame in frames]) / 1e9 * 30.0
    np.testing.assert_allclose(gaps, step, atol=1e-6)
    assert all(frame.depth is not None and frame.ir is not None for frame in frames)
    # The first image is made before the sensor knows its moment.
    assert len(frames) <= len(made) <= len(frames) + 1
    assert source.images_left_out == 0, "they were not wanted"


class Recording(Sensor):
    """Frames without an arrival, such as those of a RealSense recording."""

    name, body = "a.db3", KINECT_V1

    def frames(self):
        return iter([SensorFrame(7 + k * 33_333_333, depth=np.ones((2, 2), np.uint16)) for k in range(60)])


class Listed(Recording):
    def __init__(self, frames):
        self._frames = frames

    def frames(self):
        return iter(self._frames)


@pytest.mark.parametrize("step", [1, 3])
@pytest.mark.parametrize("source", [Recording, lambda: simulated(2.0, depth="half", infrared=True)])
def test_every_image_is_recorded_and_only_the_tracker_skips(clock, source, step):
    decimation, captured = FrameDecimation(30.0), []
    decimation.choice.step = step
    sensor = paced(source(), clock, decimation)
    sensor.on_capture = captured.append
    tracked = list(sensor.frames())
    assert all(frame.depth is not None for frame in captured)
    assert len(captured) == 60
    assert len(tracked) == pytest.approx(60 / step, abs=1)


@pytest.mark.parametrize("common", ["capture", "arrival", None])
def test_recordings_of_which_only_one_has_arrivals_begin_together(clock, common):
    """One by this program, one by Microsoft's recorder, on a cable: B's first frame was 0.2 s after A's."""
    beat, came = Beat(1, common=common), {}
    for name, first_ns, host_ns in (("a", 5_000_000_000, 4_000_000_000_000), ("b", 5_200_000_000, None)):
        frames = [
            SensorFrame(first_ns + k * 33_333_333, host_ns=host_ns and host_ns + k * 33_333_333)
            for k in range(3)
        ]
        if common == "arrival":  # one run of the program recorded both
            frames = [replace(frame, host_ns=frame.time_ns + 10**12) for frame in frames]
        clock.now = 100.0
        sensor = PacedSensor(Listed(frames), beat, clock=clock, wait=clock.wait)
        came[name] = [frame.host_ns - 100_000_000_000 for frame in sensor.frames()]
    apart_ns = 0 if common is None else 200_000_000
    assert came["b"][0] - came["a"][0] == pytest.approx(apart_ns, abs=1000)
    assert came["a"] == pytest.approx([0, 33_333_333, 66_666_666], abs=1000)


def test_sensors_begin_together():
    a, b, _ = simulated_pair(motion="still", seconds=0.2, body=KINECT_V1)
    given = {}

    def read(sensor):
        given[sensor.name] = list(sensor.frames())

    threads = [threading.Thread(target=read, args=(sensor,)) for sensor in paced_together(a, b)]
    threads[0].start()
    time.sleep(0.4)  # the stimulus: without a common clock the sensors would keep this offset
    threads[1].start()
    for thread in threads:
        thread.join()
    apart = [b.host_ns - a.host_ns for a, b in zip(given[a.name], given[b.name], strict=True)]
    assert len(apart) == 6
    assert abs(np.median(apart) - 0.96e6) < 0.2e9  # B captures so much later


def test_a_sensor_whose_fellow_never_comes_begins_without_it(monkeypatch):
    monkeypatch.setattr("devices.simulated.real_time._TOGETHER", 0.3)
    a, b, _ = simulated_pair(motion="still", seconds=0.2, body=KINECT_V1)
    frames = list(paced_together(a, b)[0].frames())
    assert len(frames) == 6
    assert frames[-1].host_ns - frames[0].host_ns > 0.12e9  # at its pace, without catching up


def test_a_sensor_ends_while_it_waits_for_its_fellow(monkeypatch):
    monkeypatch.setattr("devices.simulated.real_time._TOGETHER", 60.0)
    a, b, _ = simulated_pair(motion="still", seconds=0.2, body=KINECT_V1)
    waiting, _ = paced_together(a, b)
    threading.Timer(0.2, waiting.interrupt).start()
    begun = time.monotonic()
    assert list(waiting.frames()) == []
    assert time.monotonic() - begun < 30.0


def test_a_sensor_ends_when_it_is_interrupted(clock):
    sensor = paced(simulated(10.0), clock)
    frames = sensor.frames()
    next(frames)
    sensor.interrupt()
    assert list(frames) == []
