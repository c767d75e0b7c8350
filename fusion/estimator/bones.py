"""The best skeleton with exact bone lengths, and the covariance of S*.

A bone transmits information between its joints, so that the covariance belongs to the skeleton as a whole.
"""

from __future__ import annotations

import math

from fusion.compiling.kernels import inner_kernel
from fusion.solvers.small_matrices import inverse
from fusion.solvers.tree_solver import solve_tree
from fusion.solvers.tree_start import copy

_FASTEST = 20.0  # m/s: no joint of a person is faster
_LEAST_ACROSS = 0.1  # a covariance that is reduced by more across its bone is reduced in all directions
_PRIOR_INFORMATION = 1.0  # 1/m²: a joint that was never seen has a standard deviation of one metre


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
    """S*: min Σ (x_i - m_i)ᵀ W_i (x_i - m_i) with |x_i - x_parent| = l_i, starting at the previous frame;
    returns the number of iterations.
    """
    if state.last_time[1] == 0:
        _first_guess(model, solve, state.solver_start)
    iterations, _, _, _ = solve_tree(
        model.parents, model.order, model.rest, solve.targets, solve.information, model.bone_lengths,
        state.solver_start, solve.tree_work, solve.positions,
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
        square = 0.0
        for c in range(3):
            v[i, c] += slope * (solve.positions[i, c] - x[i, c])
            x[i, c] = solve.positions[i, c]
            square += v[i, c] * v[i, c]
        if square > _FASTEST * _FASTEST:
            for c in range(3):
                v[i, c] *= _FASTEST / math.sqrt(square)
    copy(solve.positions, state.solver_start)


@inner_kernel
def joint_covariances(model, solve, covariance, sigma):  # type: ignore[no-untyped-def]
    """Computes the covariance of each joint of S* given all joints' information and the bone lengths.

    A hard bone transmits information only along its direction n. With A the information of the joint at one
    end, including everything beyond it, the other end receives n nᵀ / (nᵀ A⁻¹ n). These messages go up the
    tree, then down: belief propagation, exact on a tree for given bone directions.

    Args:
        model, solve: After the bones; the information in ``solve`` is that of the targets.
        covariance: (J, 3, 3) out, m².
        sigma: (J,) out: the square root of its trace: one standard deviation of the distance to the truth, m.

    A joint that nobody sees keeps its bone: if its direction is not known at all, the mean square of the
    distance is σ_parent² + 2 l². The covariance is reduced to that.
    """
    A, scratch = solve.covariance, solve.scratch  # A is information first, covariance in the end
    order, parents = model.order, model.parents
    for i in range(len(parents)):
        for r in range(3):
            for c in range(3):
                A[i, r, c] = solve.information[i, r, c]
            A[i, r, r] += _PRIOR_INFORMATION
    for n in range(len(order) - 1, 0, -1):
        i = order[n]
        p = parents[i]
        nx, ny, nz = _direction(solve.positions, i, p)
        information = _along(A[i], nx, ny, nz, scratch)
        up = solve.upward[i]
        up[0], up[1], up[2], up[3] = nx, ny, nz, information
        _add_along(A[p], nx, ny, nz, information)
    for n in range(1, len(order)):
        i = order[n]
        p = parents[i]
        nx, ny, nz, below = solve.upward[i, 0], solve.upward[i, 1], solve.upward[i, 2], solve.upward[i, 3]
        _add_along(A[p], nx, ny, nz, -below)  # the parent's information without this joint
        information = _along(A[p], nx, ny, nz, scratch)
        _add_along(A[p], nx, ny, nz, below)
        _add_along(A[i], nx, ny, nz, information)
    square = model.constants.spread**2
    for n in range(len(order)):
        i = order[n]
        inverse(A[i], scratch)
        trace = square * (scratch[0, 0] + scratch[1, 1] + scratch[2, 2])
        most = math.inf if n == 0 else sigma[parents[i]] ** 2 + 2.0 * model.bone_lengths[i] ** 2
        for r in range(3):
            for c in range(3):
                covariance[i, r, c] = square * scratch[r, c]
        if trace > most:
            _shrink_across(covariance[i], solve.upward[i], trace, most)
        sigma[i] = math.sqrt(min(trace, most))


@inner_kernel
def add_registration_error(model, shares, output, k):  # type: ignore[no-untyped-def]
    """Adds the uncertainty of R and t: joint i comes from B by its share w_i, at r from their centre.

        Σ ← Σ + w_i² (σ_t² I + σ_R² (|r|² I - r rᵀ))

    Args:
        model: With the mean place of the joints that R and t were found from; where it is unknown, r is from
            the root.
        shares: (J,) B's share of each joint.
        output: Row k is changed.
    """
    turn, shift = model.registration_variances[0], model.registration_variances[1]
    x, covariance, sigma = output.positions[k], output.covariance[k], output.sigma[k]
    centre = model.registration_centre
    if math.isnan(centre[0]):
        centre = x[model.order[0]]
    for i in range(len(sigma)):
        square, added = 0.0, shares[i] * shares[i]
        for c in range(3):
            square += (x[i, c] - centre[c]) ** 2
        for r in range(3):
            covariance[i, r, r] += added * (shift + turn * square)
            for c in range(3):
                covariance[i, r, c] -= added * turn * (x[i, r] - centre[r]) * (x[i, c] - centre[c])
        sigma[i] = math.sqrt(sigma[i] * sigma[i] + added * (3.0 * shift + 2.0 * turn * square))


@inner_kernel
def _shrink_across(covariance, up, trace, most):  # type: ignore[no-untyped-def]
    """Reduces the trace of a covariance to ``most``, across its bone's direction n if that is enough:
    C ← S C S with S = n nᵀ + g (I - n nᵀ).
    """
    along = 0.0
    for r in range(3):
        for c in range(3):
            along += up[r] * covariance[r, c] * up[c]
    kept, across = 1.0, math.sqrt(max(most - along, 0.0) / (trace - along))
    if across < _LEAST_ACROSS:
        kept = across = math.sqrt(most / trace)
    x, y, z = 0.0, 0.0, 0.0  # C n
    for c in range(3):
        x += covariance[0, c] * up[c]
        y += covariance[1, c] * up[c]
        z += covariance[2, c] * up[c]
    v, more = (x, y, z), kept - across
    for r in range(3):
        for c in range(3):
            covariance[r, c] = (
                across * across * covariance[r, c]
                + across * more * (up[r] * v[c] + v[r] * up[c])
                + more * more * along * up[r] * up[c]
            )


@inner_kernel
def _direction(positions, i, p):  # type: ignore[no-untyped-def]
    x, y, z = (
        positions[i, 0] - positions[p, 0],
        positions[i, 1] - positions[p, 1],
        positions[i, 2] - positions[p, 2],
    )
    s = 1.0 / max(math.sqrt(x * x + y * y + z * z), 1e-12)
    return x * s, y * s, z * s


@inner_kernel
def _along(A, x, y, z, scratch):  # type: ignore[no-untyped-def]
    """1 / (nᵀ A⁻¹ n)."""
    inverse(A, scratch)
    return 1.0 / (
        scratch[0, 0] * x * x + scratch[1, 1] * y * y + scratch[2, 2] * z * z
        + 2.0 * (scratch[0, 1] * x * y + scratch[0, 2] * x * z + scratch[1, 2] * y * z)
    )  # fmt: skip


@inner_kernel
def _add_along(A, x, y, z, information):  # type: ignore[no-untyped-def]
    A[0, 0] += information * x * x
    A[1, 1] += information * y * y
    A[2, 2] += information * z * z
    A[0, 1] += information * x * y
    A[0, 2] += information * x * z
    A[1, 2] += information * y * z
    A[1, 0], A[2, 0], A[2, 1] = A[0, 1], A[0, 2], A[1, 2]
