"""Reads skeletons from CSV, one row per joint: ``time_us,body,joint,x,y,z[,state]``; metres, sensor frame.

The files of other programs may have other units, axes, names and spellings of the columns, or a row for all
joints; see :mod:`.columns`.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from devices.sensor import DeviceError
from devices.skeletons.csv_files.columns import COLUMNS, Columns
from devices.skeletons.csv_files.states import MOST_STATES, is_like_states, states_of
from devices.skeletons.csv_files.text import codes, line_of_row, refuse_cut_off, text_rows
from devices.skeletons.read_file import FoundPoints, JointRows, found_of
from devices.skeletons.stated_format import UNSTATED, StatedFormat
from devices.skeletons.times import FEWEST
from fusion.skeleton import TrackingState
from fusion.support.large_arrays import GrowingArray
from fusion.support.progress import Progress, quietly

_BLOCK = 4_000_000  # bytes


def read_csv(
    path: Path, stated: StatedFormat = UNSTATED, progress: Progress = quietly, block: int = _BLOCK
) -> FoundPoints:
    """Reads a CSV file. Columns are separated by commas, semicolons or tabs.

    Where commas do not separate columns, numbers may have a decimal comma. Without a column of states every
    joint counts as tracked. A joint is not tracked in a frame in which it has no row or an empty coordinate.

    Args:
        block: Bytes that are read at once; -1 for all. The result does not depend on it.

    Raises:
        DeviceError: Wrong columns, an unknown joint, text instead of a number, an incomplete row, a
            repeated joint; the message names the line. Or times of an unknown unit.
    """
    xyz, time = GrowingArray(), list[NDArray[Any]]()
    coded: dict[str, _Coded] = {}
    ignored: list[str] = []
    count = -(-path.stat().st_size // block) if block > 0 and path.is_file() else 1
    before: pa.Table | None = None
    table: pa.Table | None = None
    text, clock = None, ""
    for text in progress(text_rows(path, block), f"reading {path.name}", count):
        before, table = table, text.table
        clock, times = text.times()
        time.append(times)
        xyz.append(np.stack([text.numbers(axis, pa.float64()) for axis in "xyz"], axis=1))
        if not coded:
            ignored = [
                name for name in table.column_names if name not in (*COLUMNS, text.columns.time, "", " ")
            ]
            coded = {name: _Coded(MOST_STATES) for name in ignored if is_like_states(name)}
            coded |= {name: _Coded() for name in ("body", "joint", text.columns.device)}
        for name, column in coded.items():
            column.append(table, name)
    assert text is not None
    columns = text.columns
    refuse_cut_off(text, before, np.concatenate(time[-2:]))
    pa.default_memory_pool().release_unused()
    at, *code = GrowingArray.wholes((xyz, *(column.code for column in coded.values())))
    values = {name: list(column.values) for name, column in coded.items()}
    told, keep = _one_sensor(path, columns, values[columns.device], code[-1], stated.side)
    times, at, code = np.concatenate(time)[keep], at[keep], [of[keep] for of in code]
    codes_of = dict(zip(coded, code, strict=True))
    number = np.arange(len(codes_of["body"])) if isinstance(keep, slice) else keep

    def where(row: int) -> str:
        return f"in line {line_of_row(path, int(number[row]) // columns.joints_per_line)}"

    ids, has_body = values["body"], "body" in text.table.column_names
    person = codes_of["body"]
    if len(ids) >= FEWEST and 2 * len(ids) > _pairs(times, person):
        told.append(f"{path}: the column of ids ({ids[0]!r}, …) counts rows and is no person's.")
        ids, person, has_body = ["0"], np.zeros_like(person), False
    states, about_states, used = _states(path, values, codes_of, where, len(at))
    rows = JointRows(
        path, clock, times, None, ids, person, values["joint"], codes_of["joint"], at, states, where,
        columns.time_in_file, has_body,
    )  # fmt: skip
    unread = tuple(name for name in (*ignored, *columns.others) if name != used)
    return found_of(rows, stated.names, [*told, *about_states], free_axes=True, ignored=unread)


class _Coded:
    """A column of texts, block after block: the distinct ones, and which of them each row has.

    Args:
        most: Distinct texts that are kept; others count as one.
    """

    def __init__(self, most: float = np.inf) -> None:
        self.values: dict[str, int] = {}
        self.code = GrowingArray()
        self._most = most

    def append(self, table: pa.Table, column: str) -> None:
        texts, code = ["0"], np.zeros(table.num_rows, dtype=np.int64)
        if column in table.column_names:
            texts, code = codes(table, column)
        for text in texts:
            if len(self.values) < self._most:
                self.values.setdefault(text, len(self.values))
        self.code.append(
            np.array([self.values.get(text, len(self.values) - 1) for text in texts], np.int32)[code]
        )


def _one_sensor(
    path: Path, columns: Columns, sensors: list[str], sensor: NDArray[Any], side: str
) -> tuple[list[str], Any]:
    """A line about a file of several sensors, and which rows are of this one."""
    if len(sensors) < 2:
        return [], slice(None)
    mine = int(side == "b")
    return [
        f"{path}: it has {len(sensors)} sensors by the column {columns.device}; this is "
        f"{sensors[mine]!r}. The file given twice is fused: the first two as A and B."
    ], np.flatnonzero(sensor == mine)


def _pairs(times: NDArray[Any], person: NDArray[Any]) -> int:
    """How many people are in the frames, each counted in every frame."""
    return len(np.unique(np.unique(times, return_inverse=True)[1] * (1 + int(person.max())) + person))


def _states(
    path: Path,
    values: dict[str, list[str]],
    code: dict[str, NDArray[Any]],
    where: Callable[[int], str],
    count: int,
) -> tuple[NDArray[np.uint8], list[str], str]:
    """(N,) tracking states of all rows, lines for the user, and the name of the column of states, or none."""
    told = []
    for name in (name for name in values if is_like_states(name)):
        states, wrong, known = states_of(name, values[name])
        if len(states):
            return states[code[name]], [], name
        if name == "state":
            row = int(np.flatnonzero(code[name] == values[name].index(wrong))[0])
            raise DeviceError(
                f"{path}, {where(row).removeprefix('in ')}: state {wrong[:40]!r} is none of {known}."
            )
        told.append(
            f"{path}: column {name} is ignored, because its values, such as {wrong[:20]!r}, are no states: "
            f"{known}. Every joint counts as tracked."
        )
    return np.full(count, TrackingState.TRACKED, dtype=np.uint8), told, ""
