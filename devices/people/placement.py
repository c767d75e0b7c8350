"""Where two sensors stand to each other, by the people whom both see.

Within a view a body is followed by its place (a track), whatever ids a tracker gives it. The registration is
right that puts the most skeletons of both views in one place, all the time.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from devices.pairing import clock_by_motion
from devices.people.tracks import Index, Tracks
from fusion.body import Body
from fusion.calibration.person_size import ANOTHER_SIZE, sizes_of
from fusion.clocks import Clock, median_interval, nearest_of
from fusion.errors import CalibrationError
from fusion.registration.rigid_fit import fit_recording, fit_rigid
from fusion.rigid import RigidTransform
from fusion.skeleton import TRACKED
from fusion.support.types import Array

_MOMENTS = 300  # at which the registration is looked for
_TRIED = 3  # longest tracks of each view
_FITTED = 24  # moments of one fit
SAME_M = 0.3  # mean distance of the joints of one person in two views, at most
_AGREE = 2.0  # times the mean distance of those who agree best: a pair of people that is farther off
_LEAST_FIT = 0.2  # of the skeletons that can have a partner
_ANOTHER_RAD = 0.3  # registrations that differ by more are not of one kind
_FEWEST_JOINTS = 5
_MOVED_M, _LEFT = 0.1, 0.1
"""Least rms movement; largest share of its variance that one placement of the sensors leaves unexplained."""


@dataclass(frozen=True, eq=False)
class Placement:
    """A registration of the sensors, B's corrected times, and how well it puts skeletons in one place."""

    a_from_b: RigidTransform
    time_b: Index
    fit: float  # share of the skeletons that can have a partner: those in one place
    lead: float  # over another registration, as such a share
    middle: Array  # (3,) metres, of the people, in K_B's frame

    def differs_from(self, a_from_b: RigidTransform) -> bool:
        """Whether a registration is of another kind: it puts the people elsewhere, or turns them."""
        off = np.linalg.norm(self.a_from_b.apply(self.middle) - a_from_b.apply(self.middle))
        return bool(off > SAME_M or self.a_from_b.angle_to(a_from_b) > _ANOTHER_RAD)


def placement_of(a: Tracks, b: Tracks, clock: Clock | None) -> Placement | None:
    """The placement in which the people of two recordings agree; None if there is none.

    Args:
        clock: B's on A's. None: found from the motion of the people.
    """
    found: Placement | None = None
    for each in (Clock(), *_by_motion(a, b)) if clock is None else (clock,):
        search = search_placement(a, b, b.people.time_ns + each.at(b.people.time_ns))
        while True:
            try:
                next(search)
            except StopIteration as end:
                now: Placement | None = end.value
                break
        if now is not None and (found is None or now.fit > found.fit):
            found = now
    return found


def search_placement(a: Tracks, b: Tracks, time_b: Index) -> Generator[None, None, Placement | None]:
    """The registration that puts the most skeletons of both views in one place; yields after each fit.

    It is fitted to two tracks that are often seen together, then to all skeletons that are in one place. Of
    several that do so about as often, the one in which they agree best is right: a mirror image or somebody
    else who stands still is farther off.
    """
    body = a.people.body
    rows_a, rows_b = _meetings(a, b, *moments(a.people.frame, b.people.frame, a.people.time_ns, time_b))
    if not len(rows_a):
        return None
    p, q = a.at(rows_a), b.at(rows_b)
    mirrored = q[:, body.mirror]
    most_of_all = min(len(np.unique(rows_a)), len(np.unique(rows_b)))
    tried: list[tuple[RigidTransform, Array]] = []
    pairs, counts = np.unique(np.stack((a.track[rows_a], b.track[rows_b])), axis=1, return_counts=True)
    for k in np.argsort(-counts, kind="stable")[: _TRIED * _TRIED]:
        of = np.flatnonzero((a.track[rows_a] == pairs[0, k]) & (b.track[rows_b] == pairs[1, k]))
        of = of[np.linspace(0, len(of) - 1, min(_FITTED, len(of))).astype(np.int64)]
        for seen in (q, mirrored):
            found = _fit(p[of], seen[of])
            for _ in range(3):  # then of all who are in one place
                yield
                if found is None:
                    break
                apart, exchanged = (_apart(found, p, each) for each in (q, mirrored))
                least = np.full(len(a.track), SAME_M)
                np.minimum.at(least, rows_a, np.minimum(apart, exchanged))
                tried.append((found, least[np.unique(rows_a)]))
                of = np.flatnonzero(np.minimum(apart, exchanged) <= np.minimum(least[rows_a], SAME_M))
                of = of[np.linspace(0, len(of) - 1, min(2 * _FITTED, len(of))).astype(np.int64)]
                turned = (exchanged < apart)[of, None, None]
                found = _fit(p[of], np.where(turned, mirrored[of], q[of]))
    fits = np.array([_score(apart, SAME_M) for _, apart in tried]) / most_of_all
    if not len(fits) or fits.max() < _LEAST_FIT:
        return None
    often = np.flatnonzero(fits > 0.5 * fits.max())
    agreeing = min(float(np.median(tried[k][1][tried[k][1] < SAME_M])) for k in often)
    scores = np.array([_score(apart, min(SAME_M, _AGREE * agreeing)) for _, apart in tried]) / most_of_all
    k = int(np.argmax(scores))
    now = Placement(tried[k][0], time_b, float(fits[k]), float(scores[k]), np.nanmean(q, axis=(0, 1)))
    others = [of for of, (found, _) in zip(scores, tried, strict=True) if now.differs_from(found)]
    return replace(now, lead=now.lead - max(others, default=0.0))


