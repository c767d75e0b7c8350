"""The summary in the terminal: three figures first, few lines, warnings in words."""

import io
import json
import math
import re
import shlex
from dataclasses import replace
from html import unescape
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console
from scipy.spatial.transform import Rotation

from devices.events import Event
from devices.sensor import LinkFigures
from fusion.body import KINECT_V2
from fusion.calibration.calibration import FEWEST_PAIRS
from fusion.registration.rigid_fit import Registration
from fusion.skeleton import NO_FRAME
from recordings.quality.doubtful_time import doubtful_seconds, seen_people
from recordings.quality.figures import _angle, method_figures, report, with_verdict
from recordings.quality.limits import beside
from recordings.quality.verdict import verdict
from recordings.quality.without_truth import truth_free_figures
from tests.helpers.frame_pairs import frame_pairs
from tests.helpers.two_views import calibration_of, standing
from viewer_app.batch.worker import _session_figures
from viewer_app.output_files import save_report
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


@pytest.fixture
def session(fused_run):
    fused = fused_run(frame_pairs(KINECT_V2, 60), calibration_of(KINECT_V2))
    rows = replace(fused.rows, sigma=np.full_like(fused.rows.sigma, 0.03))  # these frames lose an arm
    return replace(fused, rows=rows, calibrations=((0, registered(31.0)),))


@pytest.fixture
def figures(session):
    return report(session)


def said(figures, width=80, **more):
    out = io.StringIO()
    print_summary(Console(file=out, width=width), figures, **more)
    return out.getvalue()


def judged(figures, **calibration):
    changed = with_verdict(figures | {"calibration": figures["calibration"] | calibration})
    return next(lead_lines(changed))


def with_views(figures, median_mm):
    return figures | {"views_agree_mm": {"median": median_mm, "p95": median_mm}}


def seen_at(metres):
    limits = {"near": 1.8, "far": 3.9}
    return {"distance_m": {"a": {"median": 2.5, **limits}, "b": {"median": metres, **limits}}}


def test_the_verdict_leads_in_at_most_six_short_lines(figures):
    lines = said(with_verdict(with_views(figures, 31.0))).splitlines()
    labels = ["Verdict", "Views agree", "Calibration", "Repaired", "S*", "Bones"]
    assert [line[:13].strip() for line in lines[:6]] == labels
    assert len(lines) <= 7
    assert all(line[12] == " " and line[13] != " " for line in lines), "texts are aligned"
    assert lines[0].split() == ["Verdict", "good."]
    assert lines[1].split(maxsplit=2)[2].startswith("median 31 mm, 95 % 31 mm")
    assert lines[2].split(maxsplit=1)[1].startswith("± 0.6°, from 90 frames")


@pytest.mark.parametrize(
    ("median_mm", "words", "warning"),
    [
        (39.0, "good.", False),
        (40.2, "usable: the views differ by 40.2 mm; good is below 40.", False),
        (79.6, "usable: the views differ by 79.6 mm", False),
        (81.0, "poor: the views differ by 81 mm; usable is below 80. Check that both recordings", True),
        (None, "unknown: no joint was seen by both sensors", True),
    ],
)
def test_a_verdict_is_a_word_and_says_what_to_do_where_it_is_poor(figures, median_mm, words, warning):
    line = judged(with_views(figures, median_mm))
    assert line.text.startswith(words)
    assert line.warning is warning


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        (
            {"clock": {"offset_ms": -146.0, "sd_ms": 11.0}},
            "poor: B captures -146 ± 11 ms off its time stamps",
        ),
        (
            {"mirrored": {"a": 0.0, "b": 0.97}},
            "poor: B is the mirror image of a person. Change the sign of x",
        ),
        ({"dropped": {"a": 20, "b": 22}, "paired": 40}, "poor: 33 % of the frames have no partner"),
        ({"dropped": {"a": 90, "b": 92}, "paired": 60}, "poor: 60 % of the frames have no partner"),
        (
            seen_at(0.9),
            "poor: the person is 0.9 m from B; good is 1.8 to 3.9 m. Record with the person further",
        ),
        (
            seen_at(4.2),
            "usable: the person is 4.2 m from B; good is 1.8 to 3.9 m. Record with the person nearer",
        ),
    ],
)
def test_the_verdict_names_what_is_worst(figures, changed, words):
    assert judged(with_views(figures, 50.0 if words[0] == "p" else 30.0) | changed).text.startswith(words)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"angle_deg": 45.0}, "usable: the sensors look 45° apart; good is 60° to 120°. Record with"),
        (
            {"rotation_sd_deg": 2.1},
            "usable: B's rotation is certain to 2.1° only; good is 2°. Record with the person walking about",
        ),
        ({"frames": FEWEST_PAIRS - 1}, "unknown: calibrated on 14 frames; at least 15 are needed"),
        ({"provisional": True}, "unknown: the calibration is provisional"),
    ],
)
def test_the_verdict_judges_the_calibration(figures, changed, words):
    line = judged(with_views(figures, 30.0), **changed)
    assert line.text.startswith(words)
    assert line.warning is not words.startswith("usable")


