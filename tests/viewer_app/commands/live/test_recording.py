"""``duplex record``, ``--record`` and ``duplex live a.mkv b.mkv``, on stand-ins for two Kinects."""

import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from devices.azure.mkv import MkvRecording
from devices.azure.mkv_writer import MkvWriter
from devices.capture.settings import CaptureSettings
from devices.recorded.files import recorded_at
from devices.sensor import SensorFrame
from devices.simulated.real_time import PacedSensor
from devices.tracker_choice import TrackerChoice
from fusion.body import AZURE_KINECT
from fusion.calibration.bone_lengths import bone_lengths_of
from fusion.calibration.calibration import nominal_calibration
from fusion.intrinsics import Intrinsics
from recordings.calibration_file import calibration_to_json
from recordings.session import Session
from tests.helpers.command_line import duplex, one_line
from tests.helpers.machine import small_disk
from tests.helpers.mkv_writer import lens_of, write_mkv
from tests.helpers.realsense import LENS, numbered, plugged
from tests.helpers.realsense import record as record_bag
from tests.helpers.session_text import rows_of
from viewer_app.errors import UsageError
from viewer_app.options.sensing import LiveOptions
from viewer_app.running.runner import Runner
from viewer_app.sensors import local, raw_files
from viewer_app.sensors.local import two_played_sensors

SENSORS = ("--kinect-a", "000123", "--kinect-b", "000456")


def read(path):
    with MkvRecording(path) as recording:
        frames = list(recording.frames())
    return recording, frames


@pytest.mark.parametrize("more", [(), ("--compress",), ("--color", "720P")])
def test_two_sensors_become_two_recordings(more, kinects, tmp_path, capsys):
    folder = tmp_path / "made" / "here"
    assert duplex("record", folder, *SENSORS, "--seconds", 1, *more) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "Sync cable: B leads" in said
    assert sorted(path.name for path in folder.iterdir()) == ["a.mkv", "b.mkv"]
    for name, serial, sync in (("a", "000123", "SUBORDINATE"), ("b", "000456", "MASTER")):
        recording, frames = read(folder / f"{name}.mkv")
        assert (recording.info.serial, recording.info.sync_mode) == (serial, sync)
        assert recording.info.intrinsics.cx == pytest.approx(332.0), "the sensor's own calibration"
        assert recording.warnings == []
        assert f"{name}.mkv: {len(frames)} frames" in said
        assert len(frames) >= 10
        # the stand-in's images name their capture
        numbers = [int(frame.depth[0, 0]) for frame in frames]
        assert numbers == [*range(numbers[0], numbers[0] + len(frames))]
        assert all((frame.ir == 900).all() and frame.host_ns for frame in frames)
    assert kinects.open_serials == []


@pytest.mark.usefixtures("kinects")
def test_a_disk_without_room_for_a_frame_is_the_only_reason_told(tmp_path, capsys):
    with small_disk(tmp_path / "small", 200) as disk:
        assert duplex("record", disk, *SENSORS, "--seconds", 2) == 2
        said = capsys.readouterr()
        assert "No space left on device" in said.err
        assert "no frame arrived" not in said.out


def test_realsenses_of_the_real_library_are_recorded(rs, tmp_path, capsys):
    with ThreadPoolExecutor() as pool:
        made = [
            pool.submit(
                record_bag, rs, tmp_path / f"{serial}.db3", numbered(90), serial=serial, pause_s=0.033
            )
            for serial in ("1001", "1002")
        ]
    with plugged(rs, *(one.result() for one in made)):
        assert duplex("record", tmp_path, "--principal", "1002", "--seconds", 1.5) == 0
    said = " ".join(capsys.readouterr().out.split())
    for name, serial in (("a", "1002"), ("b", "1001")):
        recording, frames = read(tmp_path / f"{name}.mkv")
        assert (recording.info.serial, recording.warnings) == (serial, [])
        assert recording.info.intrinsics == replace(LENS, distortion=(0.0,) * 8)
        assert f"{name}.mkv: {len(frames)} frames" in said
        numbers = [int(frame.depth[0, 0]) - 2001 for frame in frames]
        assert (np.diff(numbers) > 0).all()
        assert len(frames) > 25, "of 45; the library's playback leaves out some on a busy machine"
        assert "not saved" not in said
        assert [int(frame.ir[0, 0]) for frame in frames] == numbers


