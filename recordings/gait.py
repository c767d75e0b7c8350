"""Heel strikes, toe-offs and steps, by the coordinate method of Zeni, Richards and Higginson (2008).

A heel strikes when its ankle is farthest in front of the pelvis, along the direction in which the pelvis
moves. The toes leave the floor when the ankle is farthest behind it. The pelvis is the middle of the hips.
Only walking counts: the person moves to where they face, and the feet strike in turn.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fusion.body import Body
from recordings.errors import RecordingError

Array = NDArray[np.float64]

SIDES = ("left", "right")
_RATE = 100.0  # Hz, of the points that are filtered
_CUT_OFF = 6.0  # Hz, as in the source
_WINDOW = 0.35  # seconds, standard deviation: over about a stride, hips and shoulders swing no more
_SLOWEST = 0.25  # m/s of the pelvis
_FORWARDS = math.cos(math.radians(50.0))  # between the directions of facing and of moving
_SWING = 0.15  # metres, the least change of the ankle's place from the pelvis
_SHORTEST_STEP = 0.10  # metres
_BETWEEN = 0.25, 1.3  # seconds between strikes of both feet
_LONGEST_SWING = 1.0  # seconds
_FEWEST = 3  # strikes in turn
_LONGEST_GAP = 0.3  # seconds without S*
_FARTHEST = 1000.0  # metres: what is farther is damaged
_SHORTEST = 1.0  # seconds of a part without gaps
_ERRORS_LAST = 0.16  # seconds; two thirds of the strikes of simulated walks are then within 1 σ


class Step(NamedTuple):
    """A step, which a heel strike ends. Times are seconds since the first pair."""

    side: str
    """``left`` or ``right``."""
    walk: int
    """Number of the uninterrupted walk."""
    strike: float
    """When the heel strikes."""
    strike_sigma: float
    """Its uncertainty, one standard deviation; NaN where that of S* is unknown."""
    toe_off: float
    """When the foot left the floor before; NaN where that was not seen."""
    toe_off_sigma: float
    """Its uncertainty, one standard deviation."""
    seconds: float
    """Since the other heel's strike; NaN for the first of a walk."""
    length: float
    """Metres from the other ankle to this one along the walk, at the strike."""
    length_sigma: float
    """Its uncertainty, one standard deviation."""
    progress: float
    """Metres that the pelvis moved since the other heel's strike; NaN for the first of a walk."""


class Measured(NamedTuple):
    """A value and its uncertainty, one standard deviation; NaN where unknown."""

    value: float
    sigma: float


@dataclass(frozen=True, eq=False)
class Gait:
    """The steps of a recording, in the order of their strikes."""

    steps: tuple[Step, ...]
    moving_seconds: float = 0.0
    """Seconds in which the pelvis moves at 0.25 m/s or faster in any direction, and those of the walks."""

    @property
    def walking_seconds(self) -> float:
        """Seconds of the walks, from first to last strike."""
        return self._duration[1]

    @property
    def cadence(self) -> Measured:
        """Steps per minute."""
        count, seconds, sigma = self._duration
        return Measured(60.0 * count / seconds, 60.0 * count * sigma / seconds**2) if count else _UNKNOWN

    @property
    def speed(self) -> Measured:
        """Metres per second, of the pelvis."""
        count, seconds, sigma = self._duration
        if not count:
            return _UNKNOWN
        way = sum(step.progress for step in self._later)
        # the pelvis at both ends of a walk is at least as certain as the two ankles of a step
        ends = math.sqrt(sum(walk[0].length_sigma ** 2 for walk in self.walks))
        return Measured(way / seconds, math.hypot(way * sigma / seconds, ends) / seconds)

    @property
    def walks(self) -> list[list[Step]]:
        """The steps of each uninterrupted walk."""
        count = self.steps[-1].walk + 1 if self.steps else 0
        return [[step for step in self.steps if step.walk == walk] for walk in range(count)]

    @property
    def events(self) -> list[tuple[float, str]]:
        """Seconds and names, such as ``heel_strike_left`` and ``toe_off_right``, in time order."""
        strikes = [(step.strike, f"heel_strike_{step.side}") for step in self.steps]
        toe_offs = [(step.toe_off, f"toe_off_{step.side}") for step in self.steps]
        return sorted(event for event in strikes + toe_offs if math.isfinite(event[0]))

    def of_side(self, side: str) -> list[Step]:
        """The steps of a foot, ``left`` or ``right``."""
        if side not in ("left", "right"):
            raise RecordingError(f"A foot is left or right, not {side!r}.")
        return [step for step in self.steps if step.side == side]

    def cycles(self, side: str) -> Array:
        """(C, 2) seconds from each heel strike of a foot to its next one in the same walk."""
        strikes = pairwise(self.of_side(side))
        return np.array([(a.strike, b.strike) for a, b in strikes if a.walk == b.walk]).reshape(-1, 2)

    def stance(self, side: str) -> Array:
        """(C,) share of each cycle of :meth:`cycles` in which the foot is on the floor; NaN where unknown."""
        strikes = pairwise(self.of_side(side))
        shares = [(b.toe_off - a.strike) / (b.strike - a.strike) for a, b in strikes if a.walk == b.walk]
        return np.array(shares)

    @property
    def _later(self) -> list[Step]:
        return [step for step in self.steps if math.isfinite(step.seconds)]

    @property
    def _duration(self) -> tuple[int, float, float]:
        """Steps, the seconds that they took, and the uncertainty of those."""
        sigma = math.sqrt(sum(walk[0].strike_sigma ** 2 + walk[-1].strike_sigma ** 2 for walk in self.walks))
        return len(self._later), sum(step.seconds for step in self._later), sigma


