"""What a reader of skeleton files takes and gives: the bytes of a text file, and the points in it."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from devices.input_file import open_input
from devices.sensor import DeviceError
from devices.skeletons.name_tables import FilePoints
from devices.skeletons.stated_format import Unit
from devices.skeletons.times import capture_times, digest, times_of_new_frames
from fusion.pair_arrays import View, joined_views
from fusion.skeleton import TrackingState

_KINDS = (
    (b"RRF", "a session or another Rerun recording; look at it with duplex review"),
    (b"\x1f\x8b", "compressed by gzip; unpack it first"),
    (b"PK\x03\x04", "a zip archive or a spreadsheet; save it as text"),
    (b"\x1aE\xdf\xa3", "a Matroska video; its name must end in .mkv"),
    (b"\xff\xfe", "UTF-16; save it as UTF-8"),
    (b"\xfe\xff", "UTF-16; save it as UTF-8"),
)
"""First bytes of files that are often taken for a skeleton file, and what to say about them."""
_FEWEST_NULS = 8  # bytes in a row that a power cut leaves; a single one may be a flipped bit


@dataclass(frozen=True, eq=False)
class FoundPoints:
    """The points of a file as it has them.

    Attributes:
        points: Which joints they are.
        time_ns: (T,) times of the frames, in order.
        ids: The tracker's ids of the people.
        frame, person: (N,) of each skeleton: number of its frame, in order, and index of its id.
        view: N rows of P points, in the file's unit and axes.
        unit: The unit that the format defines.
        free_axes: Whether the format leaves the axes open.
        names, clock: How names and times are read, in words, if otherwise than as this program defines it.
        table: The ready-made table of names that was found.
        warnings: What the user should know about the file, a line each.
        ignored: Names of columns that are not read.
        where: Where in the file a point of a skeleton is, for messages, by their numbers.
    """

    points: FilePoints
    time_ns: NDArray[np.int64]
    ids: Sequence[str]
    frame: NDArray[np.int64]
    person: NDArray[np.int64]
    view: View
    unit: Unit = "m"
    free_axes: bool = False
    names: str = ""
    clock: str = ""
    table: str = ""
    warnings: tuple[str, ...] = ()
    ignored: tuple[str, ...] = ()
    where: Callable[[int, int], str] | None = None


@dataclass(frozen=True, eq=False)
class Bodies:
    """The people of one frame: their points (P, 3) and states (P,) by id."""

    time: int  # in the unit of the file's column
    people: Sequence[tuple[str, NDArray[np.float64], NDArray[np.uint8] | None]]


def found_of(
    path: Path, points: FilePoints, column: str, frames: Sequence[Bodies], called: str = "", **about: Any
) -> FoundPoints:
    """The points of frames, sorted by time.

    Args:
        column: The unit of their times, of :data:`devices.skeletons.times.TIME_COLUMNS`.
        called: What the file calls them.
        about: Further attributes of the result.

    Raises:
        DeviceError: There is no frame, two frames have one time, or two people of a frame one id.
    """
    if not frames:
        raise DeviceError(f"{path} has no frames.")
    moments = np.array([frame.time for frame in frames], dtype=np.int64)
    each, first = np.unique(moments, return_index=True)
    places = [frames[k].people for k in first.tolist()]
    digests = [
        sum(digest(at, np.arange(len(at)), i).sum() for i, (_, at, _) in enumerate(of)) for of in places
    ]
    telling = times_of_new_frames(each, np.array(digests, dtype=np.float64))
    times, clock, told = capture_times(path, column, moments, called=called, telling=telling)
    back = np.flatnonzero(np.diff(times) < 0)
    if len(back):
        told.append(f"{path}: the time goes back at frame {back[0] + 1}; the frames were sorted by time.")
    order = np.argsort(times, kind="stable")
    for time_ns in times[order][1:][np.diff(times[order]) == 0][:1]:
        raise DeviceError(f"{path}: two frames have the same time, {time_ns // 1000} µs.")
    numbers: dict[str, int] = {}
    index: list[tuple[int, int]] = []
    rows: list[tuple[NDArray[np.float64], NDArray[np.uint8]]] = []
    for number, k in enumerate(order):
        names = [name for name, _, _ in frames[k].people]
        if again := [name for name in names if names.count(name) > 1]:
            raise DeviceError(f"{path}: frame {k} has two people of one id, {again[0]}.")
        for name, at, states in frames[k].people:
            index.append((number, numbers.setdefault(name, len(numbers))))
            rows.append((at, np.full(len(at), TrackingState.TRACKED) if states is None else states))
    frame, person = np.array(index, dtype=np.int64).reshape(-1, 2).T
    at = np.array([xyz for xyz, _ in rows], dtype=np.float64).reshape(-1, len(points), 3)
    states = np.array([state for _, state in rows], dtype=np.uint8).reshape(-1, len(points))
    view = joined_views([View(times[order][frame], at, states)])  # type: ignore[arg-type]
    warnings = (*about.pop("warnings", ()), *told)
    return FoundPoints(
        points, times[order], list(numbers), frame, person, view, clock=clock, warnings=warnings, **about
    )


def text_bytes(path: Path) -> bytes:
    """The bytes of a text file in UTF-8; see :func:`text_blocks`."""
    return b"".join(text_blocks(path))


def text_blocks(path: Path, size: int = -1) -> Iterator[bytes]:
    """The lines of a text file in UTF-8, in blocks of about this many bytes.

    Raises:
        DeviceError: The file is no regular file, is empty, has another format, or is not UTF-8.
        OSError: It cannot be read.
    """
    with open_input(path) as file:
        start = file.read(1024)
        for magic, words in _KINDS:
            if start.startswith(magic):
                raise DeviceError(f"{path} is not a file of skeletons but {words}.")
        if b"\0" * _FEWEST_NULS in start:
            raise DeviceError(f"{path} is not text: it contains zero bytes.")
        read = 0
        while more := file.read(size):
            raw, start = start + more, b""
            if size > 0 and len(more) == size:
                end = raw.rfind(b"\n") + 1
                raw, start = raw[:end], raw[end:]
                if end == 0:  # no line ends here, or they are those of an old Mac
                    continue
            _check_text(path, raw, read)
            if read == 0 and not raw.strip():
                break
            read += len(raw)
            yield raw
        if start.strip():
            _check_text(path, start, read)
            yield start
        elif read == 0:
            raise DeviceError(f"{path} is empty.")


def _check_text(path: Path, raw: bytes, before: int) -> None:
    """Refuses what is not text; so many bytes of the file come before."""
    if raw.isascii() and b"\0" not in raw:
        return
    nuls = raw.find(b"\0" * _FEWEST_NULS)
    if nuls >= 0:
        line = _line(path, before + nuls)
        raise DeviceError(f"{path} is damaged: zero bytes in line {line}. Copy it again, or delete the rest.")
    try:
        raw.decode("utf-8")
    except UnicodeDecodeError as error:
        byte = before + error.start
        raise DeviceError(
            f"{path} is not text in UTF-8: byte {byte + 1}, in line {_line(path, byte)}. Save it as UTF-8."
        ) from None


def _line(path: Path, byte: int) -> int:
    """The number of a byte's line, from 1."""
    with path.open("rb") as file:
        for number, line in enumerate(file, start=1):
            byte -= len(line)
            if byte < 0:
                return number
    raise AssertionError(f"{path} became shorter")
