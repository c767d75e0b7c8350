"""Moments at an even rate, for formats without time stamps, and conversion to the axes of these formats."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recordings.session_arrays import SessionArrays

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
        rate: Moments per second. None: the recording's frame rate.
    """
    first_ns, last_ns = (int(rows.time_ns[k]) for k in (0, -1))
    rate = rows.frame_rate if rate is None else rate
    count = math.floor((last_ns - first_ns) * 1e-9 * rate + _WITHIN_STEPS) + 1
    time_ns = first_ns + np.rint(np.arange(count) * 1e9 / rate).astype(np.int64)
    return EvenMoments(rate, np.minimum(time_ns, last_ns))


def y_up(positions: NDArray[np.float64]) -> NDArray[np.float64]:
    """(…, 3) from K_A's frame (x right, y down, z forward) to x right, y up, z towards the sensor."""
    return np.asarray(positions * np.array([1.0, -1.0, -1.0]))


def y_up_rotations(quaternions: NDArray[np.float64]) -> NDArray[np.float64]:
    """(…, 4) quaternions x, y, z, w of the same rotations, between the axes that :func:`y_up` converts."""
    return np.asarray(quaternions * np.array([1.0, -1.0, -1.0, 1.0]))
