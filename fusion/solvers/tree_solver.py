"""The closest joints with exactly these bone lengths, eq. (1), by Newton's method on the tree of bones.

The unknowns are the root's position and one direction per bone, so that every iterate has the right bone
lengths. One step costs O(J): see :mod:`fusion.solvers.tree_elimination`.
"""

import math

from fusion.compiling.kernels import inner_kernel, kernel
from fusion.solvers import MAX_ITERATIONS
from fusion.solvers.tree_elimination import (
    SADDLE,
    eliminate,
    measure_multipliers,
    pull,
    retract,
    solve_root,
    substitute,
    update_multipliers,
)
from fusion.solvers.tree_start import (
    BENT,
    BENT_AWAY,
    FROM_START,
    FROM_TARGETS,
    aim_at,
    copy,
    leave_saddle,
    load,
    place,
    stretch,
)

MAX_SYSTEMS = 150
"""Limit of linear systems from one start, about 0.5 ms."""
_STATIONARY = 3e-11  # m: tangential force over the information it acts on
_LAST_STEP = 1e-4  # of the bone's length: an undamped step below it leaves an error of its square
_SMALL_STEP = 1e-7  # m: with zero force, a shorter step gives no new information
_ROUNDING = 1e-14  # relative: two objectives nearer than this are the same
# m: so are two that differ by what a rounded coordinate of a few metres makes of the misfit. Σ 2 w r ε is at
# most 2 ε √(f Σw); scales[root] is 6 Σw.
_COORDINATE = 8e-16
_NEAR_SADDLE = 0.01  # of the bone's length: a shorter step, with a negative pivot, crawls along a saddle
# of the objective: this many smaller gains in a row, with a negative pivot, count as crawling
_CRAWL, _CRAWLED = 0.01, 5
_BETTER = 1e-9  # relative: another start's result must be lower by this to be used
_FLAT_MINIMUM = 4  # stationary points met; at further ones the curvature is rounding
_KICK = 0.5  # of the bone's length: first step away from a saddle
_SHORTER_KICK = 0.2  # after patience ran out

# Levenberg's damping, as a share of the subtree's information. The values were chosen on random problems
# whose weights span six orders of magnitude; ordinary frames never need any.
_FIRST_DAMPING = 1e-5
_MORE, _LESS, _NONE = 8.0, 0.03, 1e-9
_PATIENCE = 8  # steps that may climb before the solver returns to the best point
_PATIENT_DAMPING, _PATIENT_MORE = 1e-8, 6.0
_CLIMBS = 4  # damping after a failure, for sharply bent valleys:
_LITTLE_LESS, _SHORT_CLIMB = 0.1, 3
_LONGEST = 10.0  # of the bone's length: a longer step is not tried


@inner_kernel
def descend(parents, order, work, objective):  # type: ignore[no-untyped-def]
    """From the joints in ``work.positions``, whose objective is given, to a minimum; as solve_tree."""
    for i in range(len(order)):
        work.multipliers[i] = 0.0
    root, scales, move = order[0], work.scales, work.moves
    iterations = systems = crawling = stationary_points = patience = climbs_lost = 0
    less, longest_climb, damping_before = _LESS, _PATIENCE, 0.0
    damping, kick = 0.0, _KICK
    last_step, converged = math.inf, False
    best = best_step = predicted = 0.0
    while True:
        stationary = pull(parents, order, work) <= _STATIONARY
        if not scales[root] > 0.0 or (stationary and last_step < _LAST_STEP):
            converged = math.isfinite(objective)
            break
        if stationary:
            stationary_points += 1
            measure_multipliers(order, work)
        scale = scales[root]
        saddle, s1, s2 = eliminate(parents, order, work, damping, 1.0)
        x, y, z, lowest, vx, vy, vz = solve_root(work.reduced[root], work.reduced_forces[root], scale)
        if saddle < 0 and lowest < -SADDLE * scale:
            saddle = root
        if saddle >= 0:
            eliminate(parents, order, work, damping, 0.0)
            x, y, z, _, _, _, _ = solve_root(work.reduced[root], work.reduced_forces[root], scale)
        move[root, 0], move[root, 1], move[root, 2] = x, y, z
        slope, relative, longest = substitute(parents, order, work, -1)
        settled = (
            longest < _SMALL_STEP or -slope <= _ROUNDING * objective or stationary_points > _FLAT_MINIMUM
        )
        if saddle < 0 and stationary and settled:
            converged = math.isfinite(objective)
            break
        if iterations == MAX_ITERATIONS or systems == MAX_SYSTEMS:
            break
        systems += 1
        if saddle >= 0 and (relative < _NEAR_SADDLE or crawling == _CRAWLED):
            crawling = 0
            eliminate(parents, order, work, damping, 1.0)
            move[root, 0], move[root, 1], move[root, 2] = vx, vy, vz
            slope = leave_saddle(parents, order, saddle, s1, s2, kick, work)
            relative = kick
        trial = retract(parents, order, work)
        if saddle >= 0 and trial < objective:
            trial = stretch(parents, order, trial, work)
        if patience == 0:
            best, best_step, predicted = objective, relative, -0.5 * slope
            copy(work.positions, work.best)
            for i in range(len(order)):
                work.best_multipliers[i] = work.multipliers[i]
        slack = _ROUNDING * best + _COORDINATE * math.sqrt(scales[root] * best)
        ratio = (best - trial + slack) / (predicted + slack)
        if ratio >= 0.01:
            iterations += 1
            climbed, patience = patience > 0, 0
            crawling = crawling + 1 if saddle >= 0 and objective - trial < _CRAWL * objective else 0
            if ratio < 0.1:
                damping = max(2.0 * damping, _FIRST_DAMPING)
            elif ratio > 0.25 and not (climbed and climbs_lost >= _CLIMBS):
                damping = damping * less if damping > _NONE else 0.0
        elif patience < longest_climb and max(best_step, relative) < _LONGEST:
            patience += 1
            if patience == 1:
                damping_before = damping
            else:
                damping = max(_PATIENT_MORE * damping, _PATIENT_DAMPING)
        else:
            copy(work.best, work.positions)
            for i in range(len(order)):
                work.multipliers[i] = work.best_multipliers[i]
            objective = best
            last_step = math.inf
            if patience > 0:
                climbs_lost += 1
                if climbs_lost >= _CLIMBS:
                    less, longest_climb, damping = _LITTLE_LESS, _SHORT_CLIMB, damping_before
            patience = 0
            damping = max(_MORE * damping, _FIRST_DAMPING)
            if stationary:
                kick *= _SHORTER_KICK
            continue
        update_multipliers(order, work)
        copy(work.trial, work.positions)
        objective = trial
        last_step = relative if saddle < 0 and damping == 0.0 else math.inf
    if patience > 0 and best < objective and not converged:
        copy(work.best, work.positions)
        objective = best
    return iterations, systems, objective, converged


