"""The offset between a session's clock and that of motion capture, from the motion that both show.

The offset δ is added to the truth's times; where the truth's clock is fast by f, its times since its first
frame are divided by 1 + f before. τ(t) is the truth's time at t. A joint is at p(t) in a view and at q(τ) in
the truth, R turns the truth's frame to the view's, and h is a tenth of a second. Displacements hardly depend
on how a joint is defined: m = p(t + h) − p(t − h) and e = R (q(τ(t + h)) − q(τ(t − h))), with the derivatives
J of e by δ and f.

1. The joints' speeds, which need no R, give candidates for δ.
2. From each, Gauss-Newton steps minimise the errors r = m − e: R is fitted anew, and δ changes by
   (Σ w JᵀJ)⁻¹ Σ w Jᵀr, where w = (1 + (|r| / c)²)⁻² and c is 1.5 times the median of |r|.
3. The standard deviation of δ is that of the jackknife: the last step without each eighth of the session.
4. Those at which the registered views match best are the offset and, if the movement repeats itself, others.
5. δ and f are refined together, from the middle of the session outwards. f is 0 where it is not certain.
6. S* is refined from there. It must correlate, by Σ m · e / √(Σ |m|² Σ |e|²), and shows its lag.
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
from fusion.support.types import Array
from recordings.comparing.joint_path import JointPath, Joints

Ints = NDArray[np.int64]

_SEARCH_RATE = 60.0  # Hz of the truth in the search of the offset
_HALF_SPAN = 0.1  # seconds before and after, between which a displacement is measured
_STEPS, _STEPS_OF_SPEED = 5, 20
_SMALL = np.array([1e-5, 1e-6])  # a last step of δ, seconds, and of f
_FITTED = 250  # frames that the rotation is fitted to
_MOST = 4000  # displacements of each joint, evenly over the session
_PARTS = 8  # of the session, for the jackknife
_LEAST_CORRELATION = 0.8  # of displacements; other movements reach 0.7, seldom 0.85; right ones 0.97
_FASTEST = 0.04  # f: a faster truth is another movement
_CERTAIN = 4.0  # standard deviations of f
_FIRST_HALF = 3.0  # seconds before and after the middle, in which f is found at first
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
    fast: float = 0.0  # share by which the truth's clock is fast; 0 where that is not certain
    fast_sd: float = float("nan")
    first: float = 0.0  # the truth's time from which on `fast` counts: that of its first frame

    def truth_times(self, seconds: Array) -> Array:
        """The truth's times at times of the session."""
        return np.asarray(self.first + (seconds - self.seconds - self.first) * (1.0 + self.fast))

    def moved(self, later: float, fast: float, middle: float) -> TimeOffset:
        """The truth later by so many seconds at a time of the session, and with a clock of this speed."""
        elapsed = (middle - self.seconds - self.first) * (1.0 + self.fast) - later
        return replace(self, seconds=middle - self.first - elapsed / (1.0 + fast), fast=fast)

    @property
    def sure(self) -> bool:
        """Whether the person moves enough to tell the offset."""
        return self.sd_seconds <= _LARGEST_SD and abs(self.lag_seconds) <= _LARGEST_LAG

    def given(self, seconds: float) -> TimeOffset:
        """An offset that is given instead of this one; it keeps the speed of the clock where it is near."""
        if abs(seconds - self.seconds) < _CONTRADICTS:
            return TimeOffset(seconds, fast=self.fast, fast_sd=self.fast_sd, first=self.first)
        near = any(abs(seconds - other) < _CONTRADICTS for other in self.others)
        return TimeOffset(seconds, instead_of=self.seconds if self.sure and not near else float("nan"))


def find_offset(body: Body, views: Sequence[Joints], fused: Joints, truth: JointPath) -> TimeOffset | None:
    """The offset; None if none matches.

    Args:
        views: S_A and S_B, which decide: S* may lag behind them.
    """
    first = TimeOffset(0.0, first=float(truth.seconds[0]))
    span, true_span = (float(np.ptp(times)) for times in (fused.seconds, truth.seconds))
    even = first.first + np.arange(int(true_span * _SEARCH_RATE) + 1) / _SEARCH_RATE
    own, true = _view(fused), _view(Joints(even, truth.at(even)))
    # the search takes the frames of the first view, the shorter one, and adds nanoseconds to the second
    pair, ns = ((true, own), -1e9) if true_span < span else ((own, true), 1e9)
    refined = list[TimeOffset]()
    for candidate in part_offsets(body, *pair):
        found = _refined(views, truth, replace(first, seconds=candidate / ns))
        if found and all(abs(found.seconds - other.seconds) > _HALF_SPAN for other in refined):
            refined.append(found)
    equal = best_offsets(*pair, [round(found.seconds * ns) for found in refined])
    if not equal:
        return None
    found, *others = (refined[k] for k in equal)
    found = _with_speed(views, truth, found)
    of_fused = _refined([fused], truth, found)
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


