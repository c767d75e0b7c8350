"""Which skeletons of two recordings are one person, where a sensor sees several people at a time.

A tracker's ids tell it neither within a view, where they are exchanged and lost, nor across views. Within a
view a body is followed by its place (a track). Two tracks are one person where one registration of the
sensors puts them in one place all the time, and with it the others as well. A track that begins after another
ended continues it where no one else can be meant: by place, time and lengths of bones.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator
from dataclasses import dataclass
from itertools import combinations, pairwise, product
from typing import cast

import numpy as np
from numpy.typing import NDArray

from devices.pairing import clock_by_motion, median_interval, nearest_of
from devices.people.recorded_people import Follow, RecordedPeople, SeenPerson
from devices.people.tracks import Tracks, mean_of_joints
from fusion.body import Body
from fusion.calibration.bone_lengths import bone_lengths_of
from fusion.errors import CalibrationError
from fusion.registration.rigid_fit import fit_recording
from fusion.rigid import RigidTransform
from fusion.support.large_arrays import parts
from fusion.support.types import Array

Index = NDArray[np.int64]

_MOMENTS = 300  # at which the registration is looked for
_TRIED = 3  # longest tracks of each view
_FITTED = 24  # moments of one fit
_SAME_M = 0.3  # mean distance of the joints of one person in two views, at most
_SAME_PLACE_M = 0.3  # distance of the centres of one person in two views, at most
_LEAST_FIT, _CLEAR_FIT = 0.2, 0.8  # of the skeletons that can have a partner
_ANOTHER_RAD = 0.3  # registrations that differ by more are not of one kind
_MUTUAL = 0.5  # of the moments that two tracks have in common
_ENOUGH = 15  # such moments; people who pass each other have less
_DIFFERENT_BONES = 0.2  # of a length, median: other people, as a child and a grown-up
_BONE_ERROR = 0.06
_PLACE_M, _WALK_M_S, _ROOM_M = 0.3, 0.7, 2.0
"""People come back this far from where they were last seen: at once, more for each second, and at most."""
_FAR = 4.0  # standard deviations: a farther place tells no more
_SEEN_FOR = {"longest": 0.9, "middle": 0.3}
"""Of several people seen for this share of the longest time, the one nearest the middle is followed."""
_OTHERS = 0.05  # of the time of the person followed: those who are seen for less are not counted


@dataclass(frozen=True, eq=False)
class Followed:
    """One person of two recordings.

    Attributes:
        rows: Their skeletons in either recording, numbers of rows of ``RecordedPeople.skeletons``.
        everyone: Those of all people, this one first, then who are seen longest.
        count: How many of these count: the others are seen for a moment only.
    """

    everyone: list[tuple[Index, Index]]
    count: int

    @property
    def rows(self) -> tuple[Index, Index]:
        return self.everyone[0]

    def people(self, of: tuple[RecordedPeople, RecordedPeople]) -> Iterator[SeenPerson]:
        """Who counts: by which id in either recording, and for how long."""
        of_ids = []
        for view, people in enumerate(of):
            ids = (people.person[rows[view]] for rows in self.everyone)
            of_ids.append(np.array([np.bincount(each, minlength=len(people.ids)) for each in ids]))
        for k, rows in enumerate(self.everyone[: self.count]):
            names: list[str | None] = []
            seconds: list[float] = []
            for people, counts, each in zip(of, of_ids, rows, strict=True):
                own = counts[k] > np.delete(counts, k, axis=0).max(axis=0, initial=0)
                names.append(people.ids[int(np.argmax(counts[k] * own))] if own.any() else None)
                seconds.append(1e-9 * len(each) * median_interval(people.time_ns))
            yield SeenPerson((names[0], names[1]), (seconds[0], seconds[1]))


def follow_one(
    a: RecordedPeople,
    b: RecordedPeople,
    offset_ns: int | Index | None,
    follow: Follow = "longest",
    ids: tuple[str | None, str | None] = (None, None),
) -> Followed | None:
    """The person whom both sensors see longest; of several seen about as long, the one nearest the middle.

    Args:
        offset_ns: Added to the times of B, one or (T,). None: found from the motion of the people.
        follow: ``middle``: the one nearest the middle of those seen a third as long.
        ids: Of the person, in either recording: who has that id most of the time, whatever other ones.

    Returns:
        None if no registration of the sensors makes two people one, or both ids one person.
    """
    tracks = Tracks.of(a), Tracks.of(b)
    best: Registered | None = None
    known = 0 if offset_ns is None else offset_ns
    for offset in (known, *(_by_motion(*tracks) if offset_ns is None else ())):
        found = Registered.best(*tracks, b.time_ns + offset)
        if found is not None and (best is None or found.score > best.score):
            best = found
    return None if best is None else _chosen(*tracks, best, follow, ids)


def _by_motion(a: Tracks, b: Tracks) -> list[Index]:
    """Corrections of B's times with which two of the longest tracks show one motion."""
    found = []
    for i, j in product(a.longest(_TRIED), b.longest(_TRIED)):
        views = (of.people.view_of(of.rows([k])) for of, k in ((a, i), (b, j)))
        seen = [view.chosen_whole(np.flatnonzero(view.states.any(axis=1))) for view in views]
        clock = clock_by_motion(a.people.body, seen[0], seen[1])
        if clock is not None:
            found.append(np.asarray(clock.at(b.people.time_ns), dtype=np.int64))
    return found


