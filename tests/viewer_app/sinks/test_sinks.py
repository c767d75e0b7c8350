"""Every sink gets the loop's frames. A sink that fails does not affect the others."""

import errno
import os
import random
import signal
import subprocess
import sys
import threading
import time
import tracemalloc
from collections import deque
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import rerun as rr
from hypothesis import assume, given
from hypothesis import strategies as st

from devices.azure.mkv import MkvRecording
from devices.azure.mkv_writer import MkvWriter
from devices.blazepose.tracked_images import registered_color
from devices.capture.settings import CaptureSettings
from devices.events import Event
from devices.pairing import clock_by_arrival, clock_by_cable
from devices.sensor import ColorCamera, ColorImage, Sensor, SensorFrame
from fusion.calibration.calibration import nominal_calibration
from fusion.intrinsics import NOMINAL_INTRINSICS, Intrinsics
from fusion.rigid import RigidTransform
from fusion.setup import FusionSetup
from recordings.data import layout
from recordings.session import Session
from recordings.writing.recorder import Recorder
from tests.helpers.live_frames import frames, known_fuser, numbers_in, session
from tests.helpers.machine import need_viewer, small_disk
from tests.helpers.mkv_writer import depth_image, grey_color, lens_of, write_mkv
from tests.helpers.pictures import headless_viewer
from tests.helpers.real_libraries import PYK4A
from tests.helpers.two_views import FRAME_NS
from tests.helpers.waiting import eventually
from viewer_app.sinks import item_queue
from viewer_app.sinks.item_queue import DropOldest, QueuedFrame
from viewer_app.sinks.live_session import SAMPLE, LiveSession
from viewer_app.sinks.queued_file import QueuedFile
from viewer_app.sinks.raw_recording import RawRecorder, _FileTimes
from viewer_app.sinks.session_file import SessionFile
from viewer_app.sinks.sink import FanOut, Sink
from viewer_app.sinks.viewer_sink import ImageTurns, ViewerFeed
from viewer_app.viewer.blueprint import session_blueprint
from viewer_app.viewer.hub import Hub
from viewer_app.viewer.rerun_process import stop
from viewer_app.viewer.viewer_choice import Viewing
from viewer_app.viewer.window import viewer_url

LOST = Event("A is lost", "WARN", "A", "start")


class Kept(Sink):
    """Records its calls; ``close`` raises if requested."""

    def __init__(self, fault=None):
        self.calls = []
        self._fault = fault

    def __getattribute__(self, name):
        if name.startswith("_") or name == "calls":
            return super().__getattribute__(name)

        def call(*arguments):
            self.calls.append((name, arguments))
            if name == "close" and self._fault is not None:
                raise self._fault

        return call


def use(sink):
    fuser = known_fuser()
    sink.write(frames(fuser, 1)[0])
    sink.event(LOST)
    sink.recalibrated(fuser.setup)
    sink.coach(None)
    sink.finish()
    sink.close()


def test_every_sink_gets_everything_in_order():
    one, two = Kept(), Kept()
    use(FanOut((one, two)))
    assert [name for name, _ in one.calls] == [
        "write", "event", "recalibrated", "coach", "finish", "close",
    ]  # fmt: skip
    assert [name for name, _ in two.calls] == [name for name, _ in one.calls]
    assert one.calls[1] == ("event", (LOST,))


def test_all_are_closed_although_one_fails():
    one, two, three = Kept(), Kept(OSError("the disk is full")), Kept()
    with pytest.raises(OSError, match="the disk is full"):
        FanOut((one, two, three)).close()
    assert one.calls == two.calls == three.calls == [("close", ())]


# --- The file behind a queue: whatever the disk does, each frame is written, or counted as lost and said.


class Disk(QueuedFile[float]):
    """A file of numbers on a disk with room for some; n + 0.5 is without images, text is no frame."""

    keep, keep_with_images, frame_type = 6, 3, float

    def __init__(self, room, fault=None, **options):
        super().__init__(Path("s.rrd"), "test", **options)
        self.go, self.content = threading.Event(), []
        self.room, self.fault = room, fault
        self._thread.start()

    def _write(self):
        self.go.wait(20.0)
        while items := self._queue.take(None, most=1):
            if self.fault is not None:
                raise self.fault
            if isinstance(items[0], str):
                continue
            if len(self.content) >= self.room:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            self.content += items
            self.written += 1

    def _without_images(self, item):
        return item + 0.5