def test_a_disk_with_room_for_less_than_a_minute_is_told_before(tmp_path, capsys):
    """Two sensors write 88 MB per second."""
    with small_disk(tmp_path / "small", 4_000_000) as disk:
        assert duplex("demo", "--no-viewer", "--seconds", 0.2, "--record", disk) == 0
        assert "Only 4096 MB are free" in capsys.readouterr().out


def test_a_slow_tracker_loses_no_recorded_frame(kinects, live, standin, tmp_path):
    standin.tracking_ms = 90  # it gets a third of the frames
    live("--record", tmp_path / "raw", "--compress", seconds=2.0)
    for name, device in zip("ab", kinects.devices, strict=True):
        path = tmp_path / "raw" / f"{name}.mkv"
        assert b"FFVH" in path.read_bytes()[:10_000]
        _, frames = read(path)
        assert len(frames) == device.captures, "every capture of the SDK"
        assert len(frames) > 1.5 * rows_of(live.saved, "/fused/skeleton")
    assert kinects.open_serials == []


@pytest.mark.usefixtures("kinects")
def test_recordings_give_the_same_s_as_live_did(live, standin, tmp_path):
    raw, calibration = tmp_path / "raw", tmp_path / "c.json"
    person = np.arange(32)[:, None] * (0.001, -0.01, 0.0)  # of the stand-in
    lengths = np.nan_to_num(bone_lengths_of(AZURE_KINECT, person))
    kept = replace(nominal_calibration(AZURE_KINECT), bone_lengths=lengths)
    calibration.write_text(calibration_to_json(kept), encoding="utf-8")
    live("--record", raw, "--calibrate", calibration, seconds=2.0)
    was = Session.open(live.saved)
    for library in ("libk4a.so", "libk4abt.so"):  # one library for both, as the loader sees it
        (tmp_path / library).symlink_to(standin.path)
    files, tracker = (raw / "a.mkv", raw / "b.mkv"), ("--k4abt", tmp_path / "libk4abt.so")
    given = (*tracker, "--no-viewer", "--calibrate", calibration, "--save")
    assert duplex("live", *files, *given, tmp_path / "l.rrd") == 0
    assert duplex("fuse", *files, *given, tmp_path / "f.rrd") == 0
    for name in "lf":
        now = Session.open(tmp_path / f"{name}.rrd")
        assert now.about["session"]["recorded"] == (recorded_at(files[0]),)
        assert now.tracker == was.tracker == "k4abt"
        for side in "ab":
            _, i, j = np.intersect1d(
                *(_column(each, f"clock_{side}") for each in (was, now)), return_indices=True
            )
            assert len(i) > 40, name
            views = _column(was, f"positions_{side}")[i], _column(now, f"positions_{side}")[j]
            np.testing.assert_allclose(*views, atol=1e-5, err_msg=name)
        # on a busy machine live loses frames, and S* of what follows is another
        same = _same_pairs(was, now)
        off = np.linalg.norm(was.fused[:same] - now.fused[:same], axis=2)
        # fuse knows later frames; live may find later that both clocks are one, which is 0.16 ms of skew
        skews = (_column(each, "skew_ns")[:same] for each in (was, now))
        whole = np.max if name == "l" and np.array_equal(*skews) else np.median
        assert same == 0 or whole(off) < 1e-4, name


def _column(session, name):
    return getattr(session.rows, name)


def _same_pairs(one, other):
    """How many pairs at the beginning of both sessions are of the same frames."""
    pairs = [
        list(zip(_column(each, "clock_a"), _column(each, "clock_b"), strict=True)) for each in (one, other)
    ]
    return next((k for k, (a, b) in enumerate(zip(*pairs, strict=False)) if a != b), min(map(len, pairs)))


