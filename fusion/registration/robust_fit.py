"""R and t from a moving person, by the error model of :mod:`fusion.registration.error_model`.

The fit is Gauss-Newton on (θ, dt) with iterated weights; β is eliminated joint by joint. It may end in a
wrong solution: a tracker may show a person's back as their front, with left and right exchanged, and R turned
by half a circle about the person then fits nearly as well as the right one. So there may be several starts.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion.body import Body
from fusion.errors import CalibrationError
from fusion.registration.error_model import (
    RobustFitSettings,
    accumulated,
    disagreement,
    eliminate_biases,
    error_model,
)
from fusion.registration.keyframes import Evidence, match_sides
from fusion.registration.lasting_errors import FrontalTurn, common_variance, turned_back
from fusion.registration.rigid_fit import Registration, label_free_fit
from fusion.rigid import RigidTransform, rotation_of, rotation_vector
from fusion.support.types import Array

_SMALLEST_NOISE, _LARGEST_NOISE = 0.004, 0.08  # metres, the spine's
_NOISE_SD = 0.03  # metres, at the start of a fit and to compare fits
_NEAR = np.radians(20.0)  # a fit farther from its start is another solution
_GAIN = 40.0
"""Of log likelihood. Simulated people who turn gain 66 to 99 by the right solution over a half-turned start;
people who stand between sensors that face each other gain up to 23 by a wrong one."""


@dataclass(frozen=True, eq=False)
class RobustFit:
    """A fitted transform and its uncertainty."""

    a_from_b: RigidTransform  # R and t
    covariance: Array  # (6, 6) of (dt, θ): shift of the centre and rotation vector about it, in K_A's frame
    centre: Array  # (3,) metres, the weighted mean of the joints, where dt and θ are least correlated
    biases: Array  # (3, J, 3) the expected β_f of each joint
    noise_sd: float  # metres, standard deviation of a spine joint's ε along one axis

    @property
    def rotation_sd(self) -> float:
        """Radians, about the least certain axis."""
        return float(np.sqrt(np.linalg.eigvalsh(self.covariance[3:, 3:])[-1]))

    @property
    def translation_sd(self) -> float:
        """Metres, of R q + t at the person's centre, along the least certain axis."""
        return float(np.sqrt(np.linalg.eigvalsh(self.covariance[:3, :3])[-1]))


class Prior(NamedTuple):
    """A transform known beforehand, with standard deviations (radians; metres at the person)."""

    a_from_b: RigidTransform
    rotation_sd: float
    translation_sd: float


def fit_robust(
    body: Body,
    evidence: Evidence,
    start: RigidTransform,
    settings: RobustFitSettings,
    *,
    iterations: int = 8,
    noise_sd: float = 0.02,
    biases: Array | None = None,
    prior: Prior | None = None,
) -> RobustFit:
    """The transform that explains the evidence best.

    Args:
        evidence: With sides matched.
        start: Within about 40° and half a metre of the solution.
        iterations: Gauss-Newton steps, each with new robust weights.
        noise_sd: Metres, initial value of the noise.
        biases: (3, J, 3) initial values of the biases.
        prior: Knowledge of the transform besides the evidence.

    Raises:
        CalibrationError: The evidence does not determine the transform.
    """
    bias_information = np.full(len(body), settings.bias_sd**-2)
    beta = np.zeros((3, len(body), 3)) if biases is None else biases.copy()
    R, t = start.rotation.copy(), start.translation.copy()
    information, middle = np.zeros((6, 6)), _middle(evidence)
    centre = middle
    for _ in range(iterations):
        centre = R @ middle + t
        sums = accumulated(
            evidence, error_model(body, settings, RigidTransform(R, t), beta, noise_sd, centre)
        )
        information, gradient, own, coupled = eliminate_biases(sums, bias_information)
        if prior is not None:
            _add_prior(information, gradient, prior, settings.inflation, R, t, centre)
        try:
            step = np.linalg.solve(information, gradient)
        except np.linalg.LinAlgError:
            raise CalibrationError("Joints seen by both sensors do not determine the transform.") from None
        if not np.isfinite(step).all():
            raise CalibrationError("Joints seen by both sensors do not determine the transform.")
        turn = rotation_of(step[3:])
        t = centre + step[:3] + turn @ (t - centre)
        R = turn @ R
        beta = np.moveaxis(own - coupled @ step, 0, 1)
        noise_sd = float(
            np.clip(np.sqrt(sums.figures[1] / max(sums.figures[2], 1.0)), _SMALLEST_NOISE, _LARGEST_NOISE)
        )
    U, _, Vt = np.linalg.svd(R)
    covariance = np.asarray(settings.inflation * np.linalg.inv(information), dtype=np.float64)
    found = RigidTransform.of(U @ Vt, t)
    covariance[:3, :3] += common_variance(found, centre, settings.common_sd) * np.eye(3)
    return RobustFit(found, covariance, centre, beta, noise_sd)


