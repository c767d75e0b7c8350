"""Live RealSense sensors: the real pyrealsense2, with its software devices and recordings as sensors."""

import re
import sqlite3
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from devices.blazepose.tracked_images import registered_color
from devices.capture.sensor_choice import cable_unknown, sync_master
from devices.capture.sensor_pair import TwoSensors
from devices.capture.sensor_state import TimeLimits
from devices.capture.settings import CaptureSettings
from devices.live.sensors import VENDORS, connected_sensors
from devices.orbbec.playback import OrbbecRecording
from devices.realsense import sensors
from devices.realsense.images import FrameReader, choose_streams
from devices.realsense.sdk_access import (
    connected_realsenses,
    context_of,
    open_realsense,
    set_sync_role,
)
from devices.realsense.sensors import RealSenseRecording, RealSenseSensor
from devices.recorded.files import frame_count, open_images, open_source
from devices.recorded.recording_apart import RecordingApart
from devices.sensor import DeviceError
from devices.simulated.kinect import simulated_pair
from devices.tracker_choice import TrackerChoice
from fusion.body import BLAZEPOSE
from fusion.intrinsics import Intrinsics
from recordings import fuse
from tests.helpers.machine import need_networks
from tests.helpers.realsense import BASELINE, LENS, Software, as_exposed, numbered, plugged, record
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
        check = VENDORS["realsense"].sensor_check(listed[0])
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


# --- Recordings that the real pyrealsense2 wrote, through the same path as all others.


DATA = Path(__file__).resolve().parents[2] / "data"


@pytest.mark.parametrize("pause_s", [0.0, 0.02])
def test_every_frame_of_a_recording_is_read_as_it_was_exposed(rs, tmp_path, pause_s):
    frames = list(numbered(60))
    with RealSenseRecording(record(rs, tmp_path / "a.db3", frames)) as recording:
        assert recording.intrinsics == LENS
        assert recording.interval_ns == 33_333_333
        assert recording.duration_ns > 0
        read = []
        for frame in recording.frames():
            read.append(frame)
            time.sleep(pause_s)
    assert [frame.time_ns for frame in read] == [time_ns for time_ns, _, _ in frames]
    for frame, (_, depth, infrared) in zip(read, frames, strict=True):
        np.testing.assert_array_equal(frame.depth, depth)
        np.testing.assert_array_equal(frame.ir, infrared)
    assert recording.warnings == []


def test_colour_is_registered_to_depth(rs, tmp_path):
    """The colour camera sits to the right, so that it sees each point further left by its disparity."""
    distance = 2.0
    columns = np.broadcast_to(
        np.arange(LENS.width, dtype=np.float64) / LENS.width * 255, (LENS.height, LENS.width)
    )
    color = np.stack([columns, np.zeros_like(columns), 255 - columns], axis=2).astype(np.uint8)
    depth = np.full((LENS.height, LENS.width), round(1000 * distance), np.uint16)
    path = record(rs, tmp_path / "a.db3", [(k * 33_333_333, depth, color) for k in range(1, 4)], color=True)
    with RealSenseRecording(path) as recording:
        frames = list(recording.frames())
    assert len(frames) == 3
    seen = registered_color(frames[0])
    disparity = LENS.fx * BASELINE / distance
    expected = (np.arange(20, 300) - disparity) / LENS.width * 255
    assert np.abs(seen[120, 20:300, 0] - expected).max() < 4.0, "JPEG, and the nearest pixel"
    assert np.abs(seen[120, 20:300, 2] - (255 - expected)).max() < 4.0
    assert frames[0].ir is None


def test_depth_of_any_unit_becomes_millimetres(rs, tmp_path):
    depth = np.array([[0, 1, 14, 16], [10_000, 12_344, 30_000, 65_531]], np.uint16)
    lens = Intrinsics(4, 2, 4.0, 4.0, 2.0, 1.0)
    image = np.zeros((2, 4), np.uint8)
    for units, name in ((0.0001, "fine.db3"), (0.002, "coarse.db3")):
        path = record(rs, tmp_path / name, [(10**9, depth, image)], lens=lens, units=units)
        with RealSenseRecording(path) as recording:
            (frame,) = recording.frames()
        millimetres = np.rint(depth * (1000.0 * units))
        np.testing.assert_array_equal(frame.depth, np.where(millimetres <= 65_535, millimetres, 0))


def test_times_go_on_where_the_sensors_counter_starts_anew(rs, tmp_path):
    """The counter has 32 bits of microseconds."""
    frames = list(numbered(6, first_ns=1000 * 2**32 - 100_000_000))
    wrapped = [(time_ns % (1000 * 2**32), depth, image) for time_ns, depth, image in frames]
    with RealSenseRecording(record(rs, tmp_path / "a.db3", wrapped)) as recording:
        read = [frame.time_ns for frame in recording.frames()]
    np.testing.assert_allclose(np.diff(read), 33_333_333, atol=1000)
    assert len(read) == 6


