"""The tables of ``duplex bench real``: none is wider than 80 columns."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from rich import box
from rich.table import Table

Column = tuple[str, float, int]

_MOTION: dict[str, Column] = {
    "rough_a": ("A", 1e3, 1),
    "rough_b": ("B", 1e3, 1),
    "rough_mean": ("mean", 1e3, 1),
    "rough_fused": ("S*", 1e3, 1),
    "roughness_ratio": ("S* by\nviews", 1.0, 2),
    "jumps_a": ("jumps\nA %", 1e2, 2),
    "jumps_b": ("jumps\nB %", 1e2, 2),
    "jumps_fused": ("jumps\nS* %", 1e2, 2),
    "jumps_own": ("S*'s\nown %", 1e2, 2),
}
_FACING: dict[str, Column] = {
    "against_a": ("A %", 1e2, 1),
    "against_b": ("B %", 1e2, 1),
    "against_fused": ("S* %", 1e2, 1),
    "flips_per_minute": ("flips\nper min", 1.0, 1),
    "rotation_off": ("R off °", 180.0 / np.pi, 1),
    "apart": ("views\napart mm", 1e3, 1),
}
_HELD_OUT: dict[str, Column] = {
    "held_out_rotation_off": ("R off °", 180.0 / np.pi, 1),
    "held_out_position_off": ("t off mm", 1e3, 0),
    "held_out_apart": ("views\napart mm", 1e3, 1),
    "held_out_apart_own_fit": ("own fit\nmm", 1e3, 1),
}


def real_tables(rows: dict[str, dict[str, float]], faults: Sequence[str]) -> list[Table]:
    """Makes the tables of all figures of all recordings, with means."""
    tables = [
        _table("Second difference of a joint (mm per frame²), and steps above 150 mm", _MOTION, rows),
        _table("Facing against the motion above 0.8 m/s; registration against a robust fit", _FACING, rows),
        _table("Registration of the first half, judged on the second half", _HELD_OUT, rows),
    ]
    if faults:
        columns: dict[str, Column] = {
            f"{fault}_{side}": (f"{fault}\n{side.upper()}", 1.0, 2) for fault in faults for side in "ab"
        }
        tables.append(_table("Share of a fault of one view, 20 frames long, that reaches S*", columns, rows))
    return tables


def _table(title: str, columns: dict[str, Column], rows: dict[str, dict[str, float]]) -> Table:
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column("recording", overflow="fold", max_width=26)
    for heading, _, _ in columns.values():
        table.add_column(heading, justify="right", no_wrap=True)
    for name, row in rows.items():
        table.add_row(name, *_cells(columns, row))
    if len(rows) > 1:
        means = {name: _mean([row[name] for row in rows.values()]) for name in columns}
        table.add_section()
        table.add_row("mean", *_cells(columns, means))
    return table


def _cells(columns: dict[str, Column], row: dict[str, float]) -> list[str]:
    return [
        f"{row[name] * scale:.{digits}f}" if np.isfinite(row[name]) else "–"
        for name, (_, scale, digits) in columns.items()
    ]


def _mean(values: list[float]) -> float:
    known = [value for value in values if np.isfinite(value)]
    return float(np.mean(known)) if known else np.nan