def _moments(a: Tracks, b: Tracks, time_b: Index, most: int | None) -> tuple[Index, Index]:
    """Frames of A and of B that are of one moment.

    Args:
        most: The largest number of A's frames that are used. None: all.
    """
    frames = np.unique(a.people.frame)
    if most is not None and len(frames) > most:
        frames = frames[np.linspace(0, len(frames) - 1, most).astype(np.int64)]
    others = np.unique(b.people.frame)
    if not len(frames) or not len(others):
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    times, at = a.people.time_ns[frames], time_b[others]
    nearest = nearest_of(times, at)
    tolerance = max(median_interval(a.people.time_ns), median_interval(b.people.time_ns))
    near = np.abs(at[nearest] - times) <= tolerance
    return frames[near], others[nearest[near]]


def _meetings(a: Tracks, b: Tracks, frames: Index, others: Index) -> tuple[Index, Index]:
    """Rows of A and of B that are of one moment: each skeleton of A with each of B."""
    first_a, end_a = (np.searchsorted(a.people.frame, frames, side) for side in ("left", "right"))
    first_b, end_b = (np.searchsorted(b.people.frame, others, side) for side in ("left", "right"))
    rows_a, rows_b = [], []
    most = [int((end - first).max(initial=0)) for first, end in ((first_a, end_a), (first_b, end_b))]
    for i, j in product(*(range(n) for n in most)):
        both = (first_a + i < end_a) & (first_b + j < end_b)
        rows_a.append(first_a[both] + i)
        rows_b.append(first_b[both] + j)
    every_a, every_b = (np.concatenate(rows) if rows else np.zeros(0, np.int64) for rows in (rows_a, rows_b))
    counts = (a.track[every_a] >= 0) & (b.track[every_b] >= 0)
    return every_a[counts], every_b[counts]


