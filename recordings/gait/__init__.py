"""The steps and turns of a recording, and the figures of its gait."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from fusion.support.types import Array
from recordings.errors import RecordingError, UnknownNameError

SIDES = ("left", "right")
_LASTING = 0.5  # of the pelvis' errors on the loops of simulated walks


class Step(NamedTuple):
    """A step, which ends with a heel strike. Times are seconds since the first pair."""

    side: str
    """``left`` or ``right``."""
    walk: int
    """Number of the uninterrupted walk."""
    strike: float
    """When the heel strikes."""
    strike_sigma: float
    """Its uncertainty, one standard deviation; NaN where that of S* is unknown."""
    toe_off: float
    """When the foot last left the floor; NaN if that was not seen."""
    toe_off_sigma: float
    """Its uncertainty, one standard deviation."""
    seconds: float
    """Since the other heel's strike; NaN for the first of a walk."""
    length: float
    """Metres from the other ankle to this one along the walk, at the strike."""
    length_sigma: float
    """Its uncertainty, one standard deviation."""
    width: float
    """Metres from the other ankle to this one across the walk, at the strike; negative if the feet cross.
    It is as uncertain as the length."""
    progress: float
    """Metres that the pelvis moved since the other heel's strike; NaN for the first of a walk."""
    turned: float
    """Radians by which the direction of walking turned since then; NaN for the first of a walk."""
    clearance: float = math.nan
    """Metres that the toes rise from their lowest to their highest place in the swing; NaN if its beginning
    or the toes were not seen."""
    clearance_sigma: float = math.nan
    """Its uncertainty, one standard deviation."""


class Turn(NamedTuple):
    """A turn of the person, on the spot or while walking."""

    begins: float
    """Seconds since the first pair."""
    seconds: float
    """Duration; that of a fast turn is up to 0.5 s too long, because S* is smoothed."""
    seconds_sigma: float
    """Its uncertainty, one standard deviation; NaN where that of S* is unknown."""
    angle: float
    """Radians, positive to the left."""
    angle_sigma: float
    """Its uncertainty, one standard deviation."""


class Measured(NamedTuple):
    """A value and its uncertainty, one standard deviation; NaN where unknown."""

    value: float
    sigma: float


@dataclass(frozen=True, eq=False, repr=False)
class Gait:
    """The steps of a recording, in the order of their strikes."""

    steps: tuple[Step, ...]
    left_out: Mapping[str, float] = field(default_factory=dict)
    """Seconds in which the pelvis moves without walking, by the reason."""
    turns: tuple[Turn, ...] = ()
    begun: tuple[tuple[float, str], ...] = ()
    """Seconds at which a foot left the floor for a step whose end is not recorded, and its side."""
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
        """Steps per minute. The uncertainty is at least that from the scatter of the steps."""
        count, seconds, sigma = self._duration
        if not count:
            return UNKNOWN
        sigma = np.fmax(sigma, count * _standard_error([step.seconds for step in self._later]))
        return Measured(60.0 * count / seconds, 60.0 * count * float(sigma) / seconds**2)

    @property
    def speed(self) -> Measured:
        """Metres per second. The uncertainty is at least that from the scatter of the steps."""
        count, seconds, _ = self._duration
        if not count:
            return UNKNOWN
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
    def asymmetry(self) -> dict[str, Measured]:
        """Left minus right over their mean, in percent, of ``step_length``, ``step_time`` and ``stance``.

        The symmetry index of Robinson, Herzog and Nigg (1987); the uncertainty is that of both means.
        """
        of_side: dict[str, Callable[[str], ArrayLike]] = {
            "step_length": lambda side: [step.length for step in self.of_side(side)],
            "step_time": lambda side: [step.seconds for step in self.of_side(side)],
            "stance": self.stance,
        }
        return {name: _asymmetry(*map(values, SIDES)) for name, values in of_side.items()}

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
        if side not in SIDES:
            raise UnknownNameError("`side`", side, SIDES)
        return [step for step in self.steps if step.side == side]

    def cycles(self, side: str) -> Array:
        """(C, 2) seconds from each heel strike of a foot to its next one in the same walk."""
        strikes = pairwise(self.of_side(side))
        return np.array([(a.strike, b.strike) for a, b in strikes if a.walk == b.walk]).reshape(-1, 2)

    def curves(self, angle: str | Array, side: str | None = None) -> Array:
        """(C, 101) an angle at 0 to 100 % of each cycle of a foot; NaN where the angle is.

        Args:
            angle: Name of an angle of :attr:`angles`, or (T,) values of all frames.
            side: The foot, ``left`` or ``right``; if None, the one that ends the angle's name.

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


UNKNOWN = Measured(math.nan, math.nan)
_ONE_SIGMA = 0.8413  # of a normal distribution is below its mean and one standard deviation


def _asymmetry(*sides: ArrayLike) -> Measured:
    known = [each[np.isfinite(each)] for each in (np.asarray(values, dtype=np.float64) for values in sides)]
    if not all(map(len, known)):
        return UNKNOWN
    left, right = (float(each.mean()) for each in known)
    if not left + right > 0.0:
        return UNKNOWN
    percent = 200.0 / (left + right)
    # left less right over their mean changes by right (left) over the mean squared as left (right) does
    errors = [
        percent**2 / 100.0 * other * _standard_error(each)
        for each, other in zip(known, (right, left), strict=True)
    ]
    return Measured(percent * (left - right), math.hypot(*errors))


def _standard_error(values: Sequence[float] | Array) -> float:
    """Of the mean of some values, wider the fewer they are (Student); NaN of one."""
    from scipy.special import stdtrit

    if len(values) < 2:
        return math.nan
    return float(np.std(values, ddof=1) / math.sqrt(len(values)) * stdtrit(len(values) - 1, _ONE_SIGMA))
