"""Motion capture in the text exports of OptiTrack Motive, Vicon Nexus and Qualisys Track Manager."""

import csv
import math
import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from recordings.errors import RecordingError

Rows = list[list[str]]
Read = tuple[list[str], NDArray[np.float64], NDArray[np.float64]]


_NEXUS = re.compile(r"(Devices|Events|Joints|Segments|Model Outputs|Trajectories)\W*(\n|\Z)")


def is_vendor_text(start: str) -> bool:
    """Whether a file that begins so is of one of these programs."""
    return start.startswith(("Format Version,", "NO_OF_FRAMES\t")) or _NEXUS.match(start) is not None


def read_vendor_text(name: object, text: str) -> Read:
    """Reads labels, times in seconds, and points (N, M, 3) in the file's unit.

    Raises:
        RecordingError: It is not complete, or has no points.
    """
    read = {"Fo": _motive, "NO": _qualisys}.get(text[:2], _nexus)
    separator = "\t" if read is _qualisys else ","
    try:
        return read(
            [[cell.strip() for cell in row] for row in csv.reader(text.splitlines(), delimiter=separator)]
        )
    except (csv.Error, StopIteration, IndexError, KeyError, ValueError) as fault:
        raise RecordingError(f"{name} is not complete, or not as its program writes it ({fault}).") from None


def _motive(rows: Rows) -> Read:
    """Rows of heads end with ``Frame,Time (Seconds)``; of a skeleton, bones are taken instead of markers."""
    head = next(k for k, row in enumerate(rows) if row and row[0] == "Frame")
    of = {row[1]: row for row in rows[1:head] if len(row) > 1}
    begins = [k for k in _begins(rows[head]) if rows[head - 1][k] == "Position"]
    bones = [k for k in begins if of["Type"][k] == "Bone"]
    begins = bones or begins
    table = _table(rows[head + 1 :], len(rows[head]))
    return [of["Name"][k] for k in begins], table[:, 1], _points(table, begins)


def _nexus(rows: Rows) -> Read:
    """Sections follow one another; an empty row ends one."""
    first = next(k for k, row in enumerate(rows) if row[:1] == ["Trajectories"])
    rate, names, axes = float(rows[first + 1][0]), rows[first + 2], rows[first + 3]
    if not rate > 0.0:
        raise ValueError(f"its rate is {rate}")
    rows = rows[first + 5 :]
    end = next((k for k, row in enumerate(rows) if not any(row)), len(rows))
    table, begins = _table(rows[:end], len(axes)), _begins(axes)
    seconds = (table[:, 0] - table[0, 0]) / rate
    return [names[k] for k in begins], seconds, _points(table, begins)


def _qualisys(rows: Rows) -> Read:
    """Rows of names and values, perhaps a head, and rows of points, perhaps after frame and time."""
    of = {row[0]: row[1:] for row in rows if row and row[0].isupper()}
    names = [name for name in of["MARKER_NAMES"] if name]
    first = next(k for k, row in enumerate(rows) if len(row) >= 3 * len(names) and _is_number(row[0]))
    rows = [row for row in rows[first:] if any(row)]
    if len(rows) < int(of["NO_OF_FRAMES"][0]):
        raise ValueError(f"it states {of['NO_OF_FRAMES'][0]} frames and has {len(rows)}")
    before = 2 if len(rows[0]) >= 2 + 3 * len(names) else 0  # a tab may follow the last
    table = _table(rows, before + 3 * len(names))
    seconds = table[:, 1] if before else np.arange(len(table)) / float(of["FREQUENCY"][0])
    points = table[:, before:].reshape(len(table), -1, 3)
    return names, seconds, points


def _begins(axes: Sequence[str]) -> list[int]:
    """The columns in which three columns X, Y and Z begin."""
    return [k for k in range(len(axes)) if list(axes[k : k + 3]) == ["X", "Y", "Z"]]


def _points(table: NDArray[np.float64], begins: Sequence[int]) -> NDArray[np.float64]:
    return np.stack([table[:, k : k + 3] for k in begins], axis=1)


def _is_number(cell: str) -> bool:
    return cell.replace(".", "").replace("-", "").isdecimal()


def _table(rows: Rows, width: int) -> NDArray[np.float64]:
    """Rows of numbers; an empty cell is NaN, and so are those that a row lacks at its end."""
    rows = [row for row in rows if any(row)]
    if not rows:
        raise ValueError("it has no frames")
    cells = [[float(cell or math.nan) for cell in row[:width]] for row in rows]
    return np.array([row + [math.nan] * (width - len(row)) for row in cells]).reshape(-1, width)