def moments(
    frame_a: Index, frame_b: Index, time_a: Index, time_b: Index, most: int | None = _MOMENTS
) -> tuple[Index, Index]:
    """Frames of A and of B with somebody in them that are of one moment.

    Args:
        most: The largest number of A's frames that are used. None: all.
    """
    frames, others = np.unique(frame_a), np.unique(frame_b)
    if most is not None and len(frames) > most:
        frames = frames[np.linspace(0, len(frames) - 1, most).astype(np.int64)]
    if not len(frames) or not len(others):
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    times, at = time_a[frames], time_b[others]
    nearest = nearest_of(times, at)
    near = np.abs(at[nearest] - times) <= max(median_interval(time_a), median_interval(time_b))
    return frames[near], others[nearest[near]]


def one_movement(body: Body, p: Array, q: Array) -> RigidTransform | None:
    """The placement of the sensors that makes one movement of two views' joints; None if none does.

    Left and right may be exchanged in some frames, as by a tracker that takes a back for a front.

    Args:
        p, q: (T, J, 3) metres in each sensor's frame; NaN where unknown.
    """
    exchanged = q[:, body.mirror]
    known = np.isfinite(p + q + exchanged).all(axis=(0, 2))  # throughout
    if known.sum() < _FEWEST_JOINTS or abs(np.median(sizes(body, p) - sizes(body, q))) > ANOTHER_SIZE:
        return None
    p, q, exchanged = p[:, known], q[:, known], exchanged[:, known]
    try:
        found = fit_rigid(p.reshape(-1, 3), q.reshape(-1, 3))
        turned = np.flatnonzero(_apart(found, p, exchanged) < _apart(found, p, q))
        q[turned] = exchanged[turned]
        found = fit_rigid(p.reshape(-1, 3), q.reshape(-1, 3))
    except CalibrationError:
        return None
    moved, left = (float(np.var(of, axis=0).sum(axis=1).mean()) for of in (p, p - found.apply(q)))
    return found if moved > _MOVED_M**2 and left < _LEFT * moved else None


def sizes(body: Body, joints: NDArray[np.floating]) -> Array:
    """(T,) logarithm of the scale of (T, J, 3) skeletons relative to an adult; NaN where unknown."""
    states = np.where(np.isfinite(joints).all(axis=2), TRACKED, 0).astype(np.uint8)
    return sizes_of(body, joints, states, body.nominal_lengths)


def _by_motion(a: Tracks, b: Tracks) -> Iterator[Clock]:
    """B's clocks by which two of the longest tracks show one motion."""
    longest = (
        np.argsort(-np.bincount(of.track[of.track >= 0]), kind="stable")[:_TRIED].tolist() for of in (a, b)
    )
    for i, j in product(*longest):
        views = (of.people.view_of(np.flatnonzero(of.track == k)) for of, k in ((a, i), (b, j)))
        seen = [view.chosen_whole(np.flatnonzero(view.states.any(axis=1))) for view in views]
        clock = clock_by_motion(a.people.body, seen[0], seen[1])
        if clock is not None:
            yield clock


def _meetings(a: Tracks, b: Tracks, frames: Index, others: Index) -> tuple[Index, Index]:
    """Rows of A and of B that are of one moment: each skeleton of A with each of B."""
    first_a, end_a = (np.searchsorted(a.people.frame, frames, side) for side in ("left", "right"))
    first_b, end_b = (np.searchsorted(b.people.frame, others, side) for side in ("left", "right"))
    rows_a, rows_b = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    most = [int((end - first).max(initial=0)) for first, end in ((first_a, end_a), (first_b, end_b))]
    for i, j in product(*map(range, most)):
        both = (first_a + i < end_a) & (first_b + j < end_b)
        rows_a.append(first_a[both] + i)
        rows_b.append(first_b[both] + j)
    every_a, every_b = np.concatenate(rows_a), np.concatenate(rows_b)
    counts = (a.track[every_a] >= 0) & (b.track[every_b] >= 0)
    return every_a[counts], every_b[counts]


def _fit(p: Array, q: Array) -> RigidTransform | None:
    try:
        return fit_recording(p, q)
    except CalibrationError:
        return None


def _apart(a_from_b: RigidTransform, p: Array, q: Array) -> Array:
    """(n,) metres between the joints of each pair of skeletons, mean; infinite where none is known."""
    apart = np.minimum(np.linalg.norm(p - a_from_b.apply(q), axis=2), 2.0 * SAME_M)
    known = np.isfinite(apart)
    total, count = np.where(known, apart, 0.0).sum(axis=1), known.sum(axis=1)
    return np.asarray(np.where(count > 0, total / np.maximum(count, 1), np.inf))


def _score(apart: Array, limit: float) -> float:
    """How many skeletons are in one place: 1 each if they coincide, 0 beyond the limit."""
    return float(np.maximum(0.0, 1.0 - (apart / limit) ** 2).sum())
