"""Whom two recordings are about: the person to fuse, the same one in both, and the others."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from devices.pairing import clock_by_arrival, median_interval, nearest_of
from devices.people.placement import Placement, moments, placement_of
from devices.people.recorded_people import Follow, OneRecording, RecordedPeople, SeenPerson
from devices.people.room import FAR_M, HOLD_NS, NOBODY, Person, Room, Seen
from devices.people.tracks import Index, Tracks
from fusion.clocks import Clock
from fusion.rigid import RigidTransform
from fusion.support.large_arrays import give_back

_SEEN_FOR = {"longest": 0.9, "middle": 0.3}
"""Of several people seen for this share of the longest time, the one nearest the middle is followed."""
_OTHERS = 0.05  # of the time of the person followed: those who are seen for less are not counted


@dataclass(eq=False)
class _Someone:
    """Somebody in two recordings."""

    rows: tuple[Index, Index]  # their skeletons in either, numbers of rows
    times: tuple[Index, Index]  # of these
    together: int  # moments at which both see them in one place

    @property
    def count(self) -> int:
        return len(self.rows[0]) + len(self.rows[1])

    @property
    def sights(self) -> Index:
        return np.unique(np.concatenate(self.times))

    def then(self, other: _Someone) -> _Someone:
        """Who is this person, or the other one."""
        rows, times = (
            tuple(
                np.concatenate(both) for both in zip(getattr(self, name), getattr(other, name), strict=True)
            )
            for name in ("rows", "times")
        )
        return _Someone((rows[0], rows[1]), (times[0], times[1]), self.together + other.together)

    def long_after(self, sights: Index) -> _Someone:
        """Who is seen only when somebody is out of sight for so long that another one is followed."""
        away = [
            np.abs(times - sights[nearest_of(times, sights)]) > HOLD_NS if len(times) else times == 0
            for times in self.times
        ]
        rows, times = (
            [of[kept] for of, kept in zip(each, away, strict=True)] for each in (self.rows, self.times)
        )
        return _Someone((rows[0], rows[1]), (times[0], times[1]), self.together)


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
    a, b = (read.people for read in reads)
    tracks = Tracks.of(a), Tracks.of(b)
    clock = clock or clock_by_arrival(reads[0].arrivals, reads[1].arrivals)
    ids = reads[0].wanted, reads[1].wanted
    placed = placement_of(*tracks, clock) if a.body is b.body else None
    found = None if placed is None else _followed(tracks, placed, follow, ids)
    give_back()
    if found is None:
        read_a, read_b = (_alone(read, of) for read, of in zip(reads, tracks, strict=True))
        if not (a.crowded or b.crowded) or None not in ids:
            return read_a, read_b, ()
        line = (
            f"Several people are seen, {_has(reads)}, and their motion does not show who is the same in "
            f"both: those seen longest are followed. {_choose(reads)} the person."
        )
        return replace(read_a, warnings=[*read_a.warnings, line]), read_b, ()
    read_a, read_b = (_of_rows(read, rows) for read, rows in zip(reads, found[0].rows, strict=True))
    counted = [of for k, of in enumerate(found) if not k or of.count >= _OTHERS * found[0].count]
    several = len(counted) > 1
    if several or a.crowded or b.crowded:
        names = " and ".join(
            f"{_listed(read.people, rows)} of {side}"
            for read, rows, side in zip(reads, found[0].rows, "AB", strict=True)
            if len(rows)
        )
        count = f"{len(counted)} people are" if several else "1 person is"
        line = f"{count} seen, {_has(reads)}. The one followed is {names}"
        line += f"; {_choose(reads)} another." if None in ids else "."
        if several and follow == "longest" and ids == (None, None):
            line += (
                " That one is seen longest; `follow=middle` follows the one nearest the middle of the views."
            )
        read_a = replace(read_a, warnings=[*read_a.warnings, line])
    else:
        read_a, read_b = (
            _with_ids_told(read, rows) for read, rows in zip((read_a, read_b), found[0].rows, strict=True)
        )
    return read_a, read_b, tuple(_seen_people((a, b), counted)) if several else ()


def _followed(
    tracks: tuple[Tracks, Tracks], placed: Placement, follow: Follow, ids: tuple[str | None, str | None]
) -> list[_Someone] | None:
    """Everybody in two recordings, the person to follow first; None if both ids are not of one person."""
    everyone = _everyone(*tracks, placed)
    if ids != (None, None):
        named, alone = set(), []
        for view, (of, name) in enumerate(zip(tracks, ids, strict=True)):
            if name is not None:
                rows = of.people.rows_of([name])
                named.add(int(np.argmax([np.isin(each.rows[view], rows).sum() for each in everyone])))
        if len(named) > 1:
            return None
        person = everyone.pop(named.pop())
        for of, name, rows, times in zip(tracks, ids, person.rows, person.times, strict=True):
            own = np.isin(rows, of.people.rows_of([name])) if name is not None else np.ones(len(rows), bool)
            alone.append((rows[own], times[own]) if not of.people.crowded else (rows, times))
        rows, times = zip(*alone, strict=True)
        return [_Someone(rows, times, person.together), *everyone]
    seen = np.array([each.together for each in everyone])
    if not seen.any():
        return None
    angle = [_off_axis(tracks, each) for each in everyone]
    person = everyone.pop(int(np.argmin(np.where(seen >= _SEEN_FOR[follow] * seen.max(), angle, np.inf))))
    others = []
    for other in everyone:  # who is seen longest comes first
        if np.isin(other.sights, person.sights).any():
            others.append(other)
        else:
            person = person.then(other.long_after(person.sights))
    return [person, *others]


def _everyone(a: Tracks, b: Tracks, placed: Placement) -> list[_Someone]:
    """The people of two recordings, as a :class:`Room` tells them apart; who is seen longest comes first."""
    index = _moments_of(a.people, b.people, placed.time_b)
    times = np.where(index[:, 0] >= 0, a.people.time_ns[index[:, 0]], placed.time_b[index[:, 1]])
    order = np.argsort(times, kind="stable")
    index, times = index[order], times[order]
    if not (a.people.crowded or b.people.crowded) and _in_one_place(a, b, index, placed.a_from_b):
        rows = [np.flatnonzero(of.track >= 0) for of in (a, b)]
        at = a.people.time_ns[a.people.frame[rows[0]]], placed.time_b[b.people.frame[rows[1]]]
        return [_Someone((rows[0], rows[1]), at, len(index))]
    room, found = Room(a.people.body), dict[Person, list[tuple[int, int, int]]]()
    views = [_frames(of, numbers) for of, numbers in zip((a, b), index.T, strict=True)]
    for time_ns, *seen in zip(times.tolist(), *views, strict=True):
        room.observe(time_ns, seen, placed.a_from_b)
        for person in room.people:
            for view, k in enumerate(person.now):
                if k is not None:
                    found.setdefault(person, []).append((view, seen[view].names[k], time_ns))
    people: dict[Person, _Someone] = {}
    for person, bodies in found.items():
        view, row, at = np.array(bodies, dtype=np.int64).T
        in_a = view == 0
        now = _Someone((row[in_a], row[~in_a]), (at[in_a], at[~in_a]), person.together)
        while person.into is not None:
            person = person.into
        people[person] = people[person].then(now) if person in people else now
    return sorted(people.values(), key=lambda each: -each.count)


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


def _in_one_place(a: Tracks, b: Tracks, index: Index, a_from_b: RigidTransform) -> bool:
    """Whether the only bodies of both views are in one place at all times."""
    both = index[(index >= 0).all(axis=1)]
    at = [
        of.centres()[np.searchsorted(of.people.frame, frames)]
        for of, frames in zip((a, b), both.T, strict=True)
    ]
    return not bool((np.linalg.norm(at[0] - a_from_b.apply(at[1]), axis=1) > FAR_M).any())


def _frames(of: Tracks, frames: Index) -> Iterator[Seen]:
    """What a view sees in each of these frames, -1 for none; a body's name is its row."""
    track, doubtful, places = of.track.tolist(), of.doubtful.tolist(), of.centres().tolist()
    joints = of.people.skeletons.positions
    first, end = (np.searchsorted(of.people.frame, frames, side).tolist() for side in ("left", "right"))
    for k, begin, stop in zip(frames.tolist(), first, end, strict=True):
        rows = [row for row in range(begin, stop) if track[row] >= 0] if k >= 0 else ()
        if not rows:
            yield NOBODY
            continue
        yield Seen(
            rows,
            [joints[row] for row in rows],
            *([each[row] for row in rows] for each in (track, doubtful, places)),
        )


