"""The tables of ``duplex bench accuracy``: none is wider than 80 columns, the width of piped output."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from rich import box
from rich.table import Table

from viewer_app.bench.accuracy_methods import ABLATIONS, METHODS, OURS
from viewer_app.bench.accuracy_trials import Outcome, Trial

Column = tuple[str, float, int]

_DISTANCES: dict[str, Column] = {
    "mpjpe": ("MPJPE\nmm", 1e3, 1),
    "p95": ("95 %\nmm", 1e3, 0),
    "hidden_one": ("hidden\nin one\nview mm", 1e3, 0),
    "hidden_both": ("hidden\nin both\nmm", 1e3, 0),
    "swapped": ("L/R\nswapped\n%", 1e2, 2),
    "fuse_us": ("µs per\nframe", 1.0, 0),
}
_MOVEMENT: dict[str, Column] = {
    "bone_error": ("largest\nbone\nerror mm", 1e3, 0),
    "bone_deviation": ("bone\ndeviation\nmm", 1e3, 1),
    "jitter": ("jitter,\nstill\nmm", 1e3, 1),
    "acceleration": ("acceler.\nerror\nmm/frame²", 1e3, 1),
    "lag": ("lag\nframes", 1.0, 2),
}
_UNCERTAINTY: dict[str, Column] = {
    "within_1sd": ("truth within\n1 σ, %", 1e2, 1),
    "within_2sd": ("truth within\n2 σ, %", 1e2, 1),
}
"""By figure: the column's title, the factor to its unit, digits."""

_KINDS = {method.name: method.kind for method in (*METHODS, *ABLATIONS)}


def methods_of(outcomes: Sequence[Outcome]) -> list[str]:
    """The names of the methods that were run, in their order."""
    return list(dict.fromkeys(o.method for o in outcomes))


def rivals_of(outcomes: Sequence[Outcome]) -> list[str]:
    """The methods that ours competes with: no variant or ablation of it, and no bound that uses the truth."""
    others = [m for m in methods_of(outcomes) if m != OURS and not m.startswith(f"{OURS}, ")]
    return [m for m in others if _KINDS[m] not in ("bound", "ablation")]


def tables_of_methods(outcomes: list[Outcome]) -> list[Table]:
    """Tables with all figures of all methods; a clearly best method is bold."""
    distances = _table("Methods on identical input: mean ± deviation over seeds", _DISTANCES, outcomes)
    movement = _table("", _MOVEMENT, outcomes)
    tables = [distances, movement]
    shown = {**_DISTANCES, **_MOVEMENT}
    if any(np.isfinite(o.figures["within_1sd"]) for o in outcomes):
        shown |= _UNCERTAINTY
        certain = [o for o in outcomes if np.isfinite(o.figures["within_1sd"])]
        tables.append(_table("", _UNCERTAINTY, certain))
    trials = len({o.trial for o in outcomes})
    known = {name: len(common_trials(outcomes, name)) for name in shown}
    partly = ", ".join(f"{name} {count}" for name, count in known.items() if count < trials)
    caption = (
        "Bold: better than every other method, seed against seed, by more than twice the "
        "deviation of that difference."
    )
    if "oracle" in methods_of(outcomes):
        caption += " The oracle uses the truth and does not compete."
    if partly:
        caption += f" Only trials in which every method has a figure count: {partly} of {trials}."
    tables[-1].caption, tables[-1].caption_justify = caption, "left"
    return tables


def common_trials(outcomes: Sequence[Outcome], name: str) -> set[Trial]:
    """The trials in which every method has a figure; averages use only these.

    A method that never has the figure is ignored.
    """
    having = {o.method for o in outcomes if np.isfinite(o.figures[name])}
    missing = {o.trial for o in outcomes if o.method in having and not np.isfinite(o.figures[name])}
    return {o.trial for o in outcomes} - missing if having else set()


def over_seeds(outcomes: Sequence[Outcome], method: str, name: str) -> NDArray[np.float64]:
    """(S,) a method's figure for each seed, averaged over the movements and angles all methods have it in."""
    common = common_trials(outcomes, name)
    by_seed: dict[int, list[float]] = {}
    for outcome in outcomes:
        if outcome.method == method and outcome.trial in common and np.isfinite(outcome.figures[name]):
            by_seed.setdefault(outcome.trial.seed, []).append(outcome.figures[name])
    return np.array([np.mean(values) for _, values in sorted(by_seed.items())])


