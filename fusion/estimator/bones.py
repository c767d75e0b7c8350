"""The best skeleton with exact bone lengths, and the filter's correction towards it."""

from __future__ import annotations

import math

from fusion.compiling.kernels import inner_kernel
from fusion.estimator.three import inverse
from fusion.solvers.tree_solver import solve_tree
from fusion.solvers.tree_steps import copy


@inner_kernel
def aim(model, state, solve):  # type: ignore[no-untyped-def]
    """Sets targets x and information (M + P I)⁻¹ of each known joint, and 0 for the others."""
    for i in range(len(model.parents)):
        W = solve.information[i]
        for c in range(3):
            solve.targets[i, c] = state.positions[i, c] if state.known[i] else math.nan
            for r in range(3):
                W[r, c] = state.shared_error[i, r, c] if state.known[i] else 0.0
            W[c, c] += state.variances[i, 0] if state.known[i] else 0.0
        if state.known[i]:
            inverse(W, W)


@inner_kernel
def hold_bones(model, state, solve):  # type: ignore[no-untyped-def]
    """S*: min Σ (x_i - m_i)ᵀ W_i (x_i - m_i) with |x_i - x_parent| = l_i, starting at the previous frame.

    Returns:
        The number of iterations.
    """
    if state.clock[1] == 0:
        _first_guess(model, solve, state.before)
    iterations, _, _, _ = solve_tree(
        model.parents, model.order, model.rest, solve.targets, solve.information, model.bone_lengths,
        state.before, solve.tree_work, solve.positions,
    )  # fmt: skip
    if not model.constants.bones:
        for i in range(len(model.parents)):
            for c in range(3):
                if state.known[i]:
                    solve.positions[i, c] = solve.targets[i, c]
    return iterations


@inner_kernel
def _first_guess(model, solve, before):  # type: ignore[no-untyped-def]
    """Uses the targets as previous frame; a joint without target is placed as in the rest pose."""
    root = model.order[0]
    for n in range(len(model.order)):
        i = model.order[n]
        for c in range(3):
            if math.isfinite(solve.targets[i, c]):
                before[i, c] = solve.targets[i, c]
            elif i == root:
                total, count = 0.0, 0
                for j in range(len(model.order)):
                    if math.isfinite(solve.targets[j, c]):
                        total, count = total + solve.targets[j, c], count + 1
                before[i, c] = total / max(count, 1)
            else:
                before[i, c] = before[model.parents[i], c] + model.bone_lengths[i] * model.rest[i, c]


@inner_kernel
def follow_bones(model, state, solve):  # type: ignore[no-untyped-def]
    """Sets x ← S* and v ← v + (P_xv / P_xx) (S* - x), as if S* had been measured."""
    x, v, P = state.positions, state.velocities, state.variances
    for i in range(len(model.parents)):
        if not state.known[i]:
            continue
        slope = P[i, 1] / P[i, 0]
        for c in range(3):
            v[i, c] += slope * (solve.positions[i, c] - x[i, c])
            x[i, c] = solve.positions[i, c]
    copy(solve.positions, state.before)
