"""Reads skeletons from CSV, one row per joint: ``time_us,body,joint,x,y,z[,state]``; metres, sensor frame."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv
from numpy.typing import NDArray

from devices.sensor import DeviceError, SensorFrame
from devices.skeletons.conventions import check_metres_forward, check_microseconds
from fusion.body import Body, body_of
from fusion.errors import FusionError
from fusion.skeleton import Skeleton, TrackingState

COLUMNS = ("time_us", "body", "joint", "x", "y", "z")

LATEST_US = 9 * 10**15
"""Largest time, so that nanoseconds fit into 64 bits."""

_STATES = {
    **{state.name.lower(): state for state in TrackingState},
    **{str(state.value): state for state in TrackingState},
}


def read_csv(path: Path) -> tuple[Body, list[SensorFrame]]:
    """Reads the body and the frames of a CSV file.

    ``state`` is tracked, inferred or not_tracked, or 2, 1, 0. Without this column every joint counts as
    tracked. A joint is not tracked in a frame in which it has no row or an empty coordinate.

    Raises:
        DeviceError: Wrong columns, an unknown joint, text instead of a number, an incomplete row, a
            repeated joint; the message names the line. Or times that are no microseconds, or positions
            that are no metres, or behind the sensor.
    """
    raw = path.read_bytes()
    table = _table(raw, path)
    if table.num_rows == 0:
        raise DeviceError(f"{path} has a header and no rows.")
    time_us = _numbers(table, "time_us", pa.int64(), path)
    xyz = np.stack([_numbers(table, axis, pa.float64(), path) for axis in "xyz"], axis=1)
    check_metres_forward(path, xyz)
    states = _states(table, path)
    if np.abs(time_us).max() > LATEST_US:
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
    _refuse_repeated(slot, path, body)
    _refuse_cut_off(raw, table, frame, path)
    positions = np.full((len(times), len(people), len(body), 3), np.nan, dtype=np.float32)
    state = np.zeros((len(times), len(people), len(body)), dtype=np.uint8)
    with np.errstate(over="ignore"):
        positions.reshape(-1, 3)[slot] = xyz
    state.reshape(-1)[slot] = states
    present = np.zeros((len(times), len(people)), dtype=bool)
    present[frame, person] = True
    return body, [
        SensorFrame(
            int(t) * 1000,
            {
                people[i]: Skeleton.of(body, positions[f, i], state[f, i], int(t) * 1000)
                for i in np.flatnonzero(present[f])
            },
        )
        for f, t in enumerate(times)
    ]


def _table(raw: bytes, path: Path) -> pa.Table:
    """Reads all columns as text."""
    if not raw.strip():
        raise DeviceError(f"{path} is empty.")
    raw.decode("utf-8")  # raises UnicodeDecodeError, which the caller explains
    header = raw.splitlines()[0].decode("utf-8-sig")
    columns = [name.strip() for name in header.split(",")]
    missing = [name for name in COLUMNS if name not in columns]
    if missing:
        raise DeviceError(
            f"{path}: no column {', '.join(missing)}. Columns must be {','.join(COLUMNS)} and optionally "
            f"state; the file begins with {header[:80]!r}."
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
            parse_options=pyarrow.csv.ParseOptions(invalid_row_handler=remember),
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
        raise DeviceError(
            f"{path}{_line_of(raw, wrong[0])}: {wrong[0][:60]!r} does not have {len(columns)} columns"
            + ("; the file is cut off. Copy it again, or delete its last line." if last else ".")
        )
    return table


def _line_of(raw: bytes, text: str) -> str:
    for number, line in enumerate(raw.splitlines(), start=1):
        if line.decode("utf-8", "replace").strip() == text.strip():
            return f", line {number}"
    return ""


def _numbers(table: pa.Table, column: str, kind: pa.DataType, path: Path) -> NDArray[np.generic]:
    text = pc.utf8_trim_whitespace(table[column])
    if kind == pa.float64():
        text = pc.if_else(pc.equal(text, ""), "nan", text)
    try:
        return np.asarray(pc.cast(text, kind).to_numpy())
    except pa.ArrowInvalid:
        for row, value in enumerate(text.to_pylist()):
            try:
                pa.scalar(value).cast(kind)
            except pa.ArrowInvalid:
                wanted = "a whole number" if kind == pa.int64() else "a number"
                raise DeviceError(
                    f"{path}, line {row + 2}: {column} must be {wanted}; got {value[:40]!r}."
                ) from None
        raise


def _states(table: pa.Table, path: Path) -> NDArray[np.uint8]:
    if "state" not in table.column_names:
        return np.full(table.num_rows, TrackingState.TRACKED, dtype=np.uint8)
    values, code = _codes(table, "state")
    for k, value in enumerate(values):
        if value.lower() not in _STATES:
            row = int(np.flatnonzero(code == k)[0])
            raise DeviceError(
                f"{path}, line {row + 2}: state {value[:40]!r} is none of tracked, inferred, not_tracked, 2, "
                f"1, 0."
            )
    return np.array([_STATES[value.lower()] for value in values], dtype=np.uint8)[code]


def _codes(table: pa.Table, column: str) -> tuple[list[str], NDArray[np.int64]]:
    """Returns the distinct values of a column, and the index of each row's value."""
    encoded = pc.utf8_trim_whitespace(table[column]).combine_chunks().dictionary_encode()
    return encoded.dictionary.to_pylist(), np.asarray(encoded.indices.to_numpy(), dtype=np.int64)


def _refuse_repeated(slot: NDArray[np.int64], path: Path, body: Body) -> None:
    sorted_slots = np.sort(slot)
    repeated = sorted_slots[1:][sorted_slots[1:] == sorted_slots[:-1]]
    if len(repeated):
        joint = body.joints[int(repeated[0]) % len(body)]
        raise DeviceError(f"{path}: joint {joint} of one person has two rows in one frame.")


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
