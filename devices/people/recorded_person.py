"""Whom two recordings are about: the person to fuse, the same one in both, and the others."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from devices.pairing import clock_by_arrival
from devices.people.placement import Placement, moments, placement_of
from devices.people.recorded_people import Follow, OneRecording, RecordedPeople, SeenPerson
from devices.people.room import FAR_M, HOLD_NS, NOBODY, Person, Room, Seen
from devices.people.tracks import Index, Tracks
from fusion.clocks import Clock, median_interval, nearest_of
from fusion.support.large_arrays import give_back

_SEEN_FOR = {"longest": 0.9, "middle": 0.3}
"""Of several people seen for this share of the longest time, the one nearest the middle is followed."""
_OTHERS = 0.05  # of the time of the person followed: those who are seen for less are not counted

Both = tuple[Index, Index]  # of the skeletons of A and of B


def follow_one_person(
    reads: tuple[OneRecording, OneRecording], clock: Clock | None, follow: Follow
) -> tuple[OneRecording, OneRecording, tuple[SeenPerson, ...]]:
    """Chooses the person to fuse, the same one in both.

    It is who both see longest; of several seen about as long, the one nearest the middle; ``middle``: the one
    nearest the middle of those seen a third as long. Who is seen only while that one is not is followed then.

    Args:
        clock: B's on A's. None: found from arrivals, or the motion of the people.

    Returns:
        Both with the person, and who else is seen.
    """
    a, b = people = reads[0].people, reads[1].people
    tracks = Tracks.of(a), Tracks.of(b)
    clock = clock or clock_by_arrival(reads[0].arrivals, reads[1].arrivals)
    ids = reads[0].wanted, reads[1].wanted
    placed = placement_of(*tracks, clock) if a.body is b.body else None
    found = None if placed is None else _followed(tracks, placed, follow, ids)
    give_back()
    crowded = a.crowded or b.crowded
    if found is None:
        rows = [_rows_alone(read, of.track) for read, of in zip(reads, tracks, strict=True)]
        read_a, read_b = (_with_ids_told(_of_rows(*of), of[1]) for of in zip(reads, rows, strict=True))
        if not crowded or None not in ids:
            return read_a, read_b, ()
        line = (
            f"Several people are seen, {_has(reads)}, and their motion does not show who is the same in "
            f"both: those seen longest are followed. {_choose(reads)} the person."
        )
        return replace(read_a, warnings=[*read_a.warnings, line]), read_b, ()
    person, who = found
    rows = [np.flatnonzero(of == person) for of in who]
    read_a, read_b = map(_of_rows, reads, rows)
    every = np.concatenate(who)
    count = np.bincount(every[every >= 0], minlength=person + 1)
    others = [k for k in np.argsort(-count, kind="stable").tolist() if k != person]
    counted = [person, *(k for k in others if count[k] >= _OTHERS * count[person])]
    several = len(counted) > 1
    if not several and not crowded:
        return _with_ids_told(read_a, rows[0]), _with_ids_told(read_b, rows[1]), ()
    names = " and ".join(
        f"{_listed(of, each)} of {side}"
        for of, each, side in zip(people, rows, "AB", strict=True)
        if len(each)
    )
    how_many = f"{len(counted)} people are" if several else "1 person is"
    line = f"{how_many} seen, {_has(reads)}. The one followed is {names}"
    line += f"; {_choose(reads)} another." if None in ids else "."
    if several and follow == "longest" and ids == (None, None):
        line += " That one is seen longest; `follow=middle` follows the one nearest the middle of the views."
    read_a = replace(read_a, warnings=[*read_a.warnings, line])
    return read_a, read_b, tuple(_seen_people(people, who, counted)) if several else ()


def _followed(
    tracks: tuple[Tracks, Tracks], placed: Placement, follow: Follow, ids: tuple[str | None, str | None]
) -> tuple[int, Both] | None:
    """The person to follow, and whose each skeleton is; None if both ids are not of one person."""
    a, b = (of.people for of in tracks)
    index = _moments_of(a, b, placed.time_b)
    who, together = _everyone(*tracks, placed, index)
    if ids != (None, None):
        named = set()
        for of, whose, name in zip(tracks, who, ids, strict=True):
            if name is not None:
                own = np.isin(np.arange(len(whose)), of.people.rows_of([name]))
                named.add(int(np.bincount(whose[own & (whose >= 0)], minlength=1).argmax()))
                if not of.people.crowded:  # only who has the id
                    whose[~own] = -1
        return (named.pop(), who) if len(named) == 1 else None
    if not together.any():
        return None
    angle = sum(_off_axis(of.places, whose, len(together)) for of, whose in zip(tracks, who, strict=True))
    person = int(np.argmin(np.where(together >= _SEEN_FOR[follow] * together.max(), angle, np.inf)))
    both, time_b = index[(index >= 0).all(axis=1)], placed.time_b.copy()
    time_b[both[:, 1]] = a.time_ns[both[:, 0]]  # frames of one moment have one time
    times = a.time_ns[a.frame], time_b[b.frame]
    for other in range(len(together)):  # who is seen longest comes first
        mine, theirs = (
            np.unique(np.concatenate([at[whose == k] for at, whose in zip(times, who, strict=True)]))
            for k in (person, other)
        )
        if np.isin(theirs, mine).any():
            continue
        for at, whose in zip(times, who, strict=True):  # only so long after the person as others wait live
            rows = np.flatnonzero(whose == other)
            if len(rows):
                whose[rows[np.abs(at[rows] - mine[nearest_of(at[rows], mine)]) > HOLD_NS]] = person
    return person, who


def _everyone(a: Tracks, b: Tracks, placed: Placement, index: Index) -> tuple[Both, Index]:
    """Whose each skeleton is, as a :class:`Room` tells people apart, -1 for nobody's; and of each person the
    moments at which both views see them in one place. Who is seen longest comes first."""
    times = np.where(index[:, 0] >= 0, a.people.time_ns[index[:, 0]], placed.time_b[index[:, 1]])
    order = np.argsort(times, kind="stable")
    index, times = index[order], times[order]
    if not (a.people.crowded or b.people.crowded) and _are_in_one_place(a, b, index, placed):
        return (np.minimum(a.track, 0), np.minimum(b.track, 0)), np.array([len(index)])
    room, people = Room(a.people.body), dict[Person, int]()
    who = np.full(len(a.track), -1), np.full(len(b.track), -1)
    views = [_frames(of, numbers) for of, numbers in zip((a, b), index.T, strict=True)]
    for time_ns, *seen in zip(times.tolist(), *views, strict=True):
        room.observe(time_ns, seen, placed.a_from_b)
        for person in room.people:
            for view, k in enumerate(person.now):
                if k is not None:
                    who[view][seen[view].names[k]] = people.setdefault(person, len(people))
    number, together = np.zeros(len(people) + 1, np.int64), np.zeros(len(people), np.int64)
    for person, k in people.items():
        while person.into is not None:
            person = person.into
        number[k] = people[person]
        together[number[k]] = person.together
    number[-1] = -1
    count = np.bincount(number[np.concatenate(who)] + 1, minlength=len(people) + 1)[1:]
    longest = np.argsort(-count, kind="stable")
    number[:-1] = np.argsort(longest)[number[:-1]]
    return (number[who[0]], number[who[1]]), together[longest]


def _moments_of(a: RecordedPeople, b: RecordedPeople, time_b: Index) -> Index:
    """(M, 2) frames of A and of B that are of one moment; -1 where one has none with somebody in it."""
    frames, others = moments(a.frame, b.frame, a.time_ns, time_b, None)
    others, first = np.unique(others, return_index=True)
    frames = frames[first]
    index = [np.stack((frames, others), axis=1)]
    for view, (of, used) in enumerate(((a, frames), (b, others))):
        rest = np.setdiff1d(of.frame, used)
        alone = np.full((len(rest), 2), -1, dtype=np.int64)
        alone[:, view] = rest
        index.append(alone)
    return np.concatenate(index)


def _are_in_one_place(a: Tracks, b: Tracks, index: Index, placed: Placement) -> bool:
    """Whether the only bodies of both views are in one place at all times."""
    both = index[(index >= 0).all(axis=1)]
    p, q = (
        of.places[np.searchsorted(of.people.frame, rows)] for of, rows in zip((a, b), both.T, strict=True)
    )
    return not bool((np.linalg.norm(p - placed.a_from_b.apply(q), axis=1) > FAR_M).any())


def _frames(of: Tracks, frames: Index) -> Iterator[Seen]:
    """What a view sees in each of these frames, -1 for none; a body's name is its row."""
    track, doubtful, places = of.track.tolist(), of.doubtful.tolist(), of.places.tolist()
    joints = of.people.skeletons.positions
    first, end = (np.searchsorted(of.people.frame, frames, side).tolist() for side in ("left", "right"))
    for k, begin, stop in zip(frames.tolist(), first, end, strict=True):
        rows = [row for row in range(begin, stop) if track[row] >= 0] if k >= 0 else []
        each = [[of[row] for row in rows] for of in (joints, track, doubtful, places)] if rows else ()
        yield Seen(rows, *each) if each else NOBODY