@pytest.mark.parametrize(
    "untrusted", [{"provisional": True}, {"registration": registered(31.0, 1).registration}]
)
def test_no_second_is_good_under_a_calibration_that_proves_nothing(session, untrusted):
    found = replace(session, calibrations=((0, replace(session.calibration, **untrusted)),))
    assert "poor" not in {each.word for each in session.quality_per_second}
    assert not found.good_frames.any()
    (reason,) = (each.reason for each in found.verdict.shortcomings if each.word == "unknown")
    assert {each.reason for each in found.quality_per_second} == {reason}
    assert "1 frames" not in reason


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"views_agree_mm": {"median": 81.0, "p95": 90.0}}, "Calibrate: stand still"),
        ({"mirrored": {"a": 0.0, "b": 0.97}}, "Switch the mirroring off."),
        ({"calibration": {"angle_deg": 45.0}}, "Move them further apart round the person."),
        (seen_at(4.2), "Stand nearer."),
        ({"calibration": {"rotation_sd_deg": 2.1}}, "Walk about while both sensors see you."),
        ({"dropped": {"a": 20, "b": 22}}, "Check the frame rates of both sensors and trackers."),
    ],
)
def test_people_before_sensors_get_other_advice_than_files(figures, changed, words):
    changed = changed | {"calibration": figures["calibration"] | changed.get("calibration", {})}
    figures = with_views(figures, 30.0) | changed
    live = {**stream_figures(sensors()), **figures, "streams": {}}
    assert words in str(verdict(live))
    assert words not in str(verdict(figures))


@pytest.mark.parametrize(
    ("frames", "provisional", "another"),
    [(30, False, True), (46, False, False), (60, False, False), (30, True, False)],
)
def test_another_part_is_advised_where_there_is_one(figures, frames, provisional, another):
    """Of 60 frames; those of a live session whose calibration stayed provisional cannot be fused again."""
    calibration = figures["calibration"] | {
        "frames": frames,
        "provisional": provisional,
        "rotation_sd_deg": 9.0,
    }
    far = with_views(figures, 90.0) | {"calibration": calibration}
    told = " ".join(each.remedy for each in verdict(far).shortcomings)
    assert ("alibrate on another part" in told) == another
    assert ("ecord again" in told) != another


def test_every_reason_for_the_verdict_is_in_the_details_if_not_in_the_lead(figures):
    calibration = figures["calibration"] | {"rotation_sd_deg": 9.0, "angle_deg": 45.0}
    found = with_verdict(with_views(figures, 50.0) | {"calibration": calibration})
    lead, details = (" ".join(line.text for line in lines(found)) for lines in (lead_lines, detail_lines))
    first, *others = verdict(found).reasons
    assert first in lead
    assert first not in details
    assert len(others) >= 2
    assert all(reason in details for reason in others)


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
    every = f"95 % {1e3 * most:.0f} mm, over all frames"
    viewer = session_page(session.last_setup, figures).text
    for told in (said(figures, width=200), viewer):
        assert f"median {1e3 * median:.0f} mm, {every}" in told
    page = unescape(review_page(session, figures))
    assert re.search(rf'<dd class="figure">{1e3 * median:.0f} mm</dd>\s*<dd>Median; {every}', page)


WORDS = "good", "usable", "unknown", "poor"
DOUBTS = "views_apart", "limb_uncertain", "one_view"


def with_doubts(figures, median_mm, p95_mm, **seconds):
    """Figures of a hundred seconds."""
    lasts = {"all": 100.0, **dict.fromkeys(DOUBTS, 0.0), "limb": "left arm", **seconds}
    return figures | {"views_agree_mm": {"median": median_mm, "p95": p95_mm}, "seconds_of": lasts}


