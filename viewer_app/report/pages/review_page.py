"""A session on one self-contained HTML page: its quality and its motion; no network, light and dark.

This module collects the content of the page; ``templates/review_page.html`` defines its form, and
``templates/player.js`` plays the motion. Jinja escapes all text from the session.
"""

import math
from contextlib import suppress
from datetime import datetime
from itertools import groupby
from shlex import quote
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined, Template
from markupsafe import Markup

from devices.findings.rules import of_views
from devices.people.recorded_people import SeenPerson
from devices.recorded.files import distinct_names
from recordings.appearance.colors import MARK_COLORS, PROMINENT_BONES
from recordings.appearance.joint_trust import TrustColors
from recordings.data.frame_noise import frame_noise_of
from recordings.data.session_arrays import rate_without_pauses
from recordings.quality.doubtful_time import UNCERTAIN
from recordings.session import Session
from viewer_app.report.events import (
    event_in_words,
    list_events,
    opening_event,
    seconds_of,
    shortest_list,
)
from viewer_app.report.motion import encoded_motion
from viewer_app.report.pages.film import film
from viewer_app.report.pages.good_part import good_seconds
from viewer_app.report.svg_plots import bar_plot, line_plot, skeleton_color, trust_map
from viewer_app.report.walking import GAIT_HEAD, movement_of
from viewer_app.report.words import BONE_HEAD, bone_rows, detail_lines, lead_lines

_MOST_EVENTS = 12
"""Printed on paper; the screen lists all."""


def review_page(session: Session, figures: dict[str, Any]) -> str:
    """The page as HTML."""
    source_a, source_b = distinct_names(*session.sources)
    lead = list(lead_lines(figures))
    events = list_events(session.events)
    printed = {each.number for each in shortest_list(events, _MOST_EVENTS)}
    opening = opening_event(events, session.first_calibrated_frame or 0)
    return page_template("review_page.html").render(
        name=session.name,
        damage=session.damage_in_words,
        recorded=recorded(session),
        seconds=stretches(session),
        good=good_seconds(session),
        uncertain=f"{UNCERTAIN:.0f}",
        settings=", ".join(f"{name} {values[0]}" for name, values in session.about["settings"].items()),
        source_a=source_a,
        source_b=source_b,
        colors=page_colors(),
        tiles=[line for line in lead if line.figure],
        lines=[line for line in lead if not line.figure],
        details=detail_lines(figures),
        movement=movement_of(session),
        gait_head=GAIT_HEAD,
        bone_plots=_bone_plots(session),
        bone_head=BONE_HEAD,
        bones=list(bone_rows(figures)),
        jitter_plot=_jitter_plot(session),
        trust_plot=_trust_plot(session),
        disagreement_plot=_disagreement_plot(session),
        timing_plots=_timing_plots(session),
        people_head=("", "seen by A", "seen by B", "follow with"),
        people=[_seen(person, followed=not k) for k, person in enumerate(session.seen_people)],
        events=[
            {
                "number": each.number,
                "at": each.event.time_ns * 1e-9,
                "time": seconds_of(each.event.time_ns),
                "text": event_in_words(each),
                "printed": each.number in printed,
            }
            for each in events
        ],
        motion=encoded_motion(session, [each.event.time_ns * 1e-9 for each in events]),
        film=film(session),
        start=0.0 if opening is None else opening.event.time_ns * 1e-9,
    )


def _seen(person: SeenPerson, followed: bool) -> tuple[list[str], str]:
    """The cells of a person, and the options with which this one is followed."""
    cells, options = ["followed" if followed else ""], []
    for side, name, seconds in zip("ab", person.ids, person.seconds, strict=True):
        cells.append(f"{seconds:.1f} s" if seconds else "–")
        if name is not None and all(person.seconds):  # else nobody is there to be fused
            options.append(f"--person-{side} {quote(name)}")
    return cells, " ".join(options)


def page_colors() -> dict[str, str]:
    """The colours that ``page.css`` needs."""
    marks = {"good": "do", "usable": "better", "poor": "mend"}
    return {key: skeleton_color(key) for key in ("a", "b", "fused")} | {
        word: "#{:02x}{:02x}{:02x}".format(*MARK_COLORS[mark]) for word, mark in marks.items()
    }


