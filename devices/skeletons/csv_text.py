"""The rows of a CSV file as text: its columns, its lines, and the numbers in it."""

from __future__ import annotations

import csv
from collections.abc import Collection, Iterator
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv
from numpy.typing import NDArray

from devices.sensor import DeviceError
from devices.skeletons.conventions import TIME_COLUMNS
from devices.skeletons.read_file import text_blocks
from fusion.skeleton import TrackingState

COLUMNS = ("body", "joint", "x", "y", "z")
_LONGEST_HEADER = 65_536  # bytes
_SEPARATORS = (",", ";", "\t")
_STATES = {
    **{state.name.lower(): state for state in TrackingState},
    **{str(state.value): state for state in TrackingState},
}


@dataclass(frozen=True, eq=False)
class TextRows:
    """Consecutive rows of a file as text."""

    table: pa.Table  # all columns, as text
    raw: bytes
    path: Path
    first: int  # number of the first of these rows in the file
    time: str  # name of the column of times
    decimal_comma: bool  # whether numbers may be written with a comma

    def line(self, row: int) -> int:
        """The number of a row's line in the file, from 1."""
        return line_of_row(self.path, self.first + row)

    def numbers(self, column: str, kind: pa.DataType) -> NDArray[Any]:
        """A column as numbers; an empty coordinate is NaN."""
        with suppress(pa.ArrowInvalid):
            return np.asarray(pc.cast(self.table[column], kind).to_numpy())
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
                    raise self._not(wanted, column, row, value) from None
            raise

    def times(self) -> NDArray[Any]:
        """The times as whole numbers, or as decimals where one of them is."""
        with suppress(DeviceError):
            return self.numbers(self.time, pa.int64())
        values = self.numbers(self.time, pa.float64())
        for row in np.flatnonzero(~np.isfinite(values))[:1]:
            raise self._not("a number", self.time, int(row), self.table[self.time][int(row)].as_py())
        return values

    def _not(self, wanted: str, column: str, row: int, value: str) -> DeviceError:
        return DeviceError(
            f"{self.path}, line {self.line(row)}: {column} must be {wanted}; got {value[:40]!r}."
        )


def text_rows(path: Path, size: int, required: Collection[str] = COLUMNS) -> Iterator[TextRows]:
    """The rows of a file in blocks of this many bytes, at least one.

    Raises:
        DeviceError: There is no row, no time, or one of the required columns is missing.
    """
    columns: list[str] = []
    separator, first = ",", 0
    for raw in text_blocks(path, size):
        header = not columns
        if header:
            columns, separator = _columns(path, raw, required)
        elif not raw.strip():
            continue
        table = _table(path, raw, columns, separator, header)
        if table.num_rows:
            time = next(name for name in TIME_COLUMNS if name in columns)
            yield TextRows(table, raw, path, first, time, decimal_comma=separator != ",")
        first += table.num_rows
    if first == 0:
        raise DeviceError(f"{path} has a header and no rows.")


def _columns(path: Path, raw: bytes, required: Collection[str]) -> tuple[list[str], str]:
    """The names of the columns in the first line, and what separates them."""
    header = raw[:_LONGEST_HEADER].splitlines()[0].decode("utf-8-sig", "replace")
    separator = max(_SEPARATORS, key=header.count)
    columns = [name.strip() for name in next(csv.reader([header], delimiter=separator), [])]
    if not set(required) <= set(columns) or not TIME_COLUMNS.keys() & set(columns):
        columns = [name.lower() for name in columns]  # X beside x is a column of its own
    missing = [name for name in required if name not in columns]
    if not TIME_COLUMNS.keys() & set(columns):
        missing.insert(0, next(iter(TIME_COLUMNS)))
    if missing:
        raise DeviceError(
            f"{path}: no column {', '.join(missing)}. Columns must be time_us,{','.join(COLUMNS)} and "
            f"optionally state; the file begins with {header[:80]!r}."
            + (" This looks like JSON: name it .json." if header.lstrip().startswith(("{", "[")) else "")
        )
    if len(set(columns)) < len(columns):
        raise DeviceError(f"{path}: {header!r} repeats a column name.")
    return columns, separator