@given(frames=st.lists(st.booleans(), max_size=12), room=st.integers(0, 8), late=st.integers(0, 2))
def test_each_frame_is_written_or_counted_and_said(frames, room, late):
    said = []
    file = Disk(room, on_failure=said.append)
    for number, is_frame in enumerate(frames):
        file._queue.put(float(number) if is_frame else "an event")
        assert len(file._queue) <= 6 + frames[: number + 1].count(False)
    waiting, thinned = list(file._queue), file.without_images
    file.go.set()
    file.close()
    for number in range(late):
        file._queue.put(float(number))
    file.close()
    kept = [item for item in waiting if not isinstance(item, str)]
    full = len(kept) > room
    assert file.content == kept[:room]
    assert file.written == len(file.content)
    assert file.lost + file.written == frames.count(True) + late
    assert thinned == sum(item % 1 == 0.5 for item in kept)
    assert said == [file.failure] * full
    assert full == (file.failure is not None and "No space left on device" in file.failure)
    why = "" if full else ": the disk was too slow"  # a failure says its own reason
    frames = "1 frame is" if file.lost == 1 else f"{file.lost} frames are"
    assert (f"{file.path}: {frames} not saved{why}." in file.missing) == (file.lost > 0)


def test_a_fault_of_the_writer_reaches_who_closes_once():
    file = Disk(9, fault=ValueError("broken"))
    file._queue.put(1.0)
    file.go.set()
    with pytest.raises(ValueError, match="broken"):
        file.close()
    file.close()
    assert (file.written, file.lost) == (0, 1)


# --- The queue of a sink: what does not fit gives way as the policy says, and nothing else.


@given(keep=st.integers(1, 5), kinds=st.lists(st.booleans(), max_size=40), others=st.integers(1, 6))
def test_the_newest_frames_and_events_are_kept_in_order_and_lost_frames_counted(keep, kinds, others):
    policy, queued, put = DropOldest(keep), deque(), []
    limit, item_queue._KEPT_OTHERS = item_queue._KEPT_OTHERS, others
    try:
        for k, is_frame in enumerate(kinds):
            item = QueuedFrame(k, None, k, k) if is_frame else Event(str(k))
            put.append(item)
            queued.append(policy(queued, item))
    finally:
        item_queue._KEPT_OTHERS = limit
    frames = [item for item in put if isinstance(item, QueuedFrame)]
    events = [item for item in put if isinstance(item, Event)]
    kept = {id(item) for item in (*frames[-keep:], *events[-others:])}
    assert [id(item) for item in queued] == [id(item) for item in put if id(item) in kept]
    assert policy.dropped == max(len(frames) - keep, 0)


# --- The loop never waits for a viewer, and the file gets all frames.


STUCK = [sys.executable, "-c", "import time; time.sleep(600)"]
"""A process that never reads: a frozen viewer."""


def feed_into(command, fuser, **options):
    return ViewerFeed(
        lambda: subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, bufsize=0, start_new_session=True
        ),
        rr.RecordingStream("test"),
        lambda stream: Recorder(stream, fuser.setup, ("a", "b")),
        **options,
    )


COPY = """import sys
with open(sys.argv[1], "wb", buffering=0) as file:
    while data := sys.stdin.buffer.raw.read(65536):
        file.write(data)
"""


def test_a_viewer_shows_a_sample_until_the_session_begins(tmp_path, fuser):
    shown, sample = tmp_path / "shown.rrd", SAMPLE.read_bytes()
    feed = feed_into([sys.executable, "-c", COPY, str(shown)], fuser, sample=SAMPLE)
    for frame in frames(fuser, 3):
        feed.write(frame)
    assert eventually(lambda: shown.exists() and shown.read_bytes() == sample)
    assert not feed.wait_until_free(0.5), "the frames wait"
    feed.begin()
    assert eventually(lambda: shown.stat().st_size > len(sample))
    feed.close()
    assert shown.read_bytes().startswith(sample)


def test_the_sample_is_of_todays_layout():
    """Else ``python -m tests.experiments.recorded_sample`` makes it again."""
    about = Session.open(SAMPLE).about["session"]
    assert about["layout_version"][0] == layout.VERSION


@pytest.fixture
def stuck(fuser):
    feed = feed_into(STUCK, fuser, keep=10, patience=60.0)
    yield feed
    feed.close()


