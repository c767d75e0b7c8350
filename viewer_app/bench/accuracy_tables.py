"""The tables of ``duplex bench accuracy``: none is wider than 80 columns, the width of piped output."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from rich import box
from rich.table import Table

from viewer_app.bench.accuracy_trials import METHODS, Outcome, Trial

_DISTANCES: dict[str, tuple[str, float, int]] = {
    "mpjpe": ("MPJPE\nmm", 1e3, 1),
    "p95": ("95 %\nmm", 1e3, 0),
    "hidden_one": ("hidden\nin one\nview mm", 1e3, 0),
    "hidden_both": ("hidden\nin both\nmm", 1e3, 0),
    "swapped": ("L/R\nswapped\n%", 1e2, 1),
    "fuse_us": ("µs a\nframe", 1.0, 0),
}
_MOVEMENT: dict[str, tuple[str, float, int]] = {
    "bone_error": ("largest\nbone\nerror mm", 1e3, 0),
    "bone_deviation": ("bone\ndeviation\nmm", 1e3, 1),
    "jitter": ("jitter,\nstill\nmm", 1e3, 1),
    "acceleration": ("acceler.\nerror\nmm/frame²", 1e3, 1),
    "lag": ("lag\nframes", 1.0, 2),
}
"""By figure: the column's title, the factor to its unit, digits."""


def tables_of_methods(outcomes: list[Outcome]) -> list[Table]:
    """All figures of all methods, and which method is clearly the best in one."""
    distances = _table("Methods on identical input: mean ± deviation over seeds", _DISTANCES, outcomes)
    movement = _table("", _MOVEMENT, outcomes)
    trials = len({o.trial for o in outcomes})
    known = {name: len(common_trials(outcomes, name)) for name in (*_DISTANCES, *_MOVEMENT)}
    partly = ", ".join(f"{name} {count}" for name, count in known.items() if count < trials)
    movement.caption = (
        "Bold: better than every other method, seed against seed, by more than twice the "
        "deviation of that difference."
    )
    if partly:
        movement.caption += f" Only trials in which every method has a figure count: {partly} of {trials}."
    movement.caption_justify = "left"
    return [distances, movement]


def common_trials(outcomes: list[Outcome], name: str) -> set[Trial]:
    """The trials in which every method has a figure: only those are averaged over."""
    missing = {o.trial for o in outcomes if not np.isfinite(o.figures[name])}
    return {o.trial for o in outcomes} - missing


def over_seeds(outcomes: list[Outcome], method: str, name: str) -> NDArray[np.float64]:
    """(S,) a method's figure for each seed, averaged over the movements and angles all methods have it in."""
    common = common_trials(outcomes, name)
    by_seed: dict[int, list[float]] = {}
    for outcome in outcomes:
        if outcome.method == method and outcome.trial in common:
            by_seed.setdefault(outcome.trial.seed, []).append(outcome.figures[name])
    return np.array([np.mean(values) for _, values in sorted(by_seed.items())])


def clearly_best(outcomes: list[Outcome], name: str) -> str | None:
    """The method nearest to zero, where seed against seed it is so by twice the difference's deviation."""
    values = {method: np.abs(over_seeds(outcomes, method, name)) for method in METHODS}
    best = min(METHODS, key=lambda method: float(values[method].mean()) if values[method].size else np.inf)
    if values[best].size < 2:
        return None
    worse = [values[method] - values[best] for method in METHODS if method != best]
    return best if all(by.mean() > 2.0 * by.std(ddof=1) for by in worse) else None


def wins(outcomes: list[Outcome], method: str) -> float:
    """Paired by recording: the share in which ours is nearer to the truth than another method."""
    ours = {o.trial: o.figures["mpjpe"] for o in outcomes if o.method == "ours"}
    return float(np.mean([ours[o.trial] < o.figures["mpjpe"] for o in outcomes if o.method == method]))


def table_by(title: str, of: Callable[[Trial], str], outcomes: list[Outcome]) -> Table:
    """MPJPE, and how often ours is the nearer one, by movement or by angle."""
    table = Table(
        title=f"MPJPE in mm by {title} (in how many recordings ours is nearer)",
        title_justify="left",
        box=box.SIMPLE_HEAD,
    )
    table.add_column(title, no_wrap=True)
    for method in METHODS:
        table.add_column(method.replace(" ", "\n"), justify="right", overflow="fold")
    for group in (*dict.fromkeys(of(o.trial) for o in outcomes), "all"):
        within = [o for o in outcomes if group in ("all", of(o.trial))]
        means = [float(np.mean([o.figures["mpjpe"] for o in within if o.method == m])) for m in METHODS]
        cells = [
            f"{mean * 1e3:.1f}" + ("" if method == "ours" else f"\n({wins(within, method):.0%})")
            for method, mean in zip(METHODS, means, strict=True)
        ]
        table.add_row(group, *(f"[bold]{c}[/]" if c is cells[int(np.argmin(means))] else c for c in cells))
    return table


def _table(title: str, columns: dict[str, tuple[str, float, int]], outcomes: list[Outcome]) -> Table:
    table = Table(title=title or None, title_justify="left", box=box.SIMPLE_HEAD)
    table.add_column("method", no_wrap=True)
    for heading, _, _ in columns.values():
        table.add_column(heading, justify="right", overflow="fold")  # not a digit is lost
    best = {name: clearly_best(outcomes, name) for name in columns}
    for method in METHODS:
        cells = []
        for name, (_, scale, digits) in columns.items():
            values = over_seeds(outcomes, method, name) * scale
            text = f"{values.mean():.{digits}f}" if values.size else "–"
            if values.size > 1 and name != "fuse_us":
                text += f"±{values.std(ddof=1):.{digits}f}"
            cells.append(f"[bold]{text}[/]" if best[name] == method else text)
        table.add_row(method, *cells)
    return table
