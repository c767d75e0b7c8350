"""What repeats in a recording although people move: frames that are logged again, joints that nobody sees."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from devices.skeletons.name_tables import listed
from devices.skeletons.read_file import FoundPoints
from devices.skeletons.times import FEWEST, LOGGED_TWICE, digest
from fusion.support.large_arrays import parts

_ONE_FRAME_NS = 250_000_000  # the longest time between two frames of a tracker
_DIGITS = 200  # steps within a person: centimetres are fewer, millimetres more
_MOVES = 0.5  # of the other points, while a joint keeps its place
ALMOST_ALWAYS = 0.9  # of the frames of one person


def repeats_of(found: FoundPoints) -> NDArray[np.bool_]:
    """(N,) which skeletons repeat that of the same person in the frame before."""
    repeats = np.zeros(len(found.frame), dtype=np.bool_)
    order = np.argsort(found.person, kind="stable")
    before, after = order[:-1], order[1:]
    near = (found.person[before] == found.person[after]) & (found.frame[before] + 1 == found.frame[after])
    before, after = before[near], after[near]
    for part in parts(len(after)):
        one, other = before[part], after[part]
        states = (found.view.states[one] == found.view.states[other]).all(axis=1)
        same = _same(found.view.positions[one], found.view.positions[other]).all(axis=1)
        repeats[other] = same & states
    return repeats


def _same(one: NDArray[np.floating], other: NDArray[np.floating]) -> NDArray[np.bool_]:
    return np.asarray(((one == other) | (np.isnan(one) & np.isnan(other))).all(axis=2))


def logged_again(
    path: Path, found: FoundPoints, repeats: NDArray[np.bool_]
) -> tuple[NDArray[np.bool_], list[str]]:
    """(T,) which frames are left out because they repeat the one before, and a line for the user.

    A few repeated frames are left to the estimator, and a person who stands still for longer than a frame
    takes is none.
    """
    count = np.bincount(found.frame, minlength=len(found.time_ns))
    again = np.bincount(found.frame, weights=repeats, minlength=len(found.time_ns)) == count
    again &= (count > 0) & (count == np.append(0, count[:-1]))
    begins = np.flatnonzero(~again)
    run = np.cumsum(~again) - 1
    lasts = found.time_ns[np.append(begins[1:] - 1, len(again) - 1)] - found.time_ns[begins]
    drop = again & (lasts[run] < _ONE_FRAME_NS)
    share = float(drop.mean())
    if share < LOGGED_TWICE or len(begins) < FEWEST:
        return np.zeros_like(drop), []
    return drop, [
        f"{path}: {100.0 * share:.0f} % of the frames repeat the one before, as when a program logs them "
        "faster than its tracker finds people; they are left out."
    ]


def _is_coarse(found: FoundPoints) -> bool:
    """Whether numbers have so few digits that a calm joint keeps its place for a while."""
    some = found.view.positions[:: max(1, len(found.view.positions) // 200)]
    places = np.asarray(np.isfinite(some).all(axis=2))
    some = np.where(np.isfinite(some), some, np.nan)[places.any(axis=1)]
    if not len(some):
        return False
    low, high = np.nanpercentile(some, [10, 90], axis=1)
    reach = np.median((high - low).max(axis=1))
    some = some[np.isfinite(some)]
    return bool(np.median(np.diff(np.unique(some))) > reach / _DIGITS)


def kept_places(
    path: Path, found: FoundPoints, repeats: NDArray[np.bool_]
) -> tuple[NDArray[np.bool_], list[str]]:
    """(N, P) which points keep their place while the others move, and a line for the user."""
    count = len(found.points)
    order = np.argsort(found.person, kind="stable")
    order = order[~repeats[order]]
    keeps = np.zeros((len(found.frame), count), dtype=np.bool_)
    if len(order) < FEWEST:
        return keeps, []
    same = np.zeros((len(order), count), dtype=np.bool_)
    for part in parts(len(order) - 1):
        one, other = order[:-1][part], order[1:][part]
        at, after = found.view.positions[one], found.view.positions[other]
        known = np.isfinite(after).all(axis=2) & (after != 0.0).any(axis=2) & (found.view.states[other] > 0)
        equal = (at == after).all(axis=2) & known
        moving = (known & ~equal).sum(axis=1) > _MOVES * known.sum(axis=1)
        same[1:][part] = equal & (moving & (found.person[one] == found.person[other]))[:, None]

    def lengths(point: int) -> NDArray[np.int64]:
        run = np.cumsum(~same[:, point])
        return np.asarray(np.bincount(run)[run])

    often = [point for point in range(count) if lengths(point).max() >= FEWEST]
    if often:
        person = found.person[order]
        always = (ALMOST_ALWAYS if _is_coarse(found) else 0.0) * np.bincount(person)[person]
        for point in often:
            keeps[order, point] = lengths(point) >= np.maximum(FEWEST, always)
    if not keeps.any():
        return keeps, []
    for point in np.flatnonzero(keeps.any(axis=0)).tolist():  # also where nothing else moves for a moment
        place = digest(found.view.positions[:, point], 0, 0)
        keeps[:, point] |= np.isin(place, place[keeps[:, point]])
    names = [found.points.named(int(point)) for point in np.flatnonzero(keeps.any(axis=0))]
    return keeps, [
        f"{path}: {listed(names)} {'keeps its place' if len(names) == 1 else 'keep their places'} to the "
        "last digit while the other joints move, and count as not tracked there."
    ]