def test_a_frozen_viewer_costs_the_loop_nothing_and_loses_the_oldest_frames(stuck, fuser):
    made = frames(fuser, 100, depth=True)  # 87 MB: more than the capacity of a pipe
    slowest = 0.0
    for frame in made:
        before = time.perf_counter()
        stuck.write(frame)
        slowest = max(slowest, time.perf_counter() - before)
        time.sleep(0.002)  # the pace of a fast loop, in which the feed's thread gets its turns
    assert stuck.dropped >= 50
    waiting = [item.number for item in stuck._queue.take(0.0) if isinstance(item, QueuedFrame)]
    assert waiting == list(range(90, 100))
    assert slowest < 3.0  # it would be 60 s, the patience, if it waited


def test_the_layout_is_made_anew_where_b_stands_elsewhere_and_not_for_a_refinement(fuser):
    need_viewer()
    made = []

    def framed(setup):
        made.append(setup)
        return session_blueprint(setup, np.array([0.1, 0.1, 2.6]), "setup", live=True, card=True)

    nominal = FusionSetup(nominal_calibration(fuser.setup.body))
    found = fuser.setup
    turned = RigidTransform.of(np.eye(3), found.calibration.a_from_b.translation + [0.1, 0.0, 0.0])
    refined = FusionSetup(replace(found.calibration, a_from_b=turned))
    provisional = FusionSetup(replace(found.calibration, provisional=True))
    viewing = Viewing(hub=Hub.on_free_ports(web=False))
    with LiveSession(nominal, ("a", "b"), framed(nominal), viewing=viewing, reframed=framed) as live:
        made.clear()
        for setup in (provisional, found, refined, nominal):
            live.recalibrated(setup)
    assert made == [found]


def test_closing_with_a_frozen_viewer_takes_no_time(fuser):
    feed = feed_into(STUCK, fuser, keep=10, patience=60.0)
    for frame in frames(fuser, 40, depth=True):
        feed.write(frame)
    before = time.perf_counter()
    feed.close()
    assert time.perf_counter() - before < 20.0  # it would be 600 s if it waited for the process
    assert feed.process.poll() is not None


def test_a_process_without_progress_is_replaced(fuser):
    feed = feed_into(STUCK, fuser, keep=10, patience=0.2, retry=0.01)
    made = frames(fuser, 60, depth=True)
    try:
        for frame in made:
            feed.write(frame)
        assert eventually(lambda: feed.starts >= 2)
    finally:
        feed.close()


def test_a_blocked_disk_costs_images_first(fuser, tmp_path, monkeypatch):
    monkeypatch.setattr(SessionFile, "_run", lambda self: None)
    file = SessionFile(
        tmp_path / "s.rrd",
        lambda: rr.RecordingStream("test"),
        lambda stream: Recorder(stream, fuser.setup, ("a", "b")),
    )
    made = frames(fuser, 70, depth=True)
    for number in range(2000):
        file.write(made[number % 70])
    assert file.without_images == 1800 - 60
    assert file.lost == 200
    queued = [item for item in file._queue.take(0.0) if isinstance(item, QueuedFrame)]
    with_images = [item for item in queued if item.frame.pair.a.depth is not None]
    assert len(with_images) == 60


def test_the_viewer_gets_images_at_a_capped_rate(fuser):
    turns = ImageTurns(10.0)
    shown = [turns.capped(frame) for frame in frames(fuser, 60, depth=True)]
    with_images = [
        [k for k, frame in enumerate(shown) if getattr(frame.pair, side).depth is not None] for side in "ab"
    ]
    assert with_images == [list(range(1, 60, 3)), list(range(2, 60, 3))]  # 10 Hz, one at a time


def test_a_viewer_killed_again_and_again_loses_no_frame_of_the_file(fuser, tmp_path):
    need_viewer()
    out = tmp_path / "s.rrd"
    made = frames(fuser, 600)
    hub = Hub.on_free_ports(web=False)
    kills = 0
    with session(fuser, out, hub, window=True) as live:
        for k, frame in enumerate(made):
            live.write(frame)
            if k % 100 == 50:
                victim = (live.viewer.window.process, live.viewer.process)[kills % 2]
                os.kill(victim.pid, signal.SIGSTOP if k == 550 else signal.SIGKILL)
                kills += 1
            time.sleep(0.01)  # the pace of a loop, so that viewers die in the middle of it
        assert live.viewer.starts >= 2
        live.finish()
        live.save()
        window = live.viewer.window.process
    stop(window)
    assert kills == 6
    assert numbers_in(out) == list(range(600))