@dataclass(frozen=True, eq=False)
class Registered:
    """A registration of the sensors, B's corrected times, and how many skeletons it puts in one place."""

    a_from_b: RigidTransform
    time_b: Index
    score: float
    next_score: float  # of the best other one that was tried; the score where one was enough
    most: int  # skeletons that can have a partner

    @staticmethod
    def best(a: Tracks, b: Tracks, time_b: Index) -> Registered | None:
        """As :meth:`search`, at once, until one is clearly right."""
        search = Registered.search(a, b, time_b, _CLEAR_FIT)
        while True:
            try:
                next(search)
            except StopIteration as end:
                return cast("Registered | None", end.value)

    @staticmethod
    def search(
        a: Tracks, b: Tracks, time_b: Index, clear: float = np.inf
    ) -> Generator[None, None, Registered | None]:
        """The registration that puts the most skeletons of both views in one place; yields after each fit.

        It is fitted to two tracks that are often seen together, then to all skeletons that are in one place.
        None if no registration puts a fifth of the skeletons in one place.

        Args:
            clear: The share of the skeletons in one place at which no other registration is tried.
        """
        body = a.people.body
        rows_a, rows_b = _meetings(a, b, *_moments(a, b, time_b, _MOMENTS))
        if not len(rows_a):
            return None
        p, q = a.at(rows_a), b.at(rows_b)
        mirrored = q[:, body.mirror]
        most_of_all = min(len(np.unique(rows_a)), len(np.unique(rows_b)))
        tried: list[tuple[float, RigidTransform]] = [(_LEAST_FIT * most_of_all, RigidTransform.identity())]
        pairs, counts = np.unique(np.stack((a.track[rows_a], b.track[rows_b])), axis=1, return_counts=True)
        for k in np.argsort(-counts, kind="stable")[: _TRIED * _TRIED]:
            if max(of for of, _ in tried) > clear * most_of_all:
                break
            of = np.flatnonzero((a.track[rows_a] == pairs[0, k]) & (b.track[rows_b] == pairs[1, k]))
            of = of[np.linspace(0, len(of) - 1, min(_FITTED, len(of))).astype(np.int64)]
            for seen in (q, mirrored):
                found = _fit(p[of], seen[of])
                for _ in range(3):  # then of all who are in one place
                    yield
                    if found is None:
                        break
                    same, exchanged = _sameness(found, p, q), _sameness(found, p, mirrored)
                    fits = np.maximum(same, exchanged)
                    most = np.zeros(len(a.track))
                    np.maximum.at(most, rows_a, fits)
                    tried.append((float(most.sum()), found))
                    of = np.flatnonzero((fits > 0.0) & (fits == most[rows_a]))
                    of = of[np.linspace(0, len(of) - 1, min(2 * _FITTED, len(of))).astype(np.int64)]
                    turned = (exchanged > same)[of, None, None]
                    found = _fit(p[of], np.where(turned, mirrored[of], q[of]))
        score, best = max(tried, key=lambda each: each[0])
        if best is tried[0][1]:
            return None
        others = [of for of, a_from_b in tried if a_from_b.angle_to(best) > _ANOTHER_RAD]
        return Registered(best, time_b, score, max(others, default=0.0), most_of_all)


def _fit(p: Array, q: Array) -> RigidTransform | None:
    try:
        return fit_recording(p, q)
    except CalibrationError:
        return None


def _sameness(a_from_b: RigidTransform, p: Array, q: Array) -> Array:
    """(n,) for each pair of skeletons: 1 if they are in one place, 0 if they cannot be one person."""
    apart = np.minimum(np.linalg.norm(p - a_from_b.apply(q), axis=2), 2.0 * _SAME_M)
    mean = mean_of_joints(apart[:, :, None])[:, 0]
    return np.asarray(np.maximum(0.0, 1.0 - (np.nan_to_num(mean, nan=np.inf) / _SAME_M) ** 2))


