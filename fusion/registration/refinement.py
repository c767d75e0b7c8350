"""Refinement of R and t while the person moves: one proposal per second, tested on held-out pairs."""

from collections.abc import Generator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fusion.body import Body
from fusion.errors import CalibrationError
from fusion.registration.error_model import RobustFitSettings, disagreement
from fusion.registration.keyframes import Evidence, KeyframeSet
from fusion.registration.robust_fit import Prior, RobustFit, fit_robust, with_frontal_sd
from fusion.rigid import RigidTransform
from fusion.skeleton import SkeletonPair

_STALE_NS = 500_000_000  # a proposal that was interrupted for so long is dropped


@dataclass(frozen=True)
class RefinementSettings:
    """When a refinement is proposed, and when it is accepted."""

    interval_ns: int = 1_000_000_000  # between two proposals
    fewest: int = 16  # keyframes that a proposal needs
    gain: float = 3.0
    """By how much the log-likelihood of held-out pairs must rise; 3 is a likelihood ratio of 20."""
    surer: float = 0.7
    """A fit whose standard deviation of R is below this share of that in force needs no such gain: fits of
    half of the pairs explain the other half worse than a calibration that is right by luck."""
    smallest_turn: float = 0.0015  # radians and metres; a smaller change is not proposed
    smallest_shift: float = 0.003
    half_life_ns: int = 600_000_000_000  # age at which the weight of a keyframe is one half
    fit: RobustFitSettings = field(default_factory=RobustFitSettings)  # what the fit assumes
    in_steps: bool = False
    """Whether a proposal is computed in steps of one fit, one with each pair, as a live loop needs it: the
    whole takes a third of a frame's time. It then takes effect some pairs later."""

    def worth(self, turn: float, shift: float) -> bool:
        """Whether a change by so many radians, and metres at the person, is large enough."""
        return turn > self.smallest_turn or shift > self.smallest_shift


