"""The columns of a CSV file, by the names that several programs give them."""

import csv
import re
from collections.abc import Collection
from pathlib import Path
from typing import NamedTuple

from devices.sensor import DeviceError
from devices.skeletons.csv_files.wide import AXES, Wide, find_wide
from devices.skeletons.name_tables import plain
from devices.skeletons.times import FRAME_NUMBERS, TIME_COLUMNS

COLUMNS = ("body", "joint", "x", "y", "z")
_EITHER = f"{','.join(COLUMNS)} (or HEAD_x,HEAD_y,HEAD_z and so on)"
_LONGEST_HEADER = 65_536  # bytes
_SEPARATORS = (",", ";", "\t")
_SPELLED = {
    "body": r"(?:body|person|user|player|subject)(?:id|idx|index|number|nr)?|trackingid|id",
    "joint": r"(?:joint|bodypart|part|landmark|keypoint|bone)(?:type|name|id|index|number)?",
    **AXES,
}
_CLOCK = (
    r"(?:device|capture|sensor|system|host|relative|frame|file|unix|elapsed|body)*"
    r"(?:timestamp|timeofday|time|datetime|clock|ts|t)"
)
_CLOCKS = {
    "time": _CLOCK,
    "time_us": rf"{_CLOCK}(?:us|usec|microseconds?)|microseconds",
    "time_ms": rf"{_CLOCK}(?:ms|msec|millis|milliseconds?)|milliseconds|ms",
    "time_ns": rf"{_CLOCK}(?:ns|nsec|nanoseconds?)|nanoseconds",
    "time_s": rf"{_CLOCK}(?:s|sec|secs|seconds?)|seconds|sec",
    "time_ticks": rf"{_CLOCK}ticks|ticks",
    FRAME_NUMBERS: r"frame(?:number|nr|no|id|index|count)?",
}
"""Other spellings of the columns, without case and punctuation. A column's own name comes first."""


class Columns(NamedTuple):
    """The columns of a file; those of other spellings have the names that this program uses."""

    names: list[str]
    separator: str
    time: str  # of the times, of devices.skeletons.times
    time_in_file: str
    begin: int  # lines before the first row
    wide: Wide | None = None  # if a row has all joints
    others: tuple[str, ...] = ()  # in the file of a wide table, and used for nothing

    @property
    def joints_per_line(self) -> int:
        """How many rows of one joint a line of the file has."""
        return len(self.wide.joints) if self.wide else 1

    def called(self, column: str, row: int) -> str:
        """What the file calls a column of one joint's row."""
        numbers = self.wide.numbers.get(column) if self.wide else None
        return self.wide.names[numbers[row % len(numbers)]] if self.wide and numbers else column


def columns_of(path: Path, raw: bytes, required: Collection[str], table: str = "") -> Columns:
    """The columns of a file that begins with these bytes.

    Args:
        table: Of the names of its joints, for a file whose rows have all joints; see :func:`find_wide`.

    Raises:
        DeviceError: One is missing, or is there twice.
    """
    lines = raw[:_LONGEST_HEADER].decode("utf-8-sig", "replace").splitlines()
    at = header_of(lines)
    header = lines[at].lstrip("# ")
    separator = max(_SEPARATORS, key=header.count)
    columns = [name.strip() for name in next(csv.reader([header], delimiter=separator), [])]
    names = list(columns)
    if not set(required) <= set(columns) or not TIME_COLUMNS.keys() & set(columns):
        columns = [name.lower() for name in columns]  # X beside x is a column of its own
    for wanted in required:
        _spell(columns, wanted, _SPELLED[wanted])
    time = next((name for name in TIME_COLUMNS if name in columns), "")
    in_file = list(columns)
    for wanted, spelled in _CLOCKS.items():
        if not time and _spell(columns, wanted, spelled):
            time = wanted
    missing = [name for name in required if name not in columns and name != "body"]
    if not time:
        missing.insert(0, next(iter(TIME_COLUMNS)))
    wide = find_wide(names, table) if set(missing) & set(required) else None
    if missing and not (wide and time):
        missing = [name for name in missing if not wide or name not in required]
        raise DeviceError(
            f"{path}: no column {', '.join(missing)}. Columns must be time_us,{_EITHER} and "
            f"optionally state; the file begins with {header[:80]!r}."
            + (" This looks like JSON: name it .json." if header.lstrip().startswith(("{", "[")) else "")
        )
    if len(set(columns)) < len(columns):
        twice = next(name for name in columns if columns.count(name) > 1)
        raise DeviceError(f"{path}: {header[:80]!r} repeats a column name: {twice!r}.")
    row = next(csv.reader(lines[at + 1 : at + 2], delimiter=separator), [])
    if len(row) == len(columns) + 1 and not row[-1].strip():
        columns.append("")  # a separator ends every row
    used = {number for of in wide.numbers.values() for number in of} if wide else set(range(len(names)))
    used |= {columns.index(name) for name in (time, "body", "") if name in columns}
    others = tuple(name for k, name in enumerate(names) if k not in used)
    return Columns(columns, separator, time, in_file[columns.index(time)], at + 1, wide, others)


def header_of(lines: list[str]) -> int:
    """The line of the header: after empty ones, Excel's sep=, and comments."""
    there = [k for k, line in enumerate(lines) if line.strip() and not re.match(r"\s*sep=.\s*$", line)]
    plainly = [k for k in there if not lines[k].startswith("#")]
    first = (plainly or there or [0])[0]
    before = [k for k in there if k < first]
    return before[-1] if before and re.match(r"\s*[-+\d]", lines[first]) else first


def _spell(columns: list[str], wanted: str, spelled: str) -> bool:
    """Renames the first column of another spelling, if there is none of the wanted name; whether there is."""
    if wanted not in columns:
        for k, name in enumerate(columns):
            if name not in COLUMNS and re.fullmatch(spelled, plain(name)):
                columns[k] = wanted
                break
    return wanted in columns
