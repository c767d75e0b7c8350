"""A session's quality on one page that stands alone: no network, no script, light and dark."""

from __future__ import annotations

import re
from collections.abc import Sequence
from html import escape
from typing import Any

import numpy as np

from recordings import layout
from recordings.session import Session
from recordings.session_comparison import frame_noise_of
from viewer_app.report.figures import calibration_in_words
from viewer_app.report.numbers_in_words import in_mm
from viewer_app.report.svg_plots import bar_plot, line_plot, trust_map

_STYLE = """
:root { color-scheme: light dark; --text: #1d1d1f; --quiet: #6e6e73; --page: #ffffff; --line: #d2d2d7; }
@media (prefers-color-scheme: dark) {
  :root { --text: #f2f2f4; --quiet: #a1a1a6; --page: #161618; --line: #3a3a3e; }
}
body { font: 16px/1.5 system-ui, sans-serif; color: var(--text); background: var(--page);
       max-width: 70rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.6rem; } h2 { font-size: 1.2rem; margin-top: 2.5rem; }
p.note { color: var(--quiet); }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
td, th { padding: .15rem .8rem; border-bottom: 1px solid var(--line); text-align: right; }
td:first-child, th:first-child, .words td, .words th { text-align: left; }
.numbers td, .words td:first-child { white-space: nowrap; }
.scroll, figure.wide { overflow-x: auto; }
figure { margin: 0; } figure svg { width: 100%; height: auto; } figure.wide svg { min-width: 44rem; }
.grid { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(28rem, 100%), 1fr)); gap: 1rem; }
h1, p { overflow-wrap: anywhere; }
strong.bad { color: #d7263d; }
"""


def review_page(session: Session, figures: dict[str, Any]) -> str:
    """The page as HTML.

    Args:
        session: The session.
        figures: Its report, :func:`viewer_app.report.figures.report`.
    """
    name = escape(session.name)
    body = "\n".join(
        (
            f"<h1>{name}</h1>",
            _verdict(session, figures),
            _section("Calibration", _calibration(session)),
            _section("Bone lengths", _bones(session)),
            _section("Every bone", _bone_table(figures)),
            _section("Jitter", _jitter(session)),
            _section("Trust a joint", _trust(session)),
            _section("Disagreement of the two views", _disagreement(session, figures)),
            _section("Timing", _timing(session, figures)),
            _section("Events", _events(session)),
        )
    )
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width">'
        f"<title>{name}</title><style>{_STYLE}</style></head>\n<body>{body}</body></html>\n"
    )


def _section(title: str, content: str) -> str:
    return f"<section><h2>{title}</h2>\n{content}</section>"


def _verdict(session: Session, figures: dict[str, Any]) -> str:
    rows = session.rows
    seconds = float(rows.time_ns[-1] - rows.time_ns[0]) * 1e-9
    damage = ""
    if session.damage is not None:
        damage = (
            f'<p><strong class="bad">Not whole</strong>: {escape(session.damage)}; '
            f"{session.frames_lost} frames are known to be lost.</p>"
        )
    settings = ", ".join(f"{k} {v[0]}" for k, v in session.about["settings"].items())
    source_a, source_b = _without_folders(session.sources)
    return (
        f"{damage}<p>{len(session)} frames in {seconds:.1f} s, {escape(session.body.name)}; "
        f"{escape(settings)}. A: {escape(source_a)}. B: {escape(source_b)}.</p>"
        f"<p>Largest bone error: S_A {in_mm(figures['bone_error_mm']['a']['max'])}, "
        f"S_B {in_mm(figures['bone_error_mm']['b']['max'])}, "
        f"<strong>S* {in_mm(figures['bone_error_mm']['fused']['max'])}</strong>. "
        f"Frames without a person: A {figures['without_person']['a']}, B {figures['without_person']['b']}, "
        f"both {figures['without_person']['both']}.</p>"
    )


def _calibration(session: Session) -> str:
    how, *verdict = calibration_in_words(session.calibration)
    lines = [f"Calibrated on: {how}", *verdict]
    return "".join(f"<p>{escape(line)}</p>" for line in lines)


