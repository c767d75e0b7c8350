"""Knocked sensors: a cheap suspicion, and the test of it.

**Suspicion** (:class:`KnockDetector`). The offset between the views is measured on points that an exchange
of left and right does not move, in blocks of a quarter of a second. A knocked sensor moves all of them by one
rigid transform: four blocks in a row differ from the usual offset, in the same direction.

**Test** (:func:`fit_knock`). The pairs before and after the suspected moment are explained twice, each time
by the model of :mod:`fusion.registration.robust_fit` with one set of biases β for all pairs:

* **untouched**: one transform T for all pairs, which may differ from the one in force;
* **knocked**: T before, and T D after, with D a rigid movement of a sensor.

A tracker's bias that changes with heading is in β, and a registration that was never quite right is in T, so
that both are explained without D. What remains is the gain of log-likelihood by D, at the price of D's prior.
And D is more than the errors that last as long as a pose (:mod:`fusion.registration.lasting_errors`): of a
person who stands still after a walk, these alone turn R by degrees.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fusion.body import Body
from fusion.registration.error_model import RobustFitSettings, cost_of
from fusion.registration.keyframes import Evidence, match_sides
from fusion.registration.lasting_errors import common_variance
from fusion.registration.robust_fit import Prior, RobustFit, fit_robust, with_frontal_sd
from fusion.rigid import RigidTransform, rotation_vector
from fusion.skeleton import TRACKED, Skeleton, SkeletonPair
from fusion.support.medians import median_of_known
from fusion.support.types import Array

KNOCK_TURN, KNOCK_SHIFT = float(np.radians(8.0)), 0.4
"""Standard deviations of a knock: radians, and metres at the person."""
_KNOWN = 1e-4  # metres, deviation of biases that are already subtracted
_LEAST_NOISE = 0.015
"""Lower limit of a spine joint's noise, metres. A still person shows less; biases change with the pose."""
_ROUNDS = 2  # of T with β and D in turn; a third changes the gain by less than a tenth
_FEWEST_POINTS = 3  # seen by both views
_NORM_OF_SD = 1.538  # median norm of a normal 3-vector, in standard deviations of one axis


@dataclass(frozen=True)
class KnockSettings:
    """When a knock is suspected, and when it counts."""

    block_ns: int = 250_000_000  # the offset is the median over blocks of this length
    blocks: int = 4  # number of successive blocks that must be off in the same direction
    smallest: float = 0.035  # metres; a smaller offset is left to the refinement
    deviations: float = 4.0  # threshold in robust standard deviations of the offset's own history
    history: int = 200  # number of blocks in the history
    fewest: int = 10  # number of blocks that a suspicion needs in it
    moving_ns: int = 250_000_000
    """How long a sensor moves; pairs within this time count neither as before nor as after."""
    tested_ns: int = 1_750_000_000  # time after which a suspicion is tested
    retested_ns: int = 500_000_000  # time between two tests
    dropped_ns: int = 2_500_000_000
    """Time after which it is dropped if it has less than half the gain that it needs, and after twice this
    time in any case. The next one waits as long."""
    gain: float = 30.0  # by how much a knock must raise the log-likelihood of the pairs
    few: float = 3.0
    """Number of keyframes before the knock at which twice that gain is needed: they do not yet show how
    biases change from pose to pose."""

    least: float = 12.6
    """Smallest significance of D: χ² of six degrees of freedom, 95 %."""

    def needed(self, keyframes: int) -> float:
        """The gain that a knock needs after so many keyframes."""
        return self.gain * (1.0 + self.few / max(keyframes, 1))

    def excess(self, found: KnockFit) -> float:
        """What a suspected knock has of what it needs; above 1 it is one."""
        return min(found.gain / self.needed(found.keyframes), found.significance / self.least)


class _Block(NamedTuple):
    """The mean places of the midpoints over a fraction of a second; NaN where unknown."""

    start_ns: int
    a: Array  # (M, 3) metres, K_A's frame
    b: Array  # (M, 3) metres, K_B's frame


