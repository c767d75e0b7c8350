"""A damaged session gives one line of error, or exactly the first frames; cut off, its events, too."""

from collections import Counter
from dataclasses import replace

import pyarrow as pa
import pytest
import rerun as rr

from devices.events import Event
from fusion.body import KINECT_V1
from recordings import Session, fuse
from recordings.data import layout
from recordings.errors import RecordingError
from recordings.file.session_writer import write_session
from tests.helpers.damage import damaged, opened
from tests.helpers.frame_pairs import frame_pairs
from tests.helpers.fused_runs import record_fused
from tests.helpers.recorded_pairs import write_recordings
from tests.helpers.two_views import calibration_of


def test_random_damage_gives_the_beginning_or_one_line(tmp_path):
    pairs = frame_pairs(KINECT_V1, 24, gap=(7,), only_a=(9, 10), no_b=(15,), depth=True)
    whole = record_fused(tmp_path / "whole.rrd", pairs, calibration_of(KINECT_V1), depth_every=1, block=8)
    data, path = whole.path.read_bytes(), tmp_path / "damaged.rrd"
    outcomes = Counter()
    for seed in range(24):
        path.write_bytes(damaged(data, seed))
        session = opened(path, whole)
        known = "refused" if session is None else "whole" if len(session) == len(whole) else "beginning"
        outcomes[known] += 1
    assert outcomes["beginning"] > 0
    assert outcomes["refused"] < 12


_BLOCK = 10


@pytest.fixture(scope="module")
def told(tmp_path_factory):
    """A session with an event at every second frame."""
    session = fuse(*write_recordings(tmp_path_factory.mktemp("told")))
    events = [Event(f"event {k}").placed(k, int(session.time_ns[k])) for k in range(0, len(session), 2)]
    return replace(session, events=tuple(events))


def test_a_folder_in_which_no_file_can_be_created_is_an_error_of_the_system(told, tmp_path):
    """Rerun raises a RuntimeError, which nobody would expect."""
    with pytest.raises(OSError, match="No such file"):
        write_session(told, tmp_path / "missing" / "s.rrd")


def test_events_are_kept_up_to_the_cut(told, tmp_path):
    whole, cut = tmp_path / "s.rrd", tmp_path / "cut.rrd"
    write_session(told, whole, block=_BLOCK)
    data = whole.read_bytes()
    assert len(Session.open(whole).events) == len(told.events)
    lengths = set()
    for share in range(30, 100, 5):
        cut.write_bytes(data[: len(data) * share // 100])
        try:
            found = Session.open(cut)
        except RecordingError:
            continue  # not one whole frame
        lengths.add(len(found))
        kept = {event.frame for event in found.events}
        # what was written in one go, frames and events, may be torn apart: at most two blocks
        assert kept >= set(range(0, len(found) - 2 * _BLOCK, 2)), share
    assert len(lengths) >= 3, "the cuts fall between frames"


@pytest.mark.parametrize("moment", [{"sequence": 1}, {"duration": 1.0}, {"timestamp": 1.7e9}])
def test_a_recording_of_another_program_is_refused_whatever_its_frames_are(moment, tmp_path):
    stream = rr.RecordingStream("another")
    stream.save(tmp_path / "s.rrd")
    stream.set_time(layout.FRAME, **moment)
    stream.log(
        layout.FUSED_SKELETON, rr.Points3D([[0.0, 0.0, 0.0]]), rr.AnyValues(day=pa.array([1], pa.date32()))
    )
    stream.disconnect()
    with pytest.raises(RecordingError, match="not a session of duplex-kinects"):
        Session.open(tmp_path / "s.rrd")