def _off_axis(places: np.ndarray, whose: Index, people: int) -> np.ndarray:
    """(K,) the mean angle between each person and the axis of a view, radians."""
    bearing = np.abs(np.arctan2(places[:, 0], places[:, 2]))
    known = (whose >= 0) & np.isfinite(bearing)
    count = np.bincount(whose[known], minlength=people)
    return np.bincount(whose[known], bearing[known], people) / np.maximum(count, 1)


def _seen_people(
    people: tuple[RecordedPeople, RecordedPeople], who: Both, counted: list[int]
) -> Iterator[SeenPerson]:
    """Who counts: by which id in either recording, and for how long."""
    ids = [
        np.array([np.bincount(of.person[whose == k], minlength=len(of.ids)) for k in counted])
        for of, whose in zip(people, who, strict=True)
    ]
    for k in range(len(counted)):
        names: list[str | None] = []
        seconds: list[float] = []
        for of, counts in zip(people, ids, strict=True):
            own = counts[k] > np.delete(counts, k, axis=0).max(axis=0, initial=0)
            names.append(of.ids[int(np.argmax(counts[k] * own))] if own.any() else None)
            seconds.append(1e-9 * int(counts[k].sum()) * median_interval(of.time_ns))
        yield SeenPerson((names[0], names[1]), (seconds[0], seconds[1]))