@kernel
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
    damping may still bring it below the last good point, around the bend of a narrow valley; else the
    solver returns to that point with more damping. A stationary point with a negative pivot is a saddle or a
    maximum and is left along the curvature; so is a point where Gauss–Newton steps gain almost nothing.

    An iteration ends at a better point. The steps on the way there, each with a linear system of its own, are
    its line search: those that were replaced with more damping, and those that climbed.

    It starts from the better of ``start`` and the directions between targets, both with the bones' lengths.
    From targets with a hole among them (:func:`~fusion.solvers.tree_start.aim_at`) it starts from two more
    places and keeps the best end. Where ``MAX_ITERATIONS`` or ``MAX_SYSTEMS`` run out, in a narrow curved
    valley, it starts from the others too: about ten in a million random problems.

    Args:
        parents: (J,) int64, -1 for the root.
        order: (J,) int64, every parent before its children.
        rest: (J, 3) default direction of each bone.
        targets: (J, 3) m, metres; a joint whose target is not finite has no data.
        weights: (J,) w ≥ 0 or (J, 3, 3) symmetric positive semidefinite W; 0 where there is no data.
        lengths: (J,) l, metres, by the joint at the bone's far end; the root's is ignored.
        start: (J, 3) joints to start from; NaN where there is none.
        work: A :class:`fusion.solvers.tree_start.TreeWorkspace` of J joints; overwritten.
        positions: (J, 3) out: the solution.

    Returns:
        (iterations, systems, objective, converged): steps to a better point, from the start that led to the
        solution (-1 where a bone length is not positive, or a weight not finite); linear systems solved,
        including line searches and abandoned starts; Σ (x - m)ᵀ W (x - m), in m² times the unit of the
        weights; whether the solver's criterion was met before the iterations ran out.
    """
    if not load(targets, weights, lengths, order[0], work):
        return -1, 0, math.nan, False
    objective = place(parents, order, rest, start, FROM_START, work, work.trial)
    on_targets = place(parents, order, rest, start, FROM_TARGETS, work, work.positions)
    first = FROM_START if objective <= on_targets else FROM_TARGETS
    if first == FROM_START:
        copy(work.trial, work.positions)
    iterations, systems, objective, converged = descend(parents, order, work, min(objective, on_targets))
    copy(work.positions, positions)
    hole = (first == FROM_TARGETS or not converged) and aim_at(parents, order, work)
    if converged and not hole:
        return iterations, systems, objective, converged
    for way in (BENT, BENT_AWAY, FROM_TARGETS, FROM_START):
        if way == first or (way >= BENT and not hole) or (way < BENT and converged):
            continue
        placed = place(parents, order, rest, start, way, work, work.positions)
        steps, more, found, ended = descend(parents, order, work, placed)
        systems += more
        if (ended and not converged) or (ended == converged and found < objective * (1.0 - _BETTER)):
            copy(work.positions, positions)
            iterations, objective, converged = steps, found, ended
    return iterations, systems, objective, converged