def _chosen(
    a: Tracks, b: Tracks, found: Registered, follow: Follow, ids: tuple[str | None, str | None]
) -> Followed | None:
    """The person to follow, of those whom the registration makes out of the tracks."""
    together, mutual = _in_one_place(a, b, found)
    size = len(a.count) + len(b.count)
    of_a, of_b = np.arange(len(a.count)), len(a.count) + np.arange(len(b.count))
    begin, end = np.zeros((2, size), dtype=np.int64)
    apart = np.zeros((size, size), dtype=np.bool_)  # whether two tracks cannot be one person
    for of, tracks, times in ((of_a, a, a.people.time_ns), (of_b, b, found.time_b)):
        first, last = tracks.spans()
        begin[of], end[of] = times[first], times[last]
        overlap = np.minimum(last[:, None], last) - np.maximum(first[:, None], first)
        apart[np.ix_(of, of)] = (overlap > 0) & ~np.eye(len(of), dtype=np.bool_)
    agree = mutual >= _MUTUAL * together
    enough = np.minimum(_ENOUGH, 0.5 * np.minimum(a.count[:, None], b.count))
    one = agree & (mutual >= enough)
    apart[: len(of_a), len(of_a) :] = (together > 2) & ~agree
    apart |= apart.T
    groups = _Groups(apart)
    for k in np.argsort(-mutual, axis=None, kind="stable"):
        i, j = divmod(int(k), mutual.shape[1])
        if one[i, j]:
            groups.join(i, len(of_a) + j)
    _join_returning(groups, a, b, found.a_from_b, begin, end)
    everyone = groups.members()
    seen = np.array([mutual[np.ix_(*_of_views(m, len(of_a)))].sum() for m in everyone])
    if not seen.max(initial=0):
        return None
    rows_of = [
        tuple(of.rows(m) for of, m in zip((a, b), _of_views(m, len(of_a)), strict=True)) for m in everyone
    ]
    if ids != (None, None):
        named = set()
        for view, (tracks, name) in enumerate(zip((a, b), ids, strict=True)):
            if name is not None:
                rows = tracks.people.rows_of([name])
                counts = [np.isin(each[view], rows).sum() for each in rows_of]
                named.add(int(np.argmax(counts)) if any(counts) else -1)
        if len(named) > 1 or -1 in named:
            return None
        followed = named.pop()
    else:
        off_axis = np.full(len(everyone), np.inf)
        for k in np.flatnonzero(seen >= _SEEN_FOR[follow] * seen.max()):
            off_axis[k] = sum(_off_axis(of, of_view) for of, of_view in zip((a, b), rows_of[k], strict=True))
        followed = int(np.argmin(off_axis))
    count = [sum(map(len, of_person)) for of_person in rows_of]
    others = [k for k in np.argsort(count)[::-1].tolist() if k != followed]
    counted = sum(count[k] >= _OTHERS * count[followed] for k in others)
    return Followed([(rows_of[k][0], rows_of[k][1]) for k in (followed, *others)], 1 + counted)


def _of_views(members: list[int], count_a: int) -> tuple[list[int], list[int]]:
    return [m for m in members if m < count_a], [m - count_a for m in members if m >= count_a]


def _in_one_place(a: Tracks, b: Tracks, found: Registered) -> tuple[Index, Index]:
    """(M_A, M_B) number of moments at which two tracks are seen together, and are each other's nearest."""
    at_a, at_b = (of.centres(np.arange(len(of.track))) for of in (a, b))
    at_b = found.a_from_b.apply(at_b)
    nearest_a, nearest_b = np.full(len(at_a), np.inf), np.full(len(at_b), np.inf)
    shape = len(a.count), len(b.count)
    together, one = np.zeros(shape, np.int64), np.zeros(shape, np.int64)
    frames, others = _moments(a, b, found.time_b, None)
    for find in (True, False):  # first the nearest of each
        for part in parts(len(frames)):
            rows_a, rows_b = _meetings(a, b, frames[part], others[part])
            apart = np.linalg.norm(at_a[rows_a] - at_b[rows_b], axis=1)
            if find:
                np.fmin.at(nearest_a, rows_a, apart)
                np.fmin.at(nearest_b, rows_b, apart)
                continue
            mutual = (apart <= nearest_a[rows_a]) & (apart <= nearest_b[rows_b]) & (apart < _SAME_PLACE_M)
            np.add.at(together, (a.track[rows_a], b.track[rows_b]), 1)
            np.add.at(one, (a.track[rows_a], b.track[rows_b]), mutual.astype(np.int64))
    return together, one


class _Groups:
    """Tracks that are one person each."""

    def __init__(self, apart: NDArray[np.bool_]) -> None:
        self._apart = apart
        self._of = np.arange(len(apart))

    def may_join(self, i: int, j: int) -> bool:
        one, other = self._of == self._of[i], self._of == self._of[j]
        return bool(self._of[i] != self._of[j]) and not self._apart[np.ix_(one, other)].any()

    def join(self, i: int, j: int) -> None:
        if self.may_join(i, j):
            self._of[self._of == self._of[j]] = self._of[i]

    def members(self) -> list[list[int]]:
        return [np.flatnonzero(self._of == k).tolist() for k in np.unique(self._of)]


