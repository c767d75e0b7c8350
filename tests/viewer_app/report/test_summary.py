"""The summary in the terminal: three figures first, few lines, warnings in words."""

import io
import json
import math
import re
import shlex
from copy import deepcopy
from dataclasses import asdict, replace
from functools import cache
from html import unescape
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console
from scipy.spatial.transform import Rotation

from devices.events import Event, Spell
from devices.findings.finding import WORDS, beside
from devices.sensor import LinkFigures
from fusion.body import KINECT_V2
from fusion.facing.evidence import upright_direction
from fusion.registration.rigid_fit import Registration
from fusion.skeleton import NO_FRAME
from recordings.quality.doubtful_time import DOUBTS, doubtful_seconds, seen_people
from recordings.quality.figures import method_figures, report, with_verdict
from recordings.quality.verdict import verdict
from recordings.quality.without_truth import truth_free_figures
from tests.helpers.captures import Capture
from tests.helpers.frame_pairs import frame_pairs
from tests.helpers.sentences import check_sentences
from tests.helpers.two_views import calibration_of, standing
from viewer_app.batch.worker import _session_figures
from viewer_app.flags import in_flags
from viewer_app.output_files import save_report
from viewer_app.report.events import list_events, opening_event, shortest_list
from viewer_app.report.pages.review_page import review_page
from viewer_app.report.pages.session_page import session_page
from viewer_app.report.terminal import print_lines, print_summary, say_saved
from viewer_app.report.words import Line, bone_rows, detail_lines, in_mm, lead_lines
from viewer_app.running.runner import stream_figures


def registered(median_mm, frames=90):
    """A calibration whose views are so far apart."""
    known = calibration_of(KINECT_V2)
    residuals = np.full(len(KINECT_V2), median_mm * 1e-3)
    at = median_mm * 1e-3
    fit = Registration(known.a_from_b, at, 1.3 * at, residuals, 0.01, frames, KINECT_V2)
    return replace(known, registration=fit)


@cache
def fused():
    """Two seconds of a person of 30 frames each, whose calibration is that of 90 frames."""
    session = Capture(seconds=2.0).session()
    rows = replace(session.rows, sigma=np.full_like(session.rows.sigma, 0.03))
    return replace(session, rows=rows, calibrations=((0, registered(31.0)),))


@pytest.fixture
def session():
    return fused()


@pytest.fixture
def figures():
    return deepcopy(_figures())


@cache
def _figures():
    return report(fused())


def said(figures, width=80, **more):
    out = io.StringIO()
    print_summary(Console(file=out, width=width), figures, **more)
    return out.getvalue()


def changed(figures, case):
    """Figures of a good session of 100 s, but for those of a case such as ``clock.sd_ms=11 dropped.a=5``."""
    found = with_doubts(deepcopy(figures), 30.0, 30.0)
    found |= {"distance_m": {side: {"median": 2.5, "near": 1.8, "far": 3.9} for side in "ab"}}
    for change in case.split():
        if change == "live":
            found |= stream_figures(sensors()) | {"network": {"b": asdict(WELL)}}
        elif "=" in change:
            path, _, value = change.partition("=")
            *groups, name = path.split(".")
            of = found
            for group in groups:
                of[group] = of.get(group) or {}
                of = of[group]
            of[name] = json.loads(value)
    return found


def test_sentences_of_the_verdict(figures):
    def told(case):
        found = with_verdict(changed(figures, case))
        lead, judged = next(lead_lines(found)), verdict(found)
        assert lead.warning == (judged.word in ("poor", "unknown"))
        assert lead.text == in_flags(str(judged))
        return "\n".join(judged.sentences)

    check_sentences("verdict", told)


