"""What a reader of skeleton files takes and gives: the bytes of a text file, and the points in it."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from devices.input_file import open_input
from devices.sensor import DeviceError
from devices.skeletons.name_tables import FilePoints, named_points
from devices.skeletons.stated_format import Unit
from devices.skeletons.times import FEWEST, LOGGED_TWICE, capture_times
from fusion.pair_arrays import View, joined_views
from fusion.support.large_arrays import parts

_KINDS = (
    (b"RRF", "a session or another Rerun recording; look at it with duplex review"),
    (b"\x1f\x8b", "compressed by gzip; unpack it first"),
    (b"PK\x03\x04", "a zip archive or a spreadsheet; save it as text"),
    (b"\x1aE\xdf\xa3", "a Matroska video; its name must end in .mkv"),
    (b"\xff\xfe", "UTF-16; save it as UTF-8"),
    (b"\xfe\xff", "UTF-16; save it as UTF-8"),
)
"""First bytes of files that are often taken for a skeleton file, and what to say about them."""
_MOST = 0.7  # of the rows: more are twice where times lost their digits, not of two people
LARGE = 1e9
"""Coordinates beyond it are errors, in any unit."""
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
        sets: Times of the first frames after the clock was set.
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
    sets: Sequence[int] = ()
    where: Callable[[int, int], str] | None = None


@dataclass(frozen=True, eq=False)
class JointRows:
    """Joints of people as a file has them.

    Attributes:
        path: The file.
        column: The unit of its times, of :data:`devices.skeletons.times.TIME_COLUMNS`.
        time: (M,) times, of frames or of rows.
        frame: (N,) which of them each row has; None: rows have their own.
        people: Ids of the people.
        person: (N,) index of each row's.
        labels: Names of the joints.
        label: (N,) index of each row's.
        xyz: (N, 3) positions.
        state: (N,) states.
        where: The place of a row in the file, in words.
        called: What the file calls the times, if not as their unit.
        has_body: Whether people have ids.
    """

    path: Path
    column: str
    time: NDArray[Any]
    frame: NDArray[np.int64] | None
    people: Sequence[str]
    person: NDArray[np.integer]
    labels: Sequence[str]
    label: NDArray[np.integer]
    xyz: NDArray[np.float64]
    state: NDArray[np.uint8]
    where: Callable[[int], str]
    called: str = ""
    has_body: bool = True


def found_of(rows: JointRows, table: str = "", told: Sequence[str] = (), **about: Any) -> FoundPoints:
    """The points of a file, frame by frame.

    Args:
        table: The stated table of names, if any.
        told: Lines about the file.
        about: Further attributes of the result.

    Raises:
        DeviceError: There is no frame, a name is no joint's, a joint is there twice in a frame, or the unit
            of the times is unclear.
    """
    if not len(rows.time):
        raise DeviceError(f"{rows.path} has no frames.")
    points, labels, names, found_table, about_points = named_points(rows.path, rows.labels, table)
    label = np.array([points.labels.index(name) for name in labels], dtype=np.int64)[rows.label]
    joint = rows.person * len(points) + label
    key = joint if rows.frame is None else None
    clock = capture_times(
        rows.path, rows.column, rows.time, called=rows.called, telling=_times_of_new_frames(rows), key=key,
        anonymous=not rows.has_body,
    )  # fmt: skip
    times, frame = np.unique(clock.time_ns, return_inverse=True)
    frame = frame if rows.frame is None else frame[rows.frame]
    backward = _backward(rows, frame, joint)
    skeletons, skeleton = np.unique(frame * len(rows.people) + rows.person, return_inverse=True)
    slot = skeleton * len(points) + label
    order, repeated = _once(rows, points, slot, bool(backward))
    by = slot[order]

    def blocks() -> Iterator[View]:
        for part in parts(len(skeletons)):
            first, end = np.searchsorted(by, (part.start * len(points), part.stop * len(points)))
            of, count = order[first:end], part.stop - part.start
            at = np.full((count * len(points), 3), np.nan)
            state = np.zeros(count * len(points), dtype=np.uint8)
            here = by[first:end] - part.start * len(points)
            at[here], state[here] = rows.xyz[of], rows.state[of]
            time = times[skeletons[part] // len(rows.people)]
            yield View(time, at.reshape(count, -1, 3), state.reshape(count, -1))
        if not len(skeletons):  # nobody is seen
            yield View(
                np.zeros(0, np.int64),
                np.zeros((0, len(points), 3), np.float32),
                np.zeros((0, len(points)), np.uint8),
            )

    def where(k: int, point: int) -> str:
        return rows.where(int(order[np.searchsorted(by, k * len(points) + point)]))

    return FoundPoints(
        points, times, rows.people, skeletons // max(1, len(rows.people)),
        skeletons % max(1, len(rows.people)), joined_views(blocks()), names=names, clock=clock.clock,
        table=found_table, warnings=(*told, *about_points, *clock.told, *backward, *repeated), where=where,
        sets=clock.sets,
        **about,
    )  # fmt: skip


def _times_of_new_frames(rows: JointRows) -> NDArray[Any]:
    """Different times; where a program logged many frames again, those of the tracker's own frames."""
    times, of_frame = np.unique(rows.time, return_inverse=True)
    frame = of_frame if rows.frame is None else of_frame[rows.frame]
    content = digest(rows.xyz) * (1 + rows.label + 97 * rows.person)
    new = np.append(True, np.diff(np.bincount(frame, content, minlength=len(times))) != 0.0)
    return times[new] if new.sum() >= FEWEST and new.mean() < 1.0 - LOGGED_TWICE else times


