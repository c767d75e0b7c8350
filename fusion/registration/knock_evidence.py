"""The test of a suspected knock: did one of the sensors move, or do the views' biases explain the change?

The pairs before and after the suspected moment are explained twice, each time by the model of
:mod:`fusion.registration.robust_fit` with one set of biases β for all pairs:

* **untouched**: one transform T for all pairs, which may differ from the one in force;
* **knocked**: T before, and T D after, with D a rigid movement of a sensor.

A tracker's bias that changes with heading is in β, and a registration that was never quite right is in T, so
that both are explained without D. What remains is the gain of log-likelihood by D, at the price of D's prior.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fusion.body import Body
from fusion.registration.keyframes import Evidence, match_sides
from fusion.registration.robust_fit import Prior, RobustFit, RobustFitSettings, cost_of, fit_robust
from fusion.rigid import RigidTransform

Array = NDArray[np.float64]

KNOCK_TURN, KNOCK_SHIFT = float(np.radians(8.0)), 0.4
"""Standard deviations of a knock: radians, and metres at the person."""
_KNOWN = 1e-4  # metres, deviation of biases that are already subtracted
_LEAST_NOISE = 0.015
"""Metres, the spine's: a person who stands still shows less, but not how biases change with the pose."""
_ROUNDS = 2  # of T with β and D in turn; a third changes the gain by less than a tenth


@dataclass(frozen=True, eq=False)
class KnockFit:
    """What a suspected knock would be.

    Attributes:
        gain: Log-likelihood of the knock relative to none.
        fit: R and t after the knock.
        turn: Radians, by which the sensor would have turned.
        shift: Metres, by which it would have moved the person.
        keyframes: Number of pairs before it.
    """

    gain: float
    fit: RobustFit
    turn: float
    shift: float
    keyframes: int


def fit_knock(
    body: Body,
    before: Evidence,
    after: Evidence,
    in_force: RigidTransform,
    settings: RobustFitSettings,
    prior: Prior | None = None,
) -> KnockFit:
    """Compares the two explanations of the pairs.

    Args:
        body: Of both views.
        before, after: Pairs before and after the suspected moment; sides of ``after`` may still differ.
        in_force: R and t in force.
        settings: Assumptions of the fits.
        prior: Knowledge of T besides the pairs.

    Raises:
        CalibrationError: The pairs do not determine a transform.
    """
    first = fit_robust(body, before, in_force, settings, iterations=3, prior=prior)

    untouched = after.copy()
    match_sides(body, untouched, first.a_from_b)
    every = _joined(before, untouched)
    one = fit_robust(
        body, every, first.a_from_b, settings,
        iterations=4, noise_sd=first.noise_sd, biases=first.biases, prior=prior,
    )  # fmt: skip

    later = after.copy()
    T, biases, noise_sd = first.a_from_b, first.biases, first.noise_sd
    knock, new = RigidTransform.identity(), first
    surely = RobustFitSettings(_KNOWN, settings.tempering, settings.inflation, settings.common_sd)
    for number in range(_ROUNDS):
        shown = later._replace(a=later.a - np.einsum("kf,fjc->kjc", later.basis, biases, optimize=False))
        new = fit_robust(
            body, shown, T @ knock, surely,
            iterations=3, noise_sd=noise_sd, prior=Prior(T, KNOCK_TURN, KNOCK_SHIFT),
        )  # fmt: skip
        knock = T.inverse() @ new.a_from_b
        if number == 0:
            match_sides(body, later, new.a_from_b)
        both = _joined(before, later._replace(b=knock.apply(later.b)))
        two = fit_robust(body, both, T, settings, iterations=2, noise_sd=noise_sd, biases=biases, prior=prior)
        T, biases, noise_sd = two.a_from_b, two.biases, two.noise_sd
    found = RobustFit(T @ knock, new.covariance, new.centre, biases, noise_sd)
    turn = knock.angle_to(RigidTransform.identity())
    shift = float(np.linalg.norm(found.a_from_b.apply(T.inverse().apply(new.centre)) - new.centre))
    noise_sd = max(noise_sd, _LEAST_NOISE)
    costs = [
        cost_of(body, evidence, fit.a_from_b, settings, noise_sd, fit.biases) + _price(prior, fit)
        for evidence, fit in ((every, one), (both, two))
    ]
    price = 0.5 * (turn / KNOCK_TURN) ** 2 + 0.5 * (shift / KNOCK_SHIFT) ** 2
    return KnockFit(costs[0] - costs[1] - price, found, turn, shift, len(before.a))


def _joined(one: Evidence, other: Evidence) -> Evidence:
    return Evidence(*(np.concatenate(values) for values in zip(one, other, strict=True)))


def _price(prior: Prior | None, fit: RobustFit) -> float:
    """Minus the log density of a transform under the prior."""
    if prior is None:
        return 0.0
    shift = prior.a_from_b.apply(fit.a_from_b.inverse().apply(fit.centre)) - fit.centre
    turn = prior.a_from_b.angle_to(fit.a_from_b)
    return 0.5 * (turn / prior.rotation_sd) ** 2 + 0.5 * float(shift @ shift) / prior.translation_sd**2
