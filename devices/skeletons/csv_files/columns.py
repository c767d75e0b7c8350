"""The columns of a CSV file, by the names that several programs give them."""

import csv
import re
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa

from devices.sensor import DeviceError
from devices.skeletons.csv_files.states import is_like_states
from devices.skeletons.name_tables import plain
from devices.skeletons.times import FRAME_NUMBERS, TIME_COLUMNS

COLUMNS = ("body", "joint", "x", "y", "z")
_EITHER = f"{','.join(COLUMNS)} (or HEAD_x,HEAD_y,HEAD_z and so on)"
_LONGEST_HEADER = 65_536  # bytes
_FEWEST = 5  # points; fewer may be those of another table
_SEPARATORS = (",", ";", "\t")
_MOST_TITLES = 20  # lines
_SPACE, _LENGTH = r"(?:joint|position|pos|camera|world)*", r"(?:m|cm|mm|metres?|meters?)?"
_POINT = re.compile(rf"(.+?)({_SPACE})([xyz])({_LENGTH})")
_NO_POINT = re.compile(r"q|quat|quaternion|rot|rotation|orientation|o|v|vel|velocity|a|acc")
_SPELLED = {
    "body": r"(?:body|person|user|player|subject)(?:id|idx|index|number|nr)?|trackingid|id",
    "joint": r"(?:joint|bodypart|part|landmark|keypoint|bone)(?:type|name|id|index|number)?",
}
_DEVICE = re.compile(r"(?:device|sensor|camera|kinect)(?:id|idx|index|number|nr|serial)?")
NO_DEVICE = "device"
_CLOCK = (
    r"(?:device|capture|sensor|system|host|relative|frame|file|unix|elapsed|body|header)*"
    r"(?:timestamp|timeofday|time|datetime|clock|stamp|ts|t)"
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


class Wide(NamedTuple):
    """The columns of a file that contain points, by number.

    Attributes:
        names: Of all columns, as in the file.
        joints: The points, in the order of their last columns.
        numbers: By the column that they become, x, y, z or a column of states: each point's column; -1 where
            a point has none.
    """

    names: Sequence[str]
    joints: Sequence[str]
    numbers: Mapping[str, Sequence[int]]

    def long(self, table: pa.Table, shared: Sequence[str]) -> pa.Table:
        """One row per point: those of the first row of a table come first.

        The last column of the file stays the last one, so that a file that is cut off can be recognised.

        Args:
            table: All columns of the file, of any number of rows.
            shared: Names of the columns that each point repeats.
        """
        rows, joints = table.num_rows, len(self.joints)
        row = np.repeat(np.arange(rows), joints)
        by_row = np.arange(joints * rows).reshape(joints, rows).T.ravel()
        made = {name: table[name].take(row) for name in shared}
        joint = pa.array(self.joints, pa.string()).take(np.tile(np.arange(joints), rows))
        nothing = [pa.array([""] * rows, pa.string())]
        for name, numbers in sorted(self.numbers.items(), key=lambda item: item[1][-1]):
            columns = (table.column(k).chunks if k >= 0 else nothing for k in numbers)
            made[name] = pa.concat_arrays([chunk for chunks in columns for chunk in chunks]).take(by_row)
        ends_with_joint = any(numbers[-1] == table.num_columns - 1 for numbers in self.numbers.values())
        return pa.table({"joint": joint, **made} if ends_with_joint else {**made, "joint": joint})


def find_wide(names: Sequence[str]) -> Wide | None:
    """Finds the columns x, y and z of each point; None if fewer than five points have them.

    Columns of states name a point and a state in any order.
    """
    found: dict[tuple[str, str], dict[str, dict[str, int]]] = {}  # words around it → point → axis → column
    for number, name in enumerate(names):
        if match := _POINT.fullmatch(plain(name)):
            point, space, axis, length = match.groups()
            found.setdefault((space, length), {}).setdefault(point, {}).setdefault(axis, number)
    whole = [{point: axes for point, axes in of.items() if len(axes) == 3} for of in found.values()]
    points = max(whole, key=len, default={})
    longer = {other for point in points for other in points if _NO_POINT.fullmatch(other.removeprefix(point))}
    points = {point: axes for point, axes in points.items() if point not in longer}
    if len(points) < _FEWEST:
        return None
    used = {number for axes in points.values() for number in axes.values()}
    states: dict[str, dict[str, int]] = {}
    for number, name in enumerate(names):
        word = plain(name)
        for point in sorted(points, key=len, reverse=True) if number not in used else ():
            if point in (word[: len(point)], word[-len(point) :]):
                kind = word.replace(point, "", 1)
                kind = {"c": "confidence", "s": "trackingstate"}.get(kind, kind)
                if is_like_states(kind):
                    states.setdefault(kind, {}).setdefault(point, number)
                break
    kept = {kind: of for kind, of in states.items() if 2 * len(of) > len(points)}
    columns = {axis: {point: axes[axis] for point, axes in points.items()} for axis in "xyz"} | kept
    order = sorted(points, key=lambda point: max(of.get(point, -1) for of in columns.values()))
    numbers = {name: [of.get(point, -1) for point in order] for name, of in columns.items()}
    spelled = [names[points[point]["x"]] for point in order]
    labels = [_begin(name, len(point)) for name, point in zip(spelled, order, strict=True)]
    return Wide(names, labels, numbers)


def _begin(name: str, count: int) -> str:
    """The part of a name that has so many letters and digits."""
    ends = [match.end() for match in re.finditer(r"[A-Za-z0-9]", name)]
    return name[: ends[count - 1]]


class Columns(NamedTuple):
    """The columns of a file; those of other spellings have the names that this program uses."""

    names: list[str]
    separator: str
    time: str  # of the times, of devices.skeletons.times
    time_in_file: str
    begin: int  # lines before the first row
    wide: Wide | None = None  # if a row has all joints
    others: tuple[str, ...] = ()  # in the file of a wide table, and used for nothing
    device: str = NO_DEVICE  # the column that says which sensor a row is of; may be none

    @property
    def joints_per_line(self) -> int:
        """How many rows of one joint a line of the file has."""
        return len(self.wide.joints) if self.wide else 1

    def called(self, column: str, row: int) -> str:
        """What the file calls a column of one joint's row."""
        numbers = self.wide.numbers.get(column) if self.wide else None
        return self.wide.names[numbers[row % len(numbers)]] if self.wide and numbers else column


def columns_of(path: Path, raw: bytes, required: Collection[str]) -> Columns:
    """The columns of a file that begins with these bytes.

    Raises:
        DeviceError: One is missing, or is there twice.
    """
    lines = raw[:_LONGEST_HEADER].decode("utf-8-sig", "replace").splitlines()
    at = header_of(lines)
    header = lines[at].lstrip("# ")
    separator = max(_SEPARATORS, key=header.count)
    cells = next(csv.reader([header], delimiter=separator), [])
    columns = [name.strip() or " " * k for k, name in enumerate(cells)]  # each unnamed one another
    names = list(columns)
    if not set(required) <= set(columns) or not TIME_COLUMNS.keys() & set(columns):
        columns = [name.lower() for name in columns]  # X beside x is a column of its own
    for wanted in set(_SPELLED) & set(required):
        _spell(columns, wanted, _SPELLED[wanted])
    if required and "joint" in columns:
        _spell_axes(path, columns)
    time = next((name for name in TIME_COLUMNS if name in columns), "")
    in_file = list(columns)
    for wanted, spelled in _CLOCKS.items():
        if not time and _spell(columns, wanted, spelled):
            time = wanted
    missing = [name for name in required if name not in columns and name != "body"]
    if not time:
        missing.insert(0, next(iter(TIME_COLUMNS)))
    wide = find_wide(names) if set(missing) & set(required) else None
    if missing and not (wide and time):
        missing = [name for name in missing if not wide or name not in required]
        raise DeviceError(
            f"{path}: no column {', '.join(missing)}. Columns must be time_us,{_EITHER} and "
            f"optionally state; the file begins with {header[:80]!r}."
            + " If frames came at a constant rate, a column named frame that counts them is enough."
            * (not time)
            + " This looks like JSON: name it .json." * header.lstrip().startswith(("{", "["))
        )
    if twice := next((name for name in columns if columns.count(name) > 1), ""):
        raise DeviceError(f"{path}: {header[:80]!r} repeats a column name: {twice!r}.")
    row = next(csv.reader(lines[at + 1 : at + 2], delimiter=separator), [])
    if len(row) == len(columns) + 1 and not row[-1].strip():
        columns.append(" " * len(columns))  # a separator ends every row
    used = {number for of in wide.numbers.values() for number in of} if wide else set(range(len(names)))
    used |= {columns.index(name) for name in (time, "body") if name in columns}
    others = tuple(name for k, name in enumerate(names) if k not in used and name.strip())
    device = next((name for name in columns if _DEVICE.fullmatch(plain(name))), NO_DEVICE)
    return Columns(columns, separator, time, in_file[columns.index(time)], at + 1, wide, others, device)


def header_of(lines: list[str]) -> int:
    """The line of the header: after empty ones, Excel's sep=, comments, and titles of few columns."""
    there = [k for k, line in enumerate(lines) if line.strip() and not re.match(r"\s*sep=.\s*$", line)]
    plainly = [k for k in there if not lines[k].startswith("#")]
    cells = [max(map(lines[k].count, _SEPARATORS)) for k in plainly[:_MOST_TITLES]]
    plainly = [k for k, count in zip(plainly, cells, strict=False) if 2 * count >= max(cells)] or plainly
    first = (plainly or there or [0])[0]
    before = [k for k in there if k < first]
    return before[-1] if before and re.match(r"\s*[-+\d]", lines[first]) else first


def _spell_axes(path: Path, columns: list[str]) -> None:
    """Renames the columns of a place: of usual words before x, y and z the shortest, else the only ones.

    Raises:
        DeviceError: Several may be a place.
    """
    found: dict[tuple[str, str], dict[str, int]] = {}
    for k, name in enumerate(columns):
        if match := re.fullmatch(rf"(.*?)([xyz])({_LENGTH})", plain(name)):
            found.setdefault((match[1], match[3]), {}).setdefault(match[2], k)
    of = [words for words, axes in found.items() if len(axes) == 3 and not _NO_POINT.fullmatch(words[0])]
    usual = [words for words in of if re.fullmatch(rf"{_SPACE}|p", words[0])]
    if not usual and len(of) > 1:
        places = " or ".join(columns[found[words]["x"]] for words in of)
        raise DeviceError(f"{path}: the place of a joint may be {places}; name its columns x, y and z.")
    chosen = min(usual or of, key=lambda words: len(words[0]), default=None)
    for axis, k in found[chosen].items() if chosen else ():
        if plain(columns[k]) != axis and axis in columns:  # of another kind, as pixels
            columns[columns.index(axis)] = f"{axis} "
        columns[k] = axis


def _spell(columns: list[str], wanted: str, spelled: str) -> bool:
    """Renames the first column of another spelling, if there is none of the wanted name; whether there is."""
    if wanted not in columns:
        for k, name in enumerate(columns):
            if name not in COLUMNS and re.fullmatch(spelled, plain(name)):
                columns[k] = wanted
                break
    return wanted in columns
