"""Motion capture in the texts of OpenSim, OptiTrack Motive, Vicon Nexus and Qualisys Track Manager.

They are read line by line: a quarter of an hour has a hundred thousand lines of hundreds of cells.
"""

import csv
import math
import re
from array import array
from collections.abc import Iterator, Sequence
from itertools import chain, islice, takewhile
from operator import itemgetter
from typing import TextIO

import numpy as np
from numpy.typing import NDArray

from recordings.errors import RecordingError

Rows = Iterator[list[str]]
Read = tuple[list[str], NDArray[np.float64], NDArray[np.float32]]
"""M labels, (N,) times in seconds, and (N, M, 3) points in the file's unit."""

_NEXUS = re.compile(r"(Devices|Events|Joints|Segments|Model Outputs|Trajectories)\W*(\n|\Z)")
_TRC_HEAD = 5  # lines before the first frame; an empty one may follow


def is_vendor_text(start: str) -> bool:
    """Whether a .csv or .tsv that begins so is of one of these programs."""
    return start.startswith(("Format Version,", "NO_OF_FRAMES\t")) or _NEXUS.match(start) is not None


def read_vendor_text(path: object, file: TextIO) -> Read:
    """Reads what Motive, Nexus or Track Manager wrote.

    Raises:
        RecordingError: It is not complete, or has no points.
    """
    begin = file.read(2)
    file.seek(0)
    read = {"Fo": _motive, "NO": _qualisys}.get(begin, _nexus)
    try:
        return read(csv.reader(file, delimiter="\t" if read is _qualisys else ","))
    except (csv.Error, StopIteration, IndexError, KeyError, ValueError) as fault:
        raise RecordingError(f"{path} is not complete, or not as its program writes it ({fault}).") from None


def read_trc(path: object, file: TextIO) -> Read:
    """Reads a .trc.

    Raises:
        RecordingError: It is not complete, or no .trc.
    """
    heads = list(islice(file, _TRC_HEAD))
    if len(heads) < _TRC_HEAD or not heads[3].lower().startswith("frame#"):
        raise RecordingError(f"{path} is not a .trc: its fourth line does not begin with Frame#.")
    tabs = "\t" if "\t" in heads[3] else None  # else spaces, between which no cell can be empty
    labels = [name.strip() for name in heads[3].split(tabs)[2:] if name.strip()]
    stated = dict(zip(*(line.split(tabs) for line in heads[1:3]), strict=False)).get("NumFrames", "").strip()
    if not labels:
        raise RecordingError(f"{path} has no points.")
    width, number = 2 + 3 * len(labels), 0

    def rows() -> Rows:
        nonlocal number
        for number, line in enumerate(file, start=_TRC_HEAD + 1):
            row = line.split(tabs)
            if len(row) < width and line.strip():
                what = "is cut off" if tabs else "has spaces instead of tabs and lacks cells"
                raise RecordingError(
                    f"{path}, line {number} {what}: {len(labels)} points need {width} columns, and it has "
                    f"{len(row)}."
                )
            yield row

    try:
        seconds, points = _table(rows(), 1, range(2, width, 3))
    except ValueError:
        if number == 0:
            raise RecordingError(f"{path} has no frames.") from None
        raise RecordingError(f"{path}, line {number}: not a row of numbers separated by tabs.") from None
    if stated.isdecimal() and len(points) < int(stated):
        raise RecordingError(f"{path} is cut off: it states {stated} frames and has {len(points)}.")
    return labels, seconds, points


def _motive(rows: Rows) -> Read:
    """Rows of heads end with ``Frame,Time (Seconds)``; of a skeleton, bones are taken instead of markers."""
    heads = [_stripped(next(rows))]
    while heads[-1][:1] != ["Frame"]:
        heads.append(_stripped(next(rows)))
    *heads, kinds, axes = heads[1:]
    of = {row[1]: row for row in heads if len(row) > 1}
    begins = [k for k in _begins(axes) if kinds[k] == "Position"]
    begins = [k for k in begins if of["Type"][k] == "Bone"] or begins
    return [of["Name"][k] for k in begins], *_table(rows, 1, begins)


def _nexus(rows: Rows) -> Read:
    """Sections follow one another; an empty row ends one."""
    next(row for row in rows if _stripped(row[:1]) == ["Trajectories"])
    (rate, *_), names, axes, _ = [_stripped(next(rows)) for _ in range(4)]
    if not float(rate) > 0.0:
        raise ValueError(f"its rate is {rate}")
    begins = _begins(axes)
    frames, points = _table(takewhile(_has_cells, rows), 0, begins)
    return [names[k] for k in begins], (frames - frames[0]) / float(rate), points


def _qualisys(rows: Rows) -> Read:
    """Rows of names and values, perhaps a head, and rows of points, perhaps after frame and time."""
    of = dict[str, list[str]]()
    for row in map(_stripped, rows):
        if row and row[0].isupper():
            of[row[0]] = row[1:]
        elif row and _is_number(row[0]):
            break
    names = [name for name in of["MARKER_NAMES"] if name]
    timed = len(row) >= 2 + 3 * len(names)  # a tab may follow the last
    seconds, points = _table(chain([row], rows), int(timed), range(2 * timed, 2 * timed + 3 * len(names), 3))
    if len(points) < int(of["NO_OF_FRAMES"][0]):
        raise ValueError(f"it states {of['NO_OF_FRAMES'][0]} frames and has {len(points)}")
    return names, seconds if timed else np.arange(len(points)) / float(of["FREQUENCY"][0]), points


def _begins(axes: Sequence[str]) -> list[int]:
    """The columns in which three columns X, Y and Z begin."""
    return [k for k in range(len(axes)) if list(axes[k : k + 3]) == ["X", "Y", "Z"]]


def _stripped(row: Sequence[str]) -> list[str]:
    return [cell.strip() for cell in row]


def _has_cells(row: Sequence[str]) -> bool:
    return any(map(str.strip, row))


def _is_number(cell: str) -> bool:
    return cell.replace(".", "").replace("-", "").isdecimal()


def _table(rows: Rows, time: int, begins: Sequence[int]) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
    """A column of times, and points of which each begins in a column.

    An empty cell is NaN, and so are those that a row lacks at its end.
    """
    columns = [time, *(k + axis for k in begins for axis in range(3))]
    chosen, last, seconds = itemgetter(*columns), max(columns), array("d")

    def points() -> Iterator[list[float]]:
        for row in filter(_has_cells, rows):
            try:
                at, *values = map(float, chosen(row))
            except (ValueError, IndexError):
                cells = chosen([*row, *[""] * (last + 1 - len(row))])
                at, *values = (float(cell.strip() or math.nan) for cell in cells)
            seconds.append(at)
            yield values

    found = np.empty((0, len(begins), 3), dtype=np.float32)
    if begins:
        with np.errstate(over="ignore"):  # a wrong sample may be of any size
            values = np.fromiter(points(), np.dtype((np.float32, 3 * len(begins))))
        found = np.asarray(values, dtype=np.float32).reshape(-1, len(begins), 3)
    if not len(found):
        raise ValueError("it has no frames")
    return np.array(seconds), found
