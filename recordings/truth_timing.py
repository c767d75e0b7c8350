"""The offset between a session's clock and that of motion capture, from the motion that both show.

The offset δ is added to the truth's times. A joint is at p(t) in a view and at q(t) in the truth, R turns
the truth's frame to the view's, and h is a tenth of a second. Displacements hardly depend on how a joint is
defined: m = p(t + h) − p(t − h) and e = R (q(t − δ + h) − q(t − δ − h)), with e' its derivative by δ.

1. The joints' speeds, which need no R, give candidates for δ.
2. From each, Gauss-Newton steps minimise the errors r = m − e: R is fitted anew, and δ changes by
   Σ w r · e' / Σ w |e'|², where w = (1 + (|r| / c)²)⁻² and c is 1.5 times the median of |r|.
3. The standard deviation of δ is that of the jackknife: the last step without each eighth of the session.
4. Those at which the registered views match best are the offset and, if the movement repeats itself, others.
5. S* is refined from there. It must correlate, by Σ m · e / √(Σ |m|² Σ |e|²), and shows its lag.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fusion.body import Body
from fusion.errors import CalibrationError
from fusion.pair_arrays import View
from fusion.registration.clock_search import best_offsets, part_offsets
from fusion.registration.rigid_fit import fit_recording
from fusion.skeleton import TRACKED
from recordings.joint_path import Array, JointPath, Joints

Ints = NDArray[np.int64]

_SEARCH_RATE = 60.0  # Hz of the truth in the search of the offset
_HALF_SPAN = 0.1  # seconds before and after, between which a displacement is measured
_STEPS = 5
_FITTED = 250  # frames that the rotation is fitted to
_PARTS = 8  # of the session, for the jackknife
_LEAST_CORRELATION = 0.6  # of displacements; other movements reached 0.5, the right one 0.8 at least
_LARGEST_SD, _LARGEST_LAG = 0.015, 0.050  # seconds: the person moves too little to tell
_CONTRADICTS = 0.020  # seconds between a given offset and one by the motion
_CORRELATED = 2.0  # standard errors are larger by this factor, because neighbouring frames are alike
_LEAST_SD = 0.001  # seconds: the RMS error on eight simulated sessions was 0.8 ms


@dataclass(frozen=True)
class TimeOffset:
    """When the truth begins on the session's clock."""

    seconds: float  # add it to the truth's times
    sd_seconds: float = float("nan")  # by the jackknife; NaN where the offset was given
    correlation: float = float("nan")  # of the displacements of S* and of the truth
    lag_seconds: float = float("nan")  # by which S* is behind S_A and S_B, which decide
    others: tuple[float, ...] = ()  # that match about as well, because the movement repeats itself
    instead_of: float = float("nan")  # the offset by the motion, where the given one contradicts it

    @property
    def sure(self) -> bool:
        """Whether the person moves enough to tell the offset."""
        return self.sd_seconds <= _LARGEST_SD and abs(self.lag_seconds) <= _LARGEST_LAG

    def given(self, seconds: float) -> TimeOffset:
        """An offset that is given instead of this one."""
        near = min(abs(seconds - each) for each in (self.seconds, *self.others)) < _CONTRADICTS
        return TimeOffset(seconds, instead_of=self.seconds if self.sure and not near else float("nan"))


def find_offset(body: Body, views: Sequence[Joints], fused: Joints, truth: JointPath) -> TimeOffset | None:
    """The offset; None where none matches.

    Args:
        views: S_A and S_B, which decide: S* may lag behind them.
    """
    span, true_span = (float(np.ptp(times)) for times in (fused.seconds, truth.seconds))
    even = truth.seconds[0] + np.arange(int(true_span * _SEARCH_RATE) + 1) / _SEARCH_RATE
    own, true = _view(fused), _view(Joints(even, truth.at(even)))
    # the search takes the frames of the first view, the shorter one, and adds nanoseconds to the second
    pair, ns = ((true, own), -1e9) if true_span < span else ((own, true), 1e9)
    refined = list[TimeOffset]()
    for candidate in part_offsets(body, *pair):
        found = _refined(views, truth, candidate / ns)
        if found and all(abs(found.seconds - other.seconds) > _HALF_SPAN for other in refined):
            refined.append(found)
    equal = best_offsets(*pair, [round(found.seconds * ns) for found in refined])
    if not equal:
        return None
    found, *others = (refined[k] for k in equal)
    of_fused = _refined([fused], truth, found.seconds)
    if of_fused is None or of_fused.correlation < _LEAST_CORRELATION:
        return None
    lag, elsewhere = of_fused.seconds - found.seconds, tuple(other.seconds for other in others)
    return replace(found, correlation=of_fused.correlation, lag_seconds=lag, others=elsewhere)