def _table(path: Path, raw: bytes, columns: list[str], separator: str, header: bool) -> pa.Table:
    """Reads all columns as text."""
    wrong: list[str] = []

    def remember(row: pyarrow.csv.InvalidRow) -> str:
        wrong.append(row.text)
        return "skip"

    try:
        table = pyarrow.csv.read_csv(
            pa.BufferReader(raw),
            read_options=pyarrow.csv.ReadOptions(
                column_names=columns, skip_rows=int(header), use_threads=False
            ),
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
            f"{path}{_line_of(path, wrong[0])}: {wrong[0][:60]!r} does not have {len(columns)} columns"
            + (
                "; the file is cut off. Copy it again, or delete its last line."
                if last and not commas
                else "."
            )
            + (" If its numbers have decimal commas, separate the columns by semicolons." if commas else "")
        )
    return table


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    """The lines of a file that are not empty, and their numbers from 1."""
    with path.open(encoding="utf-8", errors="replace") as file:
        yield from ((number, line) for number, line in enumerate(file, start=1) if line.strip("\n"))


def line_of_row(path: Path, row: int) -> int:
    """The number of a row's line in the file; empty lines are not rows."""
    return next((number for number, _ in islice(_lines(path), row + 1, None)), row + 2)


def _line_of(path: Path, text: str) -> str:
    return next((f", line {k}" for k, line in _lines(path) if line.strip() == text.strip()), "")


def states_of(text: TextRows) -> NDArray[np.uint8]:
    table = text.table
    if "state" not in table.column_names:
        return np.full(table.num_rows, TrackingState.TRACKED, dtype=np.uint8)
    values, code = codes(table, "state")
    for k, value in enumerate(values):
        if value.lower() not in _STATES:
            row = int(np.flatnonzero(code == k)[0])
            raise DeviceError(
                f"{text.path}, line {text.line(row)}: state {value[:40]!r} is none of tracked, inferred, "
                "not_tracked, 2, 1, 0."
            )
    return np.array([_STATES[value.lower()] for value in values], dtype=np.uint8)[code]


def codes(table: pa.Table, column: str) -> tuple[list[str], NDArray[np.int64]]:
    """Returns the distinct values of a column, and the index of each row's value."""
    encoded = table[column].combine_chunks().dictionary_encode()
    if pc.utf8_trim_whitespace(encoded.dictionary) != encoded.dictionary:
        encoded = pc.utf8_trim_whitespace(table[column]).combine_chunks().dictionary_encode()
    return encoded.dictionary.to_pylist(), np.asarray(encoded.indices.to_numpy(), dtype=np.int64)


def refuse_cut_off(text: TextRows, before: pa.Table | None, time_us: NDArray[np.int64]) -> None:
    # Without a newline at the end, the last value may have lost digits. Some writers omit that newline, so
    # the file is rejected only if this value is shorter than others, or if the last frame lacks rows.
    if text.raw.endswith(b"\n"):
        return
    _, rows = np.unique(time_us, return_counts=True)
    name = text.table.column_names[-1]
    last = pa.concat_tables([text.table] if before is None else [before, text.table])[name]
    decimals = pc.utf8_length(pc.replace_substring_regex(last, r"^[^.]*\.?", "")).to_numpy()
    if (len(rows) > 1 and rows[-1] < rows[-2]) or (name in "xyz" and decimals[-1] < decimals.max()):
        line = text.raw.splitlines()[-1].decode()[-40:]
        raise DeviceError(
            f"{text.path} seems to be cut off in its last line, {line!r}. Copy "
            "it again; if that line is complete, end it with a newline."
        )
