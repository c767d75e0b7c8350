"""Reads motion capture: points over time from .c3d, OpenSim's .trc, and .csv of this and other programs."""

import math
from dataclasses import dataclass
from io import TextIOWrapper
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from devices.input_file import open_input, reading
from devices.sensor import DeviceError
from devices.skeletons.csv_files.text import codes, refuse_cut_off, text_rows
from devices.skeletons.name_tables import NameTable, listed
from devices.skeletons.times import capture_times
from fusion.body import Body
from fusion.support.large_arrays import parts, stored
from fusion.support.medians import median_of_known
from recordings.comparing.c3d_file import read_c3d
from recordings.comparing.vendor_text import is_vendor_text, read_trc, read_vendor_text
from recordings.errors import MissingFileError, RecordingError

SUFFIXES = (".c3d", ".trc", ".csv", ".tsv")
"""Suffixes of files of motion capture."""
_FEWEST_JOINTS = 5
_LARGEST = 2 << 30  # bytes of a .trc or .c3d; a .trc of 50 points at 120 Hz takes 600 MB an hour


@dataclass(frozen=True, eq=False)
class TruthFile:
    """Points over time.

    Attributes:
        name: The file, for messages.
        labels: Names of the M points.
        seconds: (N,) times in order.
        points: (N, M, 3) in the file's unit and axes; NaN where a point is missing. Many lie in a file.
        warning: What the user should know about the file, if anything.
    """

    name: str
    labels: tuple[str, ...]
    seconds: NDArray[np.float64]
    points: NDArray[np.float32]
    warning: str = ""

    def joints(self, body: Body, table: NameTable) -> NDArray[np.float32]:
        """(N, J, 3) the joints of a body, by a table of names; NaN where the file has none.

        Raises:
            RecordingError: It has fewer than five.
        """
        joints = np.full((len(self.seconds), len(body), 3), np.nan, dtype=np.float32)
        for joint, points in table.points_of(body, self.labels).items():
            joints[:, joint] = self.points[:, points].mean(axis=1)
        count = int(np.isfinite(joints).any(axis=(0, 2)).sum())
        if count < _FEWEST_JOINTS:
            raise RecordingError(
                f"{self.name}: {count} of the joints of {body.name} are found by the table {table.name}, and "
                f"{_FEWEST_JOINTS} are needed. The file has {listed(self.labels)}. Name its points in a "
                "table with `names=TABLE.toml`."
            )
        return joints


def read_truth(path: Path) -> TruthFile:
    """Reads a file of :data:`SUFFIXES`.

    Raises:
        RecordingError: The file cannot be read, is not complete, or has no points or times.
    """
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        raise RecordingError(f"{path} is no motion capture: its name ends in none of {', '.join(SUFFIXES)}.")
    try:
        with reading(path, RecordingError, MissingFileError):
            labels, seconds, points, warning = reader(path)
    except DeviceError as error:
        raise RecordingError(str(error)) from None
    points[np.isnan(points).any(axis=2)] = np.nan
    frame, point = np.nonzero(_strays(points))
    points[frame, point] = np.nan
    if len(frame):
        first = f"{labels[point[0]]} at {seconds[frame[0]]:.3f} s"
        left_out = "1 position is" if len(frame) == 1 else f"{len(frame)} positions are"
        warning += f"{' ' * bool(warning)}{left_out} left out, far from all others, such as {first}."
    if len(labels) == 0 or not np.isfinite(points).any():
        raise RecordingError(f"{path} has no points.")
    if len(seconds) < 2 or not (np.diff(seconds) > 0.0).all():  # false where NaN
        raise RecordingError(f"{path} needs at least two frames, with times that increase.")
    (points,) = stored(points)
    return TruthFile(str(path), tuple(labels), seconds, points, warning)


_Read = tuple[list[str], NDArray[np.float64], NDArray[np.float32], str]


def _read_c3d(path: Path) -> _Read:
    with open_input(path, _LARGEST) as file:
        try:
            read = read_c3d(file)
        except RecordingError as fault:
            raise RecordingError(f"{path} is not a .c3d: {fault}.") from None
    count = len(read.points)
    if not 0.0 < read.rate < math.inf:
        raise RecordingError(f"{path} states {read.rate:g} frames per second.")
    if count < read.stated:
        raise RecordingError(f"{path} is cut off: it states {read.stated} frames and has {count}.")
    labels = read.labels[: read.points.shape[1]]
    return labels, np.arange(count) / read.rate, _without_origin(read.points[:, : len(labels)]), ""