def _view(joints: Joints) -> View:
    known = np.asarray(np.isfinite(joints.positions).all(axis=2))
    seen = np.flatnonzero(known.any(axis=1))
    states = np.where(known[seen], TRACKED, 0).astype(np.uint8)
    times = np.rint(1e9 * joints.seconds[seen]).astype(np.int64)
    return View(times, joints.positions[seen].astype(np.float32), states)


def _refined(views: Sequence[Joints], truth: JointPath, offset: float) -> TimeOffset | None:
    """The offset near another one, its standard deviation and the correlation: steps 2 and 3.

    None where the joints that each view has in common with the truth determine no rotation.
    """
    for _ in range(_STEPS):
        of_views = []
        for view in views:
            with suppress(CalibrationError):
                of_views.append(_displacements(view, truth, offset))
        if not any(len(moved) for moved, *_ in of_views):
            return None
        moved, expected, slopes, part = (np.concatenate(each) for each in zip(*of_views, strict=True))
        errors = moved - expected
        apart = np.linalg.norm(errors, axis=1)
        weights = 1.0 / (1.0 + (apart / max(1.5 * float(np.median(apart)), 1e-9)) ** 2) ** 2
        top = np.bincount(part, weights * np.sum(errors * slopes, axis=1), _PARTS)
        bottom = np.bincount(part, weights * np.sum(slopes * slopes, axis=1), _PARTS)
        change = float(top.sum() / max(bottom.sum(), 1e-12))
        offset += change
        if abs(change) < 1e-5:
            break
    others = (top.sum() - top) / np.maximum(bottom.sum() - bottom, 1e-12)
    sd = _CORRELATED * float(np.sqrt((_PARTS - 1) * np.mean((others - change) ** 2)))
    correlation = float(np.sum(moved * expected) / np.sqrt(np.sum(moved**2) * np.sum(expected**2)))
    return TimeOffset(offset, max(sd, _LEAST_SD), correlation=correlation)


def _displacements(view: Joints, truth: JointPath, offset: float) -> tuple[Array, Array, Array, Ints]:
    """(N, 3) m, e and e' of the joints and times of a view, and (N,) the part of the session."""
    step = max(1, round(_HALF_SPAN / max(float(np.median(np.diff(view.seconds))), 1e-3)))
    first, last = truth.seconds[[0, -1]] + offset
    inside = (view.seconds >= first) & (view.seconds <= last)
    times, at = view.seconds[inside], view.positions[inside]
    true = truth.at(times - offset)
    common = np.flatnonzero(np.isfinite(at + true).any(axis=(1, 2)))
    chosen = common[:: max(1, len(common) // _FITTED)]
    rotation = fit_recording(at[chosen], true[chosen]).rotation
    early, late = times[: -2 * step] - offset, times[2 * step :] - offset
    expected, slope = ((truth.at(late, d) - truth.at(early, d)) @ rotation.T for d in (0, 1))
    moved = at[2 * step :] - at[: -2 * step]
    known = np.isfinite(moved + expected).all(axis=2) & (late - early < 6.0 * _HALF_SPAN)[:, None]
    count = np.cumsum(known.any(axis=1))
    part = np.minimum(count * _PARTS // max(int(count.max(initial=0)), 1), _PARTS - 1)
    return moved[known], expected[known], -slope[known], np.broadcast_to(part[:, None], known.shape)[known]
