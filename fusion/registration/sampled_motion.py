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


def interpolated(
    time_ns: NDArray[np.int64] | Array, at: Array, wanted_ns: NDArray[np.int64] | Array, gap_ns: float
) -> Array:
    """Positions at other times, by cubic Hermite polynomials with the slopes of parabolas.

    Linear interpolation would lie off by h²/8 of the acceleration h seconds between two frames: 50 mm for a
    hand at five frames per second.

    Args:
        time_ns: (T,) increasing; T ≥ 2.
        at: (T, ...) positions; NaN where unknown.
        wanted_ns: (W,) times.

    Returns:
        (W, ...); NaN across a gap, and more than an interval before the first or after the last frame.
        Outside the frames, and beside an unknown one, it is linear.
    """
    after = np.clip(np.searchsorted(time_ns, wanted_ns), 1, len(time_ns) - 1)
    before = after - 1
    first, last = np.maximum(before - 1, 0), np.minimum(after + 1, len(time_ns) - 1)
    shape = (-1, *(1,) * (at.ndim - 1))
    h = np.maximum(time_ns[after] - time_ns[before], 1).astype(np.float64)
    share = (wanted_ns - time_ns[before]) / h
    share = np.where((share >= -1.0) & (share <= 2.0) & (h < gap_ns), share, np.nan).reshape(shape)
    step = at[after] - at[before]
    bend = np.zeros_like(step)
    inside = np.clip(share, 0.0, 1.0)
    for end, other, factor in ((before, first, 1.0 - inside), (after, last, -inside)):
        # the slope of the parabola through three frames, minus that of the line between the middle two
        far = np.abs(time_ns[end] - time_ns[other]).astype(np.float64)
        known = (far > 0.0) & (far < _FAR * h)
        far = np.where(known, far, 1.0)
        outer = (at[end] - at[other]) * np.sign(time_ns[end] - time_ns[other]).reshape(shape)
        slope = (outer * (h / far).reshape(shape) - step) * (h / (h + far)).reshape(shape)
        bend += factor * np.where(known.reshape(shape) & np.isfinite(slope), slope, 0.0)
    return np.asarray(at[before] + share * step + inside * (1.0 - inside) * bend)
