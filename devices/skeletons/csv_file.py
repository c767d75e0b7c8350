"""Reads skeletons from CSV, one row per joint: ``time_us,body,joint,x,y,z[,state]``; metres, sensor frame.

The files of other programs may have other units, axes and names.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import chain, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from devices.people import RecordedPeople
from devices.sensor import DeviceError
from devices.skeletons.conventions import (
    FEWEST_TIMES,
    check_metres_forward,
    find_time_unit,
    find_unit,
    impossible,
    impossible_in_words,
    stature_of,
)
from devices.skeletons.csv_text import TextRows, codes, line_of_row, refuse_cut_off, states_of, text_rows
from devices.skeletons.name_tables import listed
from devices.skeletons.read_file import ReadFile
from devices.skeletons.stated_format import UNSTATED, FilePoints, StatedFormat
from fusion.large_arrays import stored
from fusion.pair_arrays import View, joined_views
from fusion.progress import Progress, quietly
from fusion.skeleton import TrackingState, checked_joints

LATEST_US = 9 * 10**15
"""Largest time, so that nanoseconds fit into 64 bits."""

_BLOCK = 4_000_000  # bytes


def read_csv(
    path: Path, stated: StatedFormat = UNSTATED, progress: Progress = quietly, block: int = _BLOCK
) -> ReadFile:
    """Reads a CSV file. Columns are separated by commas, semicolons or tabs.

    Where commas do not separate columns, numbers may have a decimal comma. ``state`` is tracked, inferred or
    not_tracked, or 2, 1, 0; without this column every joint counts as tracked. A joint is not tracked in a
    frame in which it has no row or an empty coordinate.

    Args:
        block: Bytes that are read at once; -1 for all. The result does not depend on it.

    Raises:
        DeviceError: Wrong columns, an unknown joint, text instead of a number, an incomplete row, a
            repeated joint; the message names the line. Or times or positions of an unknown unit, or positions
            behind the sensor, or of a person who is a mirror image by the stated axes.
    """
    try:
        return _Reader(path, stated).read(block, progress)
    except _NotInBlocksError:
        return _Reader(path, stated).read(-1, progress)


class _NotInBlocksError(Exception):
    """A block has frames before those of an earlier one, or another body, or looks wrong by itself."""


class _Reader:
    """Turns the rows of a file into skeletons, block after block."""

    def __init__(self, path: Path, stated: StatedFormat) -> None:
        self._path, self._stated = path, stated
        self._points: FilePoints | None = None
        self._metres: float | None = None
        self._us: float | None = None  # microseconds per unit of time
        self._people: dict[str, int] = {}
        self._times: list[NDArray[np.int64]] = [np.zeros(0, dtype=np.int64)]
        self._index: list[NDArray[np.int64]] = []
        self._rows = self._frames = self._impossible = 0
        self._in_blocks = False
        self._wrong: tuple[int, NDArray[np.float64]] | None = None
        self._warnings: dict[str, str] = {}

    def read(self, size: int, progress: Progress) -> ReadFile:
        """Reads the file in blocks of this many bytes; -1: at once."""
        self._in_blocks = size > 0
        count = -(-self._path.stat().st_size // size) if self._in_blocks else 1
        skeletons = joined_views(progress(self._blocks(size), f"reading {self._path.name}", count))
        pa.default_memory_pool().release_unused()
        assert self._points is not None
        body = self._points.body
        frame, person = np.concatenate(self._index, axis=1)
        if self._wrong is not None:
            row, place = self._wrong
            where = f"in line {line_of_row(self._path, row)}"
            self._warnings["impossible"] = impossible_in_words(self._path, self._impossible, where, place)
        (times,) = stored(np.concatenate(self._times) * 1000)
        if handed := self._stated.check_handed(self._path, body, skeletons.positions):
            self._warnings["handed"] = handed
        people = RecordedPeople(body, times, list(self._people), frame, person, skeletons)
        return ReadFile(body, people, tuple(self._warnings.values()))

    def _blocks(self, size: int) -> Iterator[View]:
        """The skeletons of each block; its last two frames wait for the next one, which may continue them."""
        waiting: pa.Table | None = None
        rows: tuple[NDArray[Any], ...] | None = None
        for text, following in pairwise(chain(text_rows(self._path, size), [None])):
            assert text is not None
            new = self._numbers(text)
            rows = new if rows is None else tuple(map(np.concatenate, zip(rows, new, strict=True)))
            whole = len(rows[0])
            if following is None:
                refuse_cut_off(text, waiting, rows[0])
            else:
                begins = np.flatnonzero(np.diff(rows[0])) + 1
                whole = int(begins[-2]) if len(begins) > 1 else 0
            waiting = text.table
            if whole:
                yield self._skeletons(tuple(values[:whole] for values in rows))
                rows = tuple(values[whole:] for values in rows)
                self._rows += whole

    def _numbers(self, text: TextRows) -> tuple[NDArray[Any], ...]:
        """Time, person, point, x, y, z and state of each row."""
        time_us = self._microseconds(text)
        xyz = np.stack([text.numbers(axis, pa.float64()) for axis in "xyz"], axis=1)
        states = states_of(text)
        people, person = codes(text.table, "body")
        numbers = [self._people.setdefault(name, len(self._people)) for name in people]
        names, name = codes(text.table, "joint")
        if self._points is None:
            self._points = self._check(self._stated.points, self._path, names)
            assert self._points is not None
            if left_out := self._points.left_out:
                self._warnings["names"] = (
                    f"{self._path}: by {self._stated.names} these points are no joints: {listed(left_out)}."
                )
        points = [self._points.find(point) for point in names]
        if None in points:
            raise _NotInBlocksError
        return time_us, np.array(numbers)[person], np.array(points)[name], self._stated.turned(xyz), states

    def _microseconds(self, text: TextRows) -> NDArray[np.int64]:
        """The times, rounded."""
        times = text.times()
        if self._us is None:
            different = np.unique(times)
            if self._in_blocks and len(different) < FEWEST_TIMES:
                raise _NotInBlocksError
            self._us, warning = self._check(find_time_unit, self._path, text.time, different)
            if warning:
                self._warnings["time"] = warning
        assert self._us is not None
        if max(float(times.max()), -float(times.min())) * self._us >= LATEST_US:
            raise DeviceError(f"{self._path}: {text.time} goes beyond {LATEST_US} microseconds.")
        exact = self._us == 1.0 and times.dtype == np.int64
        return times if exact else np.rint(times * self._us).astype(np.int64)

    def _skeletons(self, rows: tuple[NDArray[Any], ...]) -> View:
        """The skeletons of whole frames."""
        path, points, (time_us, person, point, xyz, states) = self._path, self._points, rows
        assert points is not None
        body = points.body
        times, frame = np.unique(time_us, return_inverse=True)
        if len(self._times[-1]) and times[0] <= self._times[-1][-1]:
            raise _NotInBlocksError
        self._warn_backward(time_us, person * len(points) + point)
        key, row = np.unique(frame * len(self._people) + person, return_inverse=True)
        slot = row * len(points) + point
        self._refuse_repeated(slot)
        at = np.full((len(key), len(points), 3), np.nan)
        state = np.zeros((len(key), len(points)), dtype=np.uint8)
        at.reshape(-1, 3)[slot] = xyz
        state.reshape(-1)[slot] = states
        positions, state = points.joints(at, state)
        if self._metres is None:
            unit = self._stated.unit
            if self._in_blocks and unit == "auto" and stature_of(body, positions) is None:
                raise _NotInBlocksError
            self._metres, warning = self._check(find_unit, path, body, positions, unit)
            if warning:
                self._warnings["unit"] = warning
        positions *= self._metres
        self._check(check_metres_forward, path, positions)
        self._count_impossible(xyz * self._metres, states)
        joints, joint_states = checked_joints(body, positions, state, (len(key),))
        of = key // len(self._people)
        self._index.append(np.stack([self._frames + of, key % len(self._people)]))
        self._times.append(times)
        self._frames += len(times)
        return View(times[of] * 1000, joints, joint_states)

    def _check(self, check: Callable[..., Any], *values: object) -> Any:
        """The result of a check; where the values look wrong in a block, the whole file decides."""
        try:
            return check(*values)
        except DeviceError:
            if self._in_blocks:
                raise _NotInBlocksError from None
            raise

    def _refuse_repeated(self, slot: NDArray[np.int64]) -> None:
        order = np.argsort(slot, kind="stable")
        again = order[1:][slot[order][1:] == slot[order][:-1]]
        if len(again) and self._points is not None:
            row = int(again.min())
            joint = self._points.named(int(slot[row]) % len(self._points))
            raise DeviceError(
                f"{self._path}: joint {joint} of one person has two rows in one frame, the second in line "
                f"{line_of_row(self._path, self._rows + row)}."
                + (" Are two recordings in one file?" if "backward" in self._warnings else "")
            )

    def _warn_backward(self, time_us: NDArray[np.int64], joint: NDArray[np.int64]) -> None:
        """Adds a warning if the time of a joint goes back from one row to its next."""
        order = np.argsort(joint, kind="stable")
        times, of = time_us[order], joint[order]
        back = order[1:][(np.diff(times) < 0) & (of[1:] == of[:-1])]
        if len(back) and "backward" not in self._warnings:
            line = line_of_row(self._path, self._rows + int(back.min()))
            self._warnings["backward"] = (
                f"{self._path}: the time goes back in line {line}; the frames were sorted by time."
            )

    def _count_impossible(self, metres: NDArray[np.float64], states: NDArray[np.uint8]) -> None:
        """Counts positions of tracked joints that no sensor can report."""
        wrong = np.flatnonzero(impossible(metres) & (states != TrackingState.NOT_TRACKED))
        self._impossible += len(wrong)
        if len(wrong) and self._wrong is None:
            self._wrong = self._rows + int(wrong[0]), metres[wrong[0]]
