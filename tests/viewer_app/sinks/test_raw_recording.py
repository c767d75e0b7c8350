"""Raw recordings: what is in them, and what becomes of them when disk, sensor or program fail."""

import os
import random
import signal
import subprocess
import sys
import threading
import tracemalloc
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from devices.azure.mkv import MkvRecording
from devices.azure.mkv_writer import MkvWriter
from devices.blazepose.tracked_images import registered_color
from devices.capture.settings import CaptureSettings
from devices.pairing import clock_by_cable, offset_by_arrival
from devices.sensor import ColorCamera, ColorImage, Sensor, SensorFrame
from fusion.intrinsics import NOMINAL_INTRINSICS, Intrinsics
from fusion.rigid import RigidTransform
from tests.helpers.machine import small_disk
from tests.helpers.mkv_writer import depth_image, grey_color, lens_of, write_mkv
from tests.helpers.real_libraries import PYK4A
from tests.helpers.waiting import eventually
from viewer_app.sinks.raw_recording import RawRecorder, _FileTimes

ROOT = Path(__file__).resolve().parents[3]
LENS = NOMINAL_INTRINSICS["azure_kinect"]
PERIOD_NS = 33_333_000


class Camera(Sensor):
    name, intrinsics = "000123", LENS


def frame(number, lens=LENS):
    random = np.random.default_rng(number)
    depth, ir = (random.integers(0, 4000, (lens.height, lens.width), dtype=np.uint16) for _ in range(2))
    time_ns = 336_277_000 + number * PERIOD_NS
    return SensorFrame(time_ns, depth=depth, ir=ir, host_ns=10**15 + number * PERIOD_NS)


def read(path):
    with MkvRecording(path) as recording:
        return list(recording.frames()), recording


@pytest.mark.parametrize("compress", [False, True])
def test_what_was_recorded_is_read_bit_for_bit(compress, tmp_path, monkeypatch):
    monkeypatch.setattr("time.time_ns", lambda: 1_700_000_000_123_456_000)
    lens = replace(
        LENS, cx=321.1234567, cy=280.7, fx=503.3, distortion=(0.5, -2.6, 1e-4, -2e-4, 1.4, 0.4, -2.4, 1.3)
    )
    frames = [frame(number) for number in range(5)]
    settings = CaptureSettings(sync="subordinate")
    with MkvWriter(tmp_path / "a.mkv", "000123", settings, lens, frames[0], compress=compress) as writer:
        for each in frames:
            writer.write(each)
    found, recording = read(tmp_path / "a.mkv")
    info = recording.info
    assert recording.warnings == []
    assert [each.time_ns for each in found] == [each.time_ns for each in frames], "to the microsecond"
    assert [each.host_ns for each in found] == [each.host_ns for each in frames]
    for wanted, got in zip(frames, found, strict=True):
        np.testing.assert_array_equal(got.depth, wanted.depth)
        np.testing.assert_array_equal(got.ir, wanted.ir)
    assert (info.serial, info.depth_mode, info.sync_mode) == ("000123", "NFOV_UNBINNED", "SUBORDINATE")
    assert info.recorded == "2023-11-14T22:13:20.123456Z"
    assert info.subordinate_delay_ns == 160_000
    assert info.duration_ns == frames[-1].time_ns - frames[0].time_ns + 33_333_000
    for name in ("fx", "fy", "cx", "cy", "distortion"):
        assert getattr(info.intrinsics, name) == pytest.approx(getattr(lens, name), rel=1e-12), name


def test_a_camera_of_another_size_with_registered_colour_keeps_both(tmp_path):
    lens = Intrinsics(640, 480, 571.26, 571.26, 319.5, 239.5)
    jpeg = cv2.imencode(".jpg", np.full((480, 640, 3), (40, 120, 200), np.uint8))[1].tobytes()
    color = ColorImage(jpeg, ColorCamera(lens, RigidTransform.identity()))
    frames = [replace(frame(number, lens), ir=None, color=color) for number in range(3)]
    with MkvWriter(tmp_path / "a.mkv", "x", CaptureSettings(), lens, frames[0]) as writer:
        for each in frames:
            writer.write(each)
    found, recording = read(tmp_path / "a.mkv")
    assert recording.info.depth_mode == "640X480"
    assert recording.info.intrinsics == replace(lens, distortion=(0.0,) * 8)
    assert [each.color.jpeg for each in found] == [jpeg] * 3
    assert all((got.depth == wanted.depth).all() for got, wanted in zip(found, frames, strict=True))
    np.testing.assert_allclose(registered_color(found[0])[240, 320], (200, 120, 40), atol=3)


