"""Two trackers on one processor: they skip the same frames, then report a change to the lighter network."""

import itertools
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from devices.blazepose.networks.files import DETECTOR, LANDMARK_NETWORKS
from devices.blazepose.pace import TrackingPace
from devices.blazepose.settings import BlazePoseSettings
from devices.blazepose.tracked_images import TrackedImages
from devices.capture.sensor_pair import TwoSensors
from devices.sensor import Sensor, SensorFrame
from devices.simulated.kinect import simulated_pair
from fusion.body import BLAZEPOSE
from tests.helpers.machine import need_networks

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


def test_a_hitch_costs_no_accuracy(networks):
    pace = paced(networks)
    work(pace, 10, 50)
    work(pace, 90, 15)
    assert (pace.step, pace.network) == (1, "full")
    work(pace, 200, 15)
    work(pace, 20, 50)
    assert pace.network == "full", "results of the first hitch do not count"


def test_trackers_that_are_fast_enough_only_at_half_the_rate_go_on_with_lite(networks):
    pace, steps = paced(networks), []
    for _ in range(200):
        steps.append(pace.step)
        work(pace, 1, 15 if pace.step > 1 or pace.network == "lite" else 35)
    assert (pace.step, pace.network) == (1, "lite")
    assert sum(first != later for first, later in pairwise(steps)) == 4


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


def test_changes_and_advice_reach_the_reader_of_the_sensors(networks):
    pace, told = paced(networks), []
    a, b, _ = simulated_pair(motion="still", seconds=0.1)
    with TwoSensors(a, b, decimation=pace, tell=lambda event: told.append(event.text)) as sensors:
        work(pace, 60, 50)
        sensors.poll(0.0)
    assert any("lite" in text for text in told)
    assert any("15 of 30 frames" in text and "faster processor" in text for text in told)


def simulated(seconds):
    a, _, _ = simulated_pair(
        motion="still", seconds=seconds, body=BLAZEPOSE, depth="half", infrared=True, seed=1
    )
    return a


class Source(Sensor):
    """A sensor with images, whose making takes a third of the time."""

    name, body, making_ns = "s", BLAZEPOSE, 10 * MS

    def __init__(self, frames):
        self._frames = frames
        self.intrinsics = simulated(0.1).intrinsics

    def frames(self):
        yield from self._frames


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
    given = list(tracked.frames())
    assert len(given) == len(frames)
    assert told == [40 * MS] * 79, "an image took one tick; a frame without one is not tracked"
    assert pace.choice.slowest_s == pytest.approx(0.050), "with the time that making the image took"
    assert used == ["lite"], "once"


def test_a_damaged_lighter_network_does_not_end_the_session(tmp_path):
    for file in (DETECTOR, LANDMARK_NETWORKS["full"]):
        (tmp_path / file.name).write_bytes((need_networks() / file.name).read_bytes())
    (tmp_path / LANDMARK_NETWORKS["lite"].name).write_bytes(b"damaged")
    pace = paced(BlazePoseSettings(models=tmp_path))
    work(pace, 60, 50)
    assert pace.network == "lite"
    with TrackedImages(simulated(0.1), pace.settings, pace=pace) as sensor:
        assert len(list(sensor.frames())) == 3
    assert pace.network == "full"
    assert "continues with its network full" in pace.take_news()[-1]
