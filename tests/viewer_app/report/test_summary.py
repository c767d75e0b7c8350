"""The summary in the terminal: three figures first, few lines, warnings in words."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from fusion.body import KINECT_V2
from fusion.calibration.calibration import Calibration
from fusion.registration.rigid_fit import Registration
from recordings.events import Event
from recordings.session_arrays import SessionArrays
from recordings.testing import FusedRun, fused_run
from tests.helpers.frame_pairs import frame_pairs
from tests.helpers.two_views import calibration_of
from viewer_app.report.details import FEWEST_FRAMES
from viewer_app.report.figures import Figures, FusionResult, method_figures, report
from viewer_app.report.numbers_in_words import in_mm, in_percent
from viewer_app.report.summary import Line, fusion_lines, print_lines, print_summary

__all__ = ["fused_run"]  # a fixture


def registered(median_mm: float, frames: int = 90) -> Calibration:
    """A calibration whose views are so far apart."""
    known = calibration_of(KINECT_V2)
    residuals = np.full(len(KINECT_V2), median_mm * 1e-3)
    at = median_mm * 1e-3
    fit = Registration(known.a_from_b, at, 1.3 * at, residuals, 0.01, frames, KINECT_V2)
    return replace(known, registration=fit)


@pytest.fixture
def result(fused_run: FusedRun) -> FusionResult:
    session = fused_run(frame_pairs(KINECT_V2, 60), calibration_of(KINECT_V2))
    return FusionResult(session.pairing, registered(31.0), session.settings, session.rows)


def said(result: FusionResult, figures: Figures, width: int = 80, **more: object) -> str:
    out = io.StringIO()
    print_summary(Console(file=out, width=width), result, figures, **more)  # type: ignore[arg-type]
    return out.getvalue()


def test_three_figures_lead_in_at_most_six_short_lines(result: FusionResult) -> None:
    lines = said(result, report(result)).splitlines()
    assert [line[:13].strip() for line in lines[:3]] == ["Views agree", "Repaired", "S*"]
    assert len(lines) <= 6
    assert all(line[12] == " " and line[13] != " " for line in lines), "texts are aligned"
    assert lines[0].strip().endswith("good: 31 mm apart (median).")


def test_tables_come_with_verbose_only(result: FusionResult) -> None:
    figures = report(result)
    short, long = said(result, figures), said(result, figures, verbose=True)
    assert long.startswith(short)
    for words in ("Paired", "upper arm left", "start", "ms per frame", "axes are"):
        assert (words in long, words in short) == (True, False) or words == "start"


@pytest.mark.parametrize(
    ("median_mm", "frames", "words", "warning"),
    [
        (39.0, 90, "good: 39 mm apart", False),
        (41.0, 90, "usable: 41 mm apart (median); good is below 40 mm", False),
        (81.0, 90, "poor: 81 mm apart (median); usable is below 80 mm. Calibrate: stand still", True),
        (20.0, FEWEST_FRAMES - 1, "too few frames to tell: 20 mm apart over 14", True),
    ],
)
def test_a_verdict_is_a_word_and_says_what_to_do_where_it_is_poor(
    result: FusionResult, median_mm: float, frames: int, words: str, warning: bool
) -> None:
    line = next(fusion_lines(registered(median_mm, frames), report(result)))
    assert line.text.startswith(words)
    assert line.warning is warning


def test_without_a_registration_the_frames_themselves_tell(result: FusionResult) -> None:
    figures = report(result)
    figures["disagreement_mm"]["median"] = 55.0
    assert next(fusion_lines(calibration_of(KINECT_V2), figures)).text.startswith("usable: 55 mm")
    figures["disagreement_mm"]["median"] = None
    assert next(fusion_lines(calibration_of(KINECT_V2), figures)).warning


@pytest.mark.parametrize("how", ["none yet: an adult's proportions", "provisional, 1 frame of any pose"])
def test_what_is_not_calibrated_has_no_verdict(result: FusionResult, how: str) -> None:
    line = next(fusion_lines(replace(registered(20.0), how=how), report(result)))
    assert line.text.startswith("unknown: not calibrated yet. Calibrate: stand still")
    assert line.warning


def with_repairs(rows: SessionArrays) -> SessionArrays:
    """60 frames: A with exchanged sides in 15, 2 joints unseen in all, nobody seen in the last 10."""
    exchanged = np.zeros((60, 2), dtype=np.int8)
    exchanged[:15, 0] = 3
    predicted = np.zeros((60, len(KINECT_V2)), dtype=bool)
    predicted[:, :2] = True
    predicted[50:] = True
    return replace(rows, exchanged=exchanged, predicted=predicted)


def test_repaired_shares_count_frames_with_a_person(result: FusionResult) -> None:
    repaired = method_figures(with_repairs(result.rows))["repaired"]
    assert repaired["exchanged"] == {"a": pytest.approx(15 / 50), "b": 0.0}
    assert repaired["unseen_joints"] == pytest.approx(2 / len(KINECT_V2))
    result = replace(result, rows=with_repairs(result.rows))
    assert "left and right: 30 % of A, 0 % of B; joints filled in: 8.0 %." in said(result, report(result))
    without = replace(result, rows=replace(result.rows, exchanged=None))  # the paper's methods
    assert "left and right" not in said(without, report(without))


def test_what_someone_must_act_on_is_told_in_words(result: FusionResult) -> None:
    figures = report(result)
    figures["dropped"] = {"a": 3, "b": 0}
    figures["without_person"] = {"a": 5, "b": 0, "both": 0}
    events = [
        Event(9, 3_000_000_000, "A sensor seems to have been moved.", "WARN"),
        Event(30, 1_000_000_000, "calibrated", "INFO"),
        Event(20, 6_000_000_000, "Registration follows.", "WARN"),
    ]
    text = " ".join(said(result, figures, width=200, events=events).split())
    assert "Dropped 3 of 60 frames of A and 0 of 60 of B have no partner." in text
    assert "No person in 5 frames of A, 0 of B, 0 of both." in text
    assert "Warning 3.00 s: A sensor seems to have been moved. (1 more)" in text


@pytest.mark.parametrize(("a", "b", "told"), [(0.9, 0.8, True), (0.9, 0.1, False), (0.3, 0.3, False)])
def test_two_mirrored_recordings_are_noticed(result: FusionResult, a: float, b: float, told: bool) -> None:
    figures = report(result)
    figures["repaired"]["exchanged"] = {"a": a, "b": b}
    assert ("change its sign" in said(result, figures)) is told


def test_live_latency_stands_beside_the_rate(result: FusionResult) -> None:
    lines = {
        line.label: line.text
        for line in fusion_lines(result.calibration, report(result), {"p50": 12.4, "p99": 30.6})
    }
    assert lines["S*"].startswith("12 ms after the images (99 %: 31 ms), 30.0 per second")


def test_brackets_in_a_text_are_printed_as_they_are() -> None:
    out = io.StringIO()
    print_lines(Console(file=out, width=80), [Line("Warning", "[red]a.csv[/] is cut off", warning=True)])
    assert "[red]a.csv[/] is cut off" in out.getvalue()


@pytest.mark.parametrize(
    ("share", "words"),
    [(0.0, "0 %"), (1e-4, "below 0.1 %"), (0.082, "8.2 %"), (0.12, "12 %"), (1.0, "100 %"), (None, "–")],
)
def test_shares_in_words(share: float | None, words: str) -> None:
    assert in_percent(share) == words


def test_less_than_a_micrometre_is_nothing() -> None:
    assert in_mm(2.5e-13) == "0 mm"
    assert in_mm(0.0015) == "0.0015 mm"