def test_a_viewer_that_comes_later_sees_the_history(fuser):
    hub = Hub.on_free_ports(web=False)
    with session(fuser, None, hub) as live:
        for frame in frames(fuser, 60):
            live.write(frame)
        assert live.viewer.wait_until_free(10.0)
        with headless_viewer("--connect", hub.url) as viewer:

            def sees_all():
                timelines = [t for r in viewer.get_state().recordings for t in r.timelines]
                return any(t.name == layout.FRAME and t.start == 0 and t.end == 59 for t in timelines)

            assert eventually(sees_all)


def test_a_window_stands_still_when_the_session_has_ended(fuser):
    """One whose time runs draws all the time, with memory that some drivers never free."""
    need_viewer()
    from rerun.experimental import ViewerClient

    with session(fuser, None, Hub.on_free_ports(web=False), window=True) as live:
        for frame in frames(fuser, 60):
            live.write(frame)
        live.viewer.wait_until_free(10.0)
    window = live.viewer.window
    viewer = ViewerClient.connect(viewer_url(window.port))

    def times():
        return [each.current_time for each in viewer.get_state().recordings]

    try:
        assert eventually(lambda: times() == [59 * FRAME_NS])  # a slow viewer has drawn nothing yet
        viewer.set_time(layout.TIME, duration=0)  # from where one that follows goes to the end again
        time.sleep(0.5)
        assert times() == [0]
        viewer.set_time(play_state="following")
        assert window.pause(59 * FRAME_NS, 10.0)
        viewer.set_time(play_state="following")
        assert not window.pause(10**12, 0.1)  # it has not read so far, and stands there all the same
        viewer.set_time(layout.TIME, duration=0)
        time.sleep(0.5)
        assert times() == [0]
        window.process.send_signal(signal.SIGSTOP)
        assert not window.pause(0, 0.1)  # one that hangs does not keep the program
    finally:
        window.process.kill()
        stop(window.process)


# --- Raw recordings: what is in them, and what becomes of them when disk, sensor or program fail.


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


@pytest.mark.parametrize(("known", "late"), [(False, 1), (False, 12), (False, 31), (True, 31)])
def test_colour_that_starts_late_is_recorded_within_a_second_or_where_it_is_known(known, late, tmp_path):
    """A Kinect v1 starts its depth camera first. Without colour nobody would be found in its recording."""
    sensor, camera = Camera(), ColorCamera(LENS, RigidTransform.identity())
    sensor.color_camera = camera if known else None
    color = ColorImage(b"\xff\xd8colour\xff\xd9", camera)
    frames = [
        replace(frame(number), ir=None, color=color if number >= late else None) for number in range(late + 3)
    ]
    with RawRecorder(tmp_path / "a.mkv", sensor, CaptureSettings(color="720P")) as recorder:
        for number, each in enumerate(frames):
            assert number != 31 or eventually(lambda: recorder.written == 31)
            recorder.add(each)
    found, _ = read(recorder.path)
    assert [each.time_ns for each in found] == [each.time_ns for each in frames]
    has_colour = [False] * late + [known or late < 31] * 3
    assert [each.color is not None for each in found] == has_colour


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
    assert sorted(tmp_path.iterdir()) == [tmp_path / "a-2.mkv", older]
    assert len(read(tmp_path / "a-2.mkv")[0]) == 1


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
    for clock_ns, count, away_s in clocks:
        true_ns += round(away_s * 1e9)
        if previous_ns is not None:  # less than half a second is no new clock; nor is a gap to be told from
            moved_ns, gap_ns = clock_ns - was_ns, true_ns + PERIOD_NS + clock_ns - previous_ns
            assume(moved_ns > 600_000_000 or (moved_ns < -600_000_000 and gap_ns <= 0))
        was_ns = clock_ns
        held_until_ns = 0
        for k in range(count):
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
    found = clock_by_arrival(a, b)
    wrong = b_times + found.at(b_times) - a[:, 0]
    assert np.abs(wrong).max() < 200_000, "a fifth of a millisecond, where arrivals scatter by three"
    for start_ns, corrected in ((1_234_000_000_000, True), (0, False)):
        # on a sync cable, 160 µs later; the master has set the subordinate's clock, or has not
        captured = times + start_ns
        on_a = times + 160_000
        rough = replace(found, offset_ns=start_ns + 2_900_000.0, rate_ppm=0.0)
        exact = clock_by_cable(rough, 160_000, captured, on_a)
        assert (exact is not None) is corrected
        if exact is not None:
            assert np.abs(on_a + exact.at(on_a) - captured - 160_000).max() < 1000
    elsewhere = b + np.array([0, 10**14])
    assert clock_by_arrival(a, elsewhere) is None, "another machine's clock"
    assert clock_by_arrival(a, b[:0]) is None
