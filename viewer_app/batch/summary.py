"""The summary of a batch: a table with one row per pair, as Parquet and as an HTML page."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal
from urllib.parse import quote

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from jinja2 import Environment, PackageLoader, StrictUndefined
from numpy.typing import NDArray

from devices.output_file import whole_file
from viewer_app.batch.jobs import Job, Record
from viewer_app.output_files import write_text

State = Literal["failed", "fused", "pending"]

RANKED = (
    "views_agree",
    "roughness_ratio",
    "jumps_fused",
    "jumps_own",
    "against_fused",
    "flips_per_minute",
    "rotation_off",
    "lost",
)
"""Figures that order the sessions; larger is worse."""
_DEGREES = 180.0 / math.pi
_COLUMNS: dict[str, tuple[str, float, int, str]] = {
    "frames": ("pairs", 1.0, 0, "frames of S*"),
    "seconds": ("s", 1.0, 1, "its length"),
    "good": ("good %", 1e2, 0, "share of the frames in good seconds"),
    "axes_angle": ("axes °", _DEGREES, 0, "angle between the axes of the sensors"),
    "rotation_sd": ("R ± °", _DEGREES, 1, "how certain the rotation of B is, one standard deviation"),
    "rotation_off": ("R off °", _DEGREES, 1, "its difference from a robust fit of the whole session"),
    "views_agree": ("views agree mm", 1e3, 0, "median distance between the calibrated views"),
    "roughness_ratio": (
        "roughness S* by views",
        1.0,
        2,
        "second difference of S*, divided by that of S_A and S_B",
    ),
    "jumps_fused": ("jumps S* %", 1e2, 2, "steps of S* of more than 150 mm per frame"),
    "jumps_own": ("S*'s own %", 1e2, 2, "those of them that no view has"),
    "against_fused": ("faces against motion %", 1e2, 1, "fast frames in which S* faces against its motion"),
    "flips_per_minute": ("flips per min", 1.0, 1, "how often S* turns by more than 90° within 0.1 s"),
    "lost": ("not paired %", 1e2, 1, "frames without a partner"),
    "stale": ("repeated %", 1e2, 1, "frames that a sensor repeated"),
    "bone_error": ("bone error mm", 1e3, 0, "largest error of a bone of S*"),
}
"""Columns of the page: heading, factor from SI, digits, meaning."""


@dataclass(frozen=True)
class Row:
    """One pair in the summary."""

    job: Job
    state: State  # fused, failed, or pending if the batch was interrupted
    record: Record | None = None  # the record of a fused session
    error: str = ""  # the line that says why it failed

    @property
    def figures(self) -> dict[str, Any]:
        """The figures of the session, and shares of frames: ``lost`` without a partner, ``stale``."""
        if self.record is None:
            return {}
        figures: dict[str, Any] = self.record["figures"]
        sides = "ab"
        frames = sum(figures[f"frames_{side}"] for side in sides)
        lost = sum(figures[f"{what}_{side}"] for side in sides for what in ("dropped", "alone"))
        stale = sum(figures[f"stale_{side}"] for side in sides)
        return {**figures, "lost": lost / max(frames, 1), "stale": stale / max(frames, 1)}


def worst_first(rows: Iterable[Row]) -> list[Row]:
    """Orders the rows: failed ones, fused ones from worst to best, pending ones.

    The fused ones are ordered by the mean of their ranks in the figures RANKED. A rank is the share of
    sessions that are better, with half of the equal ones; a figure that a session lacks does not count.
    """
    rows = list(rows)
    fused = [row for row in rows if row.state == "fused"]
    score = dict(zip((row.job.name for row in fused), _mean_ranks(fused), strict=True))
    order = {"failed": 0, "fused": 1, "pending": 2}
    return sorted(rows, key=lambda row: (order[row.state], -score.get(row.job.name, 0.0), row.job.name))


def _mean_ranks(rows: Sequence[Row]) -> list[float]:
    if not rows:
        return []
    values = np.array([[_number(row.figures.get(name)) for name in RANKED] for row in rows])
    ranks = np.stack([_ranks(column) for column in values.T], axis=1)
    known = np.isfinite(ranks)
    counts = known.sum(axis=1)
    means = np.where(known, ranks, 0.0).sum(axis=1) / np.maximum(counts, 1)
    # a session without any figure is too short to be judged: it comes first
    return [float(mean) for mean in np.where(counts > 0, means, 1.0)]


def _ranks(column: NDArray[np.float64]) -> NDArray[np.float64]:
    known = column[np.isfinite(column)]
    better = (known[None, :] < column[:, None]).sum(axis=1) + 0.5 * (known[None, :] == column[:, None]).sum(
        axis=1
    )
    return np.where(np.isfinite(column), better / max(len(known), 1), np.nan)


def write_parquet(rows: Sequence[Row], path: Path) -> None:
    """Writes the table in SI units, one row per pair, in the given order."""
    names = list(dict.fromkeys(name for row in rows for name in row.figures))
    columns: dict[str, Any] = {
        "name": pa.array([row.job.name for row in rows], pa.string()),
        "state": pa.array([row.state for row in rows], pa.string()),
        "error": pa.array([row.error or None for row in rows], pa.string()),
        "a": pa.array([str(row.job.pair.a) for row in rows], pa.string()),
        "b": pa.array([str(row.job.pair.b) for row in rows], pa.string()),
        "session": pa.array([_link(row, row.job.session) for row in rows], pa.string()),
        "warnings": pa.array([(row.record or {}).get("warnings", []) for row in rows], pa.list_(pa.string())),
    }
    for name in names:
        values = [row.figures.get(name) for row in rows]
        text = any(isinstance(value, str) for value in values)
        columns[name] = pa.array(values, pa.string() if text else pa.float64())
    with whole_file(path, overwrite=True) as hidden:
        pq.write_table(pa.table(columns), hidden)


def write_page(rows: Sequence[Row], path: Path) -> None:
    """Writes the HTML page: one file, no network; a script sorts and filters."""
    environment = Environment(
        loader=PackageLoader("viewer_app.batch"), autoescape=True, undefined=StrictUndefined
    )
    fused = [row for row in rows if row.state == "fused"]
    page = environment.get_template("summary.html").render(
        failed=[(row.job.name, row.error) for row in rows if row.state == "failed"],
        pending=[row.job.name for row in rows if row.state == "pending"],
        head=[(heading, meaning) for heading, _, _, meaning in _COLUMNS.values()],
        fused=[
            {
                "name": row.job.name,
                "page": quote(_link(row, row.job.page) or "") if row.job.options.pages else "",
                "session": quote(_link(row, row.job.session) or ""),
                "verdict": row.figures["verdict"],
                "reason": row.figures.get("verdict_reason", ""),
                "cells": _cells(row),
                "warnings": (row.record or {}).get("warnings", []),
                "calibration": row.figures["calibration"],
            }
            for row in fused
        ],
    )
    write_text(path, page, force=True)


def _cells(row: Row) -> list[str]:
    numbers = {name: _number(row.figures.get(name)) for name in _COLUMNS}
    return [
        f"{numbers[name] * factor:.{digits}f}" if math.isfinite(numbers[name]) else "–"
        for name, (_, factor, digits, _) in _COLUMNS.items()
    ]


def _link(row: Row, file: Path) -> str | None:
    """The path of a session's file, relative to the summary; None if there is no session."""
    return f"{row.job.name}/{file.name}" if row.state == "fused" else None


def _number(value: Any) -> float:
    return float(value) if isinstance(value, (int, float)) else math.nan