def _with_speed(views: Sequence[Joints], truth: JointPath, near: TimeOffset) -> TimeOffset:
    """The offset with the speed of the truth's clock, where that is certain."""
    seen = np.concatenate([view.seconds for view in views])
    true_times = near.truth_times(seen)
    seen = seen[(true_times >= truth.seconds[0]) & (true_times <= truth.seconds[-1])]
    middle, found = 0.5 * float(seen.min() + seen.max()), near
    half = _FIRST_HALF
    while True:
        within = [np.abs(view.seconds - middle) <= half for view in views]
        parts = [
            Joints(view.seconds[some], view.positions[some]) for view, some in zip(views, within, strict=True)
        ]
        found = _refined(parts, truth, found, middle, 2) or found
        if abs(found.fast) - _FASTEST > _CERTAIN * found.fast_sd:
            return near
        if all(some.all() for some in within):
            break
        half *= 2.0
    found = replace(found, fast_sd=max(found.fast_sd, 2.0 * _LEAST_SD / float(np.ptp(seen))))
    certain = _CERTAIN * found.fast_sd < abs(found.fast) < _FASTEST
    return found if certain else near


def _refined(
    views: Sequence[Joints], truth: JointPath, near: TimeOffset, middle: float = 0.0, count: int = 1
) -> TimeOffset | None:
    """The offset near another one, its standard deviation and the correlation: steps 2 and 3.

    None if the joints that each view has in common with the truth determine no rotation.

    Args:
        middle: Time of the session at which the offset's standard deviation is that of the result.
        count: 1: δ is fitted; 2: δ and f.
    """
    for _ in range(_STEPS if count == 1 else _STEPS_OF_SPEED):
        of_views = []
        for view in views:
            with suppress(CalibrationError):
                of_views.append(_displacements(view, truth, near, middle))
        if not any(len(moved) for moved, *_ in of_views):
            return None
        moved, expected, slopes, part = (np.concatenate(each) for each in zip(*of_views, strict=True))
        errors = moved - expected
        apart = np.linalg.norm(errors, axis=1)
        weights = 1.0 / (1.0 + (apart / max(1.5 * float(np.median(apart)), 1e-9)) ** 2) ** 2
        slopes = slopes[:, :count]  # (N, count, 3)
        gradient, curvature = np.zeros((_PARTS, count)), np.zeros((_PARTS, count, count))
        np.add.at(gradient, part, weights[:, None] * np.einsum("nix,nx->ni", slopes, errors))
        np.add.at(curvature, part, weights[:, None, None] * np.einsum("nix,njx->nij", slopes, slopes))
        least = 1e-12 * np.eye(count)
        change = np.linalg.solve(curvature.sum(axis=0) + least, gradient.sum(axis=0))
        fast = near.fast + float(change[1]) if count == 2 else near.fast
        near = near.moved(float(change[0]), fast, middle)
        if (np.abs(change) < _SMALL[:count]).all():
            break
    others = np.linalg.solve(
        curvature.sum(axis=0) - curvature + least, (gradient.sum(axis=0) - gradient)[..., None]
    )[..., 0]
    sd = _CORRELATED * np.sqrt((_PARTS - 1) * np.mean((others - change) ** 2, axis=0))
    return replace(
        near,
        sd_seconds=max(float(sd[0]), _LEAST_SD),
        fast_sd=float(sd[1]) if count == 2 else near.fast_sd,
        correlation=_correlation(moved, expected),
    )


def correlation_at(fused: Joints, truth: JointPath, offset: TimeOffset) -> float:
    """The correlation of the displacements at a given offset; NaN where they have too little in common."""
    with suppress(CalibrationError):
        moved, expected, *_ = _displacements(fused, truth, offset, 0.0)
        if len(moved):
            return _correlation(moved, expected)
    return float("nan")


def _correlation(moved: Array, expected: Array) -> float:
    return float(np.sum(moved * expected) / np.sqrt(np.sum(moved**2) * np.sum(expected**2)))


def _displacements(
    view: Joints, truth: JointPath, offset: TimeOffset, middle: float
) -> tuple[Array, Array, Array, Ints]:
    """(N, 3) m and e, and (N, 2, 3) derivatives of e by δ and f, of the joints and times of a view, and (N,)
    the part of the session."""
    if len(view.seconds) < 2:
        raise CalibrationError("Displacements need two frames.")
    step = max(1, round(_HALF_SPAN / max(float(np.median(np.diff(view.seconds))), 1e-3)))
    true_times = offset.truth_times(view.seconds)
    inside = (true_times >= truth.seconds[0]) & (true_times <= truth.seconds[-1])
    times, at, true_times = view.seconds[inside], view.positions[inside], true_times[inside]
    last = max(len(times) - 2 * step, 0)
    early = np.arange(0, last, last // _MOST + 1)
    late = early + 2 * step
    before, after = truth.at(true_times[early]), truth.at(true_times[late])
    common = np.flatnonzero(np.isfinite(at[early] + before).any(axis=(1, 2)))
    chosen = common[:: max(1, len(common) // _FITTED)]
    rotation = fit_recording(at[early[chosen]], before[chosen]).rotation
    expected = (after - before) @ rotation.T
    slow, fast = (truth.at(true_times[ends], 1) @ rotation.T for ends in (early, late))
    grown = [(times[ends] - middle)[:, None, None] * of for ends, of in ((early, slow), (late, fast))]
    slopes = np.stack([slow - fast, grown[1] - grown[0]], axis=2)
    moved = at[late] - at[early]
    known = np.isfinite(moved + expected).all(axis=2)
    known &= (times[late] - times[early] < 6.0 * _HALF_SPAN)[:, None]
    count = np.cumsum(known.any(axis=1))
    part = np.minimum(count * _PARTS // max(int(count.max(initial=0)), 1), _PARTS - 1)
    return moved[known], expected[known], slopes[known], np.broadcast_to(part[:, None], known.shape)[known]
