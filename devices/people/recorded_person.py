"""Whom two recordings are about: the person to fuse, the same one in both, and the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from devices.pairing import offset_by_arrival
from devices.people.recorded_people import Follow, RecordedPeople, SeenPerson
from devices.sensor import CableSync, Orientation
from fusion.intrinsics import Intrinsics
from fusion.pair_arrays import View
from fusion.support.large_arrays import give_back


@dataclass(frozen=True, eq=False)
class OneRecording:
    """One recording without images, and the person to fuse."""

    name: str
    people: RecordedPeople
    sync: CableSync | None
    warnings: list[str]
    arrivals: NDArray[np.int64]
    """(T, 2) capture and arrival times, where they were recorded."""
    person: View
    wanted: str | None
    """Id of the person that the user chose."""
    option: str
    """What the user knows that choice as, for messages."""
    intrinsics: Intrinsics | None = None
    orientation: Orientation = 0
    others: RecordedPeople | None = None  # who are not followed

    @property
    def seen(self) -> View:
        """The frames in which the person is seen."""
        seen = self.person.states.any(axis=1)
        return self.person if seen.all() else self.person.chosen_whole(np.flatnonzero(seen))


def follow_one_person(
    reads: tuple[OneRecording, OneRecording], offset_ns: int | None, follow: Follow
) -> tuple[OneRecording, OneRecording, tuple[SeenPerson, ...]]:
    """Chooses the person to fuse, the same one in both where one of them shows several at a time.

    Returns:
        Both with the person, and who else is seen.
    """
    read_a, read_b = reads
    a, b = read_a.people, read_b.people
    if not (a.crowded or b.crowded) or a.body is not b.body:
        return _alone(read_a), _alone(read_b), ()
    from devices.people.association import follow_one  # few recordings show several people

    ids = read_a.wanted, read_b.wanted
    if offset_ns is None and (clock := offset_by_arrival(read_a.arrivals, read_b.arrivals)) is not None:
        found = follow_one(a, b, clock.at(b.time_ns), follow, ids)
    else:
        found = follow_one(a, b, offset_ns, follow, ids)
    give_back()
    options = [read.option for read in reads if read.wanted is None]
    choose = " and ".join(options) + (" choose" if len(options) > 1 else " chooses")
    has = " and ".join(f"{_listed(read.people)} by {side}" for read, side in zip(reads, "AB", strict=True))
    if found is None:
        line = (
            f"Several people are seen, {has}, and their motion does not show who is the same in both: those "
            f"seen longest are followed. {choose} the person."
        )
        alone_a, alone_b = _alone(read_a), _alone(read_b)
        return _told(alone_a, line) if options else alone_a, alone_b, ()
    names = " and ".join(
        f"{_listed(read.people, rows)} of {side}"
        for read, rows, side in zip(reads, found.rows, "AB", strict=True)
    )
    count = "1 person is" if found.count == 1 else f"{found.count} people are"
    line = f"{count} seen, {has}. The one followed is {names}; {choose} another."
    if not options:
        line = f"{count} seen, {has}. The one followed is {names}."
    elif found.count > 1 and follow == "longest":
        line += " That one is seen longest; `follow=middle` follows the one nearest the middle of the views."
    chosen_a, chosen_b = (_of_rows(read, rows) for read, rows in zip(reads, found.rows, strict=True))
    return _told(chosen_a, line), chosen_b, tuple(found.people((a, b))) if found.count > 1 else ()


def _alone(read: OneRecording) -> OneRecording:
    """The person seen longest in one recording, and those seen while that one is not."""
    people = read.people
    person = people.choose_person(read.wanted, read.name, read.option)
    others = () if read.wanted is not None else people.successors(person)
    read = _of_rows(read, people.rows_of((person, *others)))
    if not others:
        return read
    return _told(
        read,
        f"{read.name}: {_named(others)} counts as the person {person!r}, as both are never seen together. "
        f"{read.option} {person} follows {person!r} alone.",
    )


def _of_rows(read: OneRecording, rows: NDArray[np.int64]) -> OneRecording:
    """The same, with these skeletons as the person."""
    return replace(read, person=read.people.view_of(rows), others=read.people.without(rows))


def _told(read: OneRecording, line: str) -> OneRecording:
    return replace(read, warnings=[*read.warnings, line])


def _listed(people: RecordedPeople, rows: NDArray[np.int64] | None = None) -> str:
    """The ids of people, or of some skeletons, in the order in which they were seen."""
    of = people.person if rows is None else people.person[rows]
    ids, first = np.unique(of, return_index=True)
    return _named([people.ids[k] for k in ids[np.argsort(first)]])


def _named(ids: Sequence[str]) -> str:
    return ", ".join(map(repr, ids[:5])) + (" …" if len(ids) > 5 else "")
