"""Whose bones: the size of both skeletons tells that another person is there."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from fusion.body import Body
from fusion.calibration.bone_lengths import SHORTEST, bone_lengths_of
from fusion.skeleton import TRACKED
from fusion.support.types import Array

_WINDOW_NS, _SHORTEST_NS, _FEWEST = 2_500_000_000, 2_000_000_000, 10
"""Time and number of the pairs that are compared: a tracker's scale changes within a second."""
_ANOTHER = 0.055
"""Logarithm of the scale at which a person is another one. Both views of one person are at most 4.4 % too
large, or too small, together for 3 s in 21 real pairs of recordings."""
_SAME = 0.03  # the same, of somebody who was there before
_AWAY_NS = 1_000_000_000  # who was out of sight for longer may be somebody else
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
    tracked = (states[:, bones] == TRACKED) & (states[:, body.parent_indices[bones]] == TRACKED)
    seen = bone_lengths_of(body, positions)[:, bones]
    ratio = np.log(np.where(tracked & (seen >= SHORTEST), seen, np.nan) / lengths[bones])
    size = np.full(len(ratio), np.nan)
    known = np.isfinite(ratio).any(axis=1)
    size[known] = np.nanmedian(ratio[known], axis=1)
    for _ in range(3):
        weight = (lengths[bones] / (1.0 + ((ratio - size[:, None]) / _USUAL_ERROR) ** 2)) ** 2
        size[known] = np.nansum(weight * ratio, axis=1)[known] / np.nansum(weight, axis=1)[known]
    return size


class PersonSize:
    """Follows the size of the person in both views, and tells when another person is there."""

    def __init__(self) -> None:
        self.people = [0.0]
        """Logarithm of each person's size relative to the bone lengths of the calibration, the first being
        who was calibrated."""
        self.present = 0  # which of them is there
        self.since_ns: int | None = None  # since when
        self._recent: deque[tuple[int, float, float]] = deque()
        self._mean, self._count = 0.0, 0

    def observe(self, time_ns: int, a: float, b: float) -> bool:
        """Takes the size in each view of a pair in which both are new; whether another person is there."""
        if np.isnan(a + b):
            return False
        recent = self._recent
        if recent and not 0 <= time_ns - recent[-1][0] <= _AWAY_NS:
            recent.clear()
        recent.append((time_ns, a, b))
        while time_ns - recent[0][0] > _WINDOW_NS:
            _, a, b = recent.popleft()
            self._count += 1
            self._mean += (0.5 * (a + b) - self._mean) / min(self._count, _MOST)
            if self._count >= _OWN:
                self.people[self.present] = self._mean
        if len(recent) < _FEWEST or time_ns - recent[0][0] < _SHORTEST_NS:
            return False
        sizes = np.array(recent)[:, 1:]
        views = np.median(sizes, axis=0) - self.people[self.present]
        if views[0] * views[1] < 0.0 or np.abs(views).min() < _ANOTHER:
            return False
        early, late = (float(np.median(half.mean(axis=1))) for half in np.array_split(sizes, 2))
        if abs(late - early) > _ANOTHER:  # the person came within these
            return False
        size = self.people[self.present] + float(views.mean())
        nearest = int(np.argmin(np.abs(np.array(self.people) - size)))
        if nearest == self.present or abs(self.people[nearest] - size) > _SAME:
            nearest = len(self.people)
            self.people.append(size)
        self.present, self.since_ns = nearest, recent[0][0]
        self._mean, self._count = 0.0, 0
        recent.clear()
        return True
