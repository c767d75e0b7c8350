"""The offset between the sensors' clocks, estimated from the motion that both see.

If B captures τ later than A, a joint that moves with velocity v is v τ farther along in B's view:
p − (R q + t) = −v τ + bias. The bias of a joint is constant for about a second, so residual and velocity are
taken relative to their means over that second. τ follows by robust regression over many seconds. The points
used are those that an exchange of left and right does not move.
"""

import itertools
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fusion.body import Body
from fusion.clocks import Clock
from fusion.pair_arrays import Pairs
from fusion.registration.error_model import relative_noise
from fusion.registration.sampled_motion import Interpolation, Sampling
from fusion.rigid import RigidTransform
from fusion.skeleton import TRACKED, SkeletonPair
from fusion.support.types import Array

_WINDOW_NS, _WINDOW_FRAMES = 1_000_000_000, 12  # a window is a second; below 12 frames per second, so many
_WINDOWS = 120  # stored by the online estimator
_FEWEST_WINDOWS = 10
_SLOWEST = 0.08  # m/s, RMS about the one-second mean; below this, changes of the biases dominate
_SCATTER = 1.5  # factor on the windows' scatter, so that it covers the error on the simulator
_LEAST_SD_NS = 2_000_000.0
_FAR = 2.5  # robust deviations above which a residual counts less
_CERTAIN_NS = 5_000_000  # standard deviation below which an offset is reported
_CHANGED = 3.0  # standard deviations
_MOST = 18_000  # pairs of a recording
_FEWEST_FRAMES = 8  # of a window


@dataclass(frozen=True)
class _Window:
    """One second's share of the regression."""

    time_ns: float
    moment: float  # Σ w v·r, m²/s
    power: float  # Σ w v·v, (m/s)²


class LagEstimator:
    """Estimates the offset while pairs come in; bounded memory, work once a second."""

    def __init__(self, body: Body) -> None:
        self._points = _Points(body)
        self._pending: list[SkeletonPair] = []
        self._windows: deque[_Window] = deque(maxlen=_WINDOWS)
        self._told: Clock | None = None

    @property
    def estimate(self) -> Clock | None:
        """The current estimate; None before there was enough motion."""
        return _combined(list(self._windows))

    def observe(self, pair: SkeletonPair, a_from_b: RigidTransform) -> Clock | None:
        """The estimate, when it becomes certain or changes beyond its uncertainty.

        The pair is neither stale nor one-sided.
        """
        if self._pending and pair.time_ns - self._pending[0].time_ns >= self._window_ns():
            self._windows.extend(_windows(self._points, *self._points.of(self._pending, a_from_b), 0.0))
            self._pending = [pair]
            return self._news()
        self._pending.append(pair)
        return None

    def _window_ns(self) -> float:
        """How long the window that is collected lasts."""
        if len(self._pending) >= _WINDOW_FRAMES:
            return float(_WINDOW_NS)
        return _window_of(Sampling.of(np.array([pair.time_ns for pair in self._pending])))

    def _news(self) -> Clock | None:
        now = self.estimate
        if now is None or now.sd_ns > _CERTAIN_NS:
            return None
        if self._told is not None:
            change = abs(now.offset_ns - self._told.offset_ns)
            if change < _CHANGED * np.hypot(now.sd_ns, self._told.sd_ns):
                return None
        self._told = now
        return now


