"""The published scheme for eq. (1), eqs. (3)–(9), for comparison.

All bones are combined in one constraint c(X) = Σ (|e| - l)², whose gradient vanishes where it holds. Its one
multiplier cannot hold every bone against the data, so that bone lengths are only nearly right.
"""

import math

from fusion.compiling.kernels import inner_kernel, kernel
from fusion.solvers import MAX_ITERATIONS

_STEP_TOLERANCE = 1e-5  # m: the paper's ‖d‖ < 1e-5
_SHORTEST = 2.0**-20  # of a full step: below it the line search gives up
_NO_DATA = 1e-9  # of the mean weight: keeps H of eq. (7) invertible for a joint without data


@inner_kernel
def _evaluate(parents, targets, weights, lengths, at):  # type: ignore[no-untyped-def]
    """The data term of eq. (1), and its constraint c."""
    data = constraint = 0.0
    for i in range(len(parents)):
        if weights[i] > 0.0:
            x, y, z = at[i, 0] - targets[i, 0], at[i, 1] - targets[i, 1], at[i, 2] - targets[i, 2]
            data += weights[i] * (x * x + y * y + z * z)
        p = parents[i]
        if p >= 0:
            x, y, z = at[i, 0] - at[p, 0], at[i, 1] - at[p, 1], at[i, 2] - at[p, 2]
            stretch = math.sqrt(x * x + y * y + z * z) - lengths[i]
            constraint += stretch * stretch
    return data, constraint


@kernel
def solve_published(parents, targets, weights, lengths, line_search, at, work):  # type: ignore[no-untyped-def]
    """Eqs. (3)–(9) from the joints in ``at`` (J, 3), which become S*.

    An iteration, with Λ = ∂c/∂p*, b_p = -2 w (p* - m), b_λ = -c and h = 2 w:

    1. λ = (Λ H⁻¹ b_p - b_λ) / (Λ H⁻¹ Λᵀ), eq. (8)
    2. d = H⁻¹ (b_p - Λᵀ λ), eq. (9)
    3. p* ← p* + τ d, with τ = 1 or from the line search

    The two views' terms of a joint fold into one with weight w = w_A + w_B and target m, their weighted mean.
    The paper names no merit for its line search. The natural one is J of eq. (2) with this iteration's λ:
    τ is halved from 1 until J is no larger than before. A negative λ would reward wrong bones, so |λ| is
    used.

    Args:
        targets: (J, 3) m, metres.
        line_search: Whether τ is searched for; full steps otherwise.
        at: (J, 3) in: the start; out: S*.
        work: (2, J, 3) scratch.

    Returns:
        (iterations, the data term, whether ‖d‖ < 1e-5 was reached).
    """
    joints = len(parents)
    slope, trial = work[0], work[1]
    total = 0.0
    for i in range(joints):
        total += weights[i]
    floor = _NO_DATA * max(total, 1e-300) / joints
    data, constraint = _evaluate(parents, targets, weights, lengths, at)
    iterations = 0
    while iterations < MAX_ITERATIONS:
        iterations += 1
        for i in range(joints):
            for c in range(3):
                slope[i, c] = 0.0
        for i in range(joints):
            p = parents[i]
            if p < 0:
                continue
            x, y, z = at[i, 0] - at[p, 0], at[i, 1] - at[p, 1], at[i, 2] - at[p, 2]
            length = math.sqrt(x * x + y * y + z * z)
            scale = 2.0 * (length - lengths[i]) / length if length > 0.0 else 0.0
            slope[i, 0] += scale * x
            slope[i, 1] += scale * y
            slope[i, 2] += scale * z
            slope[p, 0] -= scale * x
            slope[p, 1] -= scale * y
            slope[p, 2] -= scale * z
        numerator, denominator = constraint, 0.0
        for i in range(joints):
            h = 2.0 * max(weights[i], floor)
            for c in range(3):
                if weights[i] > 0.0:
                    numerator -= (
                        slope[i, c] * weights[i] / max(weights[i], floor) * (at[i, c] - targets[i, c])
                    )
                denominator += slope[i, c] * slope[i, c] / h
        multiplier = numerator / denominator if denominator > 0.0 else 0.0
        norm = 0.0
        for i in range(joints):
            h = 2.0 * max(weights[i], floor)
            for c in range(3):
                pull = 2.0 * weights[i] * (targets[i, c] - at[i, c]) if weights[i] > 0.0 else 0.0
                slope[i, c] = (pull - slope[i, c] * multiplier) / h
                norm += slope[i, c] * slope[i, c]
        tau = 1.0
        merit = data + abs(multiplier) * constraint
        while True:
            for i in range(joints):
                for c in range(3):
                    trial[i, c] = at[i, c] + tau * slope[i, c]
            data, constraint = _evaluate(parents, targets, weights, lengths, trial)
            if not line_search or tau <= _SHORTEST or data + abs(multiplier) * constraint <= merit:
                break
            tau *= 0.5
        for i in range(joints):
            for c in range(3):
                at[i, c] = trial[i, c]
        if math.sqrt(norm) < _STEP_TOLERANCE:
            return iterations, data, True
    return iterations, data, False
