"""Motion that is sampled at any rate: how far apart velocities are measured, what a gap is, interpolation."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion.support.types import Array

_HALF_SPAN_NS = 66_666_667  # between a frame and those that its velocity is measured between
_LONGEST_NS = 300_000_000  # a longer interval is a gap, except at low rates
_GAP = 2.5  # usual intervals: so that one lost frame makes no gap
_FAR = 3.0  # intervals beyond which the far neighbours of an interpolation do not count


class Sampling(NamedTuple):
    """What follows from the usual interval between the frames of a view."""

    interval_ns: float

    @staticmethod
    def of(time_ns: NDArray[np.integer] | Array) -> Sampling:
        """That of frames at (T,) increasing times."""
        steps = np.diff(time_ns)
        steps = steps[steps > 0]
        return Sampling(float(np.median(steps)) if len(steps) else float(_LONGEST_NS))

    @property
    def reach(self) -> int:
        """Frames before and after, between which a velocity is measured; two at 30 per second."""
        return max(1, round(_HALF_SPAN_NS / self.interval_ns))

    @property
    def gap_ns(self) -> float:
        """A longer interval between two frames is a gap."""
        return max(float(_LONGEST_NS), _GAP * self.interval_ns)

    @property
    def span_ns(self) -> float:
        """The longest time over which a velocity is measured: it contains no gap."""
        return max(float(_LONGEST_NS), (2.0 * self.reach + _GAP - 1.0) * self.interval_ns)


class Interpolation:
    """Positions between frames, by cubic Hermite polynomials whose slopes are those of parabolas.

    Linear interpolation would lie off by h²/8 of the acceleration h seconds between two frames: 50 mm for a
    hand at five frames per second. What follows from the frames alone is computed once.

    Args:
        time_ns: (T,) increasing; T ≥ 2.
        at: (T, ...) positions; NaN where unknown.
        gap_ns: A longer interval is a gap.
    """

    def __init__(self, time_ns: NDArray[np.int64] | Array, at: Array, gap_ns: float) -> None:
        self._time_ns, self._at, self._gap_ns = time_ns, at, gap_ns
        self._shape = (-1, *(1,) * (at.ndim - 1))
        self._elapsed = np.diff(time_ns).astype(np.float64)
        self._h = np.maximum(self._elapsed, 1.0)
        self._step = np.diff(at, axis=0)
        self._before, self._after = self._bends(-1), self._bends(1)

    def _bends(self, side: int) -> Array:
        """(T-1, ...) of each interval: the slope of the parabola through its frames and the next one on a
        side, minus that of the line between its frames; 0 where that is unknown."""
        number = np.arange(len(self._h))
        other = np.clip(number + side, 0, len(number) - 1)
        far = np.where(other == number, 0.0, np.abs(self._elapsed[other]))
        known = (far > 0.0) & (far < _FAR * self._h)
        far = np.where(known, far, 1.0)
        outer, share = np.sign(self._elapsed[other]) * (self._h / far), self._h / (self._h + far)
        slope = (self._step[other] * outer.reshape(self._shape) - self._step) * share.reshape(self._shape)
        return np.where(known.reshape(self._shape) & np.isfinite(slope), slope, 0.0)

    def positions(self, wanted_ns: NDArray[np.int64] | Array) -> Array:
        """(W, ...) at (W,) times; NaN across a gap, and more than an interval before the first or after the
        last frame. Outside the frames, and beside an unknown one, it is linear."""
        k = np.clip(np.searchsorted(self._time_ns, wanted_ns), 1, len(self._h)) - 1
        h = self._h[k]
        share = (wanted_ns - self._time_ns[k]) / h
        share = np.where((share >= -1.0) & (share <= 2.0) & (h < self._gap_ns), share, np.nan)
        share = share.reshape(self._shape)
        inside = np.clip(share, 0.0, 1.0)
        bend = (1.0 - inside) * self._before[k] - inside * self._after[k]
        return np.asarray(self._at[k] + share * self._step[k] + inside * (1.0 - inside) * bend)