def clearly_best(outcomes: Sequence[Outcome], name: str) -> str | None:
    """The method nearest to zero, if its paired difference to each other method exceeds twice the
    deviation."""
    competing = [method for method in methods_of(outcomes) if _KINDS[method] != "bound"]
    values = {method: np.abs(over_seeds(outcomes, method, name)) for method in competing}
    values = {method: of for method, of in values.items() if of.size > 1}
    if len(values) < 2:
        return None
    best = min(values, key=lambda method: float(values[method].mean()))
    worse = [of - values[best] for method, of in values.items() if method != best]
    return best if all(by.mean() > 2.0 * by.std(ddof=1) for by in worse) else None


def wins(outcomes: Sequence[Outcome], method: str) -> float:
    """The share of recordings in which our method is nearer to the truth than another method."""
    ours = {o.trial: o.figures["mpjpe"] for o in outcomes if o.method == OURS}
    return float(np.mean([ours[o.trial] < o.figures["mpjpe"] for o in outcomes if o.method == method]))


def lost_to(outcomes: Sequence[Outcome]) -> list[tuple[str, float, str, float]]:
    """Cases in which another method is nearer to the truth on average: (movement, angle, method, metres)."""
    lost = []
    rivals = rivals_of(outcomes)
    for motion, angle in dict.fromkeys((o.trial.motion, o.trial.angle) for o in outcomes):
        here = [o for o in outcomes if (o.trial.motion, o.trial.angle) == (motion, angle)]
        ours = _mpjpe(here, OURS)
        lost += [(motion, angle, m, ours - _mpjpe(here, m)) for m in rivals if _mpjpe(here, m) < ours]
    return lost


def table_by(title: str, of: Callable[[Trial], str], outcomes: list[Outcome]) -> Table:
    """MPJPE of each method by movement or by angle, and how often ours is nearer to the truth."""
    table = Table(title=f"MPJPE in mm by {title}", title_justify="left", box=box.SIMPLE_HEAD)
    table.add_column("method", no_wrap=True)
    groups = [*dict.fromkeys(of(o.trial) for o in outcomes), "all"]
    for group in groups:
        table.add_column(group, justify="right", overflow="fold", min_width=4)
    compared = OURS in methods_of(outcomes)
    if compared:
        table.add_column(f"{OURS}\nnearer", justify="right", no_wrap=True)
    by_group = {g: [o for o in outcomes if g in ("all", of(o.trial))] for g in groups}
    means = {m: [_mpjpe(by_group[g], m) for g in groups] for m in methods_of(outcomes)}
    least = np.min([of_it for m, of_it in means.items() if _KINDS[m] != "bound"], axis=0)
    for method, values in means.items():
        cells = [f"{1e3 * v:.1f}" for v in values]
        cells = [
            f"[bold]{c}[/]" if v <= b and _KINDS[method] != "bound" else c
            for c, v, b in zip(cells, values, least, strict=True)
        ]
        if compared:
            cells.append("" if method == OURS else f"{wins(outcomes, method):.0%}")
        table.add_row(method, *cells)
    return table


def said_of_losses(outcomes: list[Outcome]) -> list[str]:
    """In which movements and at which angles another method is nearer to the truth on average, in words."""
    if OURS not in methods_of(outcomes) or not rivals_of(outcomes):
        return []
    places = len({(o.trial.motion, o.trial.angle) for o in outcomes})
    lost = lost_to(outcomes)
    if not lost:
        return [f"In each of {places} movements × angles, {OURS} is the nearest to the truth on average."]
    count = len({(motion, angle) for motion, angle, _, _ in lost})
    lines = [f"In {count} of {places} movements × angles another method is nearer to the truth on average:"]
    for method in dict.fromkeys(m for _, _, m, _ in lost):
        where = [f"{motion} {angle:g}° ({by * 1e3:.1f} mm)" for motion, angle, m, by in lost if m == method]
        lines.append(f"  {method}: {', '.join(where)}")
    return lines


def _mpjpe(outcomes: Sequence[Outcome], method: str) -> float:
    return float(np.mean([o.figures["mpjpe"] for o in outcomes if o.method == method]))


def _table(title: str, columns: dict[str, Column], outcomes: list[Outcome]) -> Table:
    table = Table(title=title or None, title_justify="left", box=box.SIMPLE_HEAD)
    table.add_column("method", no_wrap=True)
    for heading, _, _ in columns.values():
        table.add_column(heading, justify="right", overflow="fold")  # fold instead of cutting digits off
    best = {name: clearly_best(outcomes, name) for name in columns}
    for method in methods_of(outcomes):
        cells = []
        for name, (_, scale, digits) in columns.items():
            values = over_seeds(outcomes, method, name) * scale
            text = f"{values.mean():.{digits}f}" if values.size else "–"
            if values.size > 1 and name != "fuse_us":
                text += f"±{values.std(ddof=1):.{digits}f}"
            cells.append(f"[bold]{text}[/]" if best[name] == method else text)
        table.add_row(method, *cells)
    return table
