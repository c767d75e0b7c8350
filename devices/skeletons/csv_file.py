"""Reads skeletons from CSV, one row per joint: ``time_us,body,joint,x,y,z[,state]``; metres, sensor frame."""

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
    Unit,
    check_metres_forward,
    check_microseconds,
    find_unit,
    impossible,
    impossible_in_words,
    stature_of,
)
from devices.skeletons.csv_text import TextRows, codes, line_of_row, refuse_cut_off, states_of, text_rows
from devices.skeletons.read_file import ReadFile
from fusion.body import Body, body_of
from fusion.errors import FusionError
from fusion.large_arrays import stored
from fusion.pair_arrays import View, joined_views
from fusion.progress import Progress, quietly
from fusion.skeleton import TrackingState, checked_joints

LATEST_US = 9 * 10**15
"""Largest time, so that nanoseconds fit into 64 bits."""

_BLOCK = 4_000_000  # bytes that are read at once


def read_csv(path: Path, unit: Unit = "auto", progress: Progress = quietly) -> ReadFile:
    """Reads a CSV file. Columns are separated by commas, semicolons or tabs.

    Where commas do not separate columns, numbers may have a decimal comma. ``state`` is tracked, inferred or
    not_tracked, or 2, 1, 0; without this column every joint counts as tracked. A joint is not tracked in a
    frame in which it has no row or an empty coordinate.

    Raises:
        DeviceError: Wrong columns, an unknown joint, text instead of a number, an incomplete row, a
            repeated joint; the message names the line. Or times that are no microseconds, or positions
            of an unknown unit, or behind the sensor.
    """
    try:
        return _Reader(path, unit).read(_BLOCK, progress)
    except _NotInBlocksError:
        return _Reader(path, unit).read(-1, progress)


class _NotInBlocksError(Exception):
    """A block has frames before those of an earlier one, or another body, or looks wrong by itself."""


class _Reader:
    """Turns the rows of a file into skeletons, block after block."""

    def __init__(self, path: Path, unit: Unit) -> None:
        self._path, self._unit = path, unit
        self._body: Body | None = None
        self._metres: float | None = None
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
        assert self._body is not None
        frame, person = np.concatenate(self._index, axis=1)
        if self._wrong is not None:
            row, place = self._wrong
            where = f"in line {line_of_row(self._path, row)}"
            self._warnings["impossible"] = impossible_in_words(self._path, self._impossible, where, place)
        (times,) = stored(np.concatenate(self._times) * 1000)
        people = RecordedPeople(self._body, times, list(self._people), frame, person, skeletons)
        return ReadFile(self._body, people, tuple(self._warnings.values()))

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
        """Time, person, joint, x, y, z and state of each row."""
        time_us = text.numbers("time_us", pa.int64())
        xyz = np.stack([text.numbers(axis, pa.float64()) for axis in "xyz"], axis=1)
        states = states_of(text)
        if max(time_us.max(), -(time_us.min() + 1)) >= LATEST_US:  # the least integer has no absolute value
            raise DeviceError(f"{self._path}: time_us goes beyond {LATEST_US}; times are microseconds.")
        people, person = codes(text.table, "body")
        numbers = [self._people.setdefault(name, len(self._people)) for name in people]
        names, name = codes(text.table, "joint")
        if self._body is None:
            try:
                self._body = body_of(set(names))
            except FusionError as error:
                raise DeviceError(f"{self._path}: {error}") from None
        if any(self._body.find(joint) is None for joint in names):
            raise _NotInBlocksError
        joints = np.array([self._body.joint(joint) for joint in names])
        return time_us, np.array(numbers)[person], joints[name], xyz, states

    def _skeletons(self, rows: tuple[NDArray[Any], ...]) -> View:
        """The skeletons of whole frames."""
        path, body, (time_us, person, joint, xyz, states) = self._path, self._body, rows
        assert body is not None
        times, frame = np.unique(time_us, return_inverse=True)
        if len(self._times[-1]) and times[0] <= self._times[-1][-1]:
            raise _NotInBlocksError
        self._check(check_microseconds, path, times)
        self._warn_backward(time_us, person * len(body) + joint)
        key, row = np.unique(frame * len(self._people) + person, return_inverse=True)
        slot = row * len(body) + joint
        self._refuse_repeated(slot)
        positions = np.full((len(key), len(body), 3), np.nan)
        state = np.zeros((len(key), len(body)), dtype=np.uint8)
        positions.reshape(-1, 3)[slot] = xyz
        state.reshape(-1)[slot] = states
        if self._metres is None:
            if self._in_blocks and self._unit == "auto" and stature_of(body, positions) is None:
                raise _NotInBlocksError
            self._metres, warning = self._check(find_unit, path, body, positions, self._unit)
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
        if len(again) and self._body is not None:
            row = int(again.min())
            joint = self._body.joints[int(slot[row]) % len(self._body)]
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
                f"{self._path}: time_us goes back in line {line}; the frames were sorted by time."
            )

    def _count_impossible(self, metres: NDArray[np.float64], states: NDArray[np.uint8]) -> None:
        """Counts positions of tracked joints that no sensor can report."""
        wrong = np.flatnonzero(impossible(metres) & (states != TrackingState.NOT_TRACKED))
        self._impossible += len(wrong)
        if len(wrong) and self._wrong is None:
            self._wrong = self._rows + int(wrong[0]), metres[wrong[0]]
