"""Reads motion capture: points over time from .c3d, OpenSim's .trc, or a .csv as this program writes it."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv
from numpy.typing import NDArray

from recordings.errors import RecordingError

SUFFIXES = (".c3d", ".trc", ".csv")
"""Of files that are read here."""
_TRC_HEAD = 5  # lines before the first frame; an empty one may follow


@dataclass(frozen=True, eq=False)
class TruthFile:
    """Points over time.

    Attributes:
        name: The file, for messages.
        labels: Names of the M points.
        seconds: (N,) times in order.
        points: (N, M, 3) in the file's unit and axes; NaN where a point is missing.
    """

    name: str
    labels: tuple[str, ...]
    seconds: NDArray[np.float64]
    points: NDArray[np.float64]


def read_truth(path: Path) -> TruthFile:
    """Reads a file of :data:`SUFFIXES`.

    Raises:
        RecordingError: The file cannot be read, is not complete, or has no points or times.
    """
    try:
        labels, seconds, points = _READERS[path.suffix.lower()](path)
    except OSError as error:
        raise RecordingError(f"{path} cannot be read: {error.strerror or error}.") from None
    points[~np.isfinite(points).all(axis=2)] = np.nan
    if len(labels) == 0 or not np.isfinite(points).any():
        raise RecordingError(f"{path} has no points.")
    if len(seconds) < 2 or not (np.diff(seconds) > 0.0).all():  # false where NaN
        raise RecordingError(f"{path} needs at least two frames, with times that increase.")
    return TruthFile(str(path), tuple(labels), seconds, points)


_Read = tuple[list[str], NDArray[np.float64], NDArray[np.float64]]


def _read_c3d(path: Path) -> _Read:
    try:
        import ezc3d
    except ImportError:
        raise RecordingError(
            "Reading .c3d needs the package ezc3d: pip install 'duplex-kinects[export]'."
        ) from None
    with path.open("rb") as file:
        header = np.frombuffer(file.read(10).ljust(10, b"\0"), dtype="<u2").astype(np.int64)
    try:
        read = ezc3d.c3d(str(path))
        parameters, data = read["parameters"]["POINT"], read["data"]
        labels = [label for name in sorted(parameters) if name.startswith("LABELS")
                  for label in parameters[name]["value"]]  # fmt: skip
        rate = float(parameters["RATE"]["value"][0])
        points = data["points"][:3].transpose(2, 1, 0).astype(np.float64)
        residuals = data["meta_points"]["residuals"][0].T
    except (OSError, RuntimeError, ValueError, KeyError, IndexError) as error:
        raise RecordingError(f"{path} is not a .c3d that ezc3d can read: {error}.") from None
    if not 0.0 < rate < math.inf:
        raise RecordingError(f"{path} states {rate:g} frames per second.")
    stated = header[4] - header[3] + 1  # last and first frame; long files have more
    if len(points) < stated:  # ezc3d reads what is there
        raise RecordingError(f"{path} is cut off: it states {stated} frames and has {len(points)}.")
    points[(residuals < 0.0) | (points == 0.0).all(axis=2)] = np.nan
    return labels[: points.shape[1]], np.arange(len(points)) / rate, points


def _read_trc(path: Path) -> _Read:
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    if len(lines) <= _TRC_HEAD or not lines[3].lower().startswith("frame#"):
        raise RecordingError(f"{path} is not a .trc: its fourth line does not begin with Frame#.")
    labels = [name.strip() for name in lines[3].split("\t")[2:] if name.strip()]
    width = 2 + 3 * len(labels)
    rows = []
    for number, line in enumerate(lines[_TRC_HEAD:], start=_TRC_HEAD + 1):
        if not line.strip():
            continue
        cells = line.rstrip("\n").split("\t")
        cells = (cells + [""] * width)[:width]
        try:
            rows.append([float(cell) if cell.strip() else math.nan for cell in cells])
        except ValueError:
            raise RecordingError(f"{path}, line {number}: not a row of numbers separated by tabs.") from None
    values = np.array(rows).reshape(-1, width)
    return labels, values[:, 1], values[:, 2:].reshape(len(values), -1, 3)


def _read_csv(path: Path) -> _Read:
    try:
        table = pyarrow.csv.read_csv(path)
        return _of_long(table) if "joint" in table.column_names else _of_wide(table)
    except (pa.ArrowInvalid, KeyError, ValueError) as error:
        raise RecordingError(
            f"{path} is no .csv of motion ({str(error).splitlines()[0]}). Its columns must be those of "
            "duplex export, or time_us,body,joint,x,y,z."
        ) from None


def _times(table: pa.Table) -> NDArray[np.float64]:
    if "time_us" in table.column_names:
        return np.asarray(table["time_us"].cast(pa.float64()).to_numpy() * 1e-6)
    return np.asarray(table["time_s"].cast(pa.float64()).to_numpy())


def _of_long(table: pa.Table) -> _Read:
    """A row for each joint and frame."""
    if "skeleton" in table.column_names:  # of duplex export: a, b and S*
        table = table.filter(pc.equal(table["skeleton"], "fused"))
    elif "body" in table.column_names and len(bodies := pc.unique(table["body"])) > 1:
        raise ValueError(f"it has {len(bodies)} bodies, and one is compared")
    joint = table["joint"].combine_chunks().dictionary_encode()
    seconds, t = np.unique(_times(table), return_inverse=True)
    labels = [str(name) for name in joint.dictionary.to_pylist()]
    points = np.full((len(seconds), len(labels), 3), np.nan)
    for axis, name in enumerate("xyz"):
        points[t, joint.indices.to_numpy(), axis] = table[name].cast(pa.float64()).to_numpy()
    return labels, seconds, points


def _of_wide(table: pa.Table) -> _Read:
    """A row for each frame, with columns such as HEAD_x, HEAD_y and HEAD_z."""
    labels = [name[:-2] for name in table.column_names if name.endswith("_x")]
    columns = [table[f"{label}_{axis}"].cast(pa.float64()).to_numpy() for label in labels for axis in "xyz"]
    if not columns:
        raise ValueError("it has neither a column joint nor columns that end in _x, _y, _z")
    return labels, _times(table), np.stack(columns, axis=1).reshape(table.num_rows, -1, 3)


_READERS = {".c3d": _read_c3d, ".trc": _read_trc, ".csv": _read_csv}
