"""Fits of R and t from several starts, because a fit may end in a wrong solution.

A tracker may show a person's back as their front, with left and right exchanged. R turned by half a circle
about the person then fits nearly as well as the right one.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion.body import Body
from fusion.errors import CalibrationError
from fusion.registration.error_model import RobustFitSettings, disagreement
from fusion.registration.keyframes import Evidence, match_sides
from fusion.registration.rigid_fit import label_free_fit
from fusion.registration.robust_fit import RobustFit, fit_robust
from fusion.rigid import RigidTransform

_NOISE_SD = 0.03  # metres, at the start of a fit and to compare fits
_NEAR = np.radians(20.0)  # a fit farther from its start is another solution
_GAIN = 40.0
"""Of log likelihood. Simulated people who turn gain 66 to 99 by the right solution over a half-turned start;
people who stand between sensors that face each other gain up to 23 by a wrong one."""


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