def _join_returning(
    groups: _Groups, a: Tracks, b: Tracks, a_from_b: RigidTransform, begin: Index, end: Index
) -> None:
    """Joins people who left and came back. Those most alike in bones, place and time are joined first."""
    body, count_a = a.people.body, len(a.count)

    def of_track(m: int) -> tuple[Array, Array, Array]:
        tracks, k = (a, m) if m < count_a else (b, m - count_a)
        rows = tracks.rows([k])
        ends = tracks.centres(rows[[0, -1]])
        if m >= count_a:
            ends = a_from_b.apply(ends)
        some = rows[np.linspace(0, len(rows) - 1, min(_FITTED, len(rows))).astype(np.int64)]
        return bones_of(body, tracks.at(some)), ends[0], ends[1]

    known = [of_track(m) for m in range(len(begin))]
    of_view = np.arange(len(begin)) < count_a
    cost = np.full((len(begin), len(begin)), np.inf)  # of track i that goes on as track j
    for i, j in zip(*np.nonzero(end[:, None] <= begin), strict=True):
        bones = differing(known[i][0], known[j][0]) if of_view[i] == of_view[j] else np.nan
        far = float(np.linalg.norm(known[i][2] - known[j][1]))
        cost[i, j] = cost_of_return(bones, far, 1e-9 * float(begin[j] - end[i]))

    def of_groups(one: list[int], other: list[int]) -> float:
        if not groups.may_join(one[0], other[0]):
            return np.inf
        views: list[float] = []
        for view in (True, False):
            tracks = [m for m in (*one, *other) if of_view[m] == view]
            views += _changeovers(cost, begin, tracks, set(one))
        views = views or _changeovers(cost, begin, [*one, *other], set(one))
        return float(np.mean(views)) if views else np.inf

    members = groups.members()
    costs = {(k, n): of_groups(members[k], members[n]) for k, n in combinations(range(len(members)), 2)}
    while costs:
        k, n = min(costs, key=costs.__getitem__)
        if costs[k, n] == np.inf:
            break
        groups.join(members[k][0], members[n][0])
        members[k] = sorted(members[k] + members[n])
        costs = {pair: value for pair, value in costs.items() if n not in pair}
        for pair in costs:
            if k in pair:
                costs[pair] = of_groups(members[pair[0]], members[pair[1]])


def differing(one: Array, other: Array) -> float:
    """The median difference of the lengths of two people's bones, as a share; NaN if unknown."""
    ratio = np.abs(one / other - 1.0)
    ratio = ratio[np.isfinite(ratio)]
    return float(np.median(ratio)) if len(ratio) else np.nan


def cost_of_return(bones: float, far: float, seconds: float) -> float:
    """How unlike one person two are, of whom one was seen last and the other is seen so many seconds later.

    Infinite for other people.

    Args:
        bones: As of :func:`differing`.
        far: Metres between the places; NaN where unknown.
    """
    if bones > _DIFFERENT_BONES:
        return np.inf
    bones = _BONE_ERROR if np.isnan(bones) else bones
    sd = min(_PLACE_M + _WALK_M_S * seconds, _ROOM_M)
    place = _FAR if np.isnan(far) else min(far / sd, _FAR)
    # errors of the bones, and of a place on the floor
    return float(0.5 * (bones / _BONE_ERROR) ** 2 + 0.5 * place**2 + 2.0 * np.log(sd))


def _changeovers(cost: Array, begin: Index, tracks: list[int], one: set[int]) -> list[float]:
    """The mean cost of the changes from one group's tracks to the other's; empty if there is none."""
    in_order = sorted(tracks, key=lambda m: int(begin[m]))
    changes = [cost[i, j] for i, j in pairwise(in_order) if (i in one) != (j in one)]
    return [float(np.mean(changes))] if changes else []


def bones_of(body: Body, positions: NDArray[np.floating]) -> Array:
    """(J,) metres, medians of the lengths of the bones; NaN of those not seen."""
    lengths = bone_lengths_of(body, positions)
    lengths[lengths == 0.0] = np.nan
    if len(lengths) == 1:
        return np.asarray(lengths[0])
    known = np.isfinite(lengths).any(axis=0)
    medians = np.full(len(body), np.nan)
    medians[known] = np.nanmedian(lengths[:, known], axis=0)
    return medians


def _off_axis(tracks: Tracks, rows: Index) -> float:
    """The mean angle between a person and the axis of the view, radians; 0 if the place is unknown."""
    at = tracks.centres(rows)
    bearing = np.abs(np.arctan2(at[:, 0], at[:, 2]))
    return float(np.nanmean(bearing)) if np.isfinite(bearing).any() else 0.0
