"""The uncertainty of S*: the covariance of each joint, with the information that bones transmit."""

from __future__ import annotations

import math

from fusion.compiling.kernels import inner_kernel
from fusion.solvers.small_matrices import inverse

_PRIOR_INFORMATION = 1.0  # 1/m²: a joint that was never seen has a standard deviation of one metre


@inner_kernel
def joint_covariances(model, solve, covariance, sigma):  # type: ignore[no-untyped-def]
    """Computes the covariance of each joint of S* given all joints' information and the bone lengths.

    A hard bone transmits information only along its direction n. With A the information of the joint at one
    end, including everything beyond it, the other end receives n nᵀ / (nᵀ A⁻¹ n). These messages go up the
    tree, then down: belief propagation, exact on a tree for given bone directions.

    Args:
        model, solve: After the bones; the information in ``solve`` is that of the targets.
        covariance: (J, 3, 3) out, m².
        sigma: (J,) out: the square root of its trace, m: one standard deviation of the distance to the truth.
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
    for i in range(len(parents)):
        inverse(A[i], scratch)
        for r in range(3):
            for c in range(3):
                covariance[i, r, c] = square * scratch[r, c]
        sigma[i] = math.sqrt(covariance[i, 0, 0] + covariance[i, 1, 1] + covariance[i, 2, 2])


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
