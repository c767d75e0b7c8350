"""Whose bones: the size of both skeletons tells that another person is there.

It is looked at closely at first and after a gap. Without a gap only a far other size is another person: a
tracker may fit a body a tenth too small for seconds.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from fusion.body import Body
from fusion.calibration.bone_lengths import SHORTEST, bone_lengths_of
from fusion.skeleton import TRACKED, SkeletonPair
from fusion.support.types import Array

_WINDOW_NS, _SHORTEST_NS, _FEWEST = 2_500_000_000, 2_000_000_000, 10
"""Time and number of the pairs that are compared: a tracker's scale changes within a second."""
ANOTHER = 0.055
"""Logarithm of the scale at which a person is another one. Both views of one person are at most 4.4 % too
large, or too small, together for 3 s in 21 real pairs of recordings."""
_SAME = 0.03  # the same, of somebody who was there before
ANOTHER_SIZE = 0.15  # the same, of who comes without a gap
AWAY_NS = 1_000_000_000  # who was out of sight for longer may be somebody else
_OWN, _MOST = 100, 600  # samples after which a person's size is their own mean, and over how many
_USUAL_ERROR = 0.15  # of a bone; a larger one counts less and less


def sizes_of(body: Body, positions: NDArray[np.floating], states: NDArray[np.uint8], lengths: Array) -> Array:
    """(T,) logarithm of the scale of skeletons relative to bone lengths; NaN where no bone is tracked.

    It is Σ w² r / Σ w² over the logarithms r of the bones' relative lengths, with w = l / (1 + (r - s)² /
    0.15²), as the estimator weighs the scale of a view.

    Args:
        positions: (T, J, 3) metres.
        states: (T, J) tracking states.
        lengths: (J,) metres.
    """
    bones = body.bone_joints[lengths[body.bone_joints] >= SHORTEST]
    known = (states[:, bones] == TRACKED) & (states[:, body.parent_indices[bones]] == TRACKED)
    seen = bone_lengths_of(body, positions)[:, bones]
    known &= seen >= SHORTEST
    ratio = np.log(np.where(known, seen / lengths[bones], 1.0))
    size, some = np.zeros((len(ratio), 1)), known.any(axis=1)
    for _ in range(4):
        weight = np.where(known, (lengths[bones] / (1.0 + ((ratio - size) / _USUAL_ERROR) ** 2)) ** 2, 0.0)
        size[some, 0] = (weight * ratio).sum(axis=1)[some] / weight.sum(axis=1)[some]
    size[~some] = np.nan
    return size[:, 0]


def sizes_of_pair(body: Body, pair: SkeletonPair, lengths: Array) -> tuple[float, float]:
    """:func:`sizes_of` of both views; NaN where one sees nobody."""
    a, b = (
        np.nan if view is None else sizes_of(body, view.positions[None], view.states[None], lengths)[0]
        for view in (pair.a, pair.b)
    )
    return float(a), float(b)


class PersonSize:
    """Follows the size of the person in both views, and tells when another person is there."""

    def __init__(self) -> None:
        self.people = [0.0]
        """Logarithm of each person's size relative to the bone lengths of the calibration, the first being
        who was calibrated."""
        self.present = 0  # which of them is there
        self.since_ns: int | None = None  # since when
        self._recent: deque[tuple[int, float, float]] = deque()
        self._mean, self._count, self._settled = 0.0, 0, False  # settled: who is there, until nobody is

    def observe(self, time_ns: int, a: float, b: float) -> bool:
        """Takes the size in each view of a pair in which both are new; whether another person is there."""
        if np.isnan(a + b):
            return False
        recent = self._recent
        if recent and not 0 <= time_ns - recent[-1][0] <= AWAY_NS:
            recent.clear()
            self._settled = False
        recent.append((time_ns, a, b))
        while time_ns - recent[0][0] > _WINDOW_NS:
            _, a, b = recent.popleft()
            self._count += 1
            self._mean += (0.5 * (a + b) - self._mean) / min(self._count, _MOST)
            if self._count >= _OWN:
                self.people[self.present] = self._mean
        least = ANOTHER_SIZE if self._settled else ANOTHER
        near = self._settled and abs(0.5 * sum(recent[-1][1:]) - self.people[self.present]) < least
        if near or len(recent) < _FEWEST or time_ns - recent[0][0] < _SHORTEST_NS:
            return False
        sizes = np.array(recent)[:, 1:]
        early, late = (float(np.median(half.mean(axis=1))) for half in np.array_split(sizes, 2))
        if abs(late - early) > ANOTHER:  # the person came within these
            return False
        views = np.median(sizes, axis=0)
        size = float(views.mean())
        nearest = int(np.argmin(np.abs(np.array(self.people) - size)))
        if nearest == self.present or abs(self.people[nearest] - size) > _SAME:
            a, b = (views - self.people[self.present]).tolist()
            if a * b <= 0.0 or min(abs(a), abs(b)) < least:  # not both too large, or too small
                self._settled = self._settled or abs(a + b) <= 2.0 * _SAME
                return False
            nearest = len(self.people)
            self.people.append(size)
        self.present, self.since_ns = nearest, recent[0][0]
        self._mean, self._count, self._settled = 0.0, 0, True
        recent.clear()
        return True
