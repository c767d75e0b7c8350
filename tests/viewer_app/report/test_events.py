"""The numbered list of a session's events, and the event at which a review opens."""

from dataclasses import replace

import pytest

from devices.events import Event, Spell
from fusion.body import KINECT_V2
from tests.helpers.frame_pairs import frame_pairs
from tests.helpers.two_views import calibration_of
from viewer_app.report.events import list_events, opening_event, shortest_list

CALIBRATED = Event("calibrated: start-up pose, 91 frames", "INFO")
CUT_OFF = Event("a.csv is cut off", "WARN")
EARLY = Event("Too close to sensor B", "WARN").placed(20, 700_000_000)
A_FROM = Event(
    "A reports left and right exchanged", "INFO", "exchanged_a", "start", frame=168, time_ns=5_600_000_000
)
B_FROM = Event(
    "B reports left and right exchanged", "INFO", "exchanged_b", "start", frame=180, time_ns=6_000_000_000
)
A_TO = Event(
    "A reports left and right correctly again", "INFO", "exchanged_a", "end", frame=189, time_ns=6_300_000_000
)
MOVED = Event("A sensor seems to have been moved", "WARN").placed(600, 20_000_000_000)
ALL = [CALIBRATED, CUT_OFF, EARLY, A_FROM, B_FROM, A_TO, MOVED]


def test_events_are_numbered_in_order_of_time_and_a_spell_is_one_of_them():
    listed = list_events([MOVED, A_FROM, B_FROM, A_TO, CALIBRATED])  # a fused session has them in two parts
    texts = [event.text for event in (CALIBRATED, A_FROM, B_FROM, MOVED)]
    assert [(each.number, each.event.text) for each in listed] == list(enumerate(texts, 1))
    assert [each.spell for each in listed] == [None, Spell(A_FROM, A_TO), Spell(B_FROM, None), None]


@pytest.mark.parametrize(
    ("events", "settled", "expected"),
    [
        (ALL, 0, EARLY),  # the first warning, though a spell comes earlier than another warning
        (ALL, 100, MOVED),  # a warning while the sensors were set up counts less
        ([CALIBRATED, CUT_OFF, EARLY, A_FROM, A_TO], 100, A_FROM),
        ([CALIBRATED, CUT_OFF, EARLY], 100, EARLY),
        ([CALIBRATED, CUT_OFF], 0, None),  # both are about the recording as a whole
        ([], 0, None),
    ],
)
def test_a_review_opens_at_a_warning_then_at_a_spell(events, settled, expected):
    opened = opening_event(list_events(events), settled)
    assert (None if opened is None else opened.event.text) == (None if expected is None else expected.text)


def test_a_session_is_settled_with_its_first_calibration_that_is_not_provisional(fused_run):
    session = fused_run(frame_pairs(KINECT_V2, 30), calibration_of(KINECT_V2))
    one = session.calibration
    found = tuple((10 * k, replace(one, provisional=k < 2)) for k in range(3))
    assert replace(session, calibrations=found).first_calibrated_frame == 20
    assert replace(session, calibrations=found[:2]).first_calibrated_frame is None


def test_a_short_list_keeps_warnings_then_spells_in_order_of_time():
    listed = list_events(ALL)
    short = [event.text for event in (CUT_OFF, EARLY, A_FROM, MOVED)]
    assert [each.event.text for each in shortest_list(listed, 4)] == short
    assert shortest_list(listed, 99) == listed
