"""Joints of motion capture as functions of time."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion.support.types import Array

Ints = NDArray[np.int64]

_LONGEST_GAP = 0.1  # seconds without a point that are interpolated


class JointPath:
    """(N, J, 3) joints, NaN where unknown, at (N,) times; cubic splines over short gaps only."""

    def __init__(self, seconds: Array, positions: Array) -> None:
        from scipy.interpolate import CubicSpline

        self.seconds, self._shape = seconds, positions.shape[1:]
        longest = max(_LONGEST_GAP, 2.5 * float(np.median(np.diff(seconds))))
        known = np.isfinite(positions[:, :, 0])
        masks, of_mask = np.unique(known, axis=1, return_inverse=True)
        # one for all joints that are known at the same times
        self._splines = list[tuple[Ints, Array, Any, NDArray[np.bool_]]]()
        for mask, some in enumerate(masks.T):
            if some.sum() > 1:
                times, of = seconds[some], np.flatnonzero(of_mask == mask)
                spline = CubicSpline(times, positions[np.ix_(some, of)])
                self._splines.append((of, times, spline, np.diff(times) <= longest))

    def at(self, times: Array) -> Array:
        """(T, J, 3) positions; NaN in gaps and outside."""
        found = np.full((len(times), *self._shape), np.nan)
        for joints, known, spline, short in self._splines:
            before = np.clip(np.searchsorted(known, times, side="right") - 1, 0, len(known) - 2)
            inside = np.flatnonzero((times >= known[0]) & (times <= known[-1]) & short[before])
            found[np.ix_(inside, joints)] = spline(times[inside])
        return found
