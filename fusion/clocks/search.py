"""The offset between the clocks of two recordings, up to half a minute, before their frames are paired.

The speed of a joint is the same in every frame of reference, so the views need no registration. The speeds
are correlated at all offsets. The largest peaks are candidates; a rigid registration of the views at each
tells which one puts the person in the same place.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion.body import Body
from fusion.clocks import Clock
from fusion.pair_arrays import View
from fusion.registration.rigid_fit import robust_fits, sum_of_coordinates
from fusion.registration.sampled_motion import Interpolation, Sampling
from fusion.rigid import RigidTransform
from fusion.skeleton import TRACKED
from fusion.support.types import Array

_REACH_NS = 30_000_000_000
GRID_NS = 33_333_333
_LONGEST_SPAN_NS = 1_200_000_000_000
_FASTEST = 8.0  # m/s: a faster joint has jumped
_STILL = 0.1  # m/s: slower motion is mostly noise
_OVERLAP = 0.35  # least share of either view's motion that a peak is based on
_CANDIDATES = 6
_LEAST_CORRELATION = 0.2
_AMBIGUOUS = 1.6  # a candidate whose 1 - r is smaller by this factor is right where the places do not tell
_LESS = 0.9  # of the mean cost of any other candidate, and without an offset, where it is uncertain
_STEP_NS, _STEPS = 16_666_667, 8  # of the fine search, down to 15 frames per second
_STEP = 0.25  # usual intervals: the same below that
_PARTS = 8  # of the recording
_LASTING_SD_NS = 8_000_000.0
"""Part of the deviation that the jackknife does not see: errors that follow the motion as long as it is."""
APART = 9  # grid steps between two peaks
_COMMON_NS = 5_000_000_000  # at an offset beyond that: squats take 3 s, and their repetitions look alike
_MOST_SD = 0.75  # of the longer interval, or of a grid step: where the parts of a recording contradict
COMPARED = 192  # frames
FEWEST, _FEWEST_JOINTS = 24, 5
_FFT = 1024  # a multiple of it has no large prime factors, with which a transform takes longer
_FAR = 0.05  # metres: a joint's distance beyond this counts less and less
_CERTAIN = 3.0  # standard errors by which a candidate must be better than any other
_CORRELATED = 2.0  # standard errors are larger by this factor, because neighbouring frames are alike


def find_clock_offset(body: Body, a: View, b: View) -> Clock | None:
    """The time to add to B's clock so that both views show one motion; None where the motion does not tell.

    Args:
        a, b: The frames in which the person is seen. Where their times do not overlap, the search begins with
            equal first times.
    """
    if min(len(a.time_ns), len(b.time_ns)) < FEWEST:
        return None
    of_a, of_b = a.time_ns, b.time_ns
    apart = of_b[0] > of_a[-1] or of_a[0] > of_b[-1]
    base = int(of_a[0] - of_b[0]) if apart else 0
    # the middle of what both saw is enough
    first, last = max(of_a[0], of_b[0] + base), min(of_a[-1], of_b[-1] + base)
    middle = first + (last - first) // 2  # a sum could exceed 64 bits
    a = a.chosen(np.flatnonzero(np.abs(a.time_ns - middle) < _LONGEST_SPAN_NS // 2))
    if len(a.time_ns) < FEWEST:
        return None
    times, reach = b.time_ns + base, _REACH_NS + 1_000_000_000
    within = np.flatnonzero((times > a.time_ns[0] - reach) & (times < a.time_ns[-1] + reach))
    shifted = b.chosen(within)._replace(time_ns=times[within])
    peaks = _peaks(body, a, shifted, () if apart else (0,))
    if len(peaks) == (not apart):
        return None
    offsets = [offset if offset == 0 else _near(a, shifted, offset) for offset, _ in peaks]
    costs = frame_costs(a, shifted, offsets)  # (candidates, frames)
    if not (known := np.isfinite(costs).sum(axis=1) >= FEWEST).any():
        return None
    means = np.where(known, mean_costs(costs), np.inf)
    best = int(np.argmin(means))
    least_ns = 0.0
    for other in np.flatnonzero(known):
        if other == best or is_better(costs[best], costs[other]):
            continue
        mismatch = [1.0 - peaks[k][1] for k in (other, best)]
        if abs(offsets[other] - offsets[best]) < APART * GRID_NS:  # both lead to one minimum
            if offsets[other] == 0:  # views of one moment show offsets below a frame, too
                least_ns = float(np.median(np.diff(a.time_ns)))
        elif mismatch[0] < _AMBIGUOUS * mismatch[1] or means[best] > _LESS * means[other]:
            return None
    found = refined_offset(a, shifted, offsets[best], base)
    if found is None or abs(found.offset_ns - base) < least_ns:
        return None
    every_a, every_b = (float(np.median(np.diff(view.time_ns))) for view in (a, shifted))
    elsewhere = abs(offsets[best]) >= APART * GRID_NS  # it may be a repetition of what one view lacks
    if elsewhere and np.isfinite(costs[best]).mean() * len(a.time_ns) * every_a < _COMMON_NS:
        return None
    # equal first times, where the clocks are apart, are no evidence
    if (elsewhere or apart) and found.sd_ns > _MOST_SD * max(every_a, every_b, GRID_NS):
        return None
    return found


def agreement(body: Body, a: View, b: View) -> tuple[int, Array]:
    """The offset, ns, at which the registered views agree best, and the frames' penalties there."""
    offsets = [_near(a, b, offset) for offset, _ in _peaks(body, a, b, (0,))]
    costs = frame_costs(a, b, offsets)
    frames = np.isfinite(costs).sum(axis=1)
    best = int(np.argmin(np.where(2 * frames >= frames.max(), mean_costs(costs), np.inf)))
    return offsets[best], np.asarray(costs[best])


