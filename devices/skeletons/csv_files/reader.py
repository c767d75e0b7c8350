"""Reads skeletons from CSV, one row per joint: ``time_us,body,joint,x,y,z[,state]``; metres, sensor frame.

The files of other programs may have other units, axes, names and spellings of the columns, or a row for all
joints; see :mod:`.columns`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
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
from devices.skeletons.name_tables import FilePoints, listed, points_of
from devices.skeletons.read_file import FoundPoints
from devices.skeletons.stated_format import UNSTATED, StatedFormat
from devices.skeletons.times import FEWEST, capture_times, digest, times_of_new_frames
from fusion.body import BODIES
from fusion.pair_arrays import View, joined_views
from fusion.skeleton import TrackingState
from fusion.support.large_arrays import GrowingArray, parts
from fusion.support.progress import Progress, quietly

_BLOCK = 4_000_000  # bytes
_OFTEN = 0.2  # of the rows: as where each frame is logged more than once, or where times lost digits
_MOST, _FEWEST_TIMES = 0.7, 3  # the share of rows, or the number of times, at which digits are certainly lost


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
    rows, about_rows = _of_one_sensor(_rows(path, block, progress), stated.side)
    points, labels, names, table, about_points = _points(path, stated, rows.labels)
    label = np.array([points.find(name) for name in labels], dtype=np.int64)[rows.label]
    joint = rows.person * len(points) + label
    called, telling = rows.columns.time_in_file, _times_of_new_frames(rows)
    clock = capture_times(
        path, rows.clock, rows.time, called=called, telling=telling, key=joint, anonymous=not rows.has_body
    )
    time_ns, clock_in_words, about_times = clock
    backward = _backward(rows, time_ns, joint)
    times, frame = np.unique(time_ns, return_inverse=True)
    key, skeleton = np.unique(frame * len(rows.people) + rows.person, return_inverse=True)
    slot = skeleton * len(points) + label
    order, repeated = _once(path, rows, points, slot, len(times), bool(backward))
    states, about_states, ignored = _states(path, rows)
    by = slot[order]

    def blocks() -> Iterator[View]:
        for part in parts(len(key)):
            first, end = np.searchsorted(by, (part.start * len(points), part.stop * len(points)))
            of, count = order[first:end], part.stop - part.start
            at = np.full((count * len(points), 3), np.nan)
            state = np.zeros(count * len(points), dtype=np.uint8)
            here = by[first:end] - part.start * len(points)
            at[here], state[here] = rows.xyz[of], states[of]
            time = times[key[part] // len(rows.people)]
            yield View(time, at.reshape(count, -1, 3), state.reshape(count, -1))

    def where(k: int, point: int) -> str:
        row = int(order[np.searchsorted(by, k * len(points) + point)])
        return f"in line {rows.line(row)}"

    view = joined_views(blocks())
    return FoundPoints(
        points, times, rows.people, key // len(rows.people), key % len(rows.people), view, "m", True,
        names, clock_in_words, table,
        (*about_rows, *about_points, *about_times, *backward, *repeated, *about_states), ignored, where,
    )  # fmt: skip


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
            names = [name for name in table.column_names if name not in (*COLUMNS, text.columns.time, "")]
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


def _times_of_new_frames(rows: _Rows) -> NDArray[Any]:
    times, frame = np.unique(rows.time, return_inverse=True)
    return times_of_new_frames(times, np.bincount(frame, digest(rows.xyz, rows.label, rows.person)))


def _points(
    path: Path, stated: StatedFormat, labels: list[str]
) -> tuple[FilePoints, list[str], str, str, list[str]]:
    """What the points of a file are, their names, how and by which table they were found, and lines."""
    ends = [re.fullmatch(r"(.*?)(\d+)", label) for label in labels]
    same = len({end and end[1] for end in ends}) == 1
    numbers = [int(end[2]) for end in ends if end and same]
    if numbers and not stated.names:
        body = next((body for body in BODIES.values() if len(body) == 1 + max(numbers)), None)
        if body is not None:
            labels = [body.joints[number] for number in numbers]
            words = f"the numbers of joints as those of {body.name}, from 0 on"
            return points_of(path, labels)[0], labels, words, "", []
    points, table = points_of(path, labels, stated.names)
    told = []
    if left_out := points.left_out:
        told.append(f"{path}: by {stated.names or table} these points are no joints: {listed(left_out)}.")
    return points, labels, f"the names of {table}" if table else "", table, told


def _backward(rows: _Rows, time_ns: NDArray[np.int64], joint: NDArray[np.int64]) -> list[str]:
    """A warning if the time of a joint goes back from one row to its next."""
    if (np.diff(time_ns) >= 0).all():
        return []
    order = np.argsort(joint, kind="stable")
    back = order[1:][(np.diff(time_ns[order]) < 0) & (np.diff(joint[order]) == 0)]
    if not len(back):
        return []
    line = rows.line(int(back.min()))
    return [f"{rows.path}: the time goes back in line {line}; the frames were sorted by time."]


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


def _once(
    path: Path, rows: _Rows, points: FilePoints, slot: NDArray[np.int64], frames: int, backward: bool
) -> tuple[NDArray[np.int64], list[str]]:
    """The rows in the order of their slots, each slot once, and a line where many rows were repeated.

    Raises:
        DeviceError: Two different rows are of one joint of a person in a frame, or some rows are twice.
    """
    order = np.argsort(slot, kind="stable")
    if not (np.diff(slot[order]) == 0).any():
        return order, []
    # Programs write zeros for bodies that are not tracked, and often give all of these the same id.
    order = order[(np.nan_to_num(rows.xyz[order]) != 0.0).any(axis=1)]
    again = np.append(False, np.diff(slot[order]) == 0)
    if not again.any():
        return order, []
    share = float(again.mean())
    later, earlier = order[again], order[np.flatnonzero(again) - 1]
    row = int(later.min())
    if share > _OFTEN:
        if np.array_equal(rows.xyz[later], rows.xyz[earlier], equal_nan=True):
            return order[~again], [
                f"{path}: {100.0 * share:.0f} % of the rows repeat another one of the same time, and "
                "are left out."
            ]
        if frames < _FEWEST_TIMES or share > _MOST:
            there = "one time" if frames == 1 else f"{frames} different times"
            raise DeviceError(
                f"{path}: the times lost their digits: {len(slot)} rows have {there}, such as "
                f"{rows.time[row]:.6g} in line {rows.line(row)}. Write them with all digits, or, if frames "
                "came at a constant rate, a column frame that counts them."
            )
    joint = points.named(int(slot[row]) % len(points))
    why = " Are two recordings in one file?" if backward else ""
    why = why or " Have two people one id, or did the times lose digits?" * (share > _OFTEN)
    why = why if rows.has_body else " There is no column body: name the one that distinguishes people so."
    raise DeviceError(
        f"{path}: joint {joint} of one person has two rows in one frame, the second in line "
        f"{rows.line(row)}.{why}"
    )
