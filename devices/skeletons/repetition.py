"""What repeats in a recording although people move: frames that are logged again, joints that nobody sees."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from devices.skeletons.name_tables import listed
from devices.skeletons.read_file import FoundPoints, digest
from devices.skeletons.times import FEWEST, LOGGED_TWICE
from fusion.support.large_arrays import parts

_ONE_FRAME_NS = 250_000_000  # the longest time between two frames of a tracker
_OFTEN = 3.0  # times as often as another joint has one place
_QUARTER = 0.25  # of the joints, at least, are seen


def repeats_of(found: FoundPoints) -> NDArray[np.bool_]:
    """(N,) which skeletons repeat that of the same person in the frame before."""
    repeats = np.zeros(len(found.frame), dtype=np.bool_)
    order = np.argsort(found.person, kind="stable")
    before, after = order[:-1], order[1:]
    near = (found.person[before] == found.person[after]) & (found.frame[before] + 1 == found.frame[after])
    before, after = before[near], after[near]
    for part in parts(len(after)):
        of, one, other = found.view, *(found.view.positions[k[part]] for k in (before, after))
        states = (of.states[before[part]] == of.states[after[part]]).all(axis=1)
        same = (one == other) | (np.isnan(one) & np.isnan(other))
        repeats[after[part]] = same.all(axis=(1, 2)) & states
    return repeats


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
    lasts = found.time_ns[np.append(begins[1:] - 1, len(again) - 1)] - found.time_ns[begins]
    drop = again & (lasts[np.cumsum(~again) - 1] < _ONE_FRAME_NS)
    if drop.mean() < LOGGED_TWICE or len(begins) < FEWEST:
        return np.zeros_like(drop), []
    return drop, [
        f"{path}: {100.0 * drop.mean():.0f} % of the frames repeat the one before, as when a program logs "
        "them faster than its tracker finds people; they are left out."
    ]


def kept_places(
    path: Path, found: FoundPoints, repeats: NDArray[np.bool_]
) -> tuple[NDArray[np.bool_], list[str]]:
    """(N, P) which points are at a place where they mostly are while others move, and a line for the user.

    Trackers put joints there that they do not see.
    """
    at, seen = found.view.positions, found.view.states > 0
    keeps = np.zeros(seen.shape, dtype=np.bool_)
    often = np.ones(seen.shape[1])
    for point in range(len(often)):
        place = digest(at[:, point])
        there = seen[:, point] & ~repeats & (place != 0.0)
        if there.any():
            middle = there.sum() // 2
            keeps[:, point] = place == np.partition(place[there], middle)[middle]  # which most of them are
            often[point] = (keeps[:, point] & there).sum()
            keeps[:, point] &= often[point] > middle
    keeps[:, often < max(FEWEST, _OFTEN * np.quantile(often, _QUARTER))] = False
    if not keeps.any():
        return keeps, []
    names = [found.points.labels[int(point)] for point in np.flatnonzero(keeps.any(axis=0))]
    return keeps, [
        f"{path}: {listed(names)} {'keeps its place' if len(names) == 1 else 'keep their places'} to the "
        "last digit while the other joints move, and count as not tracked there."
    ]