def placement_at(a: View, b: View) -> RigidTransform:
    """The placement ``a_from_b`` of two views."""
    chosen = np.linspace(0, len(a.time_ns) - 1, COMPARED).astype(np.int64)
    p, q = _tracked(a, chosen), _at_times(b, a.time_ns[None, chosen])
    R, t = robust_fits(p.reshape(1, -1, 3), q.reshape(1, -1, 3))
    return RigidTransform(R[0], t[0])


def placed_costs(
    body: Body, own: View, other: View, other_from_own: RigidTransform, shifts_ns: NDArray[np.int64]
) -> Array:
    """(K, COMPARED) penalties of frames of a view, moved by K times, under one placement; NaN without the
    other. They are of midpoints, which an exchange of left and right does not move."""
    left, right = body.midpoints
    chosen = np.linspace(0, len(own.time_ns) - 1, COMPARED).astype(np.int64)
    p = other_from_own.apply(_tracked(own, chosen))
    p = 0.5 * (p[:, left] + p[:, right])
    costs = []
    for shift in shifts_ns.tolist():
        q = _at_times(other, own.time_ns[None, chosen] + shift)[0]
        penalty = np.log1p(sum_of_coordinates((p - 0.5 * (q[:, left] + q[:, right])) ** 2) / _FAR**2)
        known = np.isfinite(penalty)
        count = known.sum(axis=1)
        sums = np.where(known, penalty, 0.0).sum(axis=1)
        costs.append(np.where(count >= 3, sums / np.maximum(count, 1), np.nan))
    return np.array(costs)


def candidates(body: Body, a: View, b: View) -> tuple[float, list[tuple[int, float]]]:
    """How far apart the registered views are, metres, as they are, and at each offset, ns, at which they may
    be nearer, the best one first: where the motion does not tell."""
    if min(len(a.time_ns), len(b.time_ns)) < FEWEST:
        return np.nan, []
    apart = b.time_ns[0] > a.time_ns[-1] or a.time_ns[0] > b.time_ns[-1]
    base = int(a.time_ns[0] - b.time_ns[0]) if apart else 0
    shifted = b._replace(time_ns=b.time_ns + base)
    offsets = [_near(a, shifted, offset) for offset, _ in _peaks(body, a, shifted, (0,))]
    squared = _squared(a, shifted, [-base, *offsets])
    metres = [
        float(np.sqrt(np.median(each[np.isfinite(each)]))) if np.isfinite(each).any() else np.nan
        for each in squared
    ]
    enough = np.isfinite(squared).any(axis=2).sum(axis=1) >= FEWEST
    found = [(base + o, m) for o, m, known in zip(offsets, metres[1:], enough[1:], strict=True) if known]
    return metres[0], sorted(found, key=lambda one: one[1])


def _near(a: View, b: View, offset: int) -> int:
    """The offset within two steps at which the registered views differ least: peaks are some frames off."""
    offsets = [offset + k * GRID_NS for k in (-2, -1, 0, 1, 2)]
    return offsets[int(np.argmin(mean_costs(frame_costs(a, b, offsets))))]


def refined_offset(a: View, b: View, near_ns: int, base_ns: int, steps: int = _STEPS) -> Clock | None:
    """The offset nearby at which the registered views differ least, its deviation by the jackknife."""
    step_ns = max(_STEP_NS, round(_STEP * max(Sampling.of(view.time_ns).interval_ns for view in (a, b))))
    offsets = near_ns + step_ns * np.arange(-steps, steps + 1)
    costs = frame_costs(a, b, offsets.tolist())
    part = np.arange(COMPARED) * _PARTS // COMPARED
    best = _minimum(costs)
    others = np.array([_minimum(costs[:, part != k]) for k in range(_PARTS)])
    if not 0.0 < best < 2.0 * steps:
        return None  # no offset nearby is better than all others
    sd = np.sqrt((_PARTS - 1) * np.mean((others - best) ** 2))
    return Clock(base_ns + float(offsets[0] + best * step_ns), float(np.hypot(sd * step_ns, _LASTING_SD_NS)))