def test_what_is_no_recording_is_refused_in_one_line(rs, tmp_path):
    whole = record(rs, tmp_path / "whole.db3", numbered(30)).read_bytes()
    for name, content in (("other", b"something else"), ("empty", b""), ("cut", whole[: len(whole) // 2])):
        path = tmp_path / f"{name}.db3"
        path.write_bytes(content)
        with (
            pytest.raises(DeviceError, match=rf"{name}\.db3 ") as fault,
            RealSenseRecording(path) as recording,
        ):
            list(recording.frames())
        assert "realsense-viewer" in str(fault.value)
        assert "\n" not in str(fault.value)
    with pytest.raises(DeviceError, match="No file"):
        RealSenseRecording(tmp_path / "none.db3").__enter__()


def test_a_recording_that_is_damaged_in_its_middle_gives_what_is_before_and_says_so(rs, tmp_path):
    path = record(rs, tmp_path / "a.db3", numbered(40), pause_s=0.033)
    with closing(sqlite3.connect(path)) as database:
        (last,) = database.execute("select max(id) from messages").fetchone()
        database.execute("update messages set data = zeroblob(8) where id > ?", (last // 2,))
        database.commit()
    with RealSenseRecording(path) as recording:
        for _ in range(2):
            read = list(recording.frames())
    assert [int(frame.depth[0, 0]) for frame in read] == [2001 + k for k in range(len(read))]
    assert 10 <= len(read) <= 25
    (said,) = recording.warnings
    frames = f"{len(read)} frames of the first {len(read) / 30:.1f}"
    assert re.search(rf"damaged, or depth ended early: {frames} of \d\.\d s could", said)


def test_a_recording_without_a_complete_frame_is_refused(rs, tmp_path):
    path = record(rs, tmp_path / "a.db3", numbered(5))
    with closing(sqlite3.connect(path)) as database:
        of_depth = "select id from topics where name like '%/compressedDepth'"
        database.execute(f"delete from messages where topic_id = ({of_depth})")
        database.commit()
    with RealSenseRecording(path) as recording, pytest.raises(DeviceError, match="holds no complete frame"):
        list(recording.frames())


@pytest.mark.usefixtures("rs")
def test_a_bag_of_an_earlier_version_is_read():
    """pyrealsense2 2.55.1 wrote it; see ``tests/data/README.md``."""
    with open_images(DATA / "realsense_2.55.bag") as recording:
        assert recording.library is RealSenseRecording
        frames = list(recording.frames())
    assert [(int(frame.depth[0, 0]), int(frame.ir[0, 0])) for frame in frames] == [
        (2001 + k, k) for k in range(6)
    ]
    np.testing.assert_allclose(np.diff([frame.time_ns for frame in frames]), 33_333_000, atol=1)


def test_a_bag_is_of_realsense_or_of_orbbec(tmp_path):
    """By the message types in the list of connections, to which the head of a ROS bag points."""
    for kind, library in (
        ("realsense_msgs/StreamInfo", RealSenseRecording),
        ("custom_msg/OBInfo", OrbbecRecording),
    ):
        head = b"#ROSBAG V2.0\nE\0\0\0\x12\0\0\0index_pos=" + (5000).to_bytes(8, "little")
        path = tmp_path / "a.bag"
        path.write_bytes(head.ljust(5000, b"\0") + b"type=" + kind.encode())
        assert open_images(path).library is library
    path.write_bytes(b"#ROSBAG V2.0\nindex_pos=\xff\xff\xff\xff\xff\xff\xff\xff")
    assert open_images(path).library is OrbbecRecording


@pytest.mark.usefixtures("rs")
def test_a_damaged_bag_does_not_take_the_program_along(tmp_path):
    """pyrealsense2 2.59.1 crashes where the list of connections is said to be far behind the end."""
    damaged = bytearray((DATA / "realsense_2.55.bag").read_bytes())
    damaged[58] = 10  # of index_pos
    (tmp_path / "a.bag").write_bytes(damaged)
    recording = RecordingApart(tmp_path / "a.bag", RealSenseRecording)
    with pytest.raises(DeviceError, match=r"^a\.bag cannot be read by its maker's library: it crashed"):
        recording.__enter__()


def test_two_recorded_people_become_one_skeleton(rs, tmp_path):
    """Simulated people → the library's recorder → its playback → our tracker → S*."""
    need_networks()
    *views, truth = simulated_pair(motion="startup", body=BLAZEPOSE, seconds=2.0, depth="half", infrared=True)
    a, b = (tmp_path / f"{name}.db3" for name in "ab")
    for path, sensor in zip((a, b), views, strict=True):
        with sensor:
            record(rs, path, as_exposed(sensor.frames()), lens=sensor.intrinsics, serial=path.stem)
    with open_source(a, tracker=OURS) as source:
        assert frame_count(source) is not None
    session = fuse(a, b, tracker="blazepose")
    assert session.tracker == "blazepose full"
    errors = np.linalg.norm(session.fused - truth.positions_at(session.time_ns), axis=2)
    assert len(errors) == 60
    assert np.median(errors) < 0.025, "metres; 0.016 on images of 320 × 288"