def test_sentences_of_the_summary(figures):
    def told(case):
        found = changed(figures, case)
        text = said(with_verdict(found), width=300, verbose="verbose" in case)
        lines = text.partition("Bones: target")[0].rstrip().splitlines()
        usual = said(with_verdict(changed(figures, "live" if "live" in case else "")), width=300)
        return "\n".join(line for line in lines if case == "-" or line not in usual) or "-"

    check_sentences("summary", told)


@pytest.mark.parametrize(
    "untrusted", [{"provisional": True}, {"registration": registered(31.0, 1).registration}]
)
def test_no_second_is_good_under_a_calibration_that_proves_nothing(session, untrusted):
    found = replace(session, calibrations=((0, replace(session.calibration, **untrusted)),))
    assert "poor" not in {each.word for each in session.quality_per_second}
    assert not found.good_frames.any()
    (reason,) = (each.what for each in found.verdict.findings if each.word == "unknown")
    assert {each.reason for each in found.quality_per_second} == {reason}
    assert "1 frames" not in reason


def test_every_reason_for_the_verdict_is_in_the_details_if_not_in_the_lead(figures):
    calibration = figures["calibration"] | {"rotation_sd_deg": 2.1, "angle_deg": 25.0}
    clock = {"offset_ms": 80.0, "sd_ms": 2.0}
    found = with_verdict(figures | {"calibration": calibration, "clock": clock})
    lead, details = (" ".join(line.text for line in lines(found)) for lines in (lead_lines, detail_lines))
    first, *others = verdict(found).reasons
    assert first in lead
    assert first not in details
    assert len(others) >= 2
    assert all(reason in details for reason in others)


@pytest.mark.usefixtures("without_plots")
def test_how_far_the_views_are_apart_is_one_figure_everywhere(session, tmp_path):
    """Of all frames since the calibration, whose own figure is 31 mm."""
    one = session.calibration
    calibrations = (0, replace(one, provisional=True)), (20, one)
    session = replace(session, calibrations=calibrations)
    apart = session.rows.disagreement[20:]
    median, most = np.median(apart), np.percentile(apart, 95.0)
    assert session.views_agree == pytest.approx((median, most))
    assert abs(1e3 * median - 31.0) > 5.0
    figures = report(session)
    save_report(tmp_path / "r.json", figures, force=False)
    written = json.loads((tmp_path / "r.json").read_text(encoding="utf-8"))["views_agree_mm"]
    assert written == pytest.approx({"median": 1e3 * median, "p95": 1e3 * most})
    figures["without_truth"] = truth_free_figures(session)
    assert _session_figures(session, figures)["views_agree"] == pytest.approx(median)  # of duplex batch
    every = f"95 % {in_mm(1e3 * most)}, since the calibration"
    viewer = session_page(session.last_setup, figures).text
    for told in (said(figures, width=200), viewer):
        assert f"median {in_mm(1e3 * median)}, {every}" in told
    page = unescape(review_page(session, figures))
    assert re.search(rf'<dd class="figure">{in_mm(1e3 * median)}</dd>\s*<dd>Median; {every}', page)


def with_doubts(figures, median_mm, p95_mm, doubtful=0.0, **seconds):
    """Figures of a hundred seconds."""
    lasts = {"all": 100.0, "seen": 100.0, "doubtful": doubtful, **dict.fromkeys(DOUBTS, 0.0)}
    lasts |= {"limb": "left arm", **seconds}
    return figures | {"views_agree_mm": {"median": median_mm, "p95": p95_mm}, "seconds_of": lasts}


@given(
    median_mm=st.floats(5.0, 120.0),
    beyond_mm=st.floats(0.0, 2000.0),
    doubtful=st.tuples(*[st.floats(0.0, 100.0)] * 2),
    more_mm=st.tuples(st.floats(0.0, 100.0), st.floats(0.0, 1000.0)),
)
def test_what_is_worse_never_gets_a_better_word(figures, median_mm, beyond_mm, doubtful, more_mm):
    before = with_doubts(figures, median_mm, median_mm + beyond_mm, min(doubtful))
    after = with_doubts(figures, median_mm + more_mm[0], median_mm + beyond_mm + sum(more_mm), max(doubtful))
    assert WORDS.index(verdict(before).word) <= WORDS.index(verdict(after).word)


