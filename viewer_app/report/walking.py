"""The joint angles and the gait of a session, for its page."""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from markupsafe import Markup
from numpy.typing import ArrayLike

from recordings.data.series import AngleSeries
from recordings.gait import SIDES, Gait, Measured
from recordings.quality.figures import Figures, known_or_none
from recordings.quality.limits import POSSIBLE
from recordings.session import Session
from viewer_app.report.svg_plots import cycle_plot, line_plot

_OF_A_SIDE = ("hip_flexion", "knee_flexion", "hip_abduction", "shoulder_flexion", "elbow_flexion")
_FEWEST_CYCLES = 2  # of a side, for a mean
_MOTION = 3.0  # seconds, of which it is said that they have no steps
GAIT_HEAD = ("mean ± standard deviation", "left", "right", "asymmetry (%)")


class MovementSection(NamedTuple):
    """What the page shows of the person's movement."""

    angles: Markup  # plots over time
    summary: str  # of the gait; empty where the person hardly moves
    rows: list[tuple[str, ...]]  # of the gait, with the columns of GAIT_HEAD
    cycles: Markup  # plots over the gait cycle


def movement_of(session: Session) -> MovementSection:
    """The content of the page's sections about angles and gait."""
    gait = session.gait
    return MovementSection(
        Markup("").join(map(Markup, _over_time(session, session.angles))),
        _summary(gait),
        list(_gait_rows(gait)),
        Markup("").join(map(Markup, _over_cycles(gait))),
    )


def _over_time(session: Session, angles: AngleSeries) -> Iterator[str]:
    time = session.time
    plots = {
        name: {side: (f"{name}_{side}", side) for side in SIDES}
        for name in (*_OF_A_SIDE, "shoulder_abduction")
    }
    plots["trunk"] = {"forwards": ("trunk_flexion", "fused"), "to the right": ("trunk_lean", "truth")}
    for name, lines in plots.items():
        bands = {line: angles.sigma[:, angles.names.index(angle)] for line, (angle, _) in lines.items()}
        sigma = _median(list(bands.values()))
        title = name.replace("_", " ") + (f", 1 σ about {sigma:.0f}°" if np.isfinite(sigma) else "")
        values = {line: (angles[angle], key) for line, (angle, key) in lines.items()}
        beyond = POSSIBLE.get(name, (-np.inf, np.inf))
        low, high = beyond
        if any(((each < low) | (each > high)).any() for each, _ in values.values()):
            title += f"; ×: beyond {low:.0f} to {high:.0f}°"
        yield line_plot(title, "°", time, values, sigma=bands, beyond=beyond)


def _over_cycles(gait: Gait) -> Iterator[str]:
    if min(len(gait.cycles(side)) for side in SIDES) < _FEWEST_CYCLES:
        return
    toe_offs = {side: _median(gait.stance(side)) for side in SIDES}
    for name in _OF_A_SIDE:
        curves = {side: gait.curves(f"{name}_{side}") for side in SIDES}
        yield cycle_plot(name.replace("_", " "), curves, toe_offs)
    trunk = {side: gait.curves("trunk_flexion", side) for side in SIDES}
    yield cycle_plot("trunk flexion", trunk, toe_offs)


def _summary(gait: Gait) -> str:
    left_out = ", ".join(f"{seconds:.0f} s {why}" for why, seconds in gait.left_out.items() if seconds >= 0.5)
    left_out = f"left out of {gait.moving_seconds:.0f} s of motion: {left_out}" if left_out else ""
    if not gait.steps:
        return f"No steps; {left_out}." if gait.moving_seconds > _MOTION else ""
    walks = len(gait.walks)
    turns = ""
    if gait.turns:
        angles = sorted(abs(math.degrees(turn.angle)) for turn in gait.turns)
        by = f"{angles[0]:.0f}°" if len(angles) == 1 else f"{angles[0]:.0f}° to {angles[-1]:.0f}°"
        within = sum(
            any(0.0 <= step.strike - turn.begins <= turn.seconds for turn in gait.turns)
            for step in gait.steps
        )
        turns = (
            f"; {len(angles)} {'turn' if len(angles) == 1 else 'turns'} by {by} with {within} of the steps"
        )
    return (
        f"{len(gait.steps)} steps in {gait.walking_seconds:.0f} s of walking, {walks} "
        f"{'walk' if walks == 1 else 'walks'}; cadence {_in_words(gait.cadence, 1)} steps/min, speed "
        f"{_in_words(gait.speed, 2)} m/s (± standard error){turns}{left_out and '; '}{left_out}."
    )