@pytest.mark.parametrize(
    ("arrivals_s", "cable", "common"),
    [
        ((4000, 4001), True, "arrival"),
        ((4000, 9000), True, None),  # two runs
        ((4000, None), True, "capture"),
        ((None, None), True, "capture"),
        ((None, None), False, None),
    ],
)
def test_two_recordings_of_one_name_are_told_apart_and_start_by_a_common_clock(
    arrivals_s, cable, common, tmp_path, monkeypatch
):
    paths = []
    for side, sync, host_s in zip("lr", ("master", "subordinate"), arrivals_s, strict=True):
        (tmp_path / side).mkdir()
        paths.append(tmp_path / side / "output.mkv")
        image = np.ones((288, 320), np.uint16)
        host_ns = None if host_s is None else host_s * 10**9
        frame = SensorFrame(10**9, depth=image, ir=image, host_ns=host_ns)
        settings = CaptureSettings(sync=sync if cable else "standalone")
        with MkvWriter(paths[-1], side, settings, lens_of("NFOV_2X2BINNED"), frame) as writer:
            writer.write(frame)
    monkeypatch.setattr(local, "tracker_of", lambda _: TrackerChoice("blazepose", "a test"))
    played = two_played_sensors(LiveOptions(), paths, Console(quiet=True))
    a, b = (thread.sensor for thread in (played.a, played.b))
    assert [a.name, b.name] == ["l/output.mkv", "r/output.mkv"]
    assert a.key != b.key
    assert a.source._beat is b.source._beat
    assert a.source._beat.common == common


def test_recordings_are_played_at_their_own_rate(tmp_path, monkeypatch, capsys):
    """--fps is of sensors: outputs, the coach and --record take the rate of what is played."""

    def stop(runner, _stack):
        raise UsageError(f"{runner.sensors.rate}")

    paths, told = [tmp_path / "a.mkv", tmp_path / "b.mkv"], []
    for path in paths:
        frame = SensorFrame(10**9, depth=np.ones((288, 320), np.uint16), ir=np.ones((288, 320), np.uint16))
        with MkvWriter(path, path.stem, CaptureSettings(fps=15), lens_of("NFOV_2X2BINNED"), frame) as writer:
            writer.write(frame)
    monkeypatch.setattr(local, "tracker_of", lambda _: TrackerChoice("blazepose", "a test"))
    monkeypatch.setattr(raw_files.RawFiles, "attach", lambda _, sensors: told.append(sensors.rate))
    monkeypatch.setattr(Runner, "open_outputs", stop)
    assert duplex("live", *paths, "--no-viewer", "--record", tmp_path / "raw") == 2
    assert capsys.readouterr().err == "duplex: 15.0\n"
    assert told == [15.0]


def test_skeletons_that_were_saved_are_advised_where_there_is_an_option_for_them(tmp_path, capsys):
    paths = [write_mkv(tmp_path / f"{side}.mkv", 3) for side in "ab"]
    tracker = "--tracker", "k4abt", "--k4abt", tmp_path / "none.so"
    for command, advised in (("live", False), ("fuse", True)):
        assert duplex(command, *paths, *tracker, "--no-viewer") == 2
        assert ("saved before, with " in one_line(capsys)) is advised


def test_the_rate_of_what_is_played_is_that_of_its_file(rs, tmp_path):
    """With another one, every second moment would have no frames."""
    lens = Intrinsics(64, 48, 60.0, 60.0, 32.0, 24.0)
    paths = [
        record_bag(rs, tmp_path / name, numbered(4, lens, fps=15), lens=lens, fps=15)
        for name in ("a.db3", "b.db3")
    ]
    played = two_played_sensors(LiveOptions(tracker="blazepose"), paths, Console())
    assert played._decimation.period_ns == pytest.approx(1e9 / 15, abs=1)


def test_what_the_simulator_saw_is_recorded(monkeypatch, tmp_path):
    """On a busy machine it sees less: the first image of each sensor, at least."""
    seen = {}
    frames_of = PacedSensor.frames

    def noted(sensor):
        seen[sensor.name] = times = []
        for frame in frames_of(sensor):
            if frame.depth is not None:
                times.append(frame.time_ns // 1000 * 1000)  # a file has microseconds
            yield frame

    monkeypatch.setattr(PacedSensor, "frames", noted)
    begun = time.perf_counter_ns()
    options = ("--no-viewer", "--seconds", 2, "--record", tmp_path, "--save", tmp_path / "s.rrd")
    assert duplex("demo", *options, "--compress") == 0
    for name in ("a", "b"):
        recording, images = read(path := tmp_path / f"{name}.mkv")
        assert b"FFVH" in path.read_bytes()[:10_000]
        assert (recording.info.depth_mode, recording.warnings) == ("NFOV_2X2BINNED", [])
        assert [image.time_ns for image in images] == seen[f"simulated {name}"]
        assert all(begun < image.host_ns < time.perf_counter_ns() for image in images)
        assert images[0].depth.max() > 1000
        assert images[0].ir.max() > 20