_UNKNOWN = Measured(math.nan, math.nan)


def find_gait(
    body: Body, time_ns: ArrayLike, positions: Array, up: ArrayLike, sigma: ArrayLike | None = None
) -> Gait:
    """Finds the steps.

    Uncertainties are by linear propagation. That of a strike is that of the ankle's velocity relative to the
    pelvis, over its acceleration; the errors of S* are taken to last for 0.16 s.

    Args:
        time_ns: (T,) nanoseconds, ascending.
        positions: (T, J, 3) metres; NaN where unknown.
        up: (3,) against gravity.
        sigma: (T, J) metres, one standard deviation of a joint's distance to the truth.
    """
    seconds = np.asarray(time_ns, dtype=np.float64) * 1e-9
    steps: list[Step] = []
    moving_seconds = 0.0
    for t, ground, errors in _parts(body, seconds, positions, np.asarray(up, dtype=np.float64), sigma):
        speed, direction = _velocity(ground)
        moving = speed > _SLOWEST
        for walk in _walks(_strikes(t, ground, errors, speed, direction)):
            number = steps[-1].walk + 1 if steps else 0
            steps += [step._replace(walk=number) for step in walk]
            moving |= (t >= walk[0].strike) & (t <= walk[-1].strike)
        moving_seconds += np.count_nonzero(moving) / _RATE
    return Gait(tuple(steps), moving_seconds)


def cycle_curves(seconds: NDArray[np.floating], values: Array, cycles: Array) -> Array:
    """(C, 101) values at 0 to 100 % of each cycle; NaN where the values around are.

    Args:
        seconds: (T,) of the values.
        values: (T,) such as an angle.
        cycles: (C, 2) as of :meth:`Gait.cycles`.
    """
    at = cycles[:, :1] + np.linspace(0.0, 1.0, 101) * np.diff(cycles, axis=1)
    return np.asarray(np.interp(at.ravel(), seconds, values).reshape(at.shape))


def _parts(
    body: Body, seconds: Array, positions: Array, up: Array, sigma: ArrayLike | None
) -> Iterator[tuple[Array, Array, Array]]:
    """Parts without gaps: (n,) seconds, (n, 4, 2) points and (n, 3) their uncertainties.

    The points are pelvis, left and right ankle on the floor, and the direction of facing; filtered.
    """
    from scipy.signal import sosfiltfilt  # loads for a second

    up = up / np.linalg.norm(up)
    across = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    across /= np.linalg.norm(across)
    floor = np.stack([across, np.cross(up, across)], axis=1)
    names = [f"{part}{side}" for part in ("Hip", "Shoulder", "Ankle") for side in ("Left", "Right")]
    joints = [body.joint(name) for name in names]
    hip, other_hip, shoulder, other_shoulder, left, right = np.moveaxis(positions[:, joints], 1, 0)
    with np.errstate(invalid="ignore", over="ignore"):  # a damaged file has any numbers
        facing = np.cross(hip - other_hip + shoulder - other_shoulder, up)
        ground = np.stack([0.5 * (hip + other_hip), left, right, facing], axis=1) @ floor
    errors = np.full((len(seconds), 3), np.nan)
    if sigma is not None:
        of_joints = np.asarray(sigma, dtype=np.float64)[:, joints] / math.sqrt(3.0)
        errors = np.stack([0.5 * np.hypot(of_joints[:, 0], of_joints[:, 1]), *of_joints[:, 4:].T], axis=1)
    known = np.flatnonzero((np.abs(ground) < _FARTHEST).all(axis=(1, 2)))
    gaps = np.flatnonzero(np.diff(seconds[known]) > _LONGEST_GAP) + 1
    for part in np.split(known, gaps):
        if len(part) < 2 or seconds[part[-1]] - seconds[part[0]] < _SHORTEST:
            continue
        t = np.arange(seconds[part[0]], seconds[part[-1]], 1.0 / _RATE)
        values = np.concatenate([ground[part].reshape(len(part), -1), errors[part]], axis=1)
        even = np.stack([np.interp(t, seconds[part], column) for column in values.T], axis=1)
        yield t, sosfiltfilt(_low_pass(), even[:, :8], axis=0).reshape(-1, 4, 2), even[:, 8:]


