"""S* of a whole recording: later pairs count as well, so that S* has no lag.

The fixed-interval smoother of Rauch, Tung and Striebel runs backwards over the filter's results, per joint:

    x_k|T = x_k + C (x_k+1|T - x_k+1|k),    P_k|T = P_k + C (P_k+1|T - P_k+1|k) Cᵀ,    C = P_k Fᵀ (P_k+1|k)⁻¹

with x a position and a velocity along one axis. Then the bones are made exact again, pair by pair.
"""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from fusion.compiling.kernels import inner_kernel, kernel
from fusion.estimator.bones import joint_covariances
from fusion.solvers.small_matrices import inverse
from fusion.solvers.tree_solver import solve_tree
from fusion.support.types import Array


class Trace(NamedTuple):
    """The filter's results of T pairs; T is 0 where nothing is smoothed."""

    seconds: Annotated[Array, ("T",)]  # since the pair before with a person; -1 where S* starts anew
    predicted: Annotated[Array, ("T", "J", 6)]  # position and velocity before the measurements
    predicted_variances: Annotated[Array, ("T", "J", 3)]  # 0 where the joint was not known
    filtered: Annotated[Array, ("T", "J", 6)]  # position and velocity after the bones
    filtered_variances: Annotated[Array, ("T", "J", 3)]
    shared_error: Annotated[Array, ("T", "J", 3, 3)]
    added: Annotated[Array, ("T", "J", 3, 3)]  # m², what the steps after the bones add to it


@inner_kernel
def trace_result(model, state, trace, k):  # type: ignore[no-untyped-def]
    """Stores the state after pair k."""
    if len(trace.seconds) == 0:
        return
    for i in range(len(model.parents)):
        for c in range(3):
            trace.filtered[k, i, c] = state.positions[i, c]
            trace.filtered[k, i, 3 + c] = state.velocities[i, c]
            trace.filtered_variances[k, i, c] = state.variances[i, c] if state.known[i] else 0.0
            for r in range(3):
                trace.shared_error[k, i, r, c] = state.shared_error[i, r, c]


@inner_kernel
def trace_covariance(trace, output, k, sign):  # type: ignore[no-untyped-def]
    """Adds the covariance of pair k to what is added to that of the smoothed pair, or subtracts it."""
    if len(trace.seconds) > 0:
        for i in range(output.sigma.shape[1]):
            for r in range(3):
                for c in range(3):
                    trace.added[k, i, r, c] += sign * output.covariance[k, i, r, c]


@kernel
def smooth_pairs(filter, trace, output):  # type: ignore[no-untyped-def]
    """Smooths positions, covariances and velocities of the output over T consecutive pairs.

    Args:
        filter: As in :func:`fusion.estimator.estimator.estimate_pairs`.
        trace: The filter's results; filtered states are replaced by smoothed ones.
        output: Of the filter; pairs without a person stay as they are.
    """
    model, solve = filter.model, filter.solve
    later = -1  # the next pair with a person
    for k in range(len(trace.seconds) - 1, -1, -1):
        if not math.isfinite(output.positions[k, 0, 0]):
            continue
        if later >= 0 and trace.seconds[later] >= 0.0:
            for i in range(len(model.parents)):
                if trace.predicted_variances[later, i, 0] > 0.0 and trace.filtered_variances[k, i, 0] > 0.0:
                    step_back(model, trace, k, later, i)
        _solve_bones(model, solve, trace, output, k, k if later < 0 else later)
        later = k


@inner_kernel
def step_back(model, trace, k, later, i):  # type: ignore[no-untyped-def]
    """One step of the smoother for joint i, from pair ``later`` to pair k."""
    dt = trace.seconds[later]
    kept = math.exp(-dt / model.constants.velocity_seconds) if model.parents[i] >= 0 else 1.0
    a, b, c = (
        trace.filtered_variances[k, i, 0],
        trace.filtered_variances[k, i, 1],
        trace.filtered_variances[k, i, 2],
    )
    before = trace.predicted_variances[later, i]
    p, q, r = before[0], before[1], before[2]
    determinant = p * r - q * q
    # P Fᵀ with F = [1, kept dt; 0, kept]
    f11, f12, f21, f22 = a + b * kept * dt, b * kept, b + c * kept * dt, c * kept
    c11, c12 = (f11 * r - f12 * q) / determinant, (f12 * p - f11 * q) / determinant
    c21, c22 = (f21 * r - f22 * q) / determinant, (f22 * p - f21 * q) / determinant
    for axis in range(3):
        dx = trace.filtered[later, i, axis] - trace.predicted[later, i, axis]
        dv = trace.filtered[later, i, 3 + axis] - trace.predicted[later, i, 3 + axis]
        trace.filtered[k, i, axis] += c11 * dx + c12 * dv
        trace.filtered[k, i, 3 + axis] += c21 * dx + c22 * dv
    after = trace.filtered_variances[later, i]
    dp, dq, dr = after[0] - p, after[1] - q, after[2] - r
    trace.filtered_variances[k, i, 0] = a + c11 * (c11 * dp + c12 * dq) + c12 * (c11 * dq + c12 * dr)
    trace.filtered_variances[k, i, 1] = b + c11 * (c21 * dp + c22 * dq) + c12 * (c21 * dq + c22 * dr)
    trace.filtered_variances[k, i, 2] = c + c21 * (c21 * dp + c22 * dq) + c22 * (c21 * dq + c22 * dr)


@inner_kernel
def _solve_bones(model, solve, trace, output, k, like):  # type: ignore[no-untyped-def]
    """Writes the best skeleton with exact bone lengths for the smoothed joints of pair k.

    The search begins at the skeleton of pair ``like``.
    """
    for i in range(len(model.parents)):
        known = trace.filtered_variances[k, i, 0] > 0.0
        W = solve.information[i]
        for c in range(3):
            solve.targets[i, c] = trace.filtered[k, i, c] if known else math.nan
            output.velocities[k, i, c] = trace.filtered[k, i, 3 + c]
            for r in range(3):
                W[r, c] = trace.shared_error[k, i, r, c] if known else 0.0
            W[c, c] += trace.filtered_variances[k, i, 0] if known else 0.0
        if known:
            inverse(W, W)
    solve_tree(
        model.parents, model.order, model.rest, solve.targets, solve.information, model.bone_lengths,
        output.positions[like], solve.tree_work, solve.positions,
    )  # fmt: skip
    joint_covariances(model, solve, output.covariance[k], output.sigma[k])
    for i in range(len(model.parents)):
        square = output.sigma[k, i] ** 2
        for c in range(3):
            square += trace.added[k, i, c, c]
            for r in range(3):
                output.covariance[k, i, r, c] += trace.added[k, i, r, c]
        output.sigma[k, i] = math.sqrt(square)
        for c in range(3):
            output.positions[k, i, c] = solve.positions[i, c]