def test_how_long_a_session_is_doubtful_is_counted_without_its_gaps(session):
    """60 frames of 1/30 s, with a minute between two of them, compared from the tenth on."""
    rows = session.rows
    time_ns, states_b, sigma = rows.time_ns.copy(), rows.states_b.copy(), rows.sigma.copy()
    time_ns[30:] += 60_000_000_000
    states_b[40:46] = 0
    sigma[:] = 0.02
    sigma[10:28, KINECT_V2.joint("AnkleRight")] = 0.2
    sigma[12:15, KINECT_V2.joint("WristLeft")] = 0.2
    sigma[50:53] = sigma[3:6] = 0.13
    changed = replace(rows, time_ns=time_ns, states_b=states_b, sigma=sigma)
    seconds = doubtful_seconds(changed, 10, seen_people(changed))
    assert seconds == {
        "all": pytest.approx(62, abs=1e-3),
        "seen": pytest.approx(62 / 30, abs=1e-3),  # the gap counts as three frames
        "doubtful": pytest.approx(27 / 30, abs=1e-3),
        "uncertain": pytest.approx(3 / 30, abs=1e-3),
        "limb_uncertain": pytest.approx(18 / 30, abs=1e-3),
        "limb": "right leg",
        "one_view": pytest.approx(6 / 30, abs=1e-3),
    }
    assert "Doubtful     a limb, mostly the right leg, is uncertain 0.6 s (30 %)" in said(
        report(replace(session, rows=replace(rows, sigma=sigma))), 200
    )


def test_views_that_are_upside_down_are_told_apart(session):
    rows, turned = session.rows, np.float32((-1.0, -1.0, 1.0))
    for sides in ("a", "ab"):
        views = {f"positions_{side}": getattr(rows, f"positions_{side}") * turned for side in sides}
        found = report(replace(session, rows=replace(rows, **views)))["upside_down"]
        assert found == {side: float(side in sides) for side in "ab"}


def test_joints_that_no_view_has_are_named_with_where_their_bones_come_from(session):
    rows, lacking = session.rows, [KINECT_V2.joint(name) for name in ("SpineBase", "ShoulderLeft")]
    states_a, states_b = rows.states_a.copy(), rows.states_b.copy()
    states_a[:, lacking] = 0
    assert report(replace(session, rows=replace(rows, states_a=states_a)))["in_no_frame"] == []
    states_b[:, lacking] = 0
    at_a, at_b = rows.positions_a.copy(), rows.positions_b.copy()
    at_a[:, lacking] = at_b[:, lacking] = np.nan
    views = {"states_a": states_a, "states_b": states_b, "positions_a": at_a, "positions_b": at_b}
    changed = replace(session, rows=replace(rows, **views))
    found = report(changed)
    assert found["in_no_frame"] == ["SpineBase", "ShoulderLeft"]
    (line,) = [line.text for line in detail_lines(found) if line.label == "Never seen"]
    # the spine's root has no other side; the left clavicle and upper arm have
    assert line == (
        "spine base, left shoulder: S* guesses them; their bones are as long as on the other side or by an "
        "adult's proportions."
    )
    of = {row[0]: row[1] for row in bone_rows(found)}
    assert of["upper arm left"].endswith(", as long as on the other side")
    assert of["pelvis left"].endswith(", by an adult's proportions")
    assert of["upper arm right"].isdigit()
    loaded = replace(session.calibration, how="loaded from room.json (pose)")
    by_file = method_figures(changed.rows, loaded)["bones"]
    assert {by_file[f"upper_arm_{side}"]["length_from"] for side in ("left", "right")} == {"file", "views"}