class KnockDetector:
    """Watches the offset between the views under the transform in force.

    Attributes:
        a_from_b: In force; may be replaced by a refined one.
        since_ns: When the views moved apart; None if they did not.
    """

    def __init__(self, body: Body, a_from_b: RigidTransform, settings: KnockSettings | None = None) -> None:
        self._settings = settings or KnockSettings()
        self._own, self._other = body.midpoints
        self._blocks: deque[_Block] = deque(maxlen=self._settings.history)
        self._offsets = np.zeros((0, 3))  # of each block, under _offset_by
        self._offset_by: RigidTransform | None = None
        self._pairs: list[SkeletonPair] = []
        self._quiet_ns = 0
        self.a_from_b = a_from_b
        self.since_ns: int | None = None

    def adopt(self, a_from_b: RigidTransform) -> None:
        """Uses another transform and forgets the history."""
        self.a_from_b, self.since_ns = a_from_b, None
        self._blocks.clear()
        self._offset_by = None
        self._pairs.clear()

    def withdraw(self, now_ns: int) -> None:
        """Counts the offsets since the views moved apart as usual: no sensor was moved."""
        self.since_ns, self._quiet_ns = None, now_ns + self._settings.dropped_ns

    def observe(self, pair: SkeletonPair) -> None:
        """Takes a pair that is neither stale nor one-sided; updates :attr:`since_ns`."""
        if self._pairs and pair.time_ns - self._pairs[0].time_ns >= self._settings.block_ns:
            self._end_block()
        self._pairs.append(pair)

    def _end_block(self) -> None:
        start_ns, views = self._pairs[0].time_ns, zip(*((p.a, p.b) for p in self._pairs), strict=True)
        block = _Block(start_ns, *(self._mean_points(view) for view in views))
        self._pairs.clear()
        if np.count_nonzero(np.isfinite(block.a[:, 0] + block.b[:, 0])) < _FEWEST_POINTS:
            return
        self._blocks.append(block)
        every = self._update_offsets()
        newest = list(self._blocks)[-self._settings.blocks :]
        before_ns = newest[0].start_ns if self.since_ns is None else self.since_ns
        usual = [past for past in self._blocks if past.start_ns < before_ns]
        if len(usual) < self._settings.fewest or start_ns < self._quiet_ns:
            return
        offsets, history = every[-len(newest) :], every[: len(usual)]
        ordered = np.sort(history, axis=0)
        middle = (ordered[(len(usual) - 1) // 2] + ordered[len(usual) // 2]) / 2.0
        off = offsets - middle
        apart = np.sqrt((off * off).sum(axis=1)) > self._settings.smallest
        if self.since_ns is None and not apart.all():
            return
        sd = float(np.median(np.linalg.norm(history - middle, axis=1))) / _NORM_OF_SD
        apart &= np.linalg.norm(off, axis=1) > self._settings.deviations * sd
        if self.since_ns is not None:
            self.since_ns = self.since_ns if apart.any() else None
        elif apart.all():
            mean = off.mean(axis=0)
            # While the sensor still turns, the first block is between the old and the new offset.
            if np.linalg.norm(off[1:] - mean, axis=1).max() < 0.5 * np.linalg.norm(mean):
                # the blocks just before may have moved, too, by less than the threshold
                late = np.linalg.norm(history - middle - mean, axis=1) < np.linalg.norm(
                    history - middle, axis=1
                )
                first = len(usual) - int(np.argmin(np.append(late[::-1], False)))
                self.since_ns = (usual + newest)[first].start_ns

    def _update_offsets(self) -> Array:
        """(N, 3) the median difference of the views over the points of each block."""
        new = [self._blocks[-1]]
        if self._offset_by is not self.a_from_b:
            self._offsets, new = self._offsets[:0], list(self._blocks)
        apart = np.array([b.a for b in new]) - self.a_from_b.apply(np.array([b.b for b in new]))
        self._offsets = np.concatenate([self._offsets, median_of_known(apart)])[-len(self._blocks) :]
        self._offset_by = self.a_from_b
        return self._offsets

    def _mean_points(self, view: Sequence[Skeleton | None]) -> Array:
        """(M, 3) mean over time of the midpoints that are tracked in every frame of the block."""
        at = np.array([s.positions for s in view if s is not None], dtype=np.float64)
        tracked = np.array([s.states == TRACKED for s in view if s is not None])
        at[~tracked] = np.nan
        return np.asarray(0.5 * (at[:, self._own] + at[:, self._other]).mean(axis=0))


@dataclass(frozen=True, eq=False)
class KnockFit:
    """What a suspected knock would be."""

    gain: float  # log-likelihood of the knock relative to none
    fit: RobustFit  # R and t after the knock
    turn: float  # radians, by which the sensor would have turned
    shift: float  # metres, by which it would have moved the person
    significance: float  # squared, D over the deviations of both registrations, lasting errors included
    keyframes: int  # number of pairs before it


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
        before, after: Pairs before and after the suspected moment; sides of ``after`` may still differ.
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
    gain = costs[0] - costs[1] - price
    sure = _significance(body, (before, later), (first, found), settings) if gain > 0.0 else 0.0
    return KnockFit(gain, found, turn, shift, sure, len(before.a))


def _significance(
    body: Body,
    seen: tuple[Evidence, Evidence],
    fits: tuple[RobustFit, RobustFit],
    settings: RobustFitSettings,
) -> float:
    """The squared difference of two fits over their deviations, with errors that last as long as a pose."""
    first, new = (with_frontal_sd(body, of, fit, settings) for of, fit in zip(seen, fits, strict=True))
    step = new.a_from_b @ first.a_from_b.inverse()
    off = np.append(step.apply(new.centre) - new.centre, rotation_vector(step.rotation))
    there = np.eye(6)  # the first one's deviations where the person is after the knock
    there[:3, 3:] = np.cross(np.eye(3), new.centre - first.centre)
    covariance = there @ first.covariance @ there.T + new.covariance
    lasting = common_variance(first.a_from_b, first.centre, settings.common_sd)
    covariance[:3, :3] -= lasting * np.eye(3)  # both have it, and the same one
    return float(off @ np.linalg.solve(covariance, off))


def _joined(one: Evidence, other: Evidence) -> Evidence:
    return Evidence(*(np.concatenate(values) for values in zip(one, other, strict=True)))


def _price(prior: Prior | None, fit: RobustFit) -> float:
    """Minus the log density of a transform under the prior."""
    if prior is None:
        return 0.0
    shift = prior.a_from_b.apply(fit.a_from_b.inverse().apply(fit.centre)) - fit.centre
    turn = prior.a_from_b.angle_to(fit.a_from_b)
    return 0.5 * (turn / prior.rotation_sd) ** 2 + 0.5 * float(shift @ shift) / prior.translation_sd**2