_PLAYBACK = """
import json, sys
import pyk4a
playback = pyk4a.PyK4APlayback(sys.argv[1])
playback.open()
found = []
while True:
    try:
        capture = playback.get_next_capture()
    except EOFError:
        break
    sums = [int(image.astype("u8").sum()) for image in (capture.depth, capture.ir)]
    color = None if capture.color is None else len(capture.color)
    found.append([capture.depth_timestamp_usec, capture.ir_timestamp_usec, *sums, color])
lens = playback.calibration.get_camera_matrix(pyk4a.CalibrationType.DEPTH).ravel().tolist()
told = playback.configuration
roles = [int(told[key]) for key in ("wired_sync_mode", "subordinate_delay_off_master_usec", "depth_mode")]
print(json.dumps({"frames": found, "lens": lens, "roles": roles}))
"""


@pytest.mark.parametrize("color", [False, True])
def test_the_library_of_microsofts_tools_reads_it(color, tmp_path):
    path, script = tmp_path / "a.mkv", tmp_path / "playback.py"
    write_mkv(path, 6, mode="NFOV_UNBINNED", color=color)
    script.write_text(_PLAYBACK, encoding="utf-8")
    said = PYK4A.run(str(script), str(path))
    jpeg = len(grey_color().jpeg) if color else None
    sums = [int(depth_image(k, "NFOV_UNBINNED").astype(np.uint64).sum()) for k in range(6)]
    pixels = 640 * 576
    assert said["frames"] == [
        [336_277 + 33_000 * k, 336_277 + 33_000 * k, sums[k], sums[k] + pixels, jpeg] for k in range(6)
    ]
    lens = lens_of("NFOV_UNBINNED")
    wanted = [lens.fx, 0.0, lens.cx, 0.0, lens.fy, lens.cy, 0.0, 0.0, 1.0]
    np.testing.assert_allclose(said["lens"], wanted, atol=1e-4)  # the SDK's are float32
    assert said["roles"] == [2, 160, 2]


class Stuck(MkvWriter):
    """A disk that stands still until the test lets it go."""

    go = threading.Event()

    def write(self, frame):
        self.go.wait(20.0)
        super().write(frame)


def test_a_disk_that_stands_still_costs_images_first_and_bounded_memory(tmp_path, monkeypatch):
    monkeypatch.setattr(RawRecorder, "keep", 12)
    monkeypatch.setattr(RawRecorder, "keep_with_images", 6)
    monkeypatch.setattr(Stuck, "go", threading.Event())
    first = frame(0)
    with RawRecorder(tmp_path / "a.mkv", Camera(), open_writer=Stuck) as recorder:
        recorder.add(first)
        assert eventually(lambda: not recorder._queue), "the thread has it"
        tracemalloc.start()
        for number in range(1, 31):
            recorder.add(frame(number))
        size, _ = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert size < 14 * first.depth.nbytes * 1.5, "6 pairs of images, 6 depth images"
        Stuck.go.set()
    assert (recorder.lost, recorder.without_images) == (18, 6)
    found, _ = read(recorder.path)
    assert [each.time_ns for each in found] == [frame(number).time_ns for number in range(13)]
    assert [each.ir is not None for each in found] == [True] * 7 + [False] * 6
    assert recorder.written == 13


@pytest.mark.parametrize("late", [1, 12])
def test_depth_that_comes_before_the_first_colour_image_does_not_leave_colour_out(late, tmp_path):
    """A Kinect v1 starts its depth camera first. Without colour nobody would be found in its recording."""
    color = ColorImage(b"\xff\xd8colour\xff\xd9", ColorCamera(LENS, RigidTransform.identity()))
    frames = [
        replace(frame(number), ir=None, color=color if number >= late else None) for number in range(15)
    ]
    with RawRecorder(tmp_path / "a.mkv", Camera()) as recorder:
        for each in frames:
            recorder.add(each)
    found, _ = read(recorder.path)
    assert [each.time_ns for each in found] == [each.time_ns for each in frames]
    assert [each.color is not None for each in found] == [False] * late + [True] * (15 - late)


