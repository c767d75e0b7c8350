"""Live RealSense sensors: the real pyrealsense2, with its software devices and recordings as sensors."""

import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import replace

import numpy as np
import pytest

from devices.blazepose.tracked_images import registered_color
from devices.capture.sensor_choice import cable_unknown, sync_master
from devices.capture.sensor_pair import TwoSensors
from devices.capture.sensor_state import TimeLimits
from devices.capture.settings import CaptureSettings
from devices.live.sensors import VENDORS, connected_sensors
from devices.realsense import sensors
from devices.realsense.images import FrameReader, choose_streams
from devices.realsense.sdk_access import (
    connected_realsenses,
    context_of,
    open_realsense,
    sdk_check,
    sensor_check,
    set_sync_role,
)
from devices.realsense.sensors import RealSenseSensor
from devices.sensor import DeviceError
from devices.tracker_choice import TrackerChoice
from tests.helpers.realsense import LENS, Software, numbered, plugged, record
from tests.helpers.waiting import eventually

OURS = TrackerChoice("blazepose", "a test")


@pytest.fixture(scope="module")
def two(rs, tmp_path_factory):
    """Recordings of three seconds of the sensors 1001 and 1002."""
    folder = tmp_path_factory.mktemp("realsense")
    with ThreadPoolExecutor() as pool:
        recorded = [
            pool.submit(record, rs, folder / f"{serial}.db3", numbered(90), serial=serial, pause_s=0.033)
            for serial in ("1001", "1002")
        ]
    return [one.result() for one in recorded]


def _sensor(serial="1001", **settings):
    return RealSenseSensor(serial, CaptureSettings(**settings))


def test_sensors_are_listed_and_opened_by_serial(rs, two):
    assert connected_realsenses() == []
    with plugged(rs, *two):
        listed = [one for one in connected_sensors(OURS) if one.sdk == "realsense"]
        assert sorted(one.serial for one in listed) == ["1001", "1002"]
        assert listed[0].description == "Software D455, USB 3.2"
        assert sync_master(*listed, "1002") == "1002", "the library does not tell of cables"
        assert "1001" in cable_unknown(*listed)
        check = sensor_check(listed[0])
        assert (check.ok, check.needed) == (True, False)
        with _sensor("1002") as sensor:
            assert sensor.intrinsics == LENS
            frames = sensor.frames()
            first, second = next(frames), next(frames)
    assert second.time_ns - first.time_ns == pytest.approx(33_333_333, abs=1000)
    number = int(first.depth[0, 0]) - 2001
    assert (first.depth == 2001 + number).all()
    assert (first.ir == number % 251).all()
    assert first.host_ns is not None
    assert VENDORS["realsense"].sensor is RealSenseSensor


def test_infrared_is_that_of_the_depth_images_pixels(rs):
    """Of the left camera, which is the first infrared stream, and rectified: Y8."""
    software = Software(rs)
    for index, form, size in ((2, rs.format.y8, 1), (3, rs.format.y16, 2)):
        software.add(software.stereo, rs.stream.infrared, form, size, LENS, 30, index)
    wide = replace(LENS, width=848, height=480)
    for kind, form, size in ((rs.stream.depth, rs.format.z16, 2), (rs.stream.infrared, rs.format.y8, 1)):
        software.add(software.stereo, kind, form, size, wide, 30, 1, uid=50)
    streams = choose_streams(rs, software.device, "a test", 30)
    assert (streams.image.stream_index(), streams.image.format()) == (1, rs.format.y8)
    assert (streams.depth.width(), streams.image.width()) == (848, 848), "nearest to 640 pixels"
    narrow = Software(rs)
    narrow.add(narrow.stereo, rs.stream.infrared, rs.format.y8, 1, LENS, 30, 2)
    assert choose_streams(rs, narrow.device, "a test", 30).image.stream_index() == 1
    colored = Software(rs, color=True)
    colored.add(colored.stereo, rs.stream.infrared, rs.format.y8, 1, LENS, 30, 2)  # the right camera's alone
    assert choose_streams(rs, colored.device, "a test", 30).image.stream_type() == rs.stream.color