def lag_of(body: Body, pairs: Sequence[SkeletonPair], a_from_b: RigidTransform) -> Clock | None:
    """The offset and skew of a whole recording, up to a tenth of a second; None with too little motion.

    The regression is repeated with B interpolated at the offset found so far.
    :mod:`fusion.clocks.search` finds larger offsets. Of a long recording, minutes that are
    evenly spaced count.

    Args:
        pairs: In order, without stale ones and with both views.
    """
    if len(pairs) < _FEWEST_WINDOWS * _FEWEST_FRAMES:
        return None
    points, pairs = _Points(body), Pairs.of(body, pairs)
    minute = (pairs.time_ns - pairs.time_ns[0]) // 60_000_000_000
    pairs = pairs[np.flatnonzero(minute % -(-len(pairs) // _MOST) == 0)]
    views, times, skews = points.of(pairs, a_from_b)
    found: Clock | None = None
    offset_ns = rate_ppm = 0.0
    for _ in range(4):
        drifted = skews + rate_ppm * 1e-6 * (times - times.mean())
        windows = _windows(points, views, times, drifted, offset_ns)
        correction = _combined(windows)
        if correction is None:
            return found
        offset_ns += correction.offset_ns
        slope, slope_sd = _drift(windows, correction)
        found = Clock(offset_ns, correction.sd_ns, rate_ppm + slope, slope_sd)
        if abs(rate_ppm + slope) > 2.0 * slope_sd:
            rate_ppm += slope
    return found


class _Points:
    """Joints of the midline and midpoints of joints with two sides."""

    def __init__(self, body: Body) -> None:
        self._body = body
        self.own, self.other = body.midpoints
        self.noise = relative_noise(body)[self.own]

    def of(
        self, pairs: Sequence[SkeletonPair], a_from_b: RigidTransform
    ) -> tuple[tuple[Array, Array], Array, Array]:
        """(T, M, 3) the points of A and of B, in K_A's frame, NaN where not tracked; times and skews, ns."""
        of = Pairs.of(self._body, pairs).arrays()
        views = self._view(of.a, of.states_a), a_from_b.apply(self._view(of.b, of.states_b))
        return views, of.time_ns.astype(np.float64), of.skew_ns.astype(np.float64)

    def _view(self, positions: NDArray[np.float32], states: NDArray[np.uint8]) -> Array:
        at = np.where((states == TRACKED)[..., None], positions, np.float32(np.nan))
        return np.asarray(0.5 * (at[:, self.own] + at[:, self.other]), dtype=np.float64)


def _windows(
    points: _Points,
    views: tuple[Array, Array],
    times: Array,
    skews_ns: Array,
    offset_ns: float,
) -> list[_Window]:
    """The regression of each second, for what remains of the offset beyond ``offset_ns``."""
    if len(times) < _FEWEST_FRAMES:
        return []
    sampling = Sampling.of(times)
    residual, velocity = _residuals(views, times, skews_ns, offset_ns, sampling)
    known = np.asarray(np.isfinite(residual).all(axis=2) & np.isfinite(velocity).all(axis=2))
    residual[~known] = velocity[~known] = 0.0
    windows = []
    for inside in _slices(times, _window_of(sampling)):
        if inside.stop - inside.start < _FEWEST_FRAMES:
            continue
        r, v, weight = _centred(points, residual[inside], velocity[inside], known[inside])
        moment, power = float(np.sum(weight * r * v)), float(np.sum(weight * v * v))
        if power < _SLOWEST**2 * float(weight.sum()):
            continue
        windows.append(_Window(float(times[inside].mean()), moment, power))
    return windows


def _window_of(sampling: Sampling) -> float:
    return max(float(_WINDOW_NS), _WINDOW_FRAMES * sampling.interval_ns)


def _slices(times: Array, window_ns: float) -> Iterator[slice]:
    """The frames of each window since the first frame."""
    begins = np.flatnonzero(np.diff((times - times[0]) // window_ns)) + 1
    return itertools.starmap(slice, itertools.pairwise([0, *begins.tolist(), len(times)]))


def _residuals(
    views: tuple[Array, Array], times: Array, skews_ns: Array, offset_ns: float, sampling: Sampling
) -> tuple[Array, Array]:
    """p − q' (T, M, 3) with B taken at A's times, and the velocity (T, M, 3) in m/s."""
    a, b = views
    # when B's points were truly captured
    b = Interpolation(times + skews_ns + offset_ns, b, sampling.gap_ns).positions(times)
    middle = 0.5 * (a + b)
    velocity, reach = np.full_like(middle, np.nan), sampling.reach
    elapsed = times[2 * reach :] - times[: -2 * reach]
    moved = middle[2 * reach :] - middle[: -2 * reach]
    velocity[reach:-reach] = moved / (1e-9 * elapsed)[:, None, None]
    velocity[reach:-reach][elapsed > sampling.span_ns] = np.nan
    return a - b, velocity


def _centred(
    points: _Points, residual: Array, velocity: Array, known: NDArray[np.bool_]
) -> tuple[Array, Array, Array]:
    """Residual and velocity about their means of the window, and robust weights; 0 where unknown."""
    count = known.sum(axis=0)
    known = known & (count >= 6)
    count = np.maximum(count, 1)[:, None]
    r, v = (np.where(known[..., None], of - of.sum(axis=0) / count, 0.0) for of in (residual, velocity))
    size = np.linalg.norm(r, axis=2) / points.noise
    typical = float(np.median(size[known])) if known.any() else 1.0
    weight = known / (points.noise**2 * (1.0 + (size / (_FAR * max(typical, 1e-6))) ** 2))
    return r, v, np.asarray(weight[..., None])


def _combined(windows: Sequence[_Window]) -> Clock | None:
    """The regression over all windows; its uncertainty from how the windows scatter about it."""
    if len(windows) < _FEWEST_WINDOWS:
        return None
    moment = np.array([window.moment for window in windows])
    power = np.array([window.power for window in windows])
    total = power.sum()
    if total <= 0.0:
        return None
    slope = moment.sum() / total
    sd = _SCATTER * np.sqrt(np.sum((moment - slope * power) ** 2)) / total
    return Clock(float(-slope * 1e9), max(float(sd * 1e9), _LEAST_SD_NS))


def _drift(windows: Sequence[_Window], correction: Clock) -> tuple[float, float]:
    """Growth of the offset with time in millionths, and its standard deviation."""
    times = np.array([window.time_ns for window in windows])
    moment = np.array([window.moment for window in windows])
    power = np.array([window.power for window in windows])
    middle = np.sum(power * times) / power.sum()
    lever = times - middle
    information = np.sum(power * lever**2)
    if information <= 0.0:
        return 0.0, float("inf")
    rest = moment + correction.offset_ns * 1e-9 * power
    slope = np.sum(rest * lever) / information
    sd = _SCATTER * np.sqrt(np.sum(((rest - slope * power * lever) * lever) ** 2)) / information
    return float(-slope * 1e9 * 1e6), float(sd * 1e9 * 1e6)