def _minimum(costs: Array) -> float:
    """The row at which the mean cost is least, between rows by a parabola.

    The noise of interpolated frames depends on how far their neighbours are. At 30 and 90 frames per second
    it alternates from row to row, which the mean of neighbouring rows takes away.
    """
    rows = np.pad(mean_costs(costs), 1, mode="edge")
    means = 0.25 * (rows[:-2] + 2.0 * rows[1:-1] + rows[2:])
    k = int(np.argmin(means))
    return k + vertex(-means[max(k - 1, 0) : k + 2])


def _peaks(body: Body, a: View, b: View, besides: tuple[int, ...]) -> list[tuple[int, float]]:
    """The largest correlations of the speeds: offset in ns, and r; and those at the offsets ``besides``."""
    x, y, reach = speed_signals(body, a, b, _REACH_NS)
    known_x, known_y = np.isfinite(x).astype(float), np.isfinite(y).astype(float)
    x, y = np.nan_to_num(x), np.nan_to_num(y)
    product, power_x, power_y = (
        correlate(first, second) for first, second in ((x, y), (x * x, known_y), (known_x, y * y))
    )
    r = coefficients(product, power_x, power_y, _OVERLAP)
    return [(offset, float(r[reach - offset // GRID_NS])) for offset in besides] + largest_peaks(
        r, reach, _CANDIDATES
    )


def speed_signals(body: Body, a: View, b: View, reach_ns: int) -> tuple[Array, Array, int]:
    """The speeds of A, and of B from ``reach`` steps before to ``reach`` after."""
    reach = reach_ns // GRID_NS
    count = int((a.time_ns[-1] - a.time_ns[0]) // GRID_NS) + 1
    grid = a.time_ns[0] + GRID_NS * np.arange(-reach, count + reach)
    return _speeds(body, a, grid[reach : reach + count]), _speeds(body, b, grid), reach


def coefficients(product: Array, power_x: Array, power_y: Array, overlap: float) -> Array:
    """The correlation at each offset; -inf where less than a share of either motion is in common."""
    enough = (power_x > overlap * power_x.max()) & (power_y > overlap * power_y.max())
    return np.where(enough, product / np.sqrt(np.where(enough, power_x * power_y, 1.0)), -np.inf)


def largest_peaks(r: Array, reach: int, count: int) -> list[tuple[int, float]]:
    """The offsets in ns of the largest peaks, and r."""
    peaks, r = [], r.copy()
    for _ in range(count):
        k = int(np.argmax(r))
        if r[k] < _LEAST_CORRELATION:
            break
        peaks.append((round((reach - k - vertex(r[max(k - 1, 0) : k + 2])) * GRID_NS), float(r[k])))
        r[max(k - APART, 0) : k + APART + 1] = -np.inf
    return peaks


def vertex(r: Array) -> float:
    """Where a parabola through three values has its maximum, in steps from the middle one."""
    if len(r) < 3 or not np.isfinite(r).all():
        return 0.0
    curvature = r[0] - 2.0 * r[1] + r[2]
    return float(0.5 * (r[0] - r[2]) / curvature) if curvature < 0.0 else 0.0


def correlate(x: Array, y: Array) -> Array:
    """The sum over the signals of Σ x_n y_{n+k}, for each k at which x lies within y."""
    size = -(-(len(x) + len(y)) // _FFT) * _FFT
    spectrum = np.conj(np.fft.rfft(x, size, axis=0)) * np.fft.rfft(y, size, axis=0)
    return np.asarray(np.fft.irfft(spectrum.sum(axis=1), size)[: len(y) - len(x) + 1])


def _speeds(body: Body, view: View, grid: NDArray[np.int64]) -> Array:
    """(N, M) log speeds about their means, which an exchange of left and right does not change; NaN unknown.

    They are the speeds of midline joints and of midpoints, and the mean speeds of left and right joints.
    """

    def of(joint: int) -> Array:  # all joints of a long recording take too much memory
        return _tracked(view, np.s_[:, joint])

    fresh = np.arange(len(view.time_ns)) == 0
    for at in map(of, range(len(body))):
        fresh[1:] |= ((at[1:] != at[:-1]) & np.isfinite(at[1:])).any(axis=1)
    time_ns, pairs = view.time_ns[fresh], np.stack(body.midpoints, axis=1).tolist()
    sampling = Sampling.of(time_ns)
    speeds = [_speed(time_ns, 0.5 * (of(own) + of(other))[fresh], sampling) for own, other in pairs]
    for own, other in pairs:
        if own != other:
            each = [_speed(time_ns, of(joint)[fresh], sampling) for joint in (own, other)]
            speeds.append(0.5 * (each[0] + each[1]))
    signals = np.full((len(grid), len(speeds)), np.nan)
    for signal, speed in zip(signals.T, speeds, strict=True):
        known = np.flatnonzero(np.isfinite(speed))
        if len(known) < FEWEST:
            continue
        times = time_ns[known]
        after = np.clip(np.searchsorted(times, grid), 1, len(times) - 1)
        inside = (grid >= times[0]) & (grid <= times[-1])
        inside &= times[after] - times[after - 1] < sampling.gap_ns
        signal[inside] = np.interp(grid[inside], times, np.log(_STILL + speed[known]))
        signal -= np.nanmean(signal) if inside.any() else 0.0
    return signals


def _speed(time_ns: NDArray[np.int64], at: Array, sampling: Sampling) -> Array:
    """(T,) m/s of (T, 3)."""
    speed, reach = np.full(len(at), np.nan), sampling.reach
    elapsed = time_ns[2 * reach :] - time_ns[: -2 * reach]
    moved = np.linalg.norm(at[2 * reach :] - at[: -2 * reach], axis=1)
    speed[reach:-reach] = moved / (1e-9 * np.maximum(elapsed, 1))
    speed[reach:-reach][elapsed > sampling.span_ns] = np.nan
    speed[speed > _FASTEST] = np.nan
    return speed


def frame_costs(a: View, b: View, offsets_ns: Sequence[int]) -> Array:
    """(K, COMPARED) mean robust penalty of the joints of registered views at K offsets, by frames of A; NaN
    without B."""
    penalty = np.log1p(_squared(a, b, offsets_ns) / _FAR**2)
    known = np.isfinite(penalty)
    count = known.sum(axis=2)
    sums = np.where(known, penalty, 0.0).sum(axis=2)
    return np.asarray(np.where(count > 0, sums / np.maximum(count, 1), np.nan))


def _squared(a: View, b: View, offsets_ns: Sequence[int]) -> Array:
    """(K, COMPARED, J) squared distances of the joints of registered views at K offsets."""
    chosen = np.linspace(0, len(a.time_ns) - 1, COMPARED).astype(np.int64)
    p = _tracked(a, chosen)
    if not offsets_ns:
        return np.zeros((0, *p.shape[:2]))
    q = _at_times(b, a.time_ns[chosen] - np.array(offsets_ns, dtype=np.int64)[:, None])
    seen = np.isfinite(sum_of_coordinates(p + q)).sum(axis=2) >= _FEWEST_JOINTS
    q[~seen] = np.nan
    R, t = robust_fits(p.reshape(1, -1, 3), q.reshape(len(q), -1, 3))
    return np.asarray(sum_of_coordinates((p - (q @ R[:, None].mT + t[:, None, None])) ** 2))


def _tracked(view: View, index: Any) -> Array:
    """(N, J, 3) positions in some frames, or (T, 3) of a joint; NaN where not tracked."""
    tracked = (view.states[index] == TRACKED)[..., None]
    return np.where(tracked, view.positions[index], np.nan).astype(np.float64)


def _at_times(view: View, wanted_ns: NDArray[np.int64]) -> Array:
    """(K, N, J, 3) positions at (K, N) times; NaN before the first frame, after the last and across gaps."""
    last = len(view.time_ns) - 1
    near = np.clip(np.searchsorted(view.time_ns, wanted_ns)[..., None] + np.arange(-2, 2), 0, last)
    few = np.unique(near)  # the frames that interpolation needs: a long recording lies in a file
    gap_ns = Sampling.of(view.time_ns).gap_ns
    motion = Interpolation(view.time_ns[few], _tracked(view, few), gap_ns)
    at = np.array([motion.positions(times) for times in wanted_ns])
    at[(wanted_ns < view.time_ns[0]) | (wanted_ns > view.time_ns[last])] = np.nan
    return at


def mean_costs(costs: Array) -> Array:
    return np.array([np.mean(row[np.isfinite(row)]) if np.isfinite(row).any() else np.inf for row in costs])


def is_better(one: Array, other: Array, certain: float = _CERTAIN) -> bool:
    """Whether one candidate's costs are smaller than another's, by so many standard errors."""
    both = np.isfinite(one) & np.isfinite(other)
    if both.sum() < FEWEST:  # the other one has hardly a frame in common with it
        return True
    gain = other[both] - one[both]
    error = _CORRELATED * float(gain.std()) / np.sqrt(len(gain))
    return bool(gain.mean() > certain * max(error, 1e-6))