def test_a_frame_arrived_when_the_library_says(rs):
    """Not when the reader had time for it: a late reader is no late sensor."""
    software = Software(rs)
    streams, queue = choose_streams(rs, software.device, "a test"), rs.frame_queue(4, True)
    reader = FrameReader(rs, streams, LENS)
    streams.start(queue)
    arrived_ms = time.time_ns() // 1_000_000 - 50
    software.stereo.set_metadata(rs.frame_metadata_value.time_of_arrival, arrived_ms)
    software.put(0, *next(numbered(1)))
    for _ in range(2):
        reader.add(queue.wait_for_frame(1000), 10**12)
    streams.stop()
    moment = reader.joiner.take()
    assert 49_000_000 <= 10**12 - moment.host_ns < 4_000_000_000


def test_colour_comes_registered_where_there_is_no_infrared(rs, tmp_path):
    color = np.full((LENS.height, LENS.width, 3), (200, 100, 50), np.uint8)
    exposed = [(k * 33_333_333, depth, color) for k, (_, depth, _) in enumerate(numbered(30), 1)]
    path = record(rs, tmp_path / "a.db3", exposed, pause_s=0.033, serial="1001", color=True)
    with plugged(rs, path), _sensor() as sensor:
        frame = next(frame for frame in sensor.frames() if frame.color)  # depth may start before colour
    assert frame.ir is None
    np.testing.assert_allclose(registered_color(frame)[120, 200], (200, 100, 50), atol=3)


def test_a_sensor_that_is_unplugged_while_it_opens_is_told(rs, two, monkeypatch):
    def unplugged(*_):
        context_of(rs).unload_device(str(two[0]))
        raise RuntimeError("failed to set option")

    monkeypatch.setattr(sensors, "set_sync_role", unplugged)
    with plugged(rs, two[0]), pytest.raises(DeviceError, match="RealSense 1001 was unplugged"):
        _sensor().__enter__()


def test_a_lost_sensor_is_taken_back(rs, two):
    told = []
    both = [_sensor(serial, timeout_ms=50, stall_s=0.5) for serial in ("1001", "1002")]
    pairs = TwoSensors(*both, limits=TimeLimits(retry_s=0.05), tell=lambda event: told.append(event.text))

    def paired_now():
        return any(pair.a is not None and pair.b is not None for pair in pairs.poll())

    def told_now(words):
        pairs.poll()
        return any(words in text for text in told)

    with ExitStack() as first:
        first.enter_context(plugged(rs, two[1]))
        with plugged(rs, two[0]), pairs:
            assert eventually(paired_now)
            first.close()
            assert eventually(lambda: told_now("RealSense 1002 was unplugged or lost its power"))
            with plugged(rs, two[1]):
                assert eventually(lambda: told_now("1002 is back"))
                assert eventually(paired_now)


@pytest.mark.parametrize(("role", "mode"), [("standalone", 0), ("master", 1), ("subordinate", 2)])
def test_a_place_on_the_sync_cable_is_the_librarys_mode(rs, role, mode):
    software = Software(rs)
    software.stereo.set_option(rs.option.inter_cam_sync_mode, 3)
    set_sync_role(rs, software.device, "1001", CaptureSettings(sync=role))
    assert software.stereo.get_option(rs.option.inter_cam_sync_mode) == mode


@pytest.mark.parametrize("of", [{"sync": False}, {"line": "D500"}])
def test_a_model_without_master_and_slave_runs_alone_only(rs, of):
    """D405 and D421 have no sync modes; those of the D500 series have other meanings."""
    software = Software(rs, **of)
    set_sync_role(rs, software.device, "1001", CaptureSettings())
    with pytest.raises(DeviceError, match=r"1001 has no modes master and slave\. Leave `sync_master` out"):
        set_sync_role(rs, software.device, "1001", CaptureSettings(sync="master"))


def test_modes_that_it_does_not_have_are_refused(rs, two):
    with plugged(rs, two[0]):
        for settings, why in (
            ({"fps": 5}, "has no depth at 5 fps"),
            ({"depth_mode": "WFOV_2X2BINNED"}, "leave `depth_mode` out"),
            ({"color": "2160P"}, "no colour 2160P: 720P, 1080P"),
            ({"color": "720P"}, r"has no colour 720P \(RGB8\) at 30 fps\. Leave `color` out\.$"),
        ):
            with pytest.raises(DeviceError, match=why):
                _sensor(**settings).__enter__()
        assert open_realsense(rs, "1001").is_connected()


def test_the_doctor_knows_the_library(rs, monkeypatch):
    assert sdk_check().ok
    assert sdk_check().detail.startswith(rs.__version__)
    monkeypatch.setitem(sys.modules, "pyrealsense2", None)
    assert not sdk_check().ok
    assert 'pip install "duplex-kinects[realsense]"' in sdk_check().advice
