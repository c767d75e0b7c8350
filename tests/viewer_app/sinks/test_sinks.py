"""Every sink gets the loop's frames. A sink that fails does not affect the others."""

import errno
import os
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import rerun as rr
from hypothesis import given
from hypothesis import strategies as st

from devices.events import Event
from fusion.calibration.calibration import nominal_calibration
from fusion.rigid import RigidTransform
from fusion.setup import FusionSetup
from recordings.data import layout
from recordings.session import Session
from recordings.writing.recorder import Recorder
from tests.helpers.live_frames import frames, known_fuser, numbers_in, session
from tests.helpers.machine import need_viewer
from tests.helpers.pictures import headless_viewer
from tests.helpers.waiting import eventually
from viewer_app.sinks import item_queue
from viewer_app.sinks.item_queue import DropOldest, QueuedFrame
from viewer_app.sinks.live_session import SAMPLE, LiveSession
from viewer_app.sinks.queued_file import QueuedFile
from viewer_app.sinks.session_file import SessionFile
from viewer_app.sinks.sink import FanOut, Sink
from viewer_app.sinks.viewer_sink import ImageTurns, ViewerFeed
from viewer_app.viewer.blueprint import session_blueprint
from viewer_app.viewer.hub import Hub
from viewer_app.viewer.rerun_process import stop
from viewer_app.viewer.viewer_choice import Viewing

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


def test_a_sink_without_methods_takes_everything():
    use(Sink())


# --- The file behind a queue: whatever the disk does, each frame is written, or counted as lost and said.


class Disk(QueuedFile[float]):
    """A file of numbers on a disk with room for some; n + 0.5 is without images, text is no frame."""

    keep, keep_with_images, frame_type = 6, 3, float

    def __init__(self, room, placed=True, fault=None, **options):
        super().__init__(Path("s.rrd"), "test", **options)
        self.go, self.content = threading.Event(), []
        self.room, self.place, self.fault = room, SimpleNamespace(placed=placed), fault
        self._thread.start()

    def _write(self):
        self.go.wait(20.0)
        while items := self._queue.take(None, most=1):
            if self.fault is not None:
                raise self.fault
            if isinstance(items[0], str):
                continue
            with self._counting(1, self.place):
                if len(self.content) >= self.room:
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
                self.content += items

    def _without_images(self, item):
        return item + 0.5


@given(
    frames=st.lists(st.booleans(), max_size=12), room=st.integers(0, 8), placed=st.booleans(),
    late=st.integers(0, 2),
)  # fmt: skip
def test_each_frame_is_written_or_counted_and_said(frames, room, placed, late):
    said = []
    file = Disk(room, placed, on_failure=said.append)
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
    assert file.written == (0 if full and not placed else len(file.content))
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


def test_the_file_gets_every_frame_and_closing_writes_them(fuser, tmp_path):
    out = tmp_path / "s.rrd"
    with session(fuser, out) as live:
        for frame in frames(fuser, 200):
            live.write(frame)
        live.finish()
    assert numbers_in(out) == list(range(200))
    assert live.file.lost == 0


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