@given(
    median_mm=st.floats(5.0, 120.0),
    beyond_mm=st.floats(0.0, 2000.0),
    lasts=st.tuples(*[st.floats(0.0, 100.0)] * 3),
    longer=st.tuples(*[st.floats(0.0, 100.0)] * 3),
    more_mm=st.tuples(st.floats(0.0, 100.0), st.floats(0.0, 1000.0)),
)
def test_what_is_worse_never_gets_a_better_word(figures, median_mm, beyond_mm, lasts, longer, more_mm):
    before = with_doubts(figures, median_mm, median_mm + beyond_mm, **dict(zip(DOUBTS, lasts, strict=True)))
    worse = {name: min(100.0, a + b) for name, a, b in zip(DOUBTS, lasts, longer, strict=True)}
    after = with_doubts(figures, median_mm + more_mm[0], median_mm + beyond_mm + sum(more_mm), **worse)
    assert WORDS.index(verdict(before).word) <= WORDS.index(verdict(after).word)


@pytest.mark.parametrize(
    ("median_mm", "p95_mm", "seconds", "words"),
    [
        (
            60.0,
            282.0,
            {"views_apart": 28.1},
            "usable: the views differ by 60 mm; good is below 40, and they differ by more than 80 mm for "
            "28.1 s (28 %).",
        ),
        (31.0, 97.0, {"views_apart": 7.0}, "usable: the views differ by more than 80 mm for 7.0 s (7 %)."),
        (31.0, 60.0, {"views_apart": 3.0}, "good."),
        (
            31.0,
            1926.0,
            {},
            "poor: a twentieth of the time the views differ by more than 1926 mm, as those of two people do. "
            "Check that both",
        ),
        (
            31.0,
            60.0,
            {"limb_uncertain": 17.0},
            "usable: a limb, mostly the left arm, is uncertain by more than 150 mm for 17.0 s (17 %). Record",
        ),
        (
            31.0,
            60.0,
            {"one_view": 60.0},
            "poor: one view alone has the person for 60.0 s (60 %). Record where",
        ),
    ],
)
def test_the_verdict_looks_at_time(figures, median_mm, p95_mm, seconds, words):
    assert str(verdict(with_doubts(figures, median_mm, p95_mm, **seconds))).startswith(words)


def test_how_long_a_session_is_doubtful_is_counted_without_its_gaps(session):
    """60 frames of 1/30 s, with a minute between two of them."""
    rows = session.rows
    time_ns, states_b, sigma = rows.time_ns.copy(), rows.states_b.copy(), rows.sigma.copy()
    time_ns[30:] += 60_000_000_000
    states_b[40:46] = 0
    sigma[:] = 0.02
    sigma[10:28, KINECT_V2.joint("AnkleRight")] = 0.2
    sigma[12:15, KINECT_V2.joint("WristLeft")] = 0.2
    apart = np.full(50, 0.02)  # of the frames since the calibration
    apart[20:29] = 0.09
    changed = replace(rows, time_ns=time_ns, states_b=states_b, sigma=sigma)
    seconds = doubtful_seconds(changed, apart, seen_people(changed))
    assert seconds == {
        "all": pytest.approx(62 / 30, abs=1e-3),  # the gap counts as three frames
        "views_apart": pytest.approx(9 / 30, abs=0.07),
        "limb_uncertain": pytest.approx(18 / 30, abs=1e-3),
        "limb": "right leg",
        "one_view": pytest.approx(6 / 30, abs=1e-3),
    }
    assert "Doubtful     a limb uncertain by more than 150 mm 0.6 s (30 %)." in said(
        report(replace(session, rows=replace(rows, sigma=sigma)))
    )


def test_views_that_are_upside_down_and_joints_that_none_has_are_named(session):
    rows = session.rows
    turned_a, turned_b = (
        view * np.float32((-1.0, -1.0, 1.0)) for view in (rows.positions_a, rows.positions_b)
    )
    turned = replace(rows, positions_a=turned_a)
    figures = with_views(report(replace(session, rows=turned)), 30.0)
    assert str(verdict(figures)) == "usable: A is upside down."
    turned = replace(turned, positions_b=turned_b)
    assert str(verdict(with_views(report(replace(session, rows=turned)), 30.0))) == (
        "usable: A and B are upside down. If they are .csv files with the axes of the Kinect SDK, "
        "state `axes=kinect`."
    )
    lacking = [KINECT_V2.joint(name) for name in ("SpineBase", "ShoulderLeft")]
    states_a, states_b = rows.states_a.copy(), rows.states_b.copy()
    states_a[:, lacking] = 0
    assert (
        with_views(report(replace(session, rows=replace(rows, states_a=states_a))), 30.0)["in_no_frame"] == []
    )
    states_b[:, lacking] = 0
    at_a, at_b = rows.positions_a.copy(), rows.positions_b.copy()
    at_a[:, lacking] = at_b[:, lacking] = np.nan
    views = {"states_a": states_a, "states_b": states_b, "positions_a": at_a, "positions_b": at_b}
    changed = replace(session, rows=replace(rows, **views))
    found = report(changed)
    (line,) = [line.text for line in lead_lines(found) if line.label == "Never seen"]
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
    assert str(verdict(with_views(report(changed), 30.0))) == (
        "usable: no view has spine base, left shoulder in any frame, and S* predicts what is not measured."
    )