def _read_trc(path: Path) -> _Read:
    with _text(path) as file:
        labels, seconds, points = read_trc(path, file)
    return labels, seconds, _without_origin(points), ""


def _text(path: Path) -> TextIOWrapper:
    return TextIOWrapper(open_input(path, _LARGEST), "utf-8-sig", "replace")


def _strays(points: NDArray[np.float32]) -> NDArray[np.bool_]:
    """(N, M) points that are farther from the others of their frame than a body reaches.

    A point is as far from the median point of its frame as in the median of the frames, and at most two sizes
    of the body farther; the size is that distance of a point at the body's ends.
    """
    away = np.empty(points.shape[:2], dtype=np.float32)
    with np.errstate(over="ignore", invalid="ignore"):
        for part in parts(len(points)):
            away[part] = np.linalg.norm(points[part] - median_of_known(points[part])[:, None], axis=2)
        usual = median_of_known(away.T)
        size = np.quantile(usual[np.isfinite(usual)], 0.9) if np.isfinite(usual).any() else 0.0
        return np.asarray(away > usual + 2.0 * size)


def _without_origin(points: NDArray[np.float32]) -> NDArray[np.float32]:
    """Points at exactly 0, 0, 0 are missing."""
    points[(points == 0.0).all(axis=2)] = np.nan
    return points


def _read_csv(path: Path) -> _Read:
    """A row for each joint and frame, for each frame with columns such as HEAD_x; or another program's."""
    with open_input(path) as file:
        vendor = is_vendor_text(file.read(100).decode("utf-8-sig", "replace").replace("\r", ""))
    if vendor:
        with _text(path) as text_file:
            labels, seconds, points = read_vendor_text(path, text_file)
        return labels, seconds, _without_origin(points), ""
    (text,) = text_rows(path, -1, required=())
    time_ns, clock, told, _ = capture_times(
        path, *text.times(), shortest_us=2_000.0, anonymous=True
    )  # motion capture is fast, and several skeletons may follow each other
    times, frame = np.unique(time_ns, return_inverse=True)
    refuse_cut_off(text, None, frame)
    names = text.table.column_names
    wide = [name[:-2] for name in names if name.endswith("_x")]
    columns = [f"{label}_{axis}" for label in wide for axis in "xyz"] or ["joint", *"xyz"]
    if missing := [name for name in columns if name not in names]:
        lacks = f"{path} is no .csv of motion: it has no column {missing[0]}."
        raise RecordingError(
            f"{lacks} Its columns must be those of duplex export, or time_us,body,joint,x,y,z."
        )
    if wide:
        labels, joint = wide, np.tile(np.arange(len(wide)), len(frame))
        row = np.repeat(np.arange(len(frame)), len(wide))
        values = np.stack([text.numbers(name, pa.float64()) for name in columns], axis=1).reshape(-1, 3)
    else:
        labels, joint = codes(text.table, "joint")
        row = np.arange(len(frame))
        if "skeleton" in names:  # of duplex export: a, b and S*
            row = np.flatnonzero(pc.equal(text.table["skeleton"], "fused").to_numpy())
        elif "body" in names and len(bodies := codes(text.table, "body")[0]) > 1:
            raise RecordingError(f"{path} has {len(bodies)} bodies, and one is compared.")
        joint = joint[row]
        values = np.stack([text.numbers(axis, pa.float64()) for axis in "xyz"], axis=1)[row]
    slot = frame[row] * len(labels) + joint
    order = np.argsort(slot, kind="stable")
    # of exported frames of one time, such as one of each sensor in a live session, the last counts
    exported = "skeleton" in names or "gait" in names
    if len(again := order[1:][np.diff(slot[order]) == 0]) and not exported:
        first = int(again.min())
        raise RecordingError(
            f"{path}, line {text.line(int(row[first]))}: {labels[joint[first]]} has a second row at one time."
        )
    points = np.full((len(times) * len(labels), 3), np.nan, dtype=np.float32)
    points[slot] = values
    text.decimals.check(path)
    words = f"{clock} {' '.join(told)}".strip()
    return labels, times.astype(np.float64) * 1e-9, points.reshape(len(times), -1, 3), words


_READERS = {".c3d": _read_c3d, ".trc": _read_trc, ".csv": _read_csv, ".tsv": _read_csv}