@cache
def _low_pass() -> Array:
    from scipy.signal import butter

    return np.asarray(butter(2, _CUT_OFF, fs=_RATE, output="sos"))


def _velocity(ground: Array) -> tuple[Array, Array]:
    """(n,) metres per second of the pelvis over about a stride, and (n, 2) its direction."""
    from scipy.ndimage import gaussian_filter1d

    velocity = np.gradient(ground[:, 0], 1.0 / _RATE, axis=0)
    mean = gaussian_filter1d(velocity, _WINDOW * _RATE, axis=0, mode="nearest")
    speed = np.maximum(np.linalg.norm(mean, axis=1), 1e-9)
    return speed, mean / speed[:, None]


def _strikes(t: Array, ground: Array, errors: Array, speed: Array, direction: Array) -> list[Step]:
    """The heel strikes of both feet while the person walks, in time order; not yet in turn."""
    from scipy.ndimage import gaussian_filter1d
    from scipy.signal import find_peaks

    pelvis, facing = ground[:, 0], ground[:, 3]
    facing = gaussian_filter1d(facing, _WINDOW * _RATE, axis=0, mode="nearest")
    forwards = np.sum(facing * direction, axis=1) > _FORWARDS * np.linalg.norm(facing, axis=1)
    walking = forwards & (speed > _SLOWEST)
    way = np.concatenate([[0.0], np.cumsum(speed) / _RATE])
    found = []
    for side in (0, 1):
        ahead = np.sum((ground[:, 1 + side] - pelvis) * direction, axis=1)
        error = np.hypot(errors[:, 1 + side], errors[:, 0])
        toe_offs = find_peaks(-ahead, prominence=_SWING)[0]
        for k in find_peaks(ahead, prominence=_SWING)[0]:
            length = float((ground[k, 1 + side] - ground[k, 2 - side]) @ direction[k])
            if not walking[k] or length < _SHORTEST_STEP:
                continue
            before = toe_offs[: np.searchsorted(toe_offs, k)]
            swung = len(before) > 0 and k - before[-1] < _LONGEST_SWING * _RATE
            strike = _extremum(t, ahead, error, k)
            toe_off = _extremum(t, ahead, error, before[-1]) if swung else _UNKNOWN
            found.append(
                Step(
                    side=SIDES[side],
                    walk=0,
                    strike=strike.value,
                    strike_sigma=strike.sigma,
                    toe_off=toe_off.value,
                    toe_off_sigma=toe_off.sigma,
                    seconds=math.nan,
                    length=length,
                    length_sigma=math.hypot(errors[k, 1], errors[k, 2]),
                    progress=float(way[k]),
                )
            )
    return sorted(found, key=lambda step: step.strike)


def _extremum(t: Array, values: Array, error: Array, k: int) -> Measured:
    """Seconds of the vertex of the parabola through three values, of which the middle one is extreme."""
    before, middle, after = values[k - 1 : k + 2].tolist()
    bend = before - 2.0 * middle + after or 1e-9
    sigma = float(error[k]) / _ERRORS_LAST / (abs(bend) * _RATE**2)
    return Measured(float(t[k]) + 0.5 * (before - after) / bend / _RATE, sigma)


def _walks(strikes: Sequence[Step]) -> Iterator[list[Step]]:
    """Divides strikes into walks, in which the feet strike in turn."""
    walk: list[Step] = []
    ways: list[float] = []
    for step in strikes:
        before = walk[-1] if walk else None
        seconds = step.strike - before.strike if before else math.inf
        in_turn = before is not None and step.side != before.side and _BETWEEN[0] < seconds < _BETWEEN[1]
        if not in_turn:
            if len(walk) >= _FEWEST:
                yield walk
            walk, ways = [step._replace(progress=math.nan)], [step.progress]
            continue
        walk.append(step._replace(seconds=seconds, progress=step.progress - ways[-1]))
        ways.append(step.progress)
    if len(walk) >= _FEWEST:
        yield walk
