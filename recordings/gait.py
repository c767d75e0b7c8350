"""Heel strikes, toe-offs and steps, by the coordinate method of Zeni, Richards and Higginson (2008).

A foot swings from where its ankle is farthest behind the pelvis, along the direction in which the pelvis
moves, to where it is farthest in front. It stands while it is slower than 0.75 of the pelvis: the toes
leave the floor when they become faster at the beginning of a swing, and the heel strikes when the ankle
becomes slower at its end. The pelvis is the middle of the hips. Only walking counts: the person moves to
where they face, and the feet strike in turn. Limits are relative to the leg and to the person's own swings.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
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
_STANDS = 0.75  # of the pelvis' speed: labelled toes leave the floor at 0.7 to 1, simulated ones at 0.7
_SLOWEST = 0.06  # of the pelvis, lengths of the leg per second
_LEAST_SWING = 0.06  # of the ankle's place from the pelvis, lengths of the leg
_OWN_SWING = 0.3  # the least swing, of the median of the part
_SEEN = 0.1  # the least of what is seen of a swing at an end of the part, of the same median
_SHORTEST_STEP = -0.04  # lengths of the leg; in a tight curve the inner foot lands beside the other
_FORWARDS = math.cos(math.radians(50.0))  # between the directions of facing and of moving
_BETWEEN = 0.4, 2.0  # of the median time between strikes of both feet
_LONGEST_STEP = 2.0  # seconds
_FEWEST = 3  # strikes in turn
_LONGEST_GAP = 0.3  # seconds without S*
_SHORTEST_GAP = 0.004  # seconds: two frames of one moment are one
_FARTHEST = 1000.0  # metres: what is farther is damaged
_SHORTEST = 1.0  # seconds of a part without gaps
_ERRORS_LAST = 0.16  # seconds; two thirds of the strikes of simulated walks are then within 1 σ
_LASTING = 0.5  # of the pelvis' errors on the loops of simulated walks
_AROUND = 0.1  # seconds: errors of S* that count for an event
_DEFINITION_SD = 0.02  # seconds, between contact and what shows it
_OF_A_FRAME = 0.25  # of the time between frames, by which interpolation errs
_TRUNK = "HipLeft", "HipRight", "ShoulderLeft", "ShoulderRight"
_FEET = "AnkleLeft", "AnkleRight", "FootLeft", "FootRight"


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
    turned: float
    """Radians by which the direction of walking turned since then; NaN for the first of a walk."""


class Measured(NamedTuple):
    """A value and its uncertainty, one standard deviation; NaN where unknown."""

    value: float
    sigma: float


@dataclass(frozen=True, eq=False, repr=False)
class Gait:
    """The steps of a recording, in the order of their strikes."""

    steps: tuple[Step, ...]
    left_out: Mapping[str, float] = field(default_factory=dict)
    """Seconds in which the pelvis moves and that are no walk, by the reason."""
    begun: tuple[tuple[float, str], ...] = ()
    """Seconds at which a foot left the floor for a step that is not recorded to its end, and its side."""
    time: Array = field(default_factory=lambda: np.zeros(0))
    """(T,) seconds of the frames."""
    angles: Mapping[str, Array] = field(default_factory=dict)
    """(T,) degrees of each joint angle, by name."""

    def __repr__(self) -> str:
        if not self.steps:
            return "<Gait: no steps>"
        cadence, speed = self.cadence.value, self.speed.value
        return f"<Gait: {len(self.steps)} steps, {cadence:.1f} per minute, {speed:.2f} m/s>"

    @property
    def moving_seconds(self) -> float:
        """Seconds of the walks, and those in which the pelvis moves otherwise."""
        return self.walking_seconds + sum(self.left_out.values())

    @property
    def walking_seconds(self) -> float:
        """Seconds of the walks, from first to last strike."""
        return self._duration[1]

    @property
    def cadence(self) -> Measured:
        """Steps per minute. The uncertainty is at least what the scatter of the steps tells."""
        count, seconds, sigma = self._duration
        if not count:
            return _UNKNOWN
        sigma = np.fmax(sigma, count * _standard_error([step.seconds for step in self._later]))
        return Measured(60.0 * count / seconds, 60.0 * count * float(sigma) / seconds**2)

    @property
    def speed(self) -> Measured:
        """Metres per second. The uncertainty is at least what the scatter of the steps tells."""
        count, seconds, _ = self._duration
        if not count:
            return _UNKNOWN
        speeds = [step.progress / step.seconds for step in self._later]
        variance = 0.0
        for walk in self.walks:
            # the middle of two hips is half as uncertain as the distance of two ankles, at both ends of a
            # walk; of an error towards the inside of a curve half lasts
            bend = _LASTING * sum(abs(step.turned) for step in walk[1:])
            error = 0.5 * float(np.mean([step.length_sigma for step in walk]))
            variance += error**2 * (2.0 + bend**2)
        sigma = np.fmax(math.sqrt(variance) / seconds, _standard_error(speeds))
        return Measured(sum(step.progress for step in self._later) / seconds, float(sigma))

    @property
    def walks(self) -> list[list[Step]]:
        """The steps of each uninterrupted walk."""
        count = self.steps[-1].walk + 1 if self.steps else 0
        return [[step for step in self.steps if step.walk == walk] for walk in range(count)]

    @property
    def events(self) -> list[tuple[float, str]]:
        """Seconds and names, such as ``heel_strike_left`` and ``toe_off_right``, in time order."""
        strikes = [(step.strike, f"heel_strike_{step.side}") for step in self.steps]
        lifted = [(step.toe_off, step.side) for step in self.steps] + list(self.begun)
        toe_offs = [(seconds, f"toe_off_{side}") for seconds, side in lifted]
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

    def curves(self, angle: str | Array, side: str | None = None) -> Array:
        """(C, 101) an angle at 0 to 100 % of each cycle of a foot; NaN where the angle is.

        Args:
            angle: Name of an angle of :attr:`angles`, or (T,) values of all frames.
            side: The foot, ``left`` or ``right``; where None, that at the end of the name.

        Raises:
            RecordingError: There is no such angle or foot, or not a value for each frame.
        """
        if isinstance(angle, str):
            side = side or angle.rpartition("_")[2]
            angle = self.angles[angle]
        if side is None or np.shape(angle) != self.time.shape:
            raise RecordingError(
                f"Curves of (T,) values need `side` and a value for each of {len(self.time)} frames; got "
                f"{np.shape(angle)} values."
            )
        cycles = self.cycles(side)
        at = cycles[:, :1] + np.linspace(0.0, 1.0, 101) * np.diff(cycles, axis=1)
        return np.asarray(np.interp(at.ravel(), self.time, angle).reshape(at.shape))

    def stance(self, side: str) -> Array:
        """(C,) share of each cycle of :meth:`cycles` in which the foot is on the floor; NaN where unknown."""
        strikes = pairwise(self.of_side(side))
        shares = [(b.toe_off - a.strike) / (b.strike - a.strike) for a, b in strikes if a.walk == b.walk]
        return np.array(shares)

    def contact(self, side: str, seconds: ArrayLike) -> Array:
        """The probability that a foot is on the floor, by its strikes and toe-offs and their uncertainties.

        Args:
            seconds: (T,) since the first pair.

        Returns:
            (T,) probabilities; NaN outside the foot's gait cycles.
        """
        from scipy.special import ndtr

        at = np.asarray(seconds, dtype=np.float64)
        found = np.full(at.shape, math.nan)
        for a, b in pairwise(self.of_side(side)):
            if a.walk == b.walk:
                within = (at >= a.strike) & (at < b.strike)
                t = at[within]
                landed, lifted, lands = (
                    ndtr((t - when) / sigma)
                    for when, sigma in (
                        (a.strike, a.strike_sigma),
                        (b.toe_off, b.toe_off_sigma),
                        (b.strike, b.strike_sigma),
                    )
                )
                found[within] = landed * (1.0 - lifted) + lands
        return found.clip(0.0, 1.0)

    @property
    def _later(self) -> list[Step]:
        return [step for step in self.steps if math.isfinite(step.seconds)]

    @property
    def _duration(self) -> tuple[int, float, float]:
        """Steps, the seconds that they took, and the uncertainty of those."""
        sigma = math.sqrt(sum(walk[0].strike_sigma ** 2 + walk[-1].strike_sigma ** 2 for walk in self.walks))
        return len(self._later), sum(step.seconds for step in self._later), sigma


_UNKNOWN = Measured(math.nan, math.nan)
_ONE_SIGMA = 0.8413  # of a normal distribution is below its mean and one standard deviation


def _standard_error(values: Sequence[float]) -> float:
    """Of the mean of some values, wider the fewer they are (Student); NaN of one."""
    from scipy.special import stdtrit

    if len(values) < 2:
        return math.nan
    return float(np.std(values, ddof=1) / math.sqrt(len(values)) * stdtrit(len(values) - 1, _ONE_SIGMA))


def find_gait(
    body: Body, time_ns: ArrayLike, positions: Array, up: ArrayLike, sigma: ArrayLike | None = None
) -> Gait:
    """Finds the steps.

    Uncertainties are by linear propagation. That of an event is that of the foot's velocity relative to the
    pelvis, over its acceleration; the errors of S* are taken to last for 0.16 s. 20 ms, by which contact with
    the floor and what shows it differ, and a quarter of the time between frames are added.

    Args:
        time_ns: (T,) nanoseconds, ascending.
        positions: (T, J, 3) metres; NaN where unknown. Hips and ankles are needed. Ankles stand in for toes;
            hips alone tell where a person without shoulders faces.
        up: (3,) against gravity.
        sigma: (T, J) metres, one standard deviation of a joint's distance to the truth.
    """
    seconds = np.asarray(time_ns, dtype=np.float64) * 1e-9
    steps: list[Step] = []
    begun: list[tuple[float, str]] = []
    left_out = dict.fromkeys(("not forwards", "no three strikes in turn"), 0.0)
    for part in _parts(body, seconds, positions, np.asarray(up, dtype=np.float64), sigma):
        walking = np.zeros(len(part.t), dtype=bool)
        strikes, lifted = _strikes(part)
        for walk in _walks(strikes):
            number = steps[-1].walk + 1 if steps else 0
            steps += [step._replace(walk=number) for step in walk]
            walking |= (part.t >= walk[0].strike) & (part.t <= walk[-1].strike)
            begun += [
                (at, side)
                for at, side in lifted
                if side != walk[-1].side and 0.0 < at - walk[-1].strike < walk[-1].seconds
            ]
        for reason, of_reason in zip(left_out, (~part.forwards, part.forwards), strict=True):
            left_out[reason] += float(np.mean(part.moving & of_reason & ~walking)) * len(part.t) / _RATE
    return Gait(tuple(steps), left_out, tuple(begun))


class _Part(NamedTuple):
    """A part without gaps, at an even rate and filtered; places are on the floor."""

    t: Array  # (n,) seconds
    frame_seconds: float  # between the frames that it is from
    leg: float  # metres
    pelvis: Array  # (n, 2)
    ankles: Array  # (2, n, 2)
    toes: Array  # (2, n, 2); the ankles where toes are unknown
    pelvis_error: Array  # (n,)
    ankle_errors: Array  # (2, n)
    toe_errors: Array  # (2, n)
    speed: Array  # (n,) metres per second of the pelvis over about a stride
    direction: Array  # (n, 2) of that
    moving: NDArray[np.bool_]  # (n,) whether the pelvis does
    forwards: NDArray[np.bool_]  # (n,) whether that is where the person faces


def _parts(
    body: Body, seconds: Array, positions: Array, up: Array, sigma: ArrayLike | None
) -> Iterator[_Part]:
    from scipy.interpolate import CubicSpline
    from scipy.signal import sosfiltfilt  # loads for a second

    up = up / np.linalg.norm(up)
    across = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    across /= np.linalg.norm(across)
    floor = np.stack([across, np.cross(up, across)], axis=1)
    joints = [body.joint(name) for name in _TRUNK + _FEET]
    points = np.array(positions[:, joints], dtype=np.float64)
    errors = np.full(points.shape[:2], np.nan)
    if sigma is not None:
        errors = np.asarray(sigma, dtype=np.float64)[:, joints] / math.sqrt(3.0)
    points[~(np.abs(points) < _FARTHEST).all(axis=2)] = np.nan  # a damaged file has any numbers
    points[:, 6:] = np.where(np.isnan(points[:, 6:]), points[:, 4:6], points[:, 6:])
    facing = np.cross(np.nan_to_num(points[:, 0:4:2] - points[:, 1:4:2]).sum(axis=1), up)
    ground = np.stack([0.5 * (points[:, 0] + points[:, 1]), facing, *points[:, 4:].swapaxes(0, 1)], axis=1)
    legs = np.linalg.norm(points[:, :2] - points[:, 4:6], axis=2).mean(axis=1)
    columns = np.concatenate(
        [(ground @ floor).reshape(len(seconds), 12), errors[:, :2], errors[:, 4:]], axis=1
    )
    known = np.flatnonzero(np.isfinite(columns[:, :12]).all(axis=1))
    known = known[np.diff(seconds[known], prepend=-math.inf) > _SHORTEST_GAP]
    gaps = np.flatnonzero(np.diff(seconds[known]) > _LONGEST_GAP) + 1
    for part in np.split(known, gaps):
        if len(part) < _FEWEST or seconds[part[-1]] - seconds[part[0]] < _SHORTEST:
            continue
        t = np.arange(seconds[part[0]], seconds[part[-1]], 1.0 / _RATE)
        # straight lines would cut the turning points of an ankle at ten frames per second
        even = CubicSpline(seconds[part], columns[part, :12])(t)
        pelvis, facing, *feet = sosfiltfilt(_low_pass(), even, axis=0).reshape(-1, 6, 2).swapaxes(0, 1)
        hip, other_hip, *of_feet = (np.interp(t, seconds[part], column) for column in columns[part, 12:].T)
        velocity = np.gradient(pelvis, 1.0 / _RATE, axis=0)
        mean = _smoothed(velocity)
        direction = mean / np.maximum(np.linalg.norm(mean, axis=1), 1e-9)[:, None]
        # the mean of what is along the way: in a curve the mean velocity is shorter
        speed = _smoothed(np.sum(velocity * direction, axis=1))
        facing = _smoothed(facing)
        leg = float(np.median(legs[part]))
        yield _Part(
            t,
            float(np.median(np.diff(seconds[part]))),
            leg,
            pelvis,
            np.array(feet[:2]),
            np.array(feet[2:]),
            0.5 * np.hypot(hip, other_hip),
            np.array(of_feet[:2]),
            np.array(of_feet[2:]),
            speed,
            direction,
            speed > _SLOWEST * leg,
            np.sum(facing * direction, axis=1) > _FORWARDS * np.linalg.norm(facing, axis=1),
        )


@cache
def _low_pass() -> Array:
    from scipy.signal import butter

    return np.asarray(butter(2, _CUT_OFF, fs=_RATE, output="sos"))


def _smoothed(values: Array) -> Array:
    """Means over about a stride."""
    from scipy.ndimage import gaussian_filter1d

    return np.asarray(gaussian_filter1d(values, _WINDOW * _RATE, axis=0, mode="nearest"))


def _strikes(part: _Part) -> tuple[list[Step], list[tuple[float, str]]]:
    """The heel strikes of both feet while the person walks, in time order; not yet in turn.

    Besides, seconds and side of toe-offs without a strike at the end of the part.
    """
    t, walking, direction = part.t, part.moving & part.forwards, part.direction
    way = np.cumsum(part.speed) / _RATE
    heading = np.unwrap(np.arctan2(direction[:, 1], direction[:, 0]))
    found, lifted = [], []
    for side in (0, 1):
        half = 0
        # how much farther the foot went than the pelvis at a part of its speed: less while the foot stands
        ankle, toes = (
            np.cumsum(np.sum(np.gradient(each[side], axis=0) * direction, axis=1)) - _STANDS * way
            for each in (part.ankles, part.toes)
        )
        errors = [np.hypot(each[side], part.pelvis_error) for each in (part.ankle_errors, part.toe_errors)]
        ahead = np.sum((part.ankles[side] - part.pelvis) * direction, axis=1)
        fronts, backs = _swings(ahead, walking, part.leg)
        for front in fronts:
            i = int(np.searchsorted(backs, front))
            before = int(backs[i - 1]) if i else 0
            k = before + int(np.argmax(ankle[before : backs[i] if i < len(backs) else len(t)]))
            length = float((part.ankles[side, k] - part.ankles[1 - side, k]) @ direction[k])
            if not 0 < k < len(t) - 1 or not walking[k] or length < _SHORTEST_STEP * part.leg:
                continue
            strike, toe_off = _turn(part, ankle, errors[0], k), _UNKNOWN
            if i:
                half = (k - before) // 2
                toe_off = _toe_off(part, toes, errors[1], before, half)
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
                    length_sigma=math.hypot(*part.ankle_errors[:, k]),
                    progress=float(way[k]),
                    turned=float(heading[k]),
                )
            )
        if half and backs[-1] > fronts[-1]:
            lifted.append((_toe_off(part, toes, errors[1], int(backs[-1]), half).value, SIDES[side]))
    return sorted(found, key=lambda step: step.strike), lifted


def _toe_off(part: _Part, toes: Array, errors: Array, back: int, half: int) -> Measured:
    """When the toes leave the floor, within half a swing of where the ankle is farthest behind."""
    first, last = max(back - half, 0), min(back + half, len(toes) - 1)
    k = first + int(np.argmin(toes[first : last + 1]))
    if first < k < last:
        return _turn(part, toes, errors, k)
    return Measured(float(part.t[back]), half / _RATE)  # toes that S* lost


def _swings(ahead: Array, walking: NDArray[np.bool_], leg: float) -> tuple[Array, Array]:
    """Where an ankle is farthest in front of the pelvis and farthest behind it, at the ends of its swings."""
    from scipy.signal import find_peaks

    # the part may begin in a swing, or end before the pelvis has passed the foot
    (fronts, swing), (backs, swing_back) = (
        (peaks - 1, np.minimum(more["prominences"], np.ptp(ahead)))
        for peaks, more in (
            find_peaks(np.pad(values, 1, constant_values=-_FARTHEST), prominence=_LEAST_SWING * leg)
            for values in (ahead, -ahead)
        )
    )
    of_walks = swing[walking[fronts]]
    own = float(np.median(of_walks)) if len(of_walks) else 0.0
    seen = np.array([min(np.ptp(ahead[: k + 1]), np.ptp(ahead[k:])) for k in fronts])
    begun = np.array([np.ptp(ahead[k:]) for k in backs])
    return (
        fronts[(swing > _OWN_SWING * own) & (seen > _SEEN * own)],
        backs[(swing_back > _OWN_SWING * own) & (begun > _SEEN * own) & (backs > 0)],
    )


def _turn(part: _Part, values: Array, errors: Array, k: int) -> Measured:
    """Seconds of the vertex of the parabola through three values, of which the middle one is extreme."""
    before, middle, after = values[k - 1 : k + 2].tolist()
    bend = before - 2.0 * middle + after or 1e-9
    around = round(_AROUND * _RATE)
    error = float(errors[max(k - around, 0) : k + around + 1].max())
    sigma = error / _ERRORS_LAST / (abs(bend) * _RATE**2)
    return Measured(
        float(part.t[k]) + 0.5 * (before - after) / bend / _RATE,
        math.hypot(sigma, _DEFINITION_SD, _OF_A_FRAME * part.frame_seconds),
    )


def _walks(strikes: Sequence[Step]) -> Iterator[list[Step]]:
    """Divides strikes into walks, in which the feet strike in turn."""
    between = [b.strike - a.strike for a, b in pairwise(strikes) if a.side != b.side]
    least, most = (each * float(np.median(between)) if between else 0.0 for each in _BETWEEN)
    walk: list[Step] = []
    for at in strikes:
        before = walk[-1] if walk else None
        seconds = at.strike - before.strike if before else math.inf
        in_turn = before is not None and at.side != before.side
        if not (in_turn and least < seconds < min(most, _LONGEST_STEP)):
            yield from _of_steps(walk)
            walk = []
        walk.append(at)
    yield from _of_steps(walk)


def _of_steps(walk: Sequence[Step]) -> Iterator[list[Step]]:
    """A walk with what its steps took, if they are enough."""
    if len(walk) >= _FEWEST:
        first = walk[0]._replace(progress=math.nan, turned=math.nan)
        yield [first] + [
            b._replace(
                seconds=b.strike - a.strike, progress=b.progress - a.progress, turned=b.turned - a.turned
            )
            for a, b in pairwise(walk)
        ]
