"""Reads skeletons from CSV, one row per joint: ``time_us,body,joint,x,y,z[,state]``; metres, sensor frame."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv
from numpy.typing import NDArray

from devices.sensor import DeviceError, SensorFrame
from devices.skeletons.conventions import (
    Unit,
    check_metres_forward,
    check_microseconds,
    find_unit,
    impossible,
    impossible_in_words,
)
from devices.skeletons.read_file import ReadFile, text_bytes
from fusion.body import Body, body_of
from fusion.errors import FusionError
from fusion.skeleton import Skeleton, TrackingState, checked_joints

COLUMNS = ("time_us", "body", "joint", "x", "y", "z")

LATEST_US = 9 * 10**15
"""Largest time, so that nanoseconds fit into 64 bits."""

_LONGEST_HEADER = 65_536  # bytes
_SEPARATORS = (",", ";", "\t")
_STATES = {
    **{state.name.lower(): state for state in TrackingState},
    **{str(state.value): state for state in TrackingState},
}


def read_csv(path: Path, unit: Unit = "auto") -> ReadFile:
    """Reads a CSV file. Columns are separated by commas, semicolons or tabs.

    Where commas do not separate columns, numbers may have a decimal comma. ``state`` is tracked, inferred or
    not_tracked, or 2, 1, 0; without this column every joint counts as tracked. A joint is not tracked in a
    frame in which it has no row or an empty coordinate.

    Raises:
        DeviceError: Wrong columns, an unknown joint, text instead of a number, an incomplete row, a
            repeated joint; the message names the line. Or times that are no microseconds, or positions
            of an unknown unit, or behind the sensor.
    """
    raw = text_bytes(path)
    text = _table(raw, path)
    table = text.table
    if table.num_rows == 0:
        raise DeviceError(f"{path} has a header and no rows.")
    time_us = text.numbers("time_us", pa.int64())
    xyz = np.stack([text.numbers(axis, pa.float64()) for axis in "xyz"], axis=1)
    states = _states(text)
    if max(time_us.max(), -(time_us.min() + 1)) >= LATEST_US:  # the least integer has no absolute value
        raise DeviceError(f"{path}: time_us goes beyond {LATEST_US}; times are microseconds.")
    people, person = _codes(table, "body")
    names, name = _codes(table, "joint")
    try:
        body = body_of(set(names))
    except FusionError as error:
        raise DeviceError(f"{path}: {error}") from None
    joint = np.array([body.joint(n) for n in names])[name]

    times, frame = np.unique(time_us, return_inverse=True)
    check_microseconds(path, times)
    slot = (frame * len(people) + person) * len(body) + joint
    backward = _backward_times(text, time_us, person * len(body) + joint)
    _refuse_repeated(slot, text, body, backward is not None)
    _refuse_cut_off(raw, table, frame, path)
    positions = np.full((len(times), len(people), len(body), 3), np.nan)
    state = np.zeros((len(times), len(people), len(body)), dtype=np.uint8)
    positions.reshape(-1, 3)[slot] = xyz
    metres, warning = find_unit(path, body, positions.reshape(-1, len(body), 3), unit)
    positions *= metres
    check_metres_forward(path, positions)
    state.reshape(-1)[slot] = states
    present = np.zeros((len(times), len(people)), dtype=bool)
    present[frame, person] = True
    joints, joint_states = checked_joints(body, positions, state, present.shape)
    seen: list[dict[str, Skeleton]] = [{} for _ in times]
    time_ns = (times * 1000).tolist()
    for f, i in np.argwhere(present).tolist():
        seen[f][people[i]] = Skeleton(body, joints[f, i], joint_states[f, i], time_ns[f])
    frames = [SensorFrame(*each) for each in zip(time_ns, seen, strict=True)]
    warnings = warning, backward, _impossible_positions(text, xyz * metres, states)
    return ReadFile(body, frames, tuple(filter(None, warnings)))


@dataclass(frozen=True, eq=False)
class _Text:
    """The rows of a file as text."""

    table: pa.Table  # all columns, as text
    raw: bytes  # the file's bytes
    path: Path
    decimal_comma: bool  # whether numbers may be written with a comma

    def line(self, row: int) -> int:
        """The number of a row's line in the file, from 1; empty lines are not rows."""
        lines = (number for number, line in enumerate(self.raw.splitlines(), start=1) if line)
        return next(islice(lines, row + 1, None), row + 2)

    def numbers(self, column: str, kind: pa.DataType) -> NDArray[Any]:
        """A column as numbers; an empty coordinate is NaN."""
        text = pc.utf8_trim_whitespace(self.table[column])
        if kind == pa.float64():
            text = pc.if_else(pc.equal(text, ""), "nan", text)
            if self.decimal_comma:
                text = pc.replace_substring(text, ",", ".")
        else:
            text = pc.replace_substring_regex(text, r"^([0-9]+)\.0*$", r"\1")  # as pandas writes times
        try:
            return np.asarray(pc.cast(text, kind).to_numpy())
        except pa.ArrowInvalid:
            for row, value in enumerate(text.to_pylist()):
                try:
                    pa.scalar(value).cast(kind)
                except pa.ArrowInvalid:
                    wanted = "a whole number" if kind == pa.int64() else "a number"
                    raise DeviceError(
                        f"{self.path}, line {self.line(row)}: {column} must be {wanted}; got {value[:40]!r}."
                    ) from None
            raise