def _off_axis(tracks: tuple[Tracks, Tracks], person: _Someone) -> float:
    """The mean angles between somebody and the axes of the views, radians."""
    angle = 0.0
    for of, rows in zip(tracks, person.rows, strict=True):
        at = of.centres()[rows]
        bearing = np.abs(np.arctan2(at[:, 0], at[:, 2]))
        angle += float(np.nanmean(bearing)) if np.isfinite(bearing).any() else 0.0
    return angle


def _seen_people(of: tuple[RecordedPeople, RecordedPeople], counted: list[_Someone]) -> Iterator[SeenPerson]:
    """Who counts: by which id in either recording, and for how long."""
    ids = [
        np.array([np.bincount(people.person[each.rows[view]], minlength=len(people.ids)) for each in counted])
        for view, people in enumerate(of)
    ]
    for k, each in enumerate(counted):
        names: list[str | None] = []
        seconds: list[float] = []
        for people, counts, rows in zip(of, ids, each.rows, strict=True):
            own = counts[k] > np.delete(counts, k, axis=0).max(axis=0, initial=0)
            names.append(people.ids[int(np.argmax(counts[k] * own))] if own.any() else None)
            seconds.append(1e-9 * len(rows) * median_interval(people.time_ns))
        yield SeenPerson((names[0], names[1]), (seconds[0], seconds[1]))


def _alone(read: OneRecording, tracks: Tracks) -> OneRecording:
    """The person seen longest in one recording, and those seen while that one is not."""
    people = read.people
    if read.wanted is not None:
        return _of_rows(read, people.rows_of([read.wanted]))
    counted = tracks.track >= 0
    rows = np.zeros(0, dtype=np.int64)
    for k in np.argsort(-np.bincount(people.person[counted], minlength=len(people.ids)), kind="stable"):
        of = np.flatnonzero(counted & (people.person == k))
        if not np.isin(people.frame[of], people.frame[rows]).any():
            rows = np.sort(np.concatenate((rows, of)))
    return _with_ids_told(_of_rows(read, rows), rows)


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


def _listed(people: RecordedPeople, rows: Index | None = None) -> str:
    """The ids of people, or of some skeletons, in the order in which they were seen."""
    of = people.person if rows is None else people.person[rows]
    ids, first = np.unique(of, return_index=True)
    return _named([people.ids[k] for k in ids[np.argsort(first)]])


def _named(ids: Sequence[str]) -> str:
    return ", ".join(map(repr, ids[:5])) + (" …" if len(ids) > 5 else "")