def digest(xyz: NDArray[Any]) -> NDArray[np.float64]:
    """(…) a number of each (…, 3) place, which tells it from others."""
    return np.asarray(np.clip(np.nan_to_num(xyz), -LARGE, LARGE) @ (1.0, 0.7, 0.3))


def _backward(rows: JointRows, frame: NDArray[np.int64], joint: NDArray[np.int64]) -> list[str]:
    """A warning if the time of a joint goes back from one row to its next."""
    if (np.diff(frame) >= 0).all():
        return []
    order = np.argsort(joint, kind="stable")
    back = order[1:][(np.diff(frame[order]) < 0) & (np.diff(joint[order]) == 0)]
    if not len(back):
        return []
    return [f"{rows.path}: the time goes back {rows.where(int(back.min()))}; the frames were sorted by time."]


def _once(
    rows: JointRows, points: FilePoints, slot: NDArray[np.int64], backward: bool
) -> tuple[NDArray[np.int64], list[str]]:
    """The rows in the order of their slots, each slot once, and a line where many rows were repeated.

    Raises:
        DeviceError: Two different rows are of one joint of a person in a frame, or some rows are twice.
    """
    order = np.argsort(slot, kind="stable")
    if not (np.diff(slot[order]) == 0).any():
        return order, []
    # Programs write zeros for bodies that are not tracked, and often give all of these the same id.
    order = order[(np.nan_to_num(rows.xyz[order]) != 0.0).any(axis=1)]
    again = np.append(False, np.diff(slot[order]) == 0)
    if not again.any():
        return order, []
    later, earlier = order[again], order[np.flatnonzero(again) - 1]
    row, share = int(later.min()), again.mean()
    if share > LOGGED_TWICE and np.array_equal(rows.xyz[later], rows.xyz[earlier], equal_nan=True):
        repeated = f"{100.0 * share:.0f} % of the rows repeat another one of the same time"
        return order[~again], [f"{rows.path}: {repeated}, and are left out."]
    why = "Have two people one id, or the times lost digits? A column named frame that counts them is enough."
    if not rows.has_body and share < _MOST:
        why = "There is no column body: name the one that distinguishes people so."
    elif backward:
        why = "Are two recordings in one file?"
    raise DeviceError(
        f"{rows.path}: joint {points.labels[int(slot[row]) % len(points)]} of one person has two rows in one "
        f"frame, the second {rows.where(row)}. {why}"
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
        left = file.read(1024)
        for magic, words in _KINDS:
            if left.startswith(magic):
                raise DeviceError(f"{path} is not a file of skeletons but {words}.")
        if b"\0" * _FEWEST_NULS in left:
            raise DeviceError(f"{path} is not text: it contains zero bytes.")
        read, more, empty = 0, b"-", True
        while more:
            more = file.read(size)
            raw, left = left + more, b""
            if size > 0 and len(more) == size:
                end = raw.rfind(b"\n") + 1  # 0: no line ends here, or they are those of an old Mac
                raw, left = raw[:end], raw[end:]
            if raw.strip():
                _check_text(path, raw, read)
                empty = False
                yield raw
            read += len(raw)
        if empty:
            raise DeviceError(f"{path} is empty.")


def _check_text(path: Path, raw: bytes, before: int) -> None:
    """Refuses what is not text; so many bytes of the file come before."""
    if raw.isascii() and b"\0" not in raw:
        return

    def line(byte: int) -> int:
        with path.open("rb") as file:
            return file.read(before + byte).count(b"\n") + 1

    nuls = raw.find(b"\0" * _FEWEST_NULS)
    if nuls >= 0:
        raise DeviceError(
            f"{path} is damaged: zero bytes in line {line(nuls)}. Copy it again, or delete the rest."
        )
    try:
        raw.decode("utf-8")
    except UnicodeDecodeError as error:
        at = error.start
        raise DeviceError(
            f"{path} is not text in UTF-8: byte {before + at + 1}, in line {line(at)}. Save it as UTF-8."
        ) from None
