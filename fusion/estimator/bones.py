"""The best skeleton with exact bone lengths, hinges that bend one way, and the filter's correction."""

from __future__ import annotations

import math

from fusion.compiling.kernels import inner_kernel
from fusion.skeleton import TRACKED
from fusion.solvers.small_matrices import inverse
from fusion.solvers.tree_solver import solve_tree
from fusion.solvers.tree_steps import copy


@inner_kernel
def set_solver_targets(model, state, solve):  # type: ignore[no-untyped-def]
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
def solve_bones(model, state, solve):  # type: ignore[no-untyped-def]
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
def correct_state(model, state, solve):  # type: ignore[no-untyped-def]
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


@inner_kernel
def enforce_hinges(model, state, views):  # type: ignore[no-untyped-def]
    """Moves a hinge that neither view tracks onto the straight line, where it bends to the wrong side.

    A knee lies before the line from hip to ankle, an elbow behind the line from shoulder to wrist of an arm
    that hangs down. The trunk faces forwards: (left - right) × (shoulders - hips). The hinge is moved
    along the part of that direction that is normal to its line.
    """
    x = state.positions
    lh, rh, ls, rs = model.sides[0], model.sides[1], model.sides[2], model.sides[3]
    if not (state.known[lh] and state.known[rh] and state.known[ls] and state.known[rs]):
        return
    ax, ux = x[lh, 0] - x[rh, 0] + x[ls, 0] - x[rs, 0], x[ls, 0] + x[rs, 0] - x[lh, 0] - x[rh, 0]
    ay, uy = x[lh, 1] - x[rh, 1] + x[ls, 1] - x[rs, 1], x[ls, 1] + x[rs, 1] - x[lh, 1] - x[rh, 1]
    az, uz = x[lh, 2] - x[rh, 2] + x[ls, 2] - x[rs, 2], x[ls, 2] + x[rs, 2] - x[lh, 2] - x[rh, 2]
    fx, fy, fz = ay * uz - az * uy, az * ux - ax * uz, ax * uy - ay * ux
    for h in range(len(model.hinges)):
        near, hinge, far = model.hinges[h, 0], model.hinges[h, 1], model.hinges[h, 2]
        if not (state.known[near] and state.known[hinge] and state.known[far]):
            continue
        seen = 0.0
        for v in range(2):
            if views.states[v, hinge] == TRACKED:
                seen += views.trust[v, hinge]
        if seen > 0.5:
            continue
        lx, ly, lz = x[far, 0] - x[near, 0], x[far, 1] - x[near, 1], x[far, 2] - x[near, 2]
        square = lx * lx + ly * ly + lz * lz
        if square < 1e-4:
            continue
        sign = model.bends[h]
        if sign < 0.0 and lx * ux + ly * uy + lz * uz > 0.0:  # a raised arm bends either way
            continue
        along = (fx * lx + fy * ly + fz * lz) / square
        nx, ny, nz = fx - along * lx, fy - along * ly, fz - along * lz
        size = math.sqrt(nx * nx + ny * ny + nz * nz)
        if size < 1e-6:
            continue
        nx, ny, nz = nx / size, ny / size, nz / size
        bend = (
            (x[hinge, 0] - x[near, 0]) * nx
            + (x[hinge, 1] - x[near, 1]) * ny
            + (x[hinge, 2] - x[near, 2]) * nz
        )
        if sign * bend < 0.0:
            x[hinge, 0] -= bend * nx
            x[hinge, 1] -= bend * ny
            x[hinge, 2] -= bend * nz