@given(st.tuples(*[st.floats(-40.0, 40.0)] * 2), st.floats(0.0, 180.0))
def test_the_angle_of_the_sensors_is_that_about_the_vertical_however_they_are_tilted(tilts, angle):
    tilt_a, tilt_b = (Rotation.from_euler("x", tilt, degrees=True) for tilt in tilts)
    turn = Rotation.from_euler("y", -angle, degrees=True)
    known = calibration_of(KINECT_V2)
    turned = replace(known, a_from_b=replace(known.a_from_b, rotation=(tilt_a * turn * tilt_b).as_matrix()))
    up = upright_direction(KINECT_V2, tilt_a.apply(standing(KINECT_V2))[None])
    assert np.degrees(turned.angle_about(up)) == pytest.approx(angle, abs=0.5)


@given(st.floats(0.1, 200.0), st.lists(st.floats(1.0, 150.0), min_size=1, max_size=2), st.integers(0, 2))
def test_no_number_is_rounded_across_a_limit(value, limits, digits):
    told = float(beside(value, *limits, digits=digits))
    assert all((told < each, told > each) == (value < each, value > each) for each in limits)
    assert beside(60.2, 60.0) == "60.2"
    assert beside(59.97, 60.0) == "59.97"
    assert beside(45.2, 60.0) == "45"


def with_repairs(rows):
    """60 frames: A with exchanged sides in 15, 2 joints unseen in all, nobody seen in the last 10.

    A label of another 5 frames is one that S* does not follow.
    """
    exchanged = np.zeros((60, 2), dtype=np.int8)
    exchanged[:20, 0] = 3
    positions = rows.positions_a.copy()
    positions[:15] = positions[:15, KINECT_V2.mirror]
    predicted = np.zeros((60, len(KINECT_V2)), dtype=bool)
    predicted[:, :2] = True
    predicted[50:] = True
    return replace(rows, positions_a=positions, exchanged=exchanged, predicted=predicted)


def test_repaired_shares_count_frames_with_a_person(session):
    rows = with_repairs(session.rows)
    figures = report(replace(session, rows=rows))
    assert figures["repaired"]["exchanged"] == {"a": pytest.approx(15 / 50), "b": 0.0}
    assert figures["repaired"]["unseen_joints"] == pytest.approx(2 / len(KINECT_V2))
    assert "left and right: 30 % of A, 0 % of B; joints filled in: 8.0 %." in said(figures)
    without = replace(session, rows=replace(rows, exchanged=None))  # the paper's methods
    assert "left and right" not in said(report(without))


def test_a_sensor_without_a_frame_is_not_a_frame_without_a_person(session):
    rows = session.rows
    clock_b, states_a, states_b, predicted = (
        each.copy() for each in (rows.clock_b, rows.states_a, rows.states_b, rows.predicted)
    )
    clock_b[::2] = NO_FRAME
    states_b[::2] = 0
    states_b[1] = 0  # a frame of B in which it sees no one
    states_a[:2] = 0
    states_a[4] = 0  # B has no frame, and saw the person in the one before
    predicted[:10] = True  # A repeats a frame, but sees the person
    changed = replace(rows, clock_b=clock_b, states_a=states_a, states_b=states_b, predicted=predicted)
    figures = report(replace(session, rows=changed))
    assert figures["without_person"] == {"a": 3, "b": 1, "both": 1}  # one pair
    assert figures["alone"] == {"a": 30, "b": 0}
    text = " ".join(said(figures, width=200).split())
    assert "30 pairs of 60 (A) and 30 (B), alone A 30, without a person A 3, without a person B 1." in text
    assert "alone" not in said(report(session))


def test_the_first_warning_is_told_with_its_time(figures):
    events = [
        Event(text="A sensor seems to have been moved.", level="WARN", frame=9, time_ns=3_000_000_000),
        Event(text="calibrated", level="INFO", frame=30, time_ns=1_000_000_000),
        Event(text="Registration follows.", level="WARN", frame=20, time_ns=6_000_000_000),
    ]
    text = " ".join(said(figures, width=200, events=events).split())
    assert "Warning 3.00 s: A sensor seems to have been moved. (1 more)" in text