class Refinement:
    """Collects keyframes and proposes a better transform about once a second.

    A fit on all keyframes that is clearly more certain than the transform in force is accepted. Else the test
    is cross-validation. One fit on the even two-second blocks is judged on the odd ones, and vice versa. The
    transform in force is judged on both. The fit on all keyframes is accepted if the two held-out fits
    together explain the pairs better than the transform in force.

    Args:
        prior: Knowledge of the transform besides the keyframes.
    """

    def __init__(
        self,
        body: Body,
        a_from_b: RigidTransform,
        settings: RefinementSettings | None = None,
        prior: Prior | None = None,
    ) -> None:
        self._body, self._settings = body, settings or RefinementSettings()
        self.keyframes = KeyframeSet(body)
        self._noise_sd = 0.02
        self._biases: NDArray[np.float64] | None = None
        self._next_ns: int | None = None
        self._seen = self._proposed_ns = 0
        self._proposal: Generator[None, None, RobustFit | None] | None = None
        self.adopt(a_from_b, prior)

    def restart(self, a_from_b: RigidTransform, keep_from_ns: int, prior: Prior | None = None) -> None:
        """Puts another transform in force and forgets the keyframes before a time."""
        self.adopt(a_from_b, prior)
        self._biases, self._next_ns = None, None
        self.keyframes.forget_before(keep_from_ns)

    def adopt(self, a_from_b: RigidTransform, prior: Prior | None = None) -> None:
        """Puts another transform in force and keeps the evidence."""
        self._in_force, self.prior, self._proposal = a_from_b, prior, None
        self._rotation_sd = 0.0 if prior is None else prior.rotation_sd

    def observe(self, pair: SkeletonPair, codes: tuple[int, int] = (0, 0)) -> RobustFit | None:
        """Takes a pair that is neither stale nor one-sided; returns a fit that is in force from now on."""
        self._seen += self.keyframes.add(pair, codes)
        if self._next_ns is None:
            self._next_ns = pair.time_ns + self._settings.interval_ns
        if self._proposal is not None and pair.time_ns - self._proposed_ns < _STALE_NS:
            return self._go_on()
        self._proposal = None
        if pair.time_ns < self._next_ns or self._seen == 0 or len(self.keyframes) < self._settings.fewest:
            return None
        self._next_ns = pair.time_ns + self._settings.interval_ns
        self._seen = 0
        self._proposal, self._proposed_ns = self._steps(pair.time_ns), pair.time_ns
        return self._go_on()

    def _go_on(self) -> RobustFit | None:
        """Takes one step of the proposal, or all of them; returns its result with the last step."""
        assert self._proposal is not None
        try:
            next(self._proposal)
            while not self._settings.in_steps:
                next(self._proposal)
        except StopIteration as done:
            self._proposal = None
            result: RobustFit | None = done.value
            return result
        return None

    def _steps(self, now_ns: int) -> Generator[None, None, RobustFit | None]:
        """Fits all keyframes and accepts the fit if it explains held-out pairs better."""
        settings = self._settings
        self.keyframes.relabel(self._in_force)
        evidence = aged(self.keyframes.evidence, now_ns, settings.half_life_ns)
        if settings.in_steps:
            evidence = evidence.copy()  # keyframes come in between the steps
        try:
            candidate = fit_robust(
                self._body, evidence, self._in_force, settings.fit,
                iterations=3, noise_sd=self._noise_sd, biases=self._biases, prior=self.prior,
            )  # fmt: skip
            self._biases, self._noise_sd = candidate.biases, candidate.noise_sd
            frontal, surer_sd = None, settings.surer * self._rotation_sd
            if candidate.rotation_sd < surer_sd:
                yield
                frontal = with_frontal_sd(self._body, evidence, candidate, settings.fit, self.prior)
            if frontal is None or frontal.rotation_sd >= surer_sd:
                if not self._worth_it(candidate.a_from_b, candidate.centre):
                    return None
                gain = 0.0
                for fold in (0, 1):
                    yield
                    gain += _fold_gain(
                        fold, self._body, evidence, self._in_force, candidate, settings.fit, self.prior
                    )
                if gain < settings.gain:
                    return None
            if frontal is None:
                frontal = with_frontal_sd(self._body, evidence, candidate, settings.fit, self.prior)
        except CalibrationError:
            return None
        self._in_force, self._rotation_sd = frontal.a_from_b, frontal.rotation_sd
        return frontal

    def _worth_it(self, proposed: RigidTransform, centre: NDArray[np.float64]) -> bool:
        shift = proposed.apply(self._in_force.inverse().apply(centre)) - centre
        return self._settings.worth(proposed.angle_to(self._in_force), float(np.linalg.norm(shift)))


def aged(evidence: Evidence, now_ns: int, half_life_ns: int) -> Evidence:
    """The evidence with weights that halve with every half-life of age."""
    age = (now_ns - evidence.time_ns) / half_life_ns
    return evidence._replace(weights=evidence.weights * np.exp2(-age)[:, None])


def held_out_gain(
    body: Body,
    evidence: Evidence,
    in_force: RigidTransform,
    candidate: RobustFit,
    settings: RobustFitSettings,
    prior: Prior | None = None,
) -> float:
    """The gain of log-likelihood of fits like the candidate on pairs that they were not fitted to.

    Two folds of alternate blocks of two seconds. Each fold's fit starts at the candidate and sees the other
    fold only. −inf where a fold has too few keyframes.
    """
    folds = (_fold_gain(k, body, evidence, in_force, candidate, settings, prior) for k in (0, 1))
    return sum(folds, 0.0)


def _fold_gain(
    fold: int,
    body: Body,
    evidence: Evidence,
    in_force: RigidTransform,
    candidate: RobustFit,
    settings: RobustFitSettings,
    prior: Prior | None,
) -> float:
    """One fold's part of :func:`held_out_gain`."""
    learned, held_out = evidence.chosen(evidence.folds != fold), evidence.chosen(evidence.folds == fold)
    if len(learned.a) < 6 or len(held_out.a) < 6:
        return -np.inf
    fit = fit_robust(
        body, learned, candidate.a_from_b, settings,
        iterations=2, noise_sd=candidate.noise_sd, biases=candidate.biases, prior=prior,
    )  # fmt: skip
    before = disagreement(body, held_out, in_force, settings, candidate.noise_sd)
    return before - disagreement(body, held_out, fit.a_from_b, settings, candidate.noise_sd)
