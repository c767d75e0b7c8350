"""Joints of motion capture as functions of time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion.support.types import Array

_LONGEST_GAP = 0.1  # seconds without a point that are interpolated


@dataclass(frozen=True, eq=False)
class Joints:
    """(N, J, 3) joints at (N,) times, metres; NaN where unknown."""

    seconds: Array
    positions: Array


class JointPath:
    """Joints over time, interpolated by cubic splines over short gaps only."""

    def __init__(self, joints: Joints) -> None:
        from scipy.interpolate import CubicSpline

        self.seconds, self._shape = joints.seconds, joints.positions.shape[1:]
        longest = max(_LONGEST_GAP, 2.5 * float(np.median(np.diff(joints.seconds))))
        self._splines: dict[int, tuple[Array, Any, NDArray[np.bool_]]] = {}
        for joint in range(self._shape[0]):
            known = np.isfinite(joints.positions[:, joint, 0])
            if known.sum() > 1:
                times = joints.seconds[known]
                spline = CubicSpline(times, joints.positions[known, joint])
                self._splines[joint] = times, spline, np.diff(times) <= longest

    def at(self, times: Array, derivative: int = 0) -> Array:
        """(T, J, 3) positions or velocities; NaN in gaps and outside."""
        found = np.full((len(times), *self._shape), np.nan)
        for joint, (known, spline, short) in self._splines.items():
            before = np.clip(np.searchsorted(known, times, side="right") - 1, 0, len(known) - 2)
            inside = (times >= known[0]) & (times <= known[-1]) & short[before]
            found[inside, joint] = spline(times[inside], derivative)
        return found
