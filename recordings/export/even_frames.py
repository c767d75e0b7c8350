"""S* at an even rate, for formats without time stamps or gaps, and conversion to their axes."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fusion.support.large_arrays import parts
from recordings.data.interpolation import positions_at
from recordings.data.session_arrays import SessionArrays
from recordings.errors import RecordingError
from recordings.export.bones import lasting
from recordings.session_series import SessionSeries

_LONGEST_GAP = 0.25  # seconds without S* that are interpolated
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


def with_fused(session: SessionSeries) -> SessionArrays:
    """The frames of a session that has S* in some of them; or a RecordingError."""
    if not any(np.isfinite(part.fused).any() for part in session.rows.parts()):
        raise RecordingError(f"{session} has no frame with an S*; there is nothing to export.")
    return session.rows


class EvenPositions:
    """S* at an even rate, interpolated over gaps of up to 0.25 s.

    Attributes:
        rate: Moments per second.
        time_ns: (N,) the moments, since the first pair.
    """

    def __init__(self, session: SessionSeries, rate: float | None = None) -> None:
        """Chooses the moments; see :func:`even_moments`.

        Raises:
            RecordingError: No frame has an S*.
        """
        self._rows = rows = with_fused(session)
        self._even = even_moments(rows, rate)
        self.rate, self.time_ns = self._even.rate, self._even.time_ns
        self._filled = self._left = 0
        self._lasting = lasting(session)

    def parts(self) -> Iterator[tuple[slice, NDArray[np.float64], NDArray[np.bool_]]]:
        """Which moments; S*, (N, J, 3) metres in K_A's frame; and (N,) whether there is one.

        S* is NaN in longer gaps and where a joint was never seen.
        """
        times, fused, never = self._rows.time_ns, self._rows.fused, self._rows.never_seen
        self._filled = self._left = 0
        for part in parts(len(self.time_ns)):
            wanted = self.time_ns[part]
            at = positions_at(self._rows, wanted)
            gap = np.flatnonzero(~np.isfinite(at).all(axis=(1, 2)))
            if len(gap):
                reach = round(1e9 * _LONGEST_GAP)
                first, last = np.searchsorted(times, [wanted[0] - reach, wanted[-1] + reach])
                near = first + np.flatnonzero(np.isfinite(fused[first:last]).all(axis=(1, 2)))
                at[gap] = positions_at(self._rows[near], wanted[gap], _LONGEST_GAP)
            at = self._lasting(at)
            known = np.isfinite(at[:, self._rows.body.root, 0])
            left = int(np.count_nonzero(~known))
            self._left, self._filled = self._left + left, self._filled + len(gap) - left
            at[:, never] = np.nan
            yield part, at, known

    def in_words(self, otherwise: str) -> str:
        """The frames, and what was done in gaps, once all parts were taken.

        Args:
            otherwise: What was done in longer ones.
        """
        words = self._even.in_words
        if self._filled:
            words += f"; {self._filled} of them interpolated over gaps of up to {_LONGEST_GAP} s"
        return f"{words}; {self._left} in longer gaps {otherwise}" if self._left else words


def y_up(positions: NDArray[np.float64]) -> NDArray[np.float64]:
    """(…, 3) from K_A's frame (x right, y down, z forward) to x right, y up, z towards the sensor."""
    return np.asarray(positions * np.array([1.0, -1.0, -1.0]))


def y_up_rotations(quaternions: NDArray[np.float64]) -> NDArray[np.float64]:
    """(…, 4) quaternions x, y, z, w of the same rotations, between the axes that :func:`y_up` converts."""
    return np.asarray(quaternions * np.array([1.0, -1.0, -1.0, 1.0]))
