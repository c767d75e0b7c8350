"""Compares two fusions of one capture per frame: distance, noise and bone errors."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fusion.body import Body
from fusion.calibration.bone_lengths import bone_lengths_of
from fusion.clocks import median_interval, nearest_of
from recordings.data import layout
from recordings.data.frame_noise import frame_noise_of
from recordings.data.session_arrays import SessionArrays
from recordings.errors import RecordingError
from recordings.session_series import SessionSeries

_APART = 1.0  # minimum seconds between two listed worst moments


@dataclass(frozen=True, eq=False)
class Comparison:
    """The common frames of two sessions."""

    body: Body
    first: SessionArrays  # T frames of each session, at the same capture times
    second: SessionArrays

    @staticmethod
    def of(first: SessionSeries, second: SessionSeries, any_capture: bool = False) -> Comparison:
        """Finds the frames with equal capture times on A's own clock, or on B's where A has no frame.

        Args:
            any_capture: Whether to compare sessions of different captures, too: each frame with the one that
                is nearest in time since the first frame.

        Raises:
            RecordingError: The bodies differ, there is no common frame, or the skeletons S_A, S_B differ.
        """
        if first.body.name != second.body.name:
            raise RecordingError(
                f"{first} has body {first.body.name}, {second} has {second.body.name}: not the same capture."
            )
        if any_capture:
            times, other = first.rows.time_ns, second.rows.time_ns
            nearest = nearest_of(times, other)
            near = np.abs(other[nearest] - times) <= max(median_interval(times), median_interval(other)) // 2
            return Comparison(first.body, first.rows[np.flatnonzero(near)], second.rows[nearest[near]])
        _, i, j = np.intersect1d(_moments(first), _moments(second), return_indices=True)
        if len(i) == 0:
            raise RecordingError(
                f"{first} and {second} have no frame of the same time: not the same capture."
            )
        one, two = first.rows[np.sort(i).astype(np.int64)], second.rows[np.sort(j).astype(np.int64)]
        for t in np.flatnonzero(~_same_inputs(one, two))[:1]:
            raise RecordingError(
                f"{first} and {second} have {len(i)} frames of the same time, but S_A or S_B of "
                f"frame {one.frame[t]} differs from frame {two.frame[t]}: not the same capture."
            )
        return Comparison(first.body, one, two)

    def __len__(self) -> int:
        return len(self.first)

    @property
    def target(self) -> NDArray[np.float64]:
        """(2, J) bone lengths of the last calibration of each session, metres."""
        return np.stack([self.first.bone_lengths[-1], self.second.bone_lengths[-1]])

    @cached_property
    def apart(self) -> NDArray[np.float64]:
        """(T, J) distance between the two S*, metres; NaN if one is missing."""
        return np.asarray(np.linalg.norm(self.first.fused - self.second.fused, axis=2))

    @property
    def one_missing(self) -> int:
        """Number of frames in which only one session has an S*."""
        present = [np.isfinite(of.fused).all(axis=(1, 2)) for of in (self.first, self.second)]
        return int(np.count_nonzero(present[0] != present[1]))

    @cached_property
    def frame_noise(self) -> NDArray[np.float64]:
        """(2, J) metres: see :func:`recordings.data.frame_noise.frame_noise_of`."""
        return np.stack([frame_noise_of(of.fused, of.time_ns) for of in (self.first, self.second)])

    @cached_property
    def bone_deviation(self) -> NDArray[np.float64]:
        """(2, J) largest error of each bone length, metres, indexed by the child joint."""
        off = [bone_lengths_of(self.body, of.fused) - of.bone_lengths for of in (self.first, self.second)]
        return largest(np.abs(off), axis=1)

    @cached_property
    def swapped(self) -> NDArray[np.bool_]:
        """(T, J) whether a joint and its mirrored joint match the other fusion better when swapped."""
        mirror = self.body.mirror
        one, two = self.first.fused, self.second.fused
        crossed = np.linalg.norm(one - two[:, mirror], axis=2)
        straight = self.apart + self.apart[:, mirror]
        with np.errstate(invalid="ignore"):
            return np.asarray((crossed + crossed[:, mirror] < straight) & self.body.sided)

    def worst(self, count: int) -> list[tuple[int, int]]:
        """(index of the common frame, joint) with the largest differences, at least a second apart, worst
        first."""
        largest_of = np.where(np.isnan(self.apart), -1.0, self.apart)
        found: list[tuple[int, int]] = []
        time = self.first.time_ns * 1e-9
        for t in np.argsort(-largest_of.max(axis=1), kind="stable").tolist():
            if len(found) == count or largest_of[t].max() <= 0.0:
                break
            if all(abs(time[t] - time[other]) >= _APART for other, _ in found):
                found.append((t, int(largest_of[t].argmax())))
        return found


def largest(values: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
    """The largest finite value along an axis; NaN if there is none."""
    found = np.where(np.isnan(values), -np.inf, values).max(axis=axis)
    return np.where(np.isinf(found), np.nan, found)


def _same_inputs(one: SessionArrays, two: SessionArrays) -> NDArray[np.bool_]:
    """(T,) whether S_A and S_B are bit-identical; replay and trim preserve them."""
    same = np.ones(len(one), dtype=np.bool_)
    for name in ("clock_b", "positions_a", "positions_b", "states_a", "states_b"):
        a, b = (getattr(of, name).reshape(len(one), -1) for of in (one, two))
        same &= ((a == b) | ((a != a) & (b != b))).all(axis=1)
    return same


def _moments(session: SessionSeries) -> NDArray[np.void]:
    """(T,) what identifies a frame also after a trim: a sensor, A where it has a frame, and its own time.

    A frame of neither sensor has the session's time.
    """
    rows = session.rows
    without_a = rows.clock_a == layout.NO_FRAME
    without_b = rows.clock_b == layout.NO_FRAME
    moments = np.empty(len(rows), dtype=[("sensor", np.int8), ("time_ns", np.int64)])
    moments["sensor"] = np.where(without_a, np.where(without_b, 2, 1), 0)
    moments["time_ns"] = np.where(without_a, np.where(without_b, rows.time_ns, rows.clock_b), rows.clock_a)
    return moments
