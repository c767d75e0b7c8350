"""A session's quality on one self-contained HTML page: no network, no script, light and dark.

This module collects the content of the page; ``templates/review_page.html`` defines its form. Jinja escapes
all text from the session.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from recordings import layout
from recordings.session import Session
from recordings.session_comparison import frame_noise_of
from viewer_app.report.details import calibration_in_words
from viewer_app.report.event_list import (
    ListedEvent,
    event_in_words,
    list_events,
    seconds_of,
    shortest_list,
)
from viewer_app.report.numbers_in_words import in_mm, in_percent
from viewer_app.report.summary import Line, fusion_lines, shortfalls
from viewer_app.report.svg_plots import bar_plot, line_plot, skeleton_color, trust_map

_MOST_EVENTS = 12
"""Listed at first; the others open below."""


def review_page(session: Session, figures: dict[str, Any]) -> str:
    """The page as HTML.

    Args:
        session: The session.
        figures: Its report, :func:`viewer_app.report.figures.report`.
    """
    environment = Environment(
        loader=PackageLoader("viewer_app.report"), autoescape=True, undefined=StrictUndefined
    )
    environment.filters["millimetres"] = in_mm
    source_a, source_b = _without_folders(session.sources)
    tiles, lines = _lead(session, figures)
    events = list_events(session.events)
    shortest = shortest_list(events, _MOST_EVENTS)
    time_ns = session.rows.time_ns
    return environment.get_template("review_page.html").render(
        name=session.name,
        damage=session.damage,
        frames_lost=session.frames_lost,
        frames=len(session),
        seconds=float(time_ns[-1] - time_ns[0]) * 1e-9,
        body=session.body.name,
        settings=", ".join(f"{name} {values[0]}" for name, values in session.about["settings"].items()),
        source_a=source_a,
        source_b=source_b,
        colors={key: skeleton_color(key) for key in ("a", "b", "fused")},
        tiles=tiles,
        lines=lines,
        calibration=_calibration(session),
        bone_plots=_bone_plots(session),
        bones=_bone_rows(figures),
        jitter_plot=_jitter_plot(session),
        trust_plot=_trust_plot(session),
        disagreement=figures["disagreement_mm"],
        disagreement_plot=_disagreement_plot(session),
        fuse_ms=figures["fuse_ms"],
        frame_rate=session.frame_rate,
        timing_plots=_timing_plots(session),
        events=_event_rows(shortest),
        all_events=_event_rows(events) if len(shortest) < len(events) else [],
    )


@dataclass(frozen=True)
class _Tile:
    """A figure that leads the page, with the terminal's line about it."""

    label: str
    figure: str
    text: str
    warning: bool


def _lead(session: Session, figures: dict[str, Any]) -> tuple[list[_Tile], list[Line]]:
    """What leads the terminal's summary: its figures, and what else there is to say."""
    registration = session.calibration.registration
    apart = figures["disagreement_mm"]["median"]
    if registration is not None:
        apart = registration.residual_median * 1e3
    rate = figures["frames_per_second"]
    leading = {
        "Views agree": in_mm(apart),
        "Repaired": in_percent(figures["repaired"]["unseen_joints"]),
        "S*": "–" if rate is None else f"{rate:.1f} / s",
        "Bones": in_mm(figures["bone_error_mm"]["fused"]["max"]),
    }
    said = [*fusion_lines(session.calibration, figures), *shortfalls(figures)]
    tiles = [
        _Tile(each.label, leading[each.label], each.text, each.warning)
        for each in said
        if each.label in leading
    ]
    return tiles, [each for each in said if each.label not in leading]


def _calibration(session: Session) -> list[str]:
    how, *verdict = calibration_in_words(session.calibration)
    return [f"Calibrated on: {how}", *verdict]


def _bone_plots(session: Session) -> Markup:
    rows = session.rows
    time, lengths = rows.time_ns * 1e-9, rows.bone_length_of_each
    plots = []
    for limb in layout.PROMINENT_BONES:
        for side in ("left", "right"):
            bone = f"{limb}_{side}"
            if bone not in session.body.bones:
                continue
            j = session.body.bone(bone)
            lines = {
                "S_A": (lengths[0, :, j], "a"),
                "S_B": (lengths[1, :, j], "b"),
                "S*": (lengths[2, :, j], "fused"),
            }
            level = float(rows.bone_lengths[-1, j])
            plots.append(line_plot(bone.replace("_", " "), "m", time, lines, level=level))
    return Markup("").join(map(Markup, plots))


def _bone_rows(figures: dict[str, Any]) -> list[list[str]]:
    rows = []
    for name, bone in figures["bones"].items():
        cells = [name.replace("_", " "), f"{bone['target_m'] * 1e3:.0f}"]
        for key in ("a", "b", "fused"):
            mean, deviation = bone[key]["mean_m"], bone[key]["std_mm"]
            cells.append("–" if mean is None else f"{mean * 1e3:.0f} ± {deviation:.1f}")
        rows.append(cells)
    return rows


def _jitter_plot(session: Session) -> Markup:
    rows = session.rows
    jitter = {
        "S_A": (frame_noise_of(rows.positions_a.astype(np.float64), rows.frame) * 1e3, "a"),
        "S_B": (frame_noise_of(rows.positions_b.astype(np.float64), rows.frame) * 1e3, "b"),
        "S*": (frame_noise_of(rows.fused, rows.frame) * 1e3, "fused"),
    }
    return Markup(bar_plot("mm", session.body.joints, jitter))


def _trust_plot(session: Session) -> Markup:
    rows = session.rows
    total = rows.weights_a + rows.weights_b
    share = np.where(total > 0.0, rows.weights_a / np.where(total > 0.0, total, 1.0), np.nan)
    return Markup(trust_map(rows.time_ns * 1e-9, session.body.joints, share))


def _disagreement_plot(session: Session) -> Markup:
    rows = session.rows
    lines = {"median joint": (rows.disagreement * 1e3, "fused")}
    return Markup(line_plot("S_A against S_B, the median joint", "mm", rows.time_ns * 1e-9, lines, wide=True))


def _timing_plots(session: Session) -> Markup:
    rows = session.rows
    time = rows.time_ns * 1e-9
    fusion = line_plot("fusion", "ms", time, {"fusion": (rows.fuse_ms, "fused")}, logarithmic=True)
    skew = line_plot("skew of B", "ms", time, {"skew": (rows.skew_ns * 1e-6, "b")})
    return Markup(fusion) + Markup(skew)


def _event_rows(events: Sequence[ListedEvent]) -> list[tuple[str, str, str]]:
    return [(str(event.number), seconds_of(event.time_ns), event_in_words(event)) for event in events]


def _without_folders(sources: tuple[str, str]) -> tuple[str, str]:
    """The names of the sensors; for files, the shortest end of the path that distinguishes them."""
    a, b = (re.split(r"[/\\]", source) for source in sources)
    for parts in range(1, min(len(a), len(b)) + 1):
        if a[-parts:] != b[-parts:]:
            return "/".join(a[-parts:]), "/".join(b[-parts:])
    return a[-1], b[-1]
