"""The closest joints with exactly these bone lengths, eq. (1), by Newton's method on the tree of bones.

The unknowns are the root's position and one direction a bone, so that every iterate has the right bone
lengths. One step costs O(J): see :mod:`fusion.tree_elimination`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from fusion.errors import FusionError
from fusion.tree_elimination import (
    BEST,
    BONE,
    FORCE,
    INFORMATION,
    POSITION,
    REDUCED,
    SADDLE,
    STEP,
    TARGET,
    TRIAL,
    eliminate,
    measure_multipliers,
    misfit,
    pull,
    retract,
    solve_root,
    substitute,
    update_multipliers,
)
from fusion.tree_elimination import (
    BLOCKS as BLOCKS,
)

MAX_ITERATIONS = 50
_STATIONARY = 3e-11  # m: tangential force over the information it acts on
_LAST_STEP = 1e-4  # of the bone's length: an undamped step below it leaves an error of its square
_SMALL_STEP = 1e-7  # m: where the force is zero too, a shorter step tells nothing new
_ROUNDING = 1e-14  # relative: two objectives nearer than this are the same
_NEAR_SADDLE = 0.01  # of the bone's length: a shorter step, with a negative pivot, crawls along a saddle
_KICK = 0.5  # of the bone's length: how far a saddle is left at once
_DOUBLINGS = 6
_SHORTER_KICK = 0.2  # after patience ran out

# Levenberg's damping, as a share of the subtree's information. The values were chosen on random problems
# whose weights span six orders of magnitude; ordinary frames never need any.
_FIRST_DAMPING = 1e-5
_MORE, _LESS, _NONE = 8.0, 0.03, 1e-9
_PATIENCE = 8  # steps that may climb before the best point is taken up again
_PATIENT_DAMPING, _PATIENT_MORE = 1e-8, 6.0
_LONGEST = 10.0  # of the bone's length: a longer step is not worth the patience


@njit(cache=True, error_model="numpy")
def _load(targets, weights, lengths, root, work):  # type: ignore[no-untyped-def]
    """Targets and information into the workspace; a joint without a finite target has no information."""
    target, info, bone = work[TARGET], work[INFORMATION], work[BONE]
    for i in range(targets.shape[0]):
        if weights.ndim == 1:
            xx = yy = zz = weights[i]
            xy = xz = yz = 0.0
        else:
            xx, xy, xz = weights[i, 0, 0], weights[i, 0, 1], weights[i, 0, 2]
            yy, yz, zz = weights[i, 1, 1], weights[i, 1, 2], weights[i, 2, 2]
        x, y, z = targets[i, 0], targets[i, 1], targets[i, 2]
        if not (math.isfinite(x + y + z) and xx + yy + zz > 0.0):
            x = y = z = xx = xy = xz = yy = yz = zz = 0.0
        target[i, 0], target[i, 1], target[i, 2] = x, y, z
        info[i, 0], info[i, 1], info[i, 2] = xx, xy, xz
        info[i, 3], info[i, 4], info[i, 5] = yy, yz, zz
        bone[i, 3] = lengths[i]
        bone[i, 4] = 0.0
        if i != root and not (lengths[i] > 0.0 and math.isfinite(lengths[i])):
            return False
    return True


@njit(cache=True, error_model="numpy")
def _place(parents, order, rest, start, from_targets, work, at):  # type: ignore[no-untyped-def]
    """A feasible skeleton into ``at``: directions of bones from a source, then the best translation.

    A bone takes its direction from the targets of its two ends (where asked, and where there are any),
    else from ``start``, else from ``rest``. Where only the far end has a target, the bone points to it.

    Returns:
        The objective.
    """
    target, info, bone = work[TARGET], work[INFORMATION], work[BONE]
    root = order[0]
    for c in range(3):
        at[root, c] = start[root, c] if math.isfinite(start[root, c]) else 0.0
    if from_targets and info[root, 0] + info[root, 3] + info[root, 5] > 0.0:
        for c in range(3):
            at[root, c] = target[root, c]
    for k in range(1, len(order)):
        i = order[k]
        p = parents[i]
        length = bone[i, 3]
        norm = 0.0
        x = y = z = 0.0
        if from_targets and info[i, 0] + info[i, 3] + info[i, 5] > 0.0:
            source = target if info[p, 0] + info[p, 3] + info[p, 5] > 0.0 else at
            x, y, z = target[i, 0] - source[p, 0], target[i, 1] - source[p, 1], target[i, 2] - source[p, 2]
            norm = math.sqrt(x * x + y * y + z * z)
        if not norm > 1e-9 * length:
            x, y, z = start[i, 0] - start[p, 0], start[i, 1] - start[p, 1], start[i, 2] - start[p, 2]
            norm = math.sqrt(x * x + y * y + z * z)
        if not (norm > 1e-9 * length and math.isfinite(norm)):
            x, y, z = rest[i, 0], rest[i, 1], rest[i, 2]
            norm = math.sqrt(x * x + y * y + z * z)
        scale = length / norm
        at[i, 0], at[i, 1], at[i, 2] = at[p, 0] + x * scale, at[p, 1] + y * scale, at[p, 2] + z * scale
    weight = x = y = z = 0.0
    for i in range(len(order)):
        w = info[i, 0] + info[i, 3] + info[i, 5]
        weight += w
        x += w * (target[i, 0] - at[i, 0])
        y += w * (target[i, 1] - at[i, 1])
        z += w * (target[i, 2] - at[i, 2])
    objective = 0.0
    for i in range(len(order)):
        if weight > 0.0:
            at[i, 0] += x / weight
            at[i, 1] += y / weight
            at[i, 2] += z / weight
        objective += misfit(info, target, at, i)
    return objective


@njit(cache=True, error_model="numpy")
def _keep(source, target, work):  # type: ignore[no-untyped-def]
    """Copies the joints of one block to another."""
    for i in range(work.shape[1]):
        for c in range(3):
            work[target, i, c] = work[source, i, c]


@njit(cache=True, error_model="numpy")
def _leave_saddle(parents, order, saddle, s1, s2, length, work):  # type: ignore[no-untyped-def]
    """A step along the direction of negative curvature that the joint ``saddle`` found, downhill if anything.

    Its own step (s1, s2) has the pivot's negative eigenvalue; every joint below follows as the elimination
    says, so that the curvature along the whole is just that eigenvalue. The root's is in its row already.
    """
    step = work[STEP]
    if saddle != order[0]:
        step[order[0], 2] = step[order[0], 3] = step[order[0], 4] = 0.0
        step[saddle, 0], step[saddle, 1] = s1, s2
    slope, relative, _ = substitute(parents, order, work, saddle)
    scale = length / max(relative, 1e-3)
    if slope > 0.0:
        scale = -scale
    _scale(step, scale)
    return slope * scale


@njit(cache=True, error_model="numpy")
def _stretch(parents, order, trial, work):  # type: ignore[no-untyped-def]
    """Doubles a downhill step while the objective falls: a Gauss–Newton step is too short where curvature is
    negative. Returns the objective at the trial point."""
    step = work[STEP]
    factor = 2.0
    for _ in range(_DOUBLINGS):
        _scale(step, factor)
        longer = retract(parents, order, work)
        if not longer < trial:
            _scale(step, 1.0 / factor)
            return retract(parents, order, work)
        trial = longer
    return trial


@njit(cache=True, error_model="numpy")
def _scale(step, factor):  # type: ignore[no-untyped-def]
    """The step of every joint, times a factor."""
    for i in range(len(step)):
        for c in range(5):
            step[i, c] *= factor


@njit(cache=True, error_model="numpy")
def solve_tree(parents, order, rest, targets, weights, lengths, start, work, positions):  # type: ignore[no-untyped-def]
    """Eq. (1) for one frame: min Σ (x_i - m_i)ᵀ W_i (x_i - m_i) with |x_i - x_parent| = l_i for every bone.

    Each iteration, at joints x with the right bone lengths:

    1. :func:`pull`, leaves to root: forces F_i = 2 W_i (x_i - m_i) + Σ F_children. Where every F_i is along
       its bone, the point is stationary.
    2. :func:`eliminate`, leaves to root, and :func:`solve_root`: the Newton step of each bone as a function
       of its parent's. Where a pivot is negative the point is not near a minimum, and the elimination is
       done again with the curvature of compressed bones (λ_i < 0) left out: Gauss–Newton.
    3. :func:`substitute`, root to leaves: the steps.
    4. :func:`retract`: x_i = x_parent + l_i normalise(e_i + T_i s_i), so that bones stay exact.
    5. :func:`update_multipliers`: the forces that the step predicts give the next λ_i. (Forces measured at
       the new point would hold the curvature's transient, which under unequal weights swamps the data.)

    Globalisation: where the objective does not fall as predicted, up to ``_PATIENCE`` steps with growing
    damping may still bring it below the last good point, around the bend of a narrow valley; else that point
    is taken up again with more damping. A stationary point with a negative pivot is a saddle or a maximum
    and is left along the curvature.

    It starts from the better of ``start`` and the directions between targets, both with the bones' lengths.

    Args:
        parents: (J,) int64, -1 for the root.
        order: (J,) int64, every parent before its children.
        rest: (J, 3) direction of each bone where nothing better is known.
        targets: (J, 3) m, metres; a joint whose target is not finite has no data.
        weights: (J,) w ≥ 0 or (J, 3, 3) symmetric positive semidefinite W; 0 where there is no data.
        lengths: (J,) l, metres, by the joint at the bone's far end; the root's is ignored.
        start: (J, 3) joints to start from; NaN where there is none.
        work: (BLOCKS, J, 6) scratch.
        positions: (J, 3) out: the solution.

    Returns:
        (iterations, objective, converged): an iteration is one linear system, its step kept or not;
        (-1, NaN, False) where a bone length is not positive.
    """
    if not _load(targets, weights, lengths, order[0], work):
        return -1, math.nan, False
    objective = _place(parents, order, rest, start, False, work, work[POSITION])
    from_targets = _place(parents, order, rest, start, True, work, work[TRIAL])
    if from_targets < objective:
        objective = from_targets
        _keep(TRIAL, POSITION, work)
    root = order[0]
    step = work[STEP]
    iterations = 0
    patience = 0
    damping = 0.0
    kick = _KICK
    last_step = math.inf
    best = best_step = predicted = 0.0
    converged = False
    while True:
        stationary = pull(parents, order, work) <= _STATIONARY
        if not step[root, 5] > 0.0 or (stationary and last_step < _LAST_STEP):
            converged = True
            break
        if stationary:
            measure_multipliers(order, work)
        scale = step[root, 5]
        saddle, s1, s2 = eliminate(parents, order, work, damping, False)
        x, y, z, lowest, vx, vy, vz = solve_root(work[REDUCED, root], work[FORCE, root], scale)
        if saddle < 0 and lowest < -SADDLE * scale:
            saddle = root
        if saddle >= 0:
            eliminate(parents, order, work, damping, True)
            x, y, z, _, _, _, _ = solve_root(work[REDUCED, root], work[FORCE, root], scale)
        step[root, 2], step[root, 3], step[root, 4] = x, y, z
        slope, relative, longest = substitute(parents, order, work, -1)
        if saddle < 0 and stationary and (longest < _SMALL_STEP or -slope <= _ROUNDING * objective):
            converged = True
            break
        if iterations == MAX_ITERATIONS:
            break
        iterations += 1
        if saddle >= 0 and relative < _NEAR_SADDLE:
            eliminate(parents, order, work, damping, False)
            step[root, 2], step[root, 3], step[root, 4] = vx, vy, vz
            slope = _leave_saddle(parents, order, saddle, s1, s2, kick, work)
            relative = kick
        trial = retract(parents, order, work)
        if saddle >= 0 and trial < objective:
            trial = _stretch(parents, order, trial, work)
        if patience == 0:
            best, best_step, predicted = objective, relative, -0.5 * slope
            _keep(POSITION, BEST, work)
            for i in range(len(order)):
                work[BEST, i, 3] = work[BONE, i, 4]
        slack = _ROUNDING * best
        ratio = (best - trial + slack) / (predicted + slack)
        if ratio >= 0.01:
            patience = 0
            if ratio < 0.1:
                damping = max(2.0 * damping, _FIRST_DAMPING)
            elif ratio > 0.25:
                damping = damping * _LESS if damping > _NONE else 0.0
        elif patience < _PATIENCE and max(best_step, relative) < _LONGEST:
            patience += 1
            if patience > 1:
                damping = max(_PATIENT_MORE * damping, _PATIENT_DAMPING)
        else:
            _keep(BEST, POSITION, work)
            for i in range(len(order)):
                work[BONE, i, 4] = work[BEST, i, 3]
            objective = best
            last_step = math.inf
            patience = 0
            damping = max(_MORE * damping, _FIRST_DAMPING)
            if stationary:
                kick *= _SHORTER_KICK
            continue
        update_multipliers(order, work)
        _keep(TRIAL, POSITION, work)
        objective = trial
        last_step = relative if saddle < 0 and damping == 0.0 else math.inf
    if patience > 0 and best < objective and not converged:
        _keep(BEST, POSITION, work)
        objective = best
    for i in range(len(order)):
        for c in range(3):
            positions[i, c] = work[POSITION, i, c]
    return iterations, objective, converged


@dataclass(frozen=True, eq=False)
class Solution:
    """S* of one frame.

    Attributes:
        positions: (J, 3) metres, in the frame of the targets.
        iterations: Linear systems solved.
        objective: Σ (x - m)ᵀ W (x - m) there, in m² times the unit of the weights.
        converged: Whether the solver's own criterion was met before the iterations ran out.
    """

    positions: NDArray[np.float64]
    iterations: int
    objective: float
    converged: bool


class TreeSolver:
    """Solves eq. (1) for one body; keeps the workspace, so that a frame allocates its result only.

    Not to be shared between threads: the workspace is one frame's.
    """

    def __init__(self, parents: ArrayLike, order: ArrayLike, rest: ArrayLike) -> None:
        """Prepares for a tree of joints.

        Args:
            parents: (J,) index of each joint's parent, -1 for the root.
            order: (J,) joints, every parent before its children.
            rest: (J, 3) direction parent → joint where nothing better is known; not zero but for the root.

        Raises:
            FusionError: The shapes differ, or a joint stands before its parent in ``order``.
        """
        self.parents = np.array(parents, dtype=np.int64)
        self.order = np.array(order, dtype=np.int64)
        self.rest = np.array(rest, dtype=np.float64)
        joints = len(self.parents)
        if self.order.shape != (joints,) or self.rest.shape != (joints, 3):
            raise FusionError(
                f"A tree of {joints} joints needs (J,) order and (J, 3) rest; got {self.order.shape}, "
                f"{self.rest.shape}."
            )
        seen = {-1}
        for joint in self.order.tolist():
            if self.parents[joint] not in seen:
                raise FusionError(f"Joint {joint} stands before its parent {self.parents[joint]} in order.")
            seen.add(joint)
        if seen != set(range(-1, joints)) or np.count_nonzero(self.parents == -1) != 1:
            raise FusionError("A tree needs each joint once in order, and one root (parent -1).")
        self._work = np.zeros((BLOCKS, joints, 6))
        self._no_start = np.full((joints, 3), np.nan)

    def solve(
        self,
        targets: ArrayLike,
        weights: ArrayLike,
        bone_lengths: ArrayLike,
        start: ArrayLike | None = None,
    ) -> Solution:
        """S* of one frame, eq. (1).

        Args:
            targets: (J, 3) m, metres: the joint's weighted mean over the views; NaN where it has no data.
            weights: (J,) w ≥ 0, or (J, 3, 3) symmetric positive semidefinite W; 0: no data.
            bone_lengths: (J,) metres, indexed by the joint at the bone's far end; the root's is ignored.
            start: (J, 3) joints near the solution, such as the frame before's; their bones need no lengths.

        Raises:
            FusionError: A shape does not fit, or a bone length is not positive.
        """
        m = np.ascontiguousarray(targets, dtype=np.float64)
        W = np.ascontiguousarray(weights, dtype=np.float64)
        lengths = np.ascontiguousarray(bone_lengths, dtype=np.float64)
        near = self._no_start if start is None else np.ascontiguousarray(start, dtype=np.float64)
        joints = len(self.parents)
        if (
            m.shape != (joints, 3)
            or near.shape != (joints, 3)
            or lengths.shape != (joints,)
            or (W.shape != (joints,) and W.shape != (joints, 3, 3))
        ):
            raise FusionError(
                f"The tree has {joints} joints; targets are {m.shape}, weights {W.shape}, bone lengths "
                f"{lengths.shape}, start {near.shape}."
            )
        positions = np.empty((joints, 3))
        iterations, objective, converged = solve_tree(
            self.parents, self.order, self.rest, m, W, lengths, near, self._work, positions
        )
        if iterations < 0:
            raise FusionError(f"Every bone needs a length > 0 m; got {lengths[self.order[1:]].min()}.")
        return Solution(positions, iterations, objective, converged)
