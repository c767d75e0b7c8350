"""What repeats in a recording although people move: frames that are logged again, joints that nobody sees."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from devices.skeletons.name_tables import listed
from devices.skeletons.read_file import LARGE, FoundPoints, digest
from devices.skeletons.times import FEWEST, LOGGED_TWICE
from fusion.support.large_arrays import parts

_ONE_FRAME_NS = 250_000_000  # the longest time between two frames of a tracker
_OFTEN = 3.0  # times as often as another joint has one place
_QUARTER = 0.25  # of the joints, at least, are seen
_NEAR, _WAVERS, _SAMPLES = 0.1, 0.1, 300  # of a body; of the frames; frames


def repeats_of(found: FoundPoints) -> NDArray[np.bool_]:
    """(N,) which skeletons repeat that of the same person in the frame before."""
    repeats = np.zeros(len(found.frame), dtype=np.bool_)
    order = np.argsort(found.person, kind="stable")
    before, after = order[:-1], order[1:]
    near = (found.person[before] == found.person[after]) & (found.frame[before] + 1 == found.frame[after])
    before, after = before[near], after[near]
    for part in parts(len(after)):
        one, other = (found.view.positions[k[part]] for k in (before, after))
        same = (one == other) | (np.isnan(one) & np.isnan(other))
        repeats[after[part]] = same.all(axis=(1, 2))
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
    """(N, P) which points are at a place where they mostly are while others of the person move, and a line.

    Trackers put joints there that they do not see. A joint that rests wavers about its place, if only by the
    last digit of a file of whole centimetres.
    """
    keeps = np.zeros((len(found.frame), len(found.points)), dtype=np.bool_)
    order = np.argsort(found.person, kind="stable")
    for rows in np.split(order, np.cumsum(np.bincount(found.person))[:-1]):
        if len(rows) < FEWEST:
            continue
        often = np.ones(len(found.points))
        for point in range(len(often)):
            place = digest(found.view.positions[rows, point])
            there = (found.view.states[rows, point] > 0) & ~repeats[rows] & (place != 0.0)
            if not there.any():
                continue
            middle = there.sum() // 2
            here = place == np.partition(place[there], middle)[middle]  # which most of them are
            often[point] = (here & there).sum()
            if often[point] > middle and _wavering(found, point, rows, here, there) <= _WAVERS * often[point]:
                keeps[rows, point] = here
        keeps[np.ix_(rows, often < max(FEWEST, _OFTEN * np.quantile(often, _QUARTER)))] = False
    if not keeps.any():
        return keeps, []
    names = [found.points.labels[int(point)] for point in np.flatnonzero(keeps.any(axis=0))]
    return keeps, [
        f"{path}: {listed(names)} {'keeps its place' if len(names) == 1 else 'keep their places'} to the "
        "last digit while the other joints move, and count as not tracked there."
    ]


def _wavering(
    found: FoundPoints, point: int, rows: NDArray[np.int64], here: NDArray[np.bool_], there: NDArray[np.bool_]
) -> int:
    """In how many frames a point is beside a place, by a tenth of what joints are from the middle."""

    def places(of: Any) -> NDArray[np.float64]:
        return np.asarray(np.clip(np.nan_to_num(found.view.positions[of]), -LARGE, LARGE))

    body = places(rows[here & there][:_SAMPLES])
    middle = np.median(body, axis=1, keepdims=True)
    near = _NEAR * np.median(np.linalg.norm(body - middle, axis=2))
    off = np.linalg.norm(places((rows[there & ~here], point)) - body[0, point], axis=1)
    return int((off < near).sum())
