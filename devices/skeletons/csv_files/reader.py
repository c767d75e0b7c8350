"""Reads skeletons from CSV, one row per joint: ``time_us,body,joint,x,y,z[,state]``; metres, sensor frame.

The files of other programs may have other units, axes, names and spellings of the columns, or a row for all
joints; see :mod:`.columns`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from devices.sensor import DeviceError
from devices.skeletons.csv_files.columns import COLUMNS, Columns
from devices.skeletons.csv_files.states import StateColumn
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
    rows, told = _of_one_sensor(_rows(path, block, progress), stated.side)
    states, about_states, ignored = _states(path, rows)
    joints = JointRows(
        path, rows.clock, rows.time, None, rows.people, rows.person, rows.labels, rows.label, rows.xyz,
        states, lambda row: f"in line {rows.line(row)}", rows.columns.time_in_file, rows.has_body,
    )  # fmt: skip
    return found_of(joints, stated.names, [*told, *about_states], free_axes=True, ignored=ignored)


@dataclass(frozen=True, eq=False)
class _Rows:
    """All rows of a file."""

    path: Path
    columns: Columns
    clock: str  # the column of the times' unit
    time: NDArray[Any]
    has_body: bool
    people: list[str]
    person: NDArray[np.int32]  # index of each row's person
    labels: list[str]
    label: NDArray[np.int32]
    xyz: NDArray[np.float64]
    states: list[StateColumn]
    other_columns: tuple[str, ...]
    sensors: list[str]
    sensor: NDArray[np.int32]  # index of each row's sensor
    number: NDArray[np.int64] | None = None  # of each row in the file; None: all rows in their order

    def line(self, row: int) -> int:
        """The number of a row's line in the file, from 1."""
        row = row if self.number is None else int(self.number[row])
        return line_of_row(self.path, row // self.columns.joints_per_line)


def _rows(path: Path, block: int, progress: Progress) -> _Rows:
    people, labels, sensors = dict[str, int](), dict[str, int](), dict[str, int]()
    person, label, xyz, sensor = GrowingArray(), GrowingArray(), GrowingArray(), GrowingArray()
    times: list[NDArray[Any]] = []
    states: list[StateColumn] = []
    names: list[str] = []
    count = -(-path.stat().st_size // block) if block > 0 and path.is_file() else 1
    before: pa.Table | None = None
    table: pa.Table | None = None
    text, clock = None, ""
    for text in progress(text_rows(path, block), f"reading {path.name}", count):
        before, table = table, text.table
        clock, time = text.times()
        times.append(time)
        xyz.append(np.stack([text.numbers(axis, pa.float64()) for axis in "xyz"], axis=1))
        columns = (people, "body", person), (labels, "joint", label), (sensors, text.columns.device, sensor)
        for known, column, rows in columns:
            there = column in table.column_names
            values, code = codes(table, column) if there else (["0"], np.zeros(len(time), dtype=np.int64))
            numbers = [known.setdefault(value, len(known)) for value in values]
            rows.append(np.array(numbers, dtype=np.int32)[code])
        if len(times) == 1:
            names = [
                name for name in table.column_names if name not in (*COLUMNS, text.columns.time, "", " ")
            ]
            states = [StateColumn(name) for name in names if StateColumn.is_like(name)]
        for column_of_states in states:
            column_of_states.append(*codes(table, column_of_states.name))
    assert text is not None
    refuse_cut_off(text, before, np.concatenate(times[-2:]))
    pa.default_memory_pool().release_unused()
    persons, joints, places, devices = GrowingArray.wholes((person, label, xyz, sensor))
    return _Rows(
        path, text.columns, clock, np.concatenate(times), "body" in text.table.column_names,
        list(people), persons, list(labels), joints, places, states, (*names, *text.columns.others),
        list(sensors), devices,
    )  # fmt: skip


def _of_one_sensor(rows: _Rows, side: str) -> tuple[_Rows, list[str]]:
    """The rows of one of several sensors, and of people; with lines for the user.

    A column of ids that has another one in almost every frame counts rows.
    """
    told = []
    if len(rows.sensors) > 1:
        chosen = int(side == "b")
        number = np.flatnonzero(rows.sensor == chosen)
        told.append(
            f"{rows.path}: it has {len(rows.sensors)} sensors by the column {rows.columns.device}; this is "
            f"{rows.sensors[chosen]!r}. The file given twice is fused: the first two as A and B."
        )
        for column in rows.states:
            column.keep(number)
        rows = replace(
            rows, time=rows.time[number], person=rows.person[number], label=rows.label[number],
            xyz=rows.xyz[number], number=number,
        )  # fmt: skip
    ids = len(rows.people)
    if ids >= FEWEST and 2 * ids > len(
        np.unique(np.unique(rows.time, return_inverse=True)[1] * ids + rows.person)
    ):
        told.append(f"{rows.path}: the column of ids ({rows.people[0]!r}, …) counts rows and is no person's.")
        rows = replace(rows, people=["0"], person=np.zeros_like(rows.person), has_body=False)
    return rows, told


def _states(path: Path, rows: _Rows) -> tuple[NDArray[np.uint8], list[str], tuple[str, ...]]:
    """The states of all rows, lines for the user, and the columns that are ignored."""
    for column in rows.states:
        states = column.states()
        if states is not None:
            return states, [], tuple(name for name in rows.other_columns if name != column.name)
        if column.name == "state":
            row, value = column.refused()
            raise DeviceError(
                f"{path}, line {rows.line(row)}: state {value[:40]!r} is none of tracked, inferred, "
                "not_tracked, 3, 2, 1, 0."
            )
    told = [
        f"{path}: column {column.name} is ignored, because its values, such as {column.refused()[1][:20]!r}, "
        f"are no states: {column.known}. Every joint counts as tracked."
        for column in rows.states
    ]
    return np.full(len(rows.time), TrackingState.TRACKED, dtype=np.uint8), told, rows.other_columns
