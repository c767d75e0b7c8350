"""The method, one line a step: S_A and S_B in, S* out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fusion.calibration import Calibration
from fusion.errors import FusionError
from fusion.paper_solver import PaperSolver
from fusion.reliability import PAPER_H, equal_weights, reliability_weights
from fusion.rigid import RigidTransform
from fusion.skeleton import Skeleton, SkeletonPair
from fusion.solver import Solver
from fusion.tree_solver import TreeSolver
from fusion.viewing_plane import NOMINAL_INTRINSICS, Intrinsics

_FORGET_NS = 1_000_000_000  # after so long without a person the next one starts afresh


@dataclass(frozen=True)
class FuserSettings:
    """The choices the method leaves open, with the paper's values where it names one.

    Attributes:
        h: How much more a tracked joint counts than an inferred one, in (0.5, 1); sec. 3.
        solver: ``exact`` (one constraint a bone) or ``paper`` (eqs. (3)-(9) as published).
        weights: ``paper`` (eqs. (10), (11)) or ``equal``.
    """

    h: float = PAPER_H
    solver: Literal["exact", "paper"] = "exact"
    weights: Literal["paper", "equal"] = "paper"

    def __post_init__(self) -> None:
        if not 0.5 < self.h < 1.0:
            raise FusionError(f"h must lie between 0.5 and 1 (sec. 3); got {self.h}.")


@dataclass(frozen=True, eq=False)
class FusedFrame:
    """S* of one pair, and why it is so.

    Attributes:
        positions: (J, 3) metres, in K_A's frame; NaN throughout where neither sensor sees a person.
        predicted: (J,) whether a joint has no data and hangs on its bones and the frame before.
        weights_a, weights_b: (J,) w^A and w^B of eq. (11); both 0 where predicted.
        misleading: (J,) the mis-leading joint m of sec. 3; -1 where there is none.
        a_from_b: R, and t of this frame.
        iterations: Steps the solver took.
        stale_a, stale_b: Whether the sensor's skeleton repeats its last one.
        time_ns: The pair's time.
    """

    positions: NDArray[np.float64]
    predicted: NDArray[np.bool_]
    weights_a: NDArray[np.float64]
    weights_b: NDArray[np.float64]
    misleading: NDArray[np.int64]
    a_from_b: RigidTransform
    iterations: int
    stale_a: bool
    stale_b: bool
    time_ns: int

    @property
    def has_person(self) -> bool:
        """Whether there is an S* at all."""
        return not self.predicted.all()


class Fuser:
    """Makes one skeleton of two, pair by pair; it remembers only the frame before.

    Args:
        calibration: R, t and the bone lengths.
        settings: The method's choices.
        intrinsics_a, intrinsics_b: The sensors' depth cameras; the family's nominal ones where None.
    """

    def __init__(
        self,
        calibration: Calibration,
        settings: FuserSettings | None = None,
        intrinsics_a: Intrinsics | None = None,
        intrinsics_b: Intrinsics | None = None,
    ) -> None:
        self.calibration = calibration
        self.settings = settings or FuserSettings()
        body = calibration.body
        self.intrinsics_a = intrinsics_a or NOMINAL_INTRINSICS[body.name]
        self.intrinsics_b = intrinsics_b or NOMINAL_INTRINSICS[body.name]
        self._body = body
        self._nobody = Skeleton.of(body, np.full((len(body), 3), np.nan))
        self._torso = np.array(body.torso, dtype=np.int64)
        self._solver: Solver = (
            PaperSolver(body.parents)
            if self.settings.solver == "paper"
            else TreeSolver(body.parents, body.order, body.rest)
        )
        self._a_from_b = calibration.a_from_b
        self._before: NDArray[np.float64] | None = None
        self._before_ns = 0
        self._last_a: Skeleton | None = None
        self._last_b: Skeleton | None = None

    def update(self, pair: SkeletonPair) -> FusedFrame:
        """Fuses the next pair.

        Args:
            pair: Both skeletons in their own sensors' frames, of the calibration's body. A sensor that sees
                no one gives None, and S* comes from the other alone; with neither there is no S*.
        """
        a, b = pair.a or self._nobody, pair.b or self._nobody
        stale_a, stale_b = self._notice_stale(pair)
        if pair.time_ns - self._before_ns > _FORGET_NS:
            self._before = None

        # t again from the torso's centres (sec. 4), and S_B in K_A's frame
        self._a_from_b = self._carry(a, b)
        p, q = a.positions.astype(np.float64), self._a_from_b.apply(b.positions)

        # how far to trust each view of each joint (eqs. (10), (11))
        weights_a, weights_b, misleading = self._trust(a, b)
        weights = weights_a + weights_b
        predicted = weights == 0.0

        # the closest joints with exactly these bones (eq. (1))
        iterations = 0
        fused = np.full((len(self._body), 3), np.nan)
        if not predicted.all():
            targets = np.where(weights_a[:, None] > 0.0, weights_a[:, None] * p, 0.0)
            targets += np.where(weights_b[:, None] > 0.0, weights_b[:, None] * q, 0.0)
            targets /= np.where(predicted, 1.0, weights)[:, None]
            start = self._first_guess(targets, predicted) if self._before is None else self._before
            solution = self._solver.solve(targets, weights, self.calibration.bone_lengths, start)
            fused, iterations = solution.positions, solution.iterations
            self._before, self._before_ns = fused, pair.time_ns
        return FusedFrame(
            fused, predicted, weights_a, weights_b, misleading, self._a_from_b, iterations,
            stale_a, stale_b, pair.time_ns,
        )  # fmt: skip

    def _notice_stale(self, pair: SkeletonPair) -> tuple[bool, bool]:
        stale_a = pair.a is not None and pair.a.repeats(self._last_a)
        stale_b = pair.b is not None and pair.b.repeats(self._last_b)
        self._last_a, self._last_b = pair.a, pair.b
        return stale_a, stale_b

    def _carry(self, a: Skeleton, b: Skeleton) -> RigidTransform:
        """R with the t that lays the torso's centre of S_B on that of S_A; unchanged where none is shared."""
        shared = self._torso[(a.has_position & b.has_position)[self._torso]]
        if len(shared) == 0:
            return self._a_from_b
        R = self._a_from_b.rotation
        centre_a = a.positions[shared].astype(np.float64).mean(axis=0)
        centre_b = b.positions[shared].astype(np.float64).mean(axis=0)
        return RigidTransform(R, centre_a - R @ centre_b)

    def _trust(
        self, a: Skeleton, b: Skeleton
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
        pixels_a = self.intrinsics_a.project(a.positions)
        pixels_b = self.intrinsics_b.project(b.positions)
        if self.settings.weights == "equal":
            return *equal_weights(pixels_a, pixels_b), np.full(len(self._body), -1, dtype=np.int64)
        return reliability_weights(pixels_a, pixels_b, a.states, b.states, self._body.linked, self.settings.h)

    def _first_guess(self, targets: NDArray[np.float64], predicted: NDArray[np.bool_]) -> NDArray[np.float64]:
        """(J, 3) the targets, with joints that have none hung on their parents as in a person at rest."""
        guess = np.where(predicted[:, None], np.nan, targets)
        guess[self._body.root] = np.where(
            predicted[self._body.root], np.nanmean(guess, axis=0), guess[self._body.root]
        )
        for joint in self._body.order[1:]:
            if predicted[joint]:
                bone = self.calibration.bone_lengths[joint] * self._body.rest[joint]
                guess[joint] = guess[self._body.parents[joint]] + bone
        return guess