def test_colour_that_starts_seconds_after_depth_is_recorded(tmp_path):
    """A sensor that is open knows its colour camera before that gives an image."""
    sensor = Camera()
    sensor.color_camera = ColorCamera(LENS, RigidTransform.identity())
    color = ColorImage(b"\xff\xd8colour\xff\xd9", sensor.color_camera)
    with RawRecorder(tmp_path / "a.mkv", sensor, CaptureSettings(color="720P")) as recorder:
        for number in range(31):
            recorder.add(replace(frame(number), ir=None))
        assert eventually(lambda: recorder.written == 31)
        recorder.add(replace(frame(31), ir=None, color=color))
    found, _ = read(recorder.path)
    assert [each.color is not None for each in found] == [False] * 31 + [True]


def test_a_sensor_without_an_image_is_recorded_after_a_second(tmp_path):
    with RawRecorder(tmp_path / "a.mkv", Camera()) as recorder:
        for number in range(31):
            recorder.add(replace(frame(number), ir=None))
        assert eventually(lambda: recorder.written == 31)
    assert recorder.lost == 0


def test_a_full_disk_ends_it_in_a_sentence_and_leaves_what_was_written(tmp_path):
    with small_disk(tmp_path / "small", 20_000) as disk:
        said = []
        with RawRecorder(disk / "a.mkv", Camera(), on_failure=said.append) as recorder:
            for number in range(40):
                recorder.add(frame(number))
        assert said == [recorder.waited, recorder.failure]
        assert recorder.failure == (
            f"{disk}/a.mkv is not saved from frame {recorder.written} on: No space left on device. "
            f"Everything before that can be read."
        )
        found, recording = read(disk / "a.mkv")
        assert len(found) == recorder.written == 20_000 * 1024 // (4 * 640 * 576)
        assert recorder.lost + recorder.written == 40
        assert ["is cut off" in warning for warning in recording.warnings] == [True]


def test_an_older_recording_is_replaced_when_asked_and_when_the_new_one_is_safe(tmp_path):
    older = tmp_path / "a.mkv"
    older.write_bytes(b"precious")
    for overwrite in (False, True):
        with RawRecorder(older, Camera(), overwrite=overwrite) as recorder:
            recorder.add(frame(0))
            assert eventually(lambda: recorder.written or recorder.failure)
            assert older.read_bytes() == b"precious"
        assert (recorder.failure is None) == overwrite
    assert len(read(older)[0]) == 1
    assert list(tmp_path.iterdir()) == [older]


def test_a_full_disk_leaves_the_older_recording(tmp_path):
    with small_disk(tmp_path / "small", 1_000) as disk:
        (disk / "a.mkv").write_bytes(b"precious")
        with RawRecorder(disk / "a.mkv", Camera(), overwrite=True) as recorder:
            recorder.add(frame(0))
        assert recorder.failure == f"{disk}/a.mkv could not be written: No space left on device."
        assert [path.read_bytes() for path in disk.iterdir()] == [b"precious"]


def test_a_folder_that_is_gone_is_told(tmp_path):
    with RawRecorder(tmp_path / "none" / "a.mkv", Camera()) as recorder:
        recorder.add(frame(0))
    assert recorder.failure == f"{tmp_path}/none/a.mkv could not be written: No such file or directory."


@given(
    clocks=st.lists(
        st.tuples(st.integers(-(10**15), 10**15), st.integers(2, 40), st.floats(0.7, 100.0)),
        min_size=1,
        max_size=4,
    ),
    held=st.sets(st.integers(5, 100), max_size=2),
    twice=st.sets(st.integers(1, 100), max_size=5),
    seed=st.integers(0, 1000),
)
def test_the_times_of_a_recording_are_true_whatever_its_clock_does(clocks, held, twice, seed):
    """A clock that starts anew goes back or ahead; frames may be held up, or given twice."""
    random, times = np.random.default_rng(seed), _FileTimes()
    true_ns, errors, number, previous_ns, was_ns = 10**18, [], 0, None, 0
    for clock_ns, frames, away_s in clocks:
        true_ns += round(away_s * 1e9)
        if previous_ns is not None:  # less than half a second is no new clock; nor is a gap to be told from
            moved_ns, gap_ns = clock_ns - was_ns, true_ns + PERIOD_NS + clock_ns - previous_ns
            assume(moved_ns > 600_000_000 or (moved_ns < -600_000_000 and gap_ns <= 0))
        was_ns = clock_ns
        held_until_ns = 0
        for k in range(frames):
            true_ns, number = true_ns + PERIOD_NS, number + 1
            if number in held and k and true_ns > held_until_ns:
                held_until_ns = true_ns + 700_000_000
            came_ns = max(true_ns + 20_000_000 + int(random.exponential(1e6)), held_until_ns)
            shot = SensorFrame(true_ns + clock_ns, host_ns=came_ns)
            time_ns = times.of(shot)
            errors.append(time_ns - true_ns)
            if number in twice:
                assert times.of(shot) is None
        previous_ns = true_ns + clock_ns
    # A new clock is found by one frame, to the jitter.
    assert np.ptp(np.array(errors)) < 30_000_000