def _bones(session: Session) -> str:
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
            plots.append(
                line_plot(bone.replace("_", " "), "m", time, lines, level=float(rows.bone_lengths[-1, j]))
            )
    return (
        '<p class="note">As in the paper\'s fig. 5; dashed is the length measured in the start-up pose.</p>'
        f'<div class="grid">{"".join(plots)}</div>'
    )


def _bone_table(figures: dict[str, Any]) -> str:
    rows = []
    for name, of in figures["bones"].items():
        cells = [f"{of['target_m'] * 1e3:.0f}"]
        for key in ("a", "b", "fused"):
            mean, deviation = of[key]["mean_m"], of[key]["std_mm"]
            cells.append("–" if mean is None else f"{mean * 1e3:.0f} ± {deviation:.1f}")
        rows.append((name.replace("_", " "), *cells))
    return _table(("bone, mm", "target", "S_A", "S_B", "S*"), rows)


def _jitter(session: Session) -> str:
    rows = session.rows
    jitter = {
        "S_A": (frame_noise_of(rows.positions_a.astype(np.float64), rows.frame) * 1e3, "a"),
        "S_B": (frame_noise_of(rows.positions_b.astype(np.float64), rows.frame) * 1e3, "b"),
        "S*": (frame_noise_of(rows.fused, rows.frame) * 1e3, "fused"),
    }
    note = "The median second difference over √6: the noise of one frame, where movement is slow."
    return f'<p class="note">{note}</p>' + bar_plot("mm", session.body.joints, jitter)


def _trust(session: Session) -> str:
    rows = session.rows
    total = rows.weights_a + rows.weights_b
    share = np.where(total > 0.0, rows.weights_a / np.where(total > 0.0, total, 1.0), np.nan)
    note = "1: S* follows A; 0: it follows B; empty: neither sees the joint and it hangs on its bones."
    return f'<p class="note">{note}</p>' + trust_map(rows.time_ns * 1e-9, session.body.joints, share)


def _disagreement(session: Session, figures: dict[str, Any]) -> str:
    of, time = figures["disagreement_mm"], session.rows.time_ns * 1e-9
    plot = line_plot(
        "S_A against S_B, the median joint",
        "mm",
        time,
        {"median joint": (session.rows.disagreement * 1e3, "fused")},
        wide=True,
    )
    return f"<p>Median {in_mm(of['median'])}, 95 % {in_mm(of['p95'])}.</p>{plot}"


def _timing(session: Session, figures: dict[str, Any]) -> str:
    ms, time = figures["fuse_ms"], session.rows.time_ns * 1e-9
    plots = "".join(
        (
            line_plot("fusion", "ms", time, {"fusion": (session.rows.fuse_ms, "fused")}, logarithmic=True),
            line_plot("skew of B", "ms", time, {"skew": (session.rows.skew_ns * 1e-6, "b")}),
        )
    )
    rate = f"{session.frame_rate:.1f} frames a second"
    text = f"{ms['p50']:.3f} ms a frame (median), 99 % {ms['p99']:.3f} ms; {rate}"
    return f'<p>{text}.</p><div class="grid">{plots}</div>'


def _events(session: Session) -> str:
    rows = [
        ("" if e.time_ns is None else f"{e.time_ns * 1e-9:.2f} s", e.level, e.text) for e in session.events
    ]
    return _table(("time", "", "event"), rows, "words") if rows else "<p>None.</p>"


def _without_folders(sources: tuple[str, str]) -> tuple[str, str]:
    """What the sensors were called: of files the end of the path that tells them apart, and no more."""
    a, b = (re.split(r"[/\\]", source) for source in sources)
    for parts in range(1, min(len(a), len(b)) + 1):
        if a[-parts:] != b[-parts:]:
            return "/".join(a[-parts:]), "/".join(b[-parts:])
    return a[-1], b[-1]


def _table(head: Sequence[str], rows: Sequence[Sequence[str]], kind: str = "numbers") -> str:
    def line(cells: Sequence[str], tag: str) -> str:
        return "<tr>" + "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in cells) + "</tr>"

    lines = line(head, "th") + "".join(line(row, "td") for row in rows)
    return f'<div class="scroll"><table class="{kind}">{lines}</table></div>'
