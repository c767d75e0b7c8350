"""How much joints shake from frame to frame: noise, or jitter, in metres, at any frame rate."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fusion.support.medians import median_of_known

_LONGEST_NS = 300_000_000  # between the first and the last of three frames: over more, movement is no line
_RMS_OF_MEDIAN = 1.1262  # √3 / 1.5382, of the length of a normal 3-vector


class FrameDeviations:
    """How far each joint lies from the line between the frames before and after, frames in time order."""

    def __init__(self) -> None:
        self._positions: NDArray[np.floating] | None = None  # (n, J, 3) the last two frames with the person
        self._time_ns = np.zeros(0, dtype=np.int64)

    def add(self, positions: NDArray[np.floating], time_ns: NDArray[np.int64]) -> NDArray[np.float64]:
        """The deviations of the next frames.

        The line is divided by the times of the frames, which need not be even. Frames without the person do
        not count, as between those of a sensor of half the rate.

        Args:
            positions: (T, J, 3) metres; NaN where unknown.

        Returns:
            (T, J) metres, in the row of the last one of each three frames, divided by √(1 + u² + v²) with u
            and v the shares of the outer ones, so that white noise has its own size. NaN where a joint is
            unknown or three frames last for more than 0.3 s.
        """
        seen = np.flatnonzero(np.isfinite(positions).any(axis=(1, 2)))
        at, times = positions[seen].astype(np.float64), time_ns[seen]
        if self._positions is not None:
            at, times = np.concatenate((self._positions, at)), np.concatenate((self._time_ns, times))
        found = np.full(positions.shape[:2], np.nan)
        if len(at) > 2:
            before, span = times[1:-1] - times[:-2], times[2:] - times[:-2]
            after = np.where((before > 0) & (span > before) & (span <= _LONGEST_NS), before / span, np.nan)
            share = after[:, None, None]
            off = at[1:-1] - (1.0 - share) * at[:-2] - share * at[2:]
            size = np.sqrt(1.0 + after**2 + (1.0 - after) ** 2)
            found[seen[len(seen) - len(off) :]] = np.linalg.norm(off, axis=2) / size[:, None]
        self._positions, self._time_ns = at[-2:].copy(), times[-2:].copy()
        return found


def noise_of(deviations: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N,) RMS length of the noise, metres, from the median of (N, …) deviations each; NaN without any."""
    return _RMS_OF_MEDIAN * median_of_known(deviations.reshape(len(deviations), -1))


def frame_noise_of(positions: NDArray[np.floating], time_ns: NDArray[np.int64]) -> NDArray[np.float64]:
    """(J,) noise of (T, J, 3) positions, metres: the RMS distance of a joint from its path.

    White noise is given back as it is, √3 times its standard deviation on each axis, at any frame rate and
    with uneven frames. A movement adds an eighth of its acceleration times the square of the time that three
    frames last, nine times as much at 10 frames per second as at 30. NaN where the joint is not seen in three
    frames within 0.3 s.
    """
    deviations = FrameDeviations().add(positions, time_ns)
    return noise_of(deviations.T)
