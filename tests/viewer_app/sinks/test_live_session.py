"""The loop never waits for a viewer, and the file gets all frames."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest
import rerun as rr

from fusion.calibration.calibration import nominal_calibration
from fusion.rigid import RigidTransform
from fusion.setup import FusionSetup
from recordings.data import layout
from recordings.writing.recorder import Recorder
from tests.helpers.live_frames import frames, numbers_in, session
from tests.helpers.machine import need_viewer
from tests.helpers.pictures import headless_viewer
from tests.helpers.waiting import eventually
from viewer_app.sinks.item_queue import QueuedFrame
from viewer_app.sinks.live_session import LiveSession
from viewer_app.sinks.session_file import SessionFile
from viewer_app.sinks.viewer_sink import ImageTurns, ViewerFeed
from viewer_app.viewer.blueprint import session_blueprint
from viewer_app.viewer.hub import Hub
from viewer_app.viewer.rerun_process import stop
from viewer_app.viewer.viewer_choice import Viewing

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