def recorded(session: Session) -> str:
    """What was recorded, when and with what, or when its file was written."""
    rate = rate_without_pauses(session.rows.time_ns)
    written = session.about["session"].get("written_by", [""])[0]
    when = recorded_when(session)
    with suppress(OSError):  # it may have been moved
        if session.path is not None and not when:
            at = datetime.fromtimestamp(session.path.stat().st_mtime)
            written += f", file of {at:%Y-%m-%d %H:%M}; nothing says when it was recorded"
    parts = (
        when and f"recorded {when}",
        f"{session.time[-1]:.1f} s, {len(session)} frames"
        + ("" if rate is None else f", {rate:.1f} per second"),
        f"body {session.body.name}" + (f", tracker {session.tracker}" if session.tracker else ""),
        f"method {session.settings.method}, revision {session.method_revision}",
        written,
    )
    return "; ".join(filter(None, parts))


def recorded_when(session: Session) -> str:
    """When a live session or its recordings were recorded, in local time; empty where nothing says so."""
    return "" if session.recorded is None else f"{session.recorded:%Y-%m-%d %H:%M}"


def stretches(session: Session) -> list[dict[str, Any]]:
    """The quality of each second; equal ones that follow each other are one stretch."""
    found: list[dict[str, Any]] = []
    seconds = session.quality_per_second
    ends = [each.start for each in seconds[1:]] + [max(session.time[-1], seconds[-1].start)]
    for (word, reason), each in groupby(zip(seconds, ends, strict=True), key=lambda pair: pair[0][1:]):
        of, until = zip(*each, strict=True)
        start, end = of[0].start, until[-1]
        text = f"{start:.0f}–{math.ceil(end)} s {word}" + (f": {reason}" if reason else "")
        found.append({"at": start, "lasts": end - start, "word": word, "text": text})
    return found


def page_template(name: str) -> Template:
    """A template of this package; all text that is put into it is escaped."""
    environment = Environment(
        loader=PackageLoader("viewer_app.report"), autoescape=True, undefined=StrictUndefined
    )
    return environment.get_template(name)


def _bone_plots(session: Session) -> Markup:
    rows = session.rows
    time, lengths = rows.time_ns * 1e-9, rows.bone_length_of_each
    plots = []
    for limb in PROMINENT_BONES:
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
            plots.append(line_plot(bone.replace("_", " "), "m", time, lines, (level,)))
    return Markup("").join(map(Markup, plots))


def _jitter_plot(session: Session) -> Markup:
    rows = session.rows
    jitter = {
        "S_A": (frame_noise_of(rows.positions_a, rows.time_ns) * 1e3, "a"),
        "S_B": (frame_noise_of(rows.positions_b, rows.time_ns) * 1e3, "b"),
        "S*": (frame_noise_of(rows.seen, rows.time_ns) * 1e3, "fused"),
    }
    return Markup(bar_plot("mm", _joints(session), jitter))


def _joints(session: Session) -> list[str]:
    """The names of the joints; those that no view has in any frame are marked."""
    never = session.never_seen
    return [f"{name} (never seen)" if name in never else name for name in session.body.joints]


def _trust_plot(session: Session) -> Markup:
    rows = session.rows
    trust = TrustColors()
    share = np.concatenate([trust.shares(part).astype(np.float32) for part in rows.parts()])
    return Markup(trust_map(rows.time_ns * 1e-9, _joints(session), share))


def _disagreement_plot(session: Session) -> Markup:
    rows = session.rows
    lines = {"median joint": (rows.disagreement * 1e3, "fused")}
    limits = of_views(session.body.name)
    levels = limits.good[1], limits.usable[1]
    title = "median joint; good is below {:.0f}, usable below {:.0f} mm".format(*levels)
    return Markup(line_plot(title, "mm", session.time, lines, levels, wide=True))


def _timing_plots(session: Session) -> Markup:
    rows = session.rows
    time = rows.time_ns * 1e-9
    fusion = line_plot("fusion", "ms", time, {"fusion": (rows.fuse_ms, "fused")}, logarithmic=True)
    if not rows.skew_ns.any():
        return Markup(fusion)
    return Markup(fusion) + Markup(line_plot("skew of B", "ms", time, {"skew": (rows.skew_ns * 1e-6, "b")}))
