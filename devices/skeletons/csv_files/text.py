"""The rows of a CSV file as text: its columns, its lines, and the numbers in it."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv
from numpy.typing import NDArray

from devices.arrow_numbers import numbers_of
from devices.sensor import DeviceError
from devices.skeletons.csv_files.columns import COLUMNS, Columns, columns_of, header_of
from devices.skeletons.read_file import text_blocks
from devices.skeletons.times import moments_of

_EMPTY = r"^(?i:nan|null|none|na|n/a|#n/a|-|-?1\.#[a-z]+)?$"
_FIRST = 1_000_000  # bytes
_TENTH = 0.11
_WRITTEN = {
    "point": r"\.",
    "comma": ",",
    "decimal": r",([0-9]{0,2}|[0-9]{4,})([^0-9,]|$)|^[+-]?(0[0-9]*|[0-9]{4,})?,",  # no comma of thousands
}


@dataclass
class Decimals:
    """How the numbers of a file are written, as far as it was read."""

    comma: bool = False
    """Whether numbers may be written with a comma, because something else separates columns."""
    seen: dict[str, str] = field(default_factory=dict)
    """A number with a point, one with a comma, and one whose comma can only be a decimal one."""

    def note(self, text: pa.ChunkedArray) -> None:
        """Notes how numbers are written."""
        for kind, pattern in _WRITTEN.items() if self.comma else ():
            if kind not in self.seen:
                row = pc.index(pc.match_substring_regex(text, pattern), True).as_py()
                self.seen |= {kind: text[row].as_py()} if row >= 0 else {}

    def check(self, path: Path) -> None:
        """Refuses a file whose commas may be either.

        Raises:
            DeviceError: Its numbers have points and commas, or every comma stands before three digits.
        """
        point, comma = self.seen.get("point"), self.seen.get("comma")
        if comma is None or (point is None and "decimal" in self.seen):
            return
        why = f"there is {point!r}, too" if point else "in no number it is certain to be a decimal comma"
        raise DeviceError(
            f"{path}: whether the comma in {comma!r} separates thousands is unclear: {why}. Write all "
            "numbers with a decimal point, and without separators of thousands."
        )


@dataclass(frozen=True, eq=False)
class TextRows:
    """Consecutive rows of a file as text."""

    table: pa.Table  # all columns, as text
    raw: bytes
    path: Path
    first: int  # number of the first of these rows in the file
    columns: Columns
    decimals: Decimals

    def line(self, row: int) -> int:
        """The number of a row's line in the file, from 1."""
        return line_of_row(self.path, (self.first + row) // self.columns.joints_per_line)

    def numbers(self, column: str, kind: pa.DataType) -> NDArray[Any]:
        """A column as numbers; an empty coordinate is NaN."""
        text = self.table[column]
        with suppress(pa.ArrowInvalid):
            found = numbers_of(pc.cast(text, kind))
            self.decimals.note(text)
            return found
        text = pc.utf8_trim_whitespace(text)
        if kind == pa.float64():
            text = pc.replace_substring_regex(text, _EMPTY, "nan")
            self.decimals.note(text)
            text = pc.replace_substring(text, ",", ".") if self.decimals.comma else text
        else:
            text = pc.replace_substring_regex(text, r"^([0-9]+)\.0*$", r"\1")  # as pandas writes times
        try:
            return numbers_of(pc.cast(text, kind))
        except pa.ArrowInvalid:
            row = next(row for row, value in enumerate(text) if not _can_be(value, kind))
            raise self._not("a number", column, row) from None

    def times(self) -> tuple[str, NDArray[Any]]:
        """The column of the times' unit, and the times: whole numbers, or decimals where one of them is."""
        time = self.columns.time
        with suppress(DeviceError):
            return time, self.numbers(time, pa.int64())
        texts, code = codes(self.table, time)
        moments = moments_of(texts)
        if moments is not None:
            return "time_ns", moments[code]
        values = self.numbers(time, pa.float64())
        if not np.isfinite(values).all():
            raise self._not("a number", time, int(np.argmin(np.isfinite(values))))
        return time, values

    def _not(self, wanted: str, column: str, row: int) -> DeviceError:
        called, value = self.columns.called(column, row), self.table[column][row].as_py().strip()
        return DeviceError(
            f"{self.path}, line {self.line(row)}: {called} must be {wanted}; got {value[:40]!r}."
        )


def _can_be(value: pa.Scalar, kind: pa.DataType) -> bool:
    try:
        value.cast(kind)
    except pa.ArrowInvalid:
        return False
    return True


def text_rows(path: Path, size: int, required: Collection[str] = COLUMNS) -> Iterator[TextRows]:
    """The rows of a file in blocks of this many bytes, at least one; a row for each joint.

    Raises:
        DeviceError: There is no row, no time, or one of the required columns is missing; or numbers have
            commas that may separate thousands.
    """
    columns: Columns | None = None
    first, decimals = 0, Decimals()
    for raw in text_blocks(path, size):
        skipped = 0
        if columns is None:
            columns = columns_of(path, raw, required)
            skipped, decimals.comma = columns.begin, columns.separator != ","
        elif not raw.strip():
            continue
        table = _table(path, raw, columns.names, columns.separator, skipped)
        if columns.wide:
            shared = [name for name in (columns.time, "body", columns.device) if name in columns.names]
            table = columns.wide.long(table, shared)
        if table.num_rows:
            yield TextRows(table, raw, path, first, columns, decimals)
        first += table.num_rows
    if first == 0:
        raise DeviceError(f"{path} has a header and no rows.")
    decimals.check(path)


def _table(path: Path, raw: bytes, columns: list[str], separator: str, skipped: int) -> pa.Table:
    """Reads all columns as text."""
    wrong: list[str] = []

    def remember(row: pyarrow.csv.InvalidRow) -> str:
        if not row.text.startswith("#"):
            wrong.append(row.text)
        return "skip"

    try:
        table = pyarrow.csv.read_csv(
            pa.BufferReader(raw),
            read_options=pyarrow.csv.ReadOptions(column_names=columns, skip_rows=skipped, use_threads=False),
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
        last = len(wrong) == 1 and raw.rstrip(b"\r\n").endswith(wrong[-1].encode())
        commas = separator == "," and wrong[0].count(",") >= len(columns) + 2
        raise DeviceError(
            f"{path}{_line_of(path, wrong[0])}: {wrong[0][:60]!r} does not have {len(columns)} columns"
            + ("; the file is cut off. Copy it again, or delete its last line." if last > commas else ".")
            + " If its numbers have decimal commas, separate the columns by semicolons." * commas
        )
    return table


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    """The header of a file, its lines that are neither empty nor comments, and their numbers from 1."""
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        begin = list(islice(file, 100))
        header = header_of(begin)
        file.seek(0)
        for number, line in enumerate(file, start=1):
            if number > header and line.strip("\n") and (number == header + 1 or not line.startswith("#")):
                yield number, line


def line_of_row(path: Path, row: int) -> int:
    """The number of a row's line in the file; empty lines and comments are not rows."""
    return next((number for number, _ in islice(_lines(path), row + 1, None)), row + 2)


def _line_of(path: Path, text: str) -> str:
    return next((f", line {k}" for k, line in _lines(path) if line.strip() == text.strip()), "")


def codes(table: pa.Table, column: str) -> tuple[list[str], NDArray[np.int64]]:
    """Returns the distinct values of a column, and the index of each row's value."""
    encoded = table[column].combine_chunks().dictionary_encode()
    if pc.utf8_trim_whitespace(encoded.dictionary) != encoded.dictionary:
        encoded = pc.utf8_trim_whitespace(table[column]).combine_chunks().dictionary_encode()
    return encoded.dictionary.to_pylist(), numbers_of(encoded.indices).astype(np.int64)


def refuse_cut_off(text: TextRows, before: pa.Table | None, times: NDArray[Any]) -> None:
    """Refuses a file whose last line is not complete.

    Without a newline at the end, the last value may have lost digits. Some writers omit that newline, so the
    file is refused only if this value is shorter than others, or if the last frame lacks rows.

    Args:
        text: The last rows of the file.
        before: The rows before them; None if there are no others.
        times: Of all these rows.

    Raises:
        DeviceError: The file seems to be cut off.
    """
    if text.raw.endswith(b"\n"):
        return
    rows = np.unique(times, return_counts=True)[1]
    table = text.table if before is None else pa.concat_tables([before, text.table])
    cut = len(rows) > 1 and rows[-1] < rows[-2]
    if not cut and (name := table.column_names[-1]) in "xyz":
        values = table[name].to_pylist()
        decimals = [len(value.partition(".")[2]) for value in values]
        joints = table["joint"].to_pylist()
        old = next(
            (v for v, joint in zip(values[-2::-1], joints[-2::-1], strict=True) if joint == joints[-1]), ""
        )
        cut = decimals[-1] < max(decimals) or _lost_digits(old, values[-1])
    if cut:
        line = text.raw.splitlines()[-1].decode()[-40:]
        raise DeviceError(
            f"{text.path} seems to be cut off in its last line, {line!r}. Copy "
            "it again; if that line is complete, end it with a newline."
        )


def _lost_digits(old: str, new: str = "") -> bool:
    """Whether a whole number seems to have lost digits, by the size of the one before it."""
    whole = re.fullmatch(r"-?\d{2,}", old) and re.fullmatch(r"-?\d+", new)
    return bool(whole) and abs(int(new)) <= _TENTH * abs(int(old))


def has_several_sensors(path: Path) -> bool:
    """Whether a column says that the rows of a file are of several sensors."""
    with suppress(DeviceError, OSError):
        rows = next(text_rows(path, _FIRST, required=()))
        named = rows.columns.device in rows.table.column_names
        return named and len(codes(rows.table, rows.columns.device)[0]) > 1
    return False