def _in_words(measured: Measured, digits: int) -> str:
    value = f"{measured.value:.{digits}f}".replace("-", "−")
    if not np.isfinite(measured.sigma):
        return value
    # no more certain than the value is rounded
    return f"{value} ± {max(measured.sigma, 10.0**-digits):.{digits}f}"


def gait_figures(gait: Gait) -> Figures:
    """The figures of the gait as a report has them, those of its section in the page; None where unknown."""

    def of_side(side: str) -> Figures:
        steps, cycles = gait.of_side(side), gait.cycles(side)
        return {
            "steps": len(steps),
            "step_length_m": _scatter([step.length for step in steps]),
            "step_width_m": _scatter([step.width for step in steps]),
            "toe_clearance_m": _scatter([step.clearance for step in steps]),
            "step_time_s": _scatter([step.seconds for step in steps]),
            "gait_cycles": len(cycles),
            "stride_time_s": _scatter(np.diff(cycles, axis=1)),
            "stance_percent": _scatter(100.0 * gait.stance(side)),
        }

    def measured(each: Measured) -> Figures:
        return {name: known_or_none(figure) for name, figure in each._asdict().items()}

    return {
        "walks": len(gait.walks),
        "walking_seconds": gait.walking_seconds,
        "left_out_seconds": dict(gait.left_out),
        "cadence_per_minute": measured(gait.cadence),
        "speed_m_per_s": measured(gait.speed),
        "turns": {
            "count": len(gait.turns),
            "angle_deg": _scatter([abs(math.degrees(turn.angle)) for turn in gait.turns]),
            "seconds": _scatter([turn.seconds for turn in gait.turns]),
        },
        **{side: of_side(side) for side in SIDES},
        "asymmetry_percent": {name: measured(each) for name, each in gait.asymmetry.items()},
    }


def _gait_rows(gait: Gait) -> Iterator[tuple[str, ...]]:
    """Mean and standard deviation of the steps of each side."""
    if not gait.steps:
        return
    figures = gait_figures(gait)
    uneven = {name: _told(each, "value", "sigma", 0) for name, each in figures["asymmetry_percent"].items()}
    for title, name, digits in (
        ("steps", "steps", None),
        ("step length (m)", "step_length_m", 2),
        ("step width (m)", "step_width_m", 2),
        ("toe clearance (m)", "toe_clearance_m", 2),
        ("step time (s)", "step_time_s", 2),
        ("gait cycles", "gait_cycles", None),
        ("stride time (s)", "stride_time_s", 2),
        ("stance (% of the cycle)", "stance_percent", 0),
    ):
        of_sides = (figures[side][name] for side in SIDES)
        sides = [str(each) if digits is None else _told(each, "mean", "sd", digits) for each in of_sides]
        yield (title, *sides, uneven.get(name.rpartition("_")[0], ""))


def _scatter(values: ArrayLike) -> Figures:
    """Mean and standard deviation of the values that are known."""
    known = np.asarray(values, dtype=np.float64)
    known = known[np.isfinite(known)]
    return {
        "mean": float(known.mean()) if len(known) else None,
        "sd": float(known.std(ddof=1)) if len(known) > 1 else None,
    }


def _told(figure: Figures, value: str, sigma: str, digits: int) -> str:
    if figure[value] is None:
        return "–"
    return _in_words(Measured(figure[value], np.nan if figure[sigma] is None else figure[sigma]), digits)


def _median(values: object) -> float:
    known = np.asarray(values, dtype=np.float64)
    known = known[np.isfinite(known)]
    return float(np.median(known)) if len(known) else float("nan")
