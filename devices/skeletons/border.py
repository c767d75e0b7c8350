"""Checks of every file of recorded skeletons, by which its points become the joints of people."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from devices.people.recorded_people import RecordedPeople
from devices.sensor import DeviceError
from devices.skeletons.likelihood import axes_likelihood, is_relative
from devices.skeletons.meaning import Evidence, Meaning, said
from devices.skeletons.read_file import FoundPoints, digest
from devices.skeletons.repetition import kept_places, logged_again, repeats_of
from devices.skeletons.stated_format import UNSTATED, StatedFormat, Unit
from fusion.body import Body
from fusion.pair_arrays import View, joined_views
from fusion.skeleton import FARTHEST_JOINT, checked_joints, impossible
from fusion.support.large_arrays import parts

_SAMPLES = 300


@dataclass(frozen=True, eq=False)
class ReadFile:
    """The content of a skeleton file.

    Attributes:
        body: Of the people; found by the names of the joints.
        people: Their frames.
        warnings: What the user should know about the file, a line each.
        meaning: How it was read.
        unit: The unit that its format defines.
        names: The ready-made table by which its names were found, if any.
        ignored: Names of columns that are not read.
    """

    body: Body
    people: RecordedPeople
    warnings: tuple[str, ...]
    meaning: Meaning
    unit: Unit = "m"
    names: str = ""
    ignored: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Look:
    """A file as it was found, and what it tells of its meaning."""

    path: Path
    found: FoundPoints
    evidence: Evidence
    drop: NDArray[np.bool_]  # (T,) frames that repeat the one before
    keeps: NDArray[np.bool_]  # (N, P) points that keep their places
    told: tuple[str, ...]


def look(path: Path, found: FoundPoints, stated: StatedFormat = UNSTATED) -> Look:
    """What a file tells of its meaning, by frames of the person of whom most joints are seen.

    A point is not seen where its state says so, where a coordinate is NaN or all are 0, and where it keeps
    its place to the last digit while the others move. Frames that repeat the one before, as where a program
    logs faster than its tracker gives frames, are left out.
    """
    repeats = repeats_of(found)
    drop, told = logged_again(path, found, repeats)
    keeps, about_places = kept_places(path, found, repeats)
    seen = np.zeros(len(found.person))
    for part in parts(len(seen)):  # programs log bodies although nobody is there
        seen[part] = ((digest(found.view.positions[part]) != 0.0) & (found.view.states[part] > 0)).sum(axis=1)
    seen[repeats] = 0.0
    most = np.bincount(found.person, seen, minlength=1).argmax()
    rows = np.flatnonzero((found.person == most) & (seen > 0.0))
    rows = rows[np.linspace(0, len(rows) - 1, min(_SAMPLES, len(rows))).astype(np.int64)]
    body = found.points.body
    at, _ = found.points.joints(_seen(found.view, keeps, rows), found.view.states[rows])
    seconds = np.asarray(found.time_ns[found.frame[rows]] * 1e-9, dtype=np.float64)
    evidence = Evidence(
        path, stated, found.unit, found.free_axes, *axes_likelihood(body, seconds, at), is_relative(body, at)
    )
    return Look(path, found, evidence, drop, keeps, (*told, *about_places))


def checked(of: Look, meaning: Meaning) -> ReadFile:
    """The joints of a file by its meaning: only what a sensor can have seen, in metres.

    Raises:
        DeviceError: No joint has a position.
    """
    found, drop = of.found, of.drop
    rows = np.flatnonzero(~drop[found.frame])
    skeletons, about_positions = _possible(of, rows, meaning)
    there = skeletons.states.any(axis=1)
    if len(rows) and there.any() and not there.all():  # bodies that a program logs although nobody is there
        rows, skeletons = rows[there], skeletons.chosen_whole(np.flatnonzero(there))
    frame = (np.cumsum(~drop) - 1)[found.frame[rows]]
    seen, person = np.unique(found.person[rows], return_inverse=True)
    ids = [found.ids[k] for k in seen]
    people = RecordedPeople(
        found.points.body, found.time_ns[~drop], ids, frame, person, skeletons, found.sets
    )
    if people.ids and not skeletons.states.any():
        raise DeviceError(f"{of.path}: no joint has a position in any frame.")
    about_meaning = said(of.evidence, meaning, found.names, found.clock)
    lines = (*about_meaning, *found.warnings, *of.told, *meaning.told, *about_positions)
    return ReadFile(found.points.body, people, lines, meaning, found.unit, found.table, found.ignored)


def _seen(view: View, keeps: NDArray[np.bool_], rows: NDArray[np.int64]) -> NDArray[np.float64]:
    """(n, P, 3) points of some skeletons, in the file's unit; NaN where one was not seen."""
    at = np.array(view.positions[rows], dtype=np.float64)
    at[keeps[rows] | (view.states[rows] == 0) | (at == 0.0).all(axis=2) | np.isnan(at).any(axis=2)] = np.nan
    return at


def _possible(look: Look, rows: NDArray[np.int64], meaning: Meaning) -> tuple[View, list[str]]:
    """The joints of some skeletons in metres, and a line about positions that no sensor can report."""
    found, keeps = look.found, look.keeps
    body, count = found.points.body, 0
    first: tuple[int, int, NDArray[np.float64]] | None = None

    def blocks() -> Iterator[View]:
        nonlocal count, first
        for part in parts(len(rows)):
            of = rows[part]
            at = meaning.turned(_seen(found.view, keeps, of) * meaning.metres)
            wrong = np.argwhere(impossible(at))
            count += len(wrong)
            if len(wrong) and first is None:
                k, point = wrong[0].tolist()
                first = int(of[k]), point, at[k, point].copy()
            at[wrong[:, 0], wrong[:, 1]] = np.nan
            joints = checked_joints(body, *found.points.joints(at, found.view.states[of]), (len(of),))
            yield View(found.view.time_ns[of], *joints)
        if not len(rows):  # nobody is seen
            yield View(
                np.zeros(1, np.int64), *checked_joints(body, np.full((1, len(body), 3), np.nan), None, (1,))
            )

    skeletons = joined_views(blocks())
    if first is None:
        return skeletons, []
    k, point, place = first
    where = found.where(k, point) if found.where else f"in frame {found.frame[k]}"
    return skeletons, [impossible_in_words(look.path, count, where, place)]


def impossible_in_words(name: object, count: int, where: str, value: NDArray[np.float64]) -> str:
    """The warning about so many impossible positions: where the first one is, and (3,) what it is."""
    axis = int(np.argmax(~(np.abs(value) < FARTHEST_JOINT)))
    axis = axis if not abs(value[axis]) < FARTHEST_JOINT else 2
    positions = "1 position is" if count == 1 else f"{count} positions are"
    return (
        f"{name}: {positions} impossible and count as not tracked, first {where}, {'xyz'[axis]} = "
        f"{value[axis]:.4g} m. Each coordinate must be within {FARTHEST_JOINT:.0f} m, and z above 0."
    )
