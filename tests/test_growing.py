"""Nothing is lost: not to a kill, not to a full disk."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import rerun as rr

from fusion.body import KINECT_V1
from fusion.fuser import Fuser
from recordings.arrays import RecordedFrame
from recordings.growing import GrowingSession
from recordings.session import Session
from recordings.testing import assert_sessions_match, record_fused
from tests.frame_pairs import calibration_of, frame_pairs

ROOT = Path(__file__).resolve().parent.parent


def fused_frames(count: int, depth: bool = False) -> tuple[Fuser, list[RecordedFrame]]:
    fuser = Fuser(calibration_of(KINECT_V1))
    pairs = frame_pairs(KINECT_V1, count, no_b=(5,), depth=depth)
    return Fuser(calibration_of(KINECT_V1)), [
        RecordedFrame(pair, fuser.update(pair.skeletons), 0) for pair in pairs
    ]


def test_it_is_the_same_session_as_one_written_at_once(tmp_path: Path) -> None:
    fuser, frames = fused_frames(50)
    with GrowingSession(tmp_path / "s.rrd", fuser, ("a", "b"), period=0.02) as growing:
        for frame in frames[:30]:
            growing.record(frame)
        growing.event("flip repaired", "WARN")
        for frame in frames[30:]:
            growing.record(frame)
    at_once = record_fused(tmp_path / "o.rrd", [frame.pair for frame in frames], calibration_of(KINECT_V1))
    session = Session.open(tmp_path / "s.rrd")
    assert_sessions_match(session, at_once, position_mm=0.0)
    assert [(event.frame, event.text, event.level) for event in session.events] == [
        (29, "flip repaired", "WARN")
    ]
    assert {path.name for path in tmp_path.iterdir()} == {"s.rrd", "o.rrd"}


def test_depth_is_kept_at_the_rate_asked_for(tmp_path: Path) -> None:
    fuser, frames = fused_frames(8, depth=True)
    with GrowingSession(tmp_path / "s.rrd", fuser, ("a", "b"), depth_every=2) as growing:
        for frame in frames:
            growing.record(frame)
    assert growing.depth_dropped == 0
    session = Session.open(tmp_path / "s.rrd")
    assert (len(session), session.damage) == (8, None)
    assert [frame for frame, _ in session.depth("a")] == [0, 2, 4, 6]
    with pytest.warns(rr.error_utils.RerunWarning, match="no footer"):  # and it can be read all the same
        chunks = rr.chunk.RrdReader(session.path).stream().to_chunks()
    assert sum(chunk.num_rows for chunk in chunks if chunk.entity_path == "/fused/skeleton") == 8 + 1


_CHILD = """
import sys, time
from pathlib import Path
from tests.test_growing import fused_frames
from recordings.growing import GrowingSession
fuser, frames = fused_frames(300)
growing = GrowingSession(Path(sys.argv[1]), fuser, ("a", "b"))
for frame in frames:
    growing.record(frame)
    print("recorded", flush=True)
    time.sleep(1 / 30)
"""


def test_a_killed_process_leaves_all_but_the_last_second(tmp_path: Path) -> None:
    path = tmp_path / "s.rrd"
    child = subprocess.Popen(
        [sys.executable, "-c", _CHILD, str(path)], stdout=subprocess.PIPE, text=True, cwd=ROOT
    )
    assert child.stdout is not None
    for recorded, _ in enumerate(child.stdout, 1):
        if recorded == 75:
            os.kill(child.pid, signal.SIGKILL)
            break
    child.wait()
    session = Session.open(path)
    assert 75 - 30 <= len(session) <= 75 + 5
    assert session.damage is not None
    _, frames = fused_frames(len(session))
    np.testing.assert_array_equal(
        session.rows.fused, np.array([frame.fused.positions for frame in frames]).astype(np.float32)
    )


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full on this system")
def test_a_full_disk_stops_the_saving_and_nothing_else(tmp_path: Path) -> None:
    (tmp_path / "s.rrd").symlink_to("/dev/full")
    fuser, frames = fused_frames(6)
    said: list[str] = []
    with GrowingSession(
        tmp_path / "s.rrd", fuser, ("a", "b"), on_failure=said.append, period=0.01
    ) as growing:
        for frame in frames:
            growing.record(frame)
    assert growing.failure is not None
    assert "No space left on device" in growing.failure
    assert "the fusion goes on" in growing.failure
    assert said == [growing.failure]


def test_a_slow_disk_costs_depth_images_and_no_skeleton(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("recordings.growing._DEPTH_WAITING", -1)
    fuser, frames = fused_frames(10, depth=True)
    with GrowingSession(tmp_path / "s.rrd", fuser, ("a", "b"), depth_every=1) as growing:
        for frame in frames:
            growing.record(frame)
    session = Session.open(tmp_path / "s.rrd")
    assert len(session) == 10
    assert list(session.depth("a")) == []
    assert growing.depth_dropped == 19  # B did not deliver one frame