def test_a_sensor_that_starts_its_clock_anew_goes_on(tmp_path):
    with RawRecorder(tmp_path / "a.mkv", Camera()) as recorder:
        for number in (0, 1, 2):
            recorder.add(frame(number))
        for number in (0, 1):  # plugged in again, two seconds later
            again = frame(number)
            recorder.add(replace(again, host_ns=again.host_ns + 2_000_000_000))
    times = np.array([each.time_ns for each in read(recorder.path)[0]])
    assert np.diff(times).tolist() == [PERIOD_NS, PERIOD_NS, 2_000_000_000 - 2 * PERIOD_NS, PERIOD_NS]


_RECORDS = """
import sys, time
from pathlib import Path
import numpy as np
from viewer_app.sinks.raw_recording import RawRecorder
from devices.sensor import Sensor, SensorFrame
from fusion.intrinsics import NOMINAL_INTRINSICS
class Camera(Sensor):
    name, intrinsics = "000123", NOMINAL_INTRINSICS["azure_kinect"]
recorder = RawRecorder(Path(sys.argv[1]), Camera(), compress=sys.argv[2] == "True")
number = 0
while True:
    depth = np.full((576, 640), 1 + number, np.uint16)
    recorder.add(SensorFrame(33_333_000 * number, depth=depth, ir=depth))
    number += 1
    while recorder.written < number:
        time.sleep(0.0005)
    sys.stdout.write(".")
    sys.stdout.flush()
"""


@pytest.mark.parametrize(("seed", "compress"), [(1, False), (4, True)])
def test_a_kill_at_any_moment_leaves_every_frame_that_was_written(seed, compress, tmp_path):
    moments = random.Random(seed)
    path = tmp_path / "a.mkv"
    command = [sys.executable, "-c", _RECORDS, str(path), str(compress)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    with subprocess.Popen(command, cwd=ROOT, env=environment, stdout=subprocess.PIPE) as program:
        told = program.stdout.read(1 + moments.randrange(40))
        threading.Event().wait(moments.random() * 0.02)  # anywhere within a frame
        os.kill(program.pid, signal.SIGKILL)
        told += program.stdout.read()
    found, recording = read(path)
    assert len(found) - len(told) in (0, 1), "not one that was told is missing"
    assert any("is cut off" in warning for warning in recording.warnings)
    assert all((each.depth == 1 + k).all() for k, each in enumerate(found))
    assert all((each.ir == 1 + k).all() for k, each in enumerate(found[: len(told)]))


def test_clocks_are_related_by_arrival():
    times = np.arange(0, 40_000_000_000, PERIOD_NS)
    late = np.random.default_rng(1).exponential(3e6, (2, len(times))).astype(np.int64)
    a = np.stack([times + 7_000, times + 10**15 + late[0]], axis=1)
    # B's clock was 5 s ahead and runs 40 ppm faster
    b_times = np.round(5_000_000_000 + times * (1 + 40e-6)).astype(np.int64)
    b = np.stack([b_times, times + 10**15 + late[1]], axis=1)
    found = offset_by_arrival(a, b)
    wrong = b_times + found.at(b_times) - a[:, 0]
    assert np.abs(wrong).max() < 200_000, "a fifth of a millisecond, where arrivals scatter by three"
    for start_ns, corrected in ((1_234_000_000_000, True), (0, False)):
        # on a sync cable, 160 µs later; the master has set the subordinate's clock, or has not
        captured = times + start_ns
        on_a = times + 160_000
        rough = replace(found, offset_ns=start_ns + 2_900_000.0, skew_ppm=0.0)
        exact = clock_by_cable(rough, 160_000, captured, on_a)
        assert (exact is not None) is corrected
        if exact is not None:
            assert np.abs(on_a + exact.at(on_a) - captured - 160_000).max() < 1000
    elsewhere = b + np.array([0, 10**14])
    assert offset_by_arrival(a, elsewhere) is None, "another machine's clock"
    assert offset_by_arrival(a, b[:0]) is None