def with_frontal_sd(
    body: Body, evidence: Evidence, fit: RobustFit, settings: RobustFitSettings, prior: Prior | None = None
) -> RobustFit:
    """A fit whose covariance contains the trackers' turn of the person.

    The fit is repeated with B's views turned by as much. Of one pose, R follows the turn; of a person who
    walks about, it hardly does.
    """
    turned = turned_back(evidence, fit.a_from_b, float(np.hypot(*FrontalTurn.of(body))))
    other = fit_robust(
        body, turned, fit.a_from_b, settings,
        iterations=3, noise_sd=fit.noise_sd, biases=fit.biases, prior=prior,
    )  # fmt: skip
    step = other.a_from_b @ fit.a_from_b.inverse()
    moved = np.append(step.apply(fit.centre) - fit.centre, rotation_vector(step.rotation))
    return replace(fit, covariance=fit.covariance + np.outer(moved, moved))


def registration_of(body: Body, evidence: Evidence, fit: RobustFit) -> Registration:
    """Converts a fit, with its residuals, to a ``Registration``."""
    sure, sd = evidence.weights > 0.5, (fit.rotation_sd, fit.translation_sd)
    return Registration.between(body, evidence.a, evidence.b, sure, fit.a_from_b, *sd)


def _middle(evidence: Evidence) -> Array:
    """(3,) metres, the weighted mean of B's joints in its frame."""
    weights = evidence.weights
    total = weights.sum()
    if total == 0.0:
        raise CalibrationError("No joint is seen by both sensors.")
    return np.asarray(np.tensordot(weights, evidence.b, axes=([0, 1], [0, 1])) / total)


def _add_prior(
    information: Array, gradient: Array, prior: Prior, inflation: float, R: Array, t: Array, centre: Array
) -> None:
    # The covariance is inflated afterwards; the prior is scaled here so that it is not inflated.
    turn = rotation_vector(prior.a_from_b.rotation @ R.T)
    in_b = R.T @ (centre - t)
    shift = prior.a_from_b.apply(in_b) - centre
    precision = inflation * np.repeat([prior.translation_sd**-2, prior.rotation_sd**-2], 3)
    information[np.diag_indices(6)] += precision
    gradient += precision * np.concatenate((shift, turn))


class Found(NamedTuple):
    """A fit from one start."""

    cost: float  # minus the log likelihood of the evidence, up to a constant
    fit: RobustFit
    evidence: Evidence  # with sides matched to the fit


def fits_from(
    body: Body, evidence: Evidence, starts: Sequence[RigidTransform], settings: RobustFitSettings
) -> Iterator[Found]:
    """Yields the fit from each start and from its half-turned version; leaves out undetermined ones."""
    for start in starts:
        for one in (start, half_turned(start, evidence)):
            seen = evidence.copy()
            match_sides(body, seen, one)
            try:
                fit = fit_robust(body, seen, one, settings, iterations=6, noise_sd=_NOISE_SD)
                match_sides(body, seen, fit.a_from_b)
                fit = fit_robust(
                    body, seen, fit.a_from_b, settings,
                    iterations=4, noise_sd=fit.noise_sd, biases=fit.biases,
                )  # fmt: skip
            except CalibrationError:
                continue
            yield Found(disagreement(body, seen, fit.a_from_b, settings, _NOISE_SD), fit, seen)


def better_fit(
    body: Body, evidence: Evidence, start: RigidTransform, settings: RobustFitSettings
) -> Found | None:
    """The best fit from other starts, if it is certainly better than that near the given start; else None.

    The other starts are the label-free fit and the half-turned versions of both.
    """
    free = label_free_fit(body, evidence)
    fits = list(fits_from(body, evidence, [start] if free is None else [start, free], settings))
    best = min(fits, key=lambda found: found.cost, default=None)
    if best is None:
        return None
    near = [found.cost for found in fits if found.fit.a_from_b.angle_to(start) < _NEAR]
    return best if min(near, default=np.inf) >= best.cost + _GAIN else None


def half_turned(a_from_b: RigidTransform, evidence: Evidence) -> RigidTransform:
    """The transform followed by half a turn about A's y axis through the person.

    The axis is vertical only where sensor A is not tilted. The result is the start of a fit.
    """
    centre: NDArray[np.float64] = evidence.a[evidence.weights > 0.5].mean(axis=0)
    half = np.diag([-1.0, 1.0, -1.0])
    return RigidTransform.of(half, centre - half @ centre) @ a_from_b
