"""The clock of views of a person on that of a path of the same points, such as motion capture.

A joint is at p(t) in a view and at q(τ) on the path; τ(t) is t on the path's clock, R turns the path's frame
to the view's, and h is a tenth of a second. Displacements hardly depend on how a joint is defined:
m = p(t + h) − p(t − h) and e = R (q(τ(t + h)) − q(τ(t − h))), with the derivatives J of e by the clock's
offset and rate. Gauss-Newton steps minimise the errors r = m − e: R is fitted anew, and the clock changes by
(Σ w JᵀJ)⁻¹ Σ w Jᵀr, where w = (1 + (|r| / c)²)⁻² and c is 1.5 times the median of |r|. The standard deviation
is that of the jackknife: the last step without each eighth of the displacements.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion.body import Body
from fusion.clocks import Clock, Times
from fusion.clocks.search import (
    APART,
    FEWEST,
    GRID_NS,
    coefficients,
    correlate,
    frame_costs,
    is_better,
    largest_peaks,
    mean_costs,
    speed_signals,
)
from fusion.errors import CalibrationError
from fusion.pair_arrays import View
from fusion.registration.rigid_fit import fit_recording
from fusion.registration.sampled_motion import Sampling
from fusion.skeleton import TRACKED
from fusion.support.types import Array

_HALF_SPAN_NS = 100_000_000  # before and after, between which a displacement is measured
_APART_NS = 1_000_000  # between the positions that tell a velocity
_STEPS, _STEPS_OF_RATE = 5, 20
_SMALL = np.array([1e-5, 1e-6])  # a last step of the offset, seconds, and of the rate
_FITTED = 250  # displacements that the rotation is fitted to
_MOST = 400  # displacements of each joint, evenly over a view
_PARTS = 8  # for the jackknife
_CORRELATED = 2.0  # standard errors are larger by this factor, because neighbouring frames are alike
_LASTING_SD_NS = 1_500_000.0
"""Part of the deviation that the jackknife does not see: errors that follow a movement as long as it lasts.
Simulated walks before Kinect v2 are 2 ms late with every seed, other movements 1 ms (RMS)."""
_CERTAIN, _FASTEST = 4.0, 0.04  # standard deviations of a rate, and a rate that is of another movement
_FIRST_HALF_NS = 3_000_000_000  # before and after the middle, in which the rate is found at first
_PART_OVERLAP = 0.03  # where one may be a calm part of the other: a steady walk has 0.07 of its start
_EQUAL = 2.0  # times the least cost: a larger one is of other places
_AS_MANY = 0.9  # of the most frames that two views have in common
_PART_CANDIDATES = 32  # a walk repeats itself twice a second
_COARSE = 2.5  # cost at an offset that is not refined: a larger one is of other places


class Path(NamedTuple):
    """Points as a function of time, on a clock of their own."""

    first_ns: int
    last_ns: int
    positions: Callable[[Times], Array]
    """(T, J, 3) at (T,) times; NaN where unknown."""

    def velocities(self, time_ns: Times) -> Array:
        """(T, J, 3) m/s."""
        late, early = (self.positions(time_ns + step) for step in (_APART_NS, -_APART_NS))
        return np.asarray((late - early) / (2e-9 * _APART_NS))


class FittedClock(NamedTuple):
    """The clock of views on that of a path."""

    clock: Clock
    correlation: float  # of the displacements, Σ m · e / √(Σ |m|² Σ |e|²)


def part_offsets(body: Body, a: View, b: View) -> list[int]:
    """The times to add to B's clock, ns, at which one view may be a part of the other: candidates.

    All offsets at which the views overlap are searched; the largest correlation is first.
    """
    if min(len(a.time_ns), len(b.time_ns)) < FEWEST:
        return []
    base = int(a.time_ns[0] - b.time_ns[0])
    shifted = b._replace(time_ns=b.time_ns + base)
    reach_ns = int(max(np.ptp(a.time_ns), np.ptp(b.time_ns)))
    x, y, reach = speed_signals(body, a, shifted, reach_ns)
    product, power_x, power_y = sums = np.zeros((3, len(y) - len(x) + 1))
    for x_of, y_of in zip(x.T[..., None], y.T[..., None], strict=True):  # of a joint, to save memory
        known_x, known_y = np.isfinite(x_of).astype(float), np.isfinite(y_of).astype(float)
        x_of, y_of = np.nan_to_num(x_of), np.nan_to_num(y_of)
        # speeds about their means in what the views have in common, which may be a calm part of one
        count = np.maximum(correlate(known_x, known_y), 1.0)
        mean_x, mean_y = correlate(x_of, known_y) / count, correlate(known_x, y_of) / count
        sums[0] += correlate(x_of, y_of) - count * mean_x * mean_y
        sums[1] += correlate(x_of * x_of, known_y) - count * mean_x**2
        sums[2] += correlate(known_x, y_of * y_of) - count * mean_y**2
    r = coefficients(product, power_x, power_y, _PART_OVERLAP)
    offsets = [offset for offset, _ in largest_peaks(r, reach, _PART_CANDIDATES)]
    mean = [float(mean_costs(frame_costs(a, shifted, [offset]))[0]) for offset in offsets]
    most = max(_COARSE, min(mean, default=0.0))
    return [base + offset for offset, cost in zip(offsets, mean, strict=True) if cost <= most]


def best_offsets(a: View, b: View, offsets: Sequence[int]) -> list[int]:
    """The offsets at which the registered views match best.

    Returns:
        The indices of those that match about as well as the best one, as where a movement repeats itself.
        Those that are not certainly worse are first, and of them those with most frames in common.
    """
    costs = frame_costs(a, b, offsets)
    frames = np.isfinite(costs).sum(axis=1).tolist()
    if not (known := [k for k, count in enumerate(frames) if count >= FEWEST]):
        return []
    mean = mean_costs(costs)
    best = min(known, key=mean.__getitem__)
    near = [k for k in known if mean[k] < _EQUAL * mean[best]]
    worse = {k: k != best and is_better(costs[best], costs[k]) for k in near}
    enough = _AS_MANY * max(frames[k] for k in near if not worse[k])
    # the views' errors may make a repetition certainly worse; one so near to the best offset is none
    equal = [k for k in near if not worse[k] or abs(offsets[k] - offsets[best]) > APART * GRID_NS]
    return sorted(equal, key=lambda k: (worse[k], frames[k] < enough, mean[k]))


def fitted_clock(views: Sequence[View], path: Path, near: Clock, *, rate: bool = False) -> FittedClock | None:
    """The clock near another one; None if the views' joints and the path's determine no rotation.

    Args:
        views: On one clock.
        rate: Whether the rate is fitted, too, about the time at which ``near`` is set.
    """
    count = 2 if rate else 1
    for _ in range(_STEPS_OF_RATE if rate else _STEPS):
        of_views = []
        for view in views:
            with suppress(CalibrationError):
                of_views.append(_displacements(view, path, near))
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
        near = replace(near, offset_ns=near.offset_ns + 1e9 * float(change[0]))
        if rate:
            near = replace(near, rate_ppm=near.rate_ppm + 1e6 * float(change[1]))
        if (np.abs(change) < _SMALL[:count]).all():
            break
    others = np.linalg.solve(
        curvature.sum(axis=0) - curvature + least, (gradient.sum(axis=0) - gradient)[..., None]
    )[..., 0]
    sd = _CORRELATED * np.sqrt((_PARTS - 1) * np.mean((others - change) ** 2, axis=0))
    near = replace(near, sd_ns=float(np.hypot(1e9 * sd[0], _LASTING_SD_NS)))
    if rate:
        near = replace(near, rate_sd_ppm=1e6 * float(sd[1]))
    return FittedClock(near, _correlation(moved, expected))


def with_rate(views: Sequence[View], path: Path, near: Clock) -> Clock:
    """The clock with its rate, found from the middle outwards, where that is certain; else the same."""
    times = np.concatenate([view.time_ns for view in views])
    on_path = times + near.at(times)
    times = times[(on_path >= path.first_ns) & (on_path <= path.last_ns)]
    if not len(times):
        return near
    middle = int(times.min() + times.max()) // 2
    found, half = near.about(middle), _FIRST_HALF_NS
    while True:
        within = [np.flatnonzero(np.abs(view.time_ns - middle) <= half) for view in views]
        parts = [view.chosen(some) for view, some in zip(views, within, strict=True)]
        fit = fitted_clock(parts, path, found, rate=True)
        found = found if fit is None else fit.clock
        if 1e-6 * (abs(found.rate_ppm) - _CERTAIN * found.rate_sd_ppm) > _FASTEST:
            return near
        if all(len(some) == len(view.time_ns) for some, view in zip(within, views, strict=True)):
            break
        half *= 2
    least_sd_ppm = 2e6 * _LASTING_SD_NS / float(np.ptp(times))
    found = replace(found, rate_sd_ppm=max(found.rate_sd_ppm, least_sd_ppm))
    certain = _CERTAIN * found.rate_sd_ppm < abs(found.rate_ppm) < 1e6 * _FASTEST
    return found if certain else near


def correlation_at(view: View, path: Path, clock: Clock) -> float:
    """The correlation of the displacements by a clock; NaN where they have too little in common."""
    with suppress(CalibrationError):
        moved, expected, *_ = _displacements(view, path, clock)
        if len(moved):
            return _correlation(moved, expected)
    return float("nan")


def _correlation(moved: Array, expected: Array) -> float:
    return float(np.sum(moved * expected) / np.sqrt(np.sum(moved**2) * np.sum(expected**2)))


def _displacements(view: View, path: Path, clock: Clock) -> tuple[Array, Array, Array, NDArray[np.int64]]:
    """(N, 3) m and e, and (N, 2, 3) derivatives of e by offset and rate, of the joints and times of a view,
    and (N,) its part."""
    if len(view.time_ns) < 2:
        raise CalibrationError("Displacements need two frames.")
    step = max(1, round(_HALF_SPAN_NS / Sampling.of(view.time_ns).interval_ns))
    on_path = view.time_ns + clock.at(view.time_ns)
    inside = np.flatnonzero((on_path >= path.first_ns) & (on_path <= path.last_ns))
    last = max(len(inside) - 2 * step, 0)
    early = np.arange(0, last, last // _MOST + 1)
    ends = inside[early], inside[early + 2 * step]
    times = [view.time_ns[end] for end in ends]
    own = [
        np.where((view.states[end] == TRACKED)[..., None], view.positions[end], np.nan).astype(np.float64)
        for end in ends
    ]
    before, after = (path.positions(on_path[end]) for end in ends)
    common = np.flatnonzero(np.isfinite(own[0] + before).any(axis=(1, 2)))
    chosen = common[:: max(1, len(common) // _FITTED)]
    rotation = fit_recording(own[0][chosen], before[chosen]).rotation
    expected, moved = (after - before) @ rotation.T, own[1] - own[0]
    slow, fast = (path.velocities(on_path[end]) @ rotation.T for end in ends)
    since = [1e-9 * (of - clock.set_ns)[:, None, None] for of in times]
    slopes = np.stack([fast - slow, since[1] * fast - since[0] * slow], axis=2)
    known = np.isfinite(moved + expected + slopes.sum(axis=2)).all(axis=2)
    known &= (times[1] - times[0] < 6 * _HALF_SPAN_NS)[:, None]
    count = np.cumsum(known.any(axis=1))
    part = np.minimum(count * _PARTS // max(int(count.max(initial=0)), 1), _PARTS - 1)
    return moved[known], expected[known], slopes[known], np.broadcast_to(part[:, None], known.shape)[known]
