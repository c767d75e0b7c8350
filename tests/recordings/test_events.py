"""Events at a moment, spells with a start and an end, and limbs that a view reports at a wrong place."""

from dataclasses import replace

import numpy as np
import pytest

from devices.events import Event, spells_of
from fusion.body import KINECT_V1, KINECT_V2
from fusion.fused_frame import FusedFrame
from fusion.skeleton import Skeleton, SkeletonPair, TrackingState
from recordings.file.session_writer import write_session
from recordings.fusing.view_events import ViewEvents
from recordings.session import Session
from tests.helpers.frame_pairs import frame_pairs
from tests.helpers.two_views import A_FROM_B, FRAME_NS, calibration_of, standing
from viewer_app.report.events import event_in_words, list_events

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


def test_a_short_interruption_does_not_end_a_spell():
    soon, late = (replace(LOST, time_ns=BACK.time_ns + gap) for gap in (400_000_000, 600_000_000))
    ended = replace(BACK, time_ns=late.time_ns + 900_000_000)
    assert [(s.start, s.end) for s in spells_of([LOST, BACK, soon, ended])] == [(LOST, ended)]
    assert [(s.start, s.end) for s in spells_of([LOST, BACK, late, ended])] == [(LOST, BACK), (late, ended)]
    (listed,) = list_events([LOST, BACK, soon, ended])
    assert event_in_words(listed) == "Warning: A is lost. It lasted 1.6 s."
    (moment,) = list_events([LOST, replace(BACK, time_ns=LOST.time_ns + 33_000_000)])
    assert event_in_words(moment) == "Warning: A is lost. It lasted 33 ms."


BODY = KINECT_V2
ARM = [BODY.joint(f"{name}_LEFT") for name in ("ELBOW", "WRIST", "HAND")]


def told_of(
    wrong_frames, *, sensor="B", off=0.5, share=0.0, joints=3, state=TrackingState.TRACKED,
    exchanged=(0, 0), mirrored="", mirrored_frames=90, other_off=0.0, reset_at=90,
):  # fmt: skip
    """The events, with their frames, of a view whose left arm is wrong from frame 10 on."""
    views_of, truth = ViewEvents(BODY), standing(BODY)
    told = []
    for k in range(90):
        time_ns = (k if k < reset_at else k - 300) * FRAME_NS
        wrong = 10 <= k < 10 + wrong_frames
        shift, weights, states = np.zeros((len(BODY), 3)), np.full(len(BODY), 0.5), np.full(len(BODY), 2)
        if wrong:
            shift[ARM[:joints], 1], weights[ARM], states[ARM] = off, share, state
        views = {"A": truth.copy(), "B": truth.copy()}
        views[sensor] += shift
        views["B" if sensor == "A" else "A"][ARM, 1] += other_off
        if k < mirrored_frames:  # S* has the sides that these views exchange
            views |= {side: views[side][BODY.mirror] for side in mirrored}
        whole = np.full(len(BODY), TrackingState.TRACKED)
        pair = SkeletonPair(
            Skeleton.of(BODY, views["A"], states if sensor == "A" else whole, time_ns),
            Skeleton.of(BODY, A_FROM_B.inverse().apply(views["B"]), states if sensor == "B" else whole, 0),
            time_ns,
        )
        fused = FusedFrame(
            truth, np.zeros(len(BODY), bool), weights if sensor == "A" else 1.0 - weights,
            weights if sensor == "B" else 1.0 - weights, np.full(len(BODY), -1), A_FROM_B, 1, False, False,
            time_ns, exchanged_a=exchanged[0], exchanged_b=exchanged[1],
        )  # fmt: skip
        told += [(k, each) for each in views_of.observe(pair, fused)]
    return told


@pytest.mark.parametrize(("sensor", "other"), [("A", "B"), ("B", "A")])
def test_a_lost_arm_is_told_with_its_distance_and_its_end(sensor, other):
    (begun, start), (ended, end) = told_of(30, sensor=sensor)
    text = f"{sensor} loses the left arm, 0.5 m off; S* follows {other}."
    assert start == Event(text, "INFO", f"lost_{sensor.lower()}_left_arm", "start")
    assert begun == 10 + 16  # 15 intervals of 33.3 ms are just short of half a second
    # 30 frames are 29 intervals; 0.1 s later it is certain
    assert end == Event(f"{sensor} finds the left arm again, after 1.0 s.", "INFO", start.topic, "end")
    assert ended == 39 + 4


def test_what_is_short_near_counted_guessed_single_or_exchanged_is_no_lost_limb():
    assert told_of(30) != []
    assert told_of(14) == []
    assert told_of(30, off=0.15) == []
    assert told_of(30, share=0.2) == []
    assert told_of(30, state=TrackingState.INFERRED) == []
    assert told_of(30, joints=1) == []
    assert told_of(30, exchanged=(3, 3)) == []
    assert told_of(30, other_off=0.4) != []
    assert told_of(30, other_off=0.6) == []  # S* follows neither


def test_a_limb_is_lost_beside_a_view_whose_sides_s_star_corrects():
    told = told_of(30, sensor="A", exchanged=(0, 3), mirrored="B")
    assert "A loses the left arm, 0.5 m off; S* follows B." in [event.text for _, event in told]


def test_sides_that_s_star_no_longer_corrects_are_uncertain():
    (_, start), (ended, end) = told_of(0, exchanged=(3, 0), mirrored="A", mirrored_frames=31)
    assert (start.topic, start.phase, ended) == ("exchanged_a", "start", 31)
    assert end == Event("Left and right of A are uncertain, after 1.0 s.", "INFO", "exchanged_a", "end")


def test_exchanged_sides_are_told_where_s_star_corrects_them_only():
    told = told_of(0, exchanged=(3, 3), mirrored="AB")
    assert [(k, event.topic, event.phase) for k, event in told] == [
        (5, "exchanged_a", "start"),  # 0.15 s later it is certain
        (5, "exchanged_b", "start"),
    ]
    assert told_of(0, exchanged=(3, 3)) == []  # a label that S* does not follow
    assert told_of(0, exchanged=(0, 0), mirrored="AB") == []


def test_where_the_time_goes_back_a_limb_is_lost_anew():
    told = told_of(60, reset_at=40)
    assert [(k, event.phase) for k, event in told] == [
        (26, "start"), (40, "moment"), (40 + 16, "start"), (69 + 4, "end"),
    ]  # fmt: skip