@given(st.tuples(*[st.floats(-40.0, 40.0)] * 2), st.floats(0.0, 180.0))
def test_the_angle_of_the_sensors_is_that_about_the_vertical_however_they_are_tilted(tilts, angle):
    tilt_a, tilt_b = (Rotation.from_euler("x", tilt, degrees=True) for tilt in tilts)
    turn = Rotation.from_euler("y", -angle, degrees=True)
    found = _angle((tilt_a * turn * tilt_b).as_matrix(), KINECT_V2, tilt_a.apply(standing(KINECT_V2))[None])
    assert found == pytest.approx(angle, abs=0.5)


def test_a_person_a_little_too_near_is_not_at_the_limit_in_words(figures):
    limits = {"near": 1.724, "far": 4.5}  # of a Kinect v2
    near = figures | {"distance_m": {side: {"median": 1.71, **limits} for side in "ab"}}
    assert "the person is 1.7 m from A; good is 1.72 to 4.5 m" in str(verdict(with_views(near, 30.0)))


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
    assert figures["without_person"] == {"a": 3, "b": 1, "both": 2}
    assert figures["alone"] == {"a": 30, "b": 0}
    text = " ".join(said(figures, width=200).split())
    assert "One view 30 of 60 frames of A and 0 of 30 of B: the other sensor has none at that time." in text
    assert "No person Frames: 3 of A, 1 of B, 2 of both." in text
    assert "One view" not in said(report(session))


def test_what_someone_must_act_on_is_told_in_words(figures):
    figures["dropped"] = {"a": 3, "b": 0}
    figures["without_person"] = {"a": 5, "b": 0, "both": 0}
    events = [
        Event(text="A sensor seems to have been moved.", level="WARN", frame=9, time_ns=3_000_000_000),
        Event(text="calibrated", level="INFO", frame=30, time_ns=1_000_000_000),
        Event(text="Registration follows.", level="WARN", frame=20, time_ns=6_000_000_000),
    ]
    text = " ".join(said(figures, width=200, events=events).split())
    assert "Dropped 3 of 60 frames of A and 0 of 60 of B have no partner." in text
    assert "No person Frames: 5 of A, 0 of B, 0 of both." in text
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
    stream = {name: SimpleNamespace(dropped=0, lost=0, returns=0, received=900) for name in ("a", "b")}
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


def trouble(sensors):
    return list(lead_lines(stream_figures(sensors)))


def test_streams_that_run_well_are_not_mentioned():
    """Late, repeated and reordered frames are put right; they come with --verbose."""
    assert trouble(sensors()) == []
    assert trouble(sensors((WELL, WELL))) == []


@pytest.mark.parametrize(
    ("counts", "words"),
    [
        ({"dropped_b": 4}, "frames of B dropped (too slow) 4."),
        ({"lost_a": 5}, "frames of A lost on USB 5."),
        ({"returns_a": 2, "resets": 1}, "reconnects of A 2, clocks reset 1."),
    ],
)
def test_what_is_lost_is_a_warning(counts, words):
    (line,) = trouble(sensors(**counts))
    assert (line.label, line.text, line.warning) == ("Streams", words, True)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"lost": 3}, "B: frames arrived: 900, lost 3; round trip 2.0 ms"),
        ({"malformed": 1}, "B: frames arrived: 900, damaged messages 1"),
        ({"restarts": 1}, "B: frames arrived: 900, restarts 1"),
        ({"clock_bound_ns": None}, "the clocks of the two PCs could not be related"),
    ],
)
def test_a_link_that_loses_something_is_a_warning(change, words):
    (line,) = trouble(sensors((WELL, replace(WELL, **change))))
    assert line.label == "Network"
    assert words in line.text
    assert line.warning


def test_the_printed_command_can_be_pasted(tmp_path):
    path = tmp_path / "Ordner mit ä" / "it's $1.rrd"
    path.parent.mkdir()
    path.write_bytes(b"0")
    console = Console(file=io.StringIO(), width=60)
    say_saved(console, path)
    command = console.file.getvalue().partition("To look at it: ")[2]
    assert str(path) in shlex.split(command)
