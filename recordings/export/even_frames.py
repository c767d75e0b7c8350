"""Moments at an even rate, for formats without time stamps, and conversion to the axes of these formats."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recordings import layout
from recordings.session_arrays import SessionArrays

_STANDARD_RATES = (5.0, 15.0, 30.0, 60.0)
_STANDARD_WITHIN = 0.05
_LONG_PAUSE = 3.0  # median intervals
_WITHIN_STEPS = 0.01  # a last moment that rounding moves behind the last frame by so much of a step is kept


@dataclass(frozen=True, eq=False)
class EvenMoments:
    """Moments at an even rate."""

    rate: float  # moments per second
    time_ns: NDArray[np.int64]  # (N,) since the first pair

    @property
    def in_words(self) -> str:
        """Their number and rate."""
        return f"{len(self.time_ns)} frames at a constant {self.rate:.6g} Hz"


def even_moments(rows: SessionArrays, rate: float | None = None) -> EvenMoments:
    """The moments k / rate since the first frame.

    Args:
        rate: Moments per second. None: the rate of A's frames, or of B's where A has none, without pauses,
            rounded to 5, 15, 30 or 60 if within 5 % of it.
    """
    first_ns, last_ns = (int(rows.time_ns[k]) for k in (0, -1))
    rate = _rate_of(rows) if rate is None else rate
    count = math.floor((last_ns - first_ns) * 1e-9 * rate + _WITHIN_STEPS) + 1
    time_ns = first_ns + np.rint(np.arange(count) * 1e9 / rate).astype(np.int64)
    return EvenMoments(rate, np.minimum(time_ns, last_ns))


def _rate_of(rows: SessionArrays) -> float:
    of_a = rows.time_ns[rows.clock_a != layout.NO_FRAME]
    times = (of_a if len(of_a) > 1 else rows.time_ns) * 1e-9
    if len(times) < 2:
        return 30.0
    steps = np.diff(times)
    rate = float(1.0 / steps[steps <= _LONG_PAUSE * np.median(steps)].mean())
    nearest = min(_STANDARD_RATES, key=lambda standard: abs(standard - rate))
    return nearest if abs(nearest - rate) <= _STANDARD_WITHIN * nearest else rate


def y_up(positions: NDArray[np.float64]) -> NDArray[np.float64]:
    """(…, 3) from K_A's frame (x right, y down, z forward) to x right, y up, z towards the sensor."""
    return np.asarray(positions * np.array([1.0, -1.0, -1.0]))


def y_up_rotations(quaternions: NDArray[np.float64]) -> NDArray[np.float64]:
    """(…, 4) quaternions x, y, z, w of the same rotations, between the axes that :func:`y_up` converts."""
    return np.asarray(quaternions * np.array([1.0, -1.0, -1.0, 1.0]))