def _table(raw: bytes, path: Path) -> _Text:
    """Reads all columns as text."""
    header = raw[:_LONGEST_HEADER].splitlines()[0].decode("utf-8-sig", "replace")
    separator = max(_SEPARATORS, key=header.count)
    columns = [name.strip() for name in next(csv.reader([header], delimiter=separator), [])]
    if not set(COLUMNS) <= set(columns):  # X beside x is a column of its own
        columns = [name.lower() for name in columns]
    missing = [name for name in COLUMNS if name not in columns]
    if missing:
        raise DeviceError(
            f"{path}: no column {', '.join(missing)}. Columns must be {','.join(COLUMNS)} and optionally "
            f"state; the file begins with {header[:80]!r}."
            + (" This looks like JSON: name it .json." if header.lstrip().startswith(("{", "[")) else "")
        )
    if len(set(columns)) < len(columns):
        raise DeviceError(f"{path}: {header!r} repeats a column name.")
    wrong: list[str] = []

    def remember(row: pyarrow.csv.InvalidRow) -> str:
        wrong.append(row.text)
        return "skip"

    try:
        table = pyarrow.csv.read_csv(
            io.BytesIO(raw),
            read_options=pyarrow.csv.ReadOptions(column_names=columns, skip_rows=1, use_threads=False),
            parse_options=pyarrow.csv.ParseOptions(delimiter=separator, invalid_row_handler=remember),
            convert_options=pyarrow.csv.ConvertOptions(
                column_types=dict.fromkeys(columns, pa.string()), strings_can_be_null=False
            ),
        )
    except pa.ArrowInvalid as error:
        if "Empty CSV" in str(error):
            raise DeviceError(f"{path} has a header and no rows.") from None
        raise DeviceError(f"{path} cannot be read as CSV: {str(error).splitlines()[0]}.") from None
    if wrong:
        last = raw.rstrip(b"\r\n").endswith(wrong[-1].encode())
        cells = wrong[0].count(",") + 1
        commas = separator == "," and cells in (len(columns) + 3, len(columns) + 4)
        raise DeviceError(
            f"{path}{_line_of(raw, wrong[0])}: {wrong[0][:60]!r} does not have {len(columns)} columns"
            + (
                "; the file is cut off. Copy it again, or delete its last line."
                if last and not commas
                else "."
            )
            + (" If its numbers have decimal commas, separate the columns by semicolons." if commas else "")
        )
    return _Text(table, raw, path, decimal_comma=separator != ",")


def _line_of(raw: bytes, text: str) -> str:
    for number, line in enumerate(raw.splitlines(), start=1):
        if line.decode("utf-8", "replace").strip() == text.strip():
            return f", line {number}"
    return ""


def _states(text: _Text) -> NDArray[np.uint8]:
    table = text.table
    if "state" not in table.column_names:
        return np.full(table.num_rows, TrackingState.TRACKED, dtype=np.uint8)
    values, code = _codes(table, "state")
    for k, value in enumerate(values):
        if value.lower() not in _STATES:
            row = int(np.flatnonzero(code == k)[0])
            raise DeviceError(
                f"{text.path}, line {text.line(row)}: state {value[:40]!r} is none of tracked, inferred, "
                "not_tracked, 2, 1, 0."
            )
    return np.array([_STATES[value.lower()] for value in values], dtype=np.uint8)[code]


def _codes(table: pa.Table, column: str) -> tuple[list[str], NDArray[np.int64]]:
    """Returns the distinct values of a column, and the index of each row's value."""
    encoded = pc.utf8_trim_whitespace(table[column]).combine_chunks().dictionary_encode()
    return encoded.dictionary.to_pylist(), np.asarray(encoded.indices.to_numpy(), dtype=np.int64)


def _refuse_repeated(slot: NDArray[np.int64], text: _Text, body: Body, backward: bool) -> None:
    order = np.argsort(slot, kind="stable")
    again = order[1:][slot[order][1:] == slot[order][:-1]]
    if len(again):
        row = int(again.min())
        joint = body.joints[int(slot[row]) % len(body)]
        raise DeviceError(
            f"{text.path}: joint {joint} of one person has two rows in one frame, the second in line "
            f"{text.line(row)}." + (" Are two recordings in one file?" if backward else "")
        )


def _backward_times(text: _Text, time_us: NDArray[np.int64], joint: NDArray[np.int64]) -> str | None:
    """A warning if the time of a joint goes back from one row to its next."""
    order = np.argsort(joint, kind="stable")
    times, of = time_us[order], joint[order]
    back = order[1:][(np.diff(times) < 0) & (of[1:] == of[:-1])]
    if not len(back):
        return None
    line = text.line(int(back.min()))
    return f"{text.path}: time_us goes back in line {line}; the frames were sorted by time."


def _impossible_positions(text: _Text, metres: NDArray[np.float64], states: NDArray[np.uint8]) -> str | None:
    """A warning about positions of tracked joints that no sensor can report."""
    wrong = np.flatnonzero(impossible(metres) & (states != TrackingState.NOT_TRACKED))
    if not len(wrong):
        return None
    row = int(wrong[0])
    return impossible_in_words(text.path, len(wrong), f"in line {text.line(row)}", metres[row])


def _refuse_cut_off(raw: bytes, table: pa.Table, frame: NDArray[np.int64], path: Path) -> None:
    # Without a newline at the end, the last value may have lost digits. Some writers omit that newline, so
    # the file is rejected only if this value is shorter than others, or if the last frame lacks rows.
    if raw.endswith(b"\n"):
        return
    rows = np.bincount(frame)
    last = table[table.column_names[-1]]
    decimals = pc.utf8_length(pc.replace_substring_regex(last, r"^[^.]*\.?", "")).to_numpy()
    is_number = table.column_names[-1] in ("x", "y", "z")
    if (len(rows) > 1 and rows[-1] < rows[-2]) or (is_number and decimals[-1] < decimals.max()):
        raise DeviceError(
            f"{path} seems to be cut off in its last line, {raw.splitlines()[-1].decode()[-40:]!r}. Copy it "
            "again; if that line is complete, end it with a newline."
        )
