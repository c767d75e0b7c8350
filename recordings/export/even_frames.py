"""Frames at an even rate, for formats without time stamps, and conversion to the axes of these formats."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recordings.session_arrays import SessionArrays

_STANDARD_RATES = (5.0, 15.0, 30.0, 60.0)
_STANDARD_WITHIN = 0.05
_LONG_PAUSE = 3.0  # median intervals


@dataclass(frozen=True, eq=False)
class EvenFrames:
    """Assigns a recorded frame to each moment of an even rate.

    Frames are never interpolated: interpolation would change bone lengths. The intervals of sensors vary by
    some milliseconds only.

    Attributes:
        rate: Frames per second.
        index: (N,) index of the recorded frame nearest to each moment; -1 if none is near.
    """

    rate: float
    index: NDArray[np.int64]

    def in_words(self, recorded: int) -> str:
        """Describes the number of frames, and how many of the `recorded` frames are repeated or dropped."""
        near = self.index[self.index >= 0]
        stood = len(np.unique(near))
        counts = {
            "repeated": len(near) - stood,
            "left out": recorded - stood,
            "without a recorded frame": len(self.index) - len(near),
        }
        made = ", ".join(f"{count} {what}" for what, count in counts.items() if count)
        return f"{len(self.index)} frames at a constant {self.rate:.6g} Hz" + (f" ({made})" if made else "")


def even_frames(rows: SessionArrays) -> EvenFrames:
    """The recorded frame nearest to each moment k / rate since the first frame.

    The rate is the rate of the recording without its pauses, rounded to 5, 15, 30 or 60 if within 5 % of it.
    """
    time = rows.time_ns * 1e-9
    if len(time) < 2:
        return EvenFrames(30.0, np.zeros(len(time), dtype=np.int64))
    steps = np.diff(time)
    rate = float(1.0 / steps[steps <= _LONG_PAUSE * np.median(steps)].mean())
    nearest = min(_STANDARD_RATES, key=lambda standard: abs(standard - rate))
    if abs(nearest - rate) <= _STANDARD_WITHIN * nearest:
        rate = nearest
    moments = np.arange(round((time[-1] - time[0]) * rate) + 1) / rate + time[0]
    after = np.clip(np.searchsorted(time, moments), 1, len(time) - 1)
    index = np.where(moments - time[after - 1] <= time[after] - moments, after - 1, after)
    index[np.abs(time[index] - moments) > 1.0 / rate] = -1
    return EvenFrames(rate, index.astype(np.int64))


def at_even_frames(values: NDArray[np.float64], even: EvenFrames) -> NDArray[np.float64]:
    """(N, …) values at the even moments; NaN where there is no frame."""
    taken = values[even.index].copy()
    taken[even.index < 0] = np.nan
    return taken


def y_up(positions: NDArray[np.float64]) -> NDArray[np.float64]:
    """(…, 3) from K_A's frame (x right, y down, z forward) to x right, y up, z towards the sensor."""
    return np.asarray(positions * np.array([1.0, -1.0, -1.0]))


def y_up_rotations(quaternions: NDArray[np.float64]) -> NDArray[np.float64]:
    """(…, 4) quaternions x, y, z, w of the same rotations, between the axes that :func:`y_up` converts."""
    return np.asarray(quaternions * np.array([1.0, -1.0, -1.0, 1.0]))