def _rows_alone(read: OneRecording, track: Index) -> Index:
    """The person seen longest in one recording, and those seen while that one is not."""
    people = read.people
    if read.wanted is not None:
        return people.rows_of([read.wanted])
    counted = track >= 0
    rows = np.zeros(0, dtype=np.int64)
    for k in np.argsort(-np.bincount(people.person[counted], minlength=len(people.ids)), kind="stable"):
        of = np.flatnonzero(counted & (people.person == k))
        if not np.isin(people.frame[of], people.frame[rows]).any():
            rows = np.sort(np.concatenate((rows, of)))
    return rows


def _with_ids_told(read: OneRecording, rows: Index) -> OneRecording:
    """The same, with a line if the person has several ids."""
    ids, count = np.unique(read.people.person[rows], return_counts=True)
    if len(ids) < 2 or read.wanted is not None:
        return read
    person, *others = (read.people.ids[k] for k in ids[np.argsort(-count, kind="stable")])
    line = (
        f"{read.name}: {_named(others)} counts as the person {person!r}, as both are never seen together. "
        f"{read.option} {person} follows {person!r} alone."
    )
    return replace(read, warnings=[*read.warnings, line])


def _of_rows(read: OneRecording, rows: Index) -> OneRecording:
    """The same, with these skeletons as the person."""
    return replace(read, person=read.people.view_of(rows), others=read.people.without(rows))


def _has(reads: Sequence[OneRecording]) -> str:
    return " and ".join(f"{_listed(of.people)} by {side}" for of, side in zip(reads, "AB", strict=True))


def _choose(reads: Sequence[OneRecording]) -> str:
    options = [read.option for read in reads if read.wanted is None]
    return " and ".join(options) + (" choose" if len(options) > 1 else " chooses")


def _listed(people: RecordedPeople, rows: Index | slice = slice(None)) -> str:
    """The ids of people, or of some skeletons, in the order in which they were seen."""
    ids, first = np.unique(people.person[rows], return_index=True)
    return _named([people.ids[k] for k in ids[np.argsort(first)]])


def _named(ids: Sequence[str]) -> str:
    return ", ".join(map(repr, ids[:5])) + (" …" if len(ids) > 5 else "")
