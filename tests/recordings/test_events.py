"""Events at a moment, and spells with a start and an end."""

from dataclasses import replace

from devices.events import Event, spells_of
from fusion.body import KINECT_V1
from recordings.file.session_writer import write_session
from recordings.session import Session
from tests.helpers.frame_pairs import frame_pairs
from tests.helpers.two_views import calibration_of

LOST = Event("A is lost", "WARN", "A", "start", frame=2, time_ns=66_000_000)
TURNED = Event("B is mirrored", "INFO", "B", "start", frame=3, time_ns=99_000_000)
BACK = Event("A is back", "INFO", "A", "end", frame=5, time_ns=165_000_000)


def test_a_spell_is_read_back_as_it_was_written(fused_run, tmp_path):
    session = fused_run(frame_pairs(KINECT_V1, 8), calibration_of(KINECT_V1))
    events = (*session.events, LOST, TURNED, BACK)
    write_session(replace(session, events=events), tmp_path / "spells.rrd")
    read = Session.open(tmp_path / "spells.rrd")
    assert read.damage is None
    assert read.events == events
    lost, turned = read.spells
    assert (lost.start, lost.end) == (LOST, BACK)
    assert (turned.start, turned.end) == (TURNED, None)


def test_a_spell_that_starts_again_before_its_end_stays_one_spell():
    again = replace(LOST, frame=4)
    assert [(spell.start, spell.end) for spell in spells_of([LOST, again, BACK, BACK])] == [(LOST, BACK)]
    assert spells_of([BACK, Event("moment", "INFO")]) == []