def test_figures_without_truth_follow_where_they_were_computed(session, figures):
    figures["without_truth"] = found = truth_free_figures(session)
    lines = {line.label: line.text for line in detail_lines(figures)}
    rough = {key: 1e3 * (found[f"rough_{key}"] or 0.0) for key in ("a", "fused")}
    assert f"S* {in_mm(rough['fused'])}, S_A {in_mm(rough['a'])}" in lines["Roughness"]
    assert lines["Jumps"].startswith("above 150 mm per frame: S* ")
    assert ", S_A 0 %, S_B 0 % of steps; S* alone " in lines["Jumps"]
    halves = math.degrees(found["halves_rotation_off"] or 0.0)
    assert f"the fits of both halves differ by {halves:.1f}°" in lines["Registration"]
    assert halves < 1.0
    figures["without_truth"] = found | {"halves_rotation_off": None, "halves_position_off": None}
    assert "from a robust fit. " in f"{said(figures, verbose=True)} ".replace("\n", " ")
    short = replace(session, rows=session.rows[slice(0, 20)])
    assert set(truth_free_figures(short).values()) == {None}
    figures["without_truth"] = truth_free_figures(short)
    assert "too short" in said(figures, verbose=True)


def test_brackets_in_a_text_are_printed_as_they_are():
    out = io.StringIO()
    print_lines(Console(file=out, width=80), [Line("Warning", "[red]a.csv[/] is cut off", warning=True)])
    assert "[red]a.csv[/] is cut off" in out.getvalue()


WELL = LinkFigures(received=900, round_trip_ns=2_000_000, clock_bound_ns=1_000_000)


def sensors(links=(None, None), **counts):
    """The counts of two sensors that run well but for what is given."""
    sensor = SimpleNamespace(link=None, simulated=False, recorded=False)
    stream = {
        name: SimpleNamespace(dropped=0, lost=0, returns=0, received=900, sensor=sensor)
        for name in ("a", "b")
    }
    stream["b"].dropped = counts.pop("dropped_b", 0)
    stream["a"].lost = counts.pop("lost_a", 0)
    stream["a"].returns = counts.pop("returns_a", 0)
    figures = SimpleNamespace(pairs=900, alone_a=0, alone_b=0, unmatched_b=0, offset_ns=None, drift_ppm=0.0)
    figures.late = figures.repeated = figures.reordered = 9
    figures.resets = counts.pop("resets", 0)
    assert not counts
    return SimpleNamespace(**stream, figures=figures, links=links)


@given(*[st.integers(0, 99)] * 6)
def test_the_counts_of_a_sensor_add_up_to_its_frames(
    pairs, alone_a, alone_b, unmatched_b, dropped_a, dropped_b
):
    counted = sensors(dropped_b=dropped_b)
    counted.a.dropped = dropped_a
    vars(counted.figures).update(pairs=pairs, alone_a=alone_a, alone_b=alone_b, unmatched_b=unmatched_b)
    figures = stream_figures(counted)
    for side, frames in (
        ("a", pairs + alone_a + dropped_a),
        ("b", pairs + alone_b + unmatched_b + dropped_b),
    ):
        assert figures["paired"] + figures["alone"][side] + figures["dropped"][side] == frames


def test_the_printed_command_can_be_pasted(tmp_path):
    path = tmp_path / "Ordner mit ä" / "it's $1.rrd"
    path.parent.mkdir()
    path.write_bytes(b"0")
    console = Console(file=io.StringIO(), width=60)
    say_saved(console, path)
    command = console.file.getvalue().partition("To look at it: ")[2]
    assert str(path) in shlex.split(command)


# --- The numbered list of a session's events, and the event at which a review opens.


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
