"""Eq. (1) by plain dense matrices: a readable reference for the tests."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import block_diag

from fusion.body import Body
from fusion.solvers.solver import MAX_ITERATIONS, Solution

_STEP_TOLERANCE = 1e-10  # metres; Newton's error after a step of s is of the order of s²
_SUFFICIENT_DECREASE = 1e-4
_FLATTEST = 1e-9  # smallest curvature kept, relative to the largest


class DenseSolver:
    """Newton on the KKT system of eq. (1), as in :class:`fusion.solvers.solver.Solver`.

    Every iterate keeps its bones: a step moves along the tangents of the bone constraints and is then
    projected back onto them, joint by joint from the root. With Z an orthonormal basis of those tangents, the
    KKT step

        ( H  Cᵀ ) (  d )     ( −∇f )
        ( C  0  ) ( λ' )  =  (   0 ),    H = 2W + Σ λ_k ∇²c_k,   c_k = ½(‖e_k‖² − l_k²)

    is d = Z s with (ZᵀHZ) s = −Zᵀ∇f, and λ are the least-squares multipliers at the iterate. The sign
    of negative curvatures is reversed, so that every step goes downhill. A line search on f makes it converge
    from anywhere.
    """

    def __init__(self, body: Body) -> None:
        self._body = body

    def solve(
        self,
        targets: ArrayLike,
        weights: ArrayLike,
        bone_lengths: ArrayLike,
        start: ArrayLike | None = None,
    ) -> Solution:
        """See :meth:`fusion.solvers.solver.Solver.solve`; weights may be (J, 3, 3)."""
        W = np.asarray(weights, dtype=np.float64)
        if W.ndim == 1:
            W = W[:, None, None] * np.eye(3)
        m = np.where(np.trace(W, axis1=1, axis2=2)[:, None] > 0.0, targets, 0.0)
        lengths = np.asarray(bone_lengths, dtype=np.float64)
        before = None if start is None else np.asarray(start, dtype=np.float64)

        def objective(x: NDArray[np.float64]) -> float:
            return float(np.einsum("ji,jik,jk->", x - m, W, x - m))

        x = min(self._starts(m, np.trace(W, axis1=1, axis2=2), lengths, before), key=objective)
        f = objective(x)
        for iteration in range(1, MAX_ITERATIONS + 1):
            gradient = 2.0 * np.einsum("jik,jk->ji", W, x - m)
            Z, H = self._tangents(x), self._lagrangian_hessian(x, gradient, W)
            s, slope = _downhill(Z.T @ H @ Z, Z.T @ gradient.ravel())
            tau = 1.0
            while True:
                d = tau * (Z @ s).reshape(-1, 3)
                trial = self._with_bones(x + d, x, lengths)
                f_trial = objective(trial)
                if f_trial <= f + _SUFFICIENT_DECREASE * tau * slope or tau < 1e-10:
                    break
                tau *= 0.5
            if f_trial > f:
                return Solution(x, iteration, f, bool(np.abs(d).max() < 1e-6), iteration)
            x, f = trial, f_trial
            if np.abs(d).max() < _STEP_TOLERANCE:
                return Solution(x, iteration, f, True, iteration)
        return Solution(x, MAX_ITERATIONS, f, False, MAX_ITERATIONS)

    def _starts(
        self,
        m: NDArray[np.float64],
        w: NDArray[np.float64],
        lengths: NDArray[np.float64],
        start: NDArray[np.float64] | None,
    ) -> list[NDArray[np.float64]]:
        """The starts: the data's own bone directions, and those of the previous frame."""
        body, parents = self._body, self._body.parent_indices
        rest = body.rest if start is None else start - start[parents]
        known = (w > 0.0) & (w[parents] > 0.0)
        from_data = np.where(known[:, None], m - m[parents], rest)
        starts = []
        for direction in [from_data] if start is None else [from_data, rest]:
            x = np.zeros_like(m)
            for joint in body.order:
                if joint != body.root:
                    x[joint] = x[parents[joint]] + lengths[joint] * _unit(direction[joint], body.rest[joint])
            starts.append(x + np.average(m - x, axis=0, weights=w))  # the best translation as a whole
        return starts

    def _with_bones(
        self, x: NDArray[np.float64], before: NDArray[np.float64], lengths: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """x with every bone brought to its length, from the root outwards."""
        placed = x.copy()
        for joint in self._body.order[1:]:
            parent = self._body.parents[joint]
            placed[joint] = placed[parent] + lengths[joint] * _unit(
                x[joint] - x[parent], before[joint] - before[parent]
            )
        return placed

    def _tangents(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """(3J, 2J+1) orthonormal basis of the steps that keep every bone to first order."""
        _, _, Vt = np.linalg.svd(self._constraint_jacobian(x))
        return np.asarray(Vt[len(self._body) - 1 :].T)

    def _constraint_jacobian(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """(J−1, 3J) ∇c: for each bone e = x_i − x_p, e at joint i and −e at its parent."""
        body = self._body
        C = np.zeros((len(body) - 1, len(body), 3))
        for k, joint in enumerate(body.bone_joints):
            parent = body.parents[joint]
            C[k, joint] = x[joint] - x[parent]
            C[k, parent] = x[parent] - x[joint]
        return C.reshape(len(body) - 1, -1)

    def _lagrangian_hessian(
        self, x: NDArray[np.float64], gradient: NDArray[np.float64], W: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """(3J, 3J) 2W + Σ λ_k (e_i − e_p)(e_i − e_p)ᵀ ⊗ I₃, W block-diagonal."""
        body = self._body
        C = self._constraint_jacobian(x)
        multipliers = np.linalg.lstsq(C.T, -gradient.ravel(), rcond=None)[0]
        coupling = np.zeros((len(body), len(body)))
        for k, joint in enumerate(body.bone_joints):
            ends = [joint, body.parents[joint]]
            coupling[np.ix_(ends, ends)] += multipliers[k] * np.array([[1.0, -1.0], [-1.0, 1.0]])
        return np.asarray(block_diag(*(2.0 * W)) + np.kron(coupling, np.eye(3)), dtype=np.float64)


def _downhill(H: NDArray[np.float64], gradient: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """The Newton step with every curvature made positive, and f's slope along it."""
    curvature, directions = np.linalg.eigh(H)
    curvature = np.abs(curvature)
    curvature = np.maximum(curvature, _FLATTEST * curvature.max())
    step: NDArray[np.float64] = -directions @ ((directions.T @ gradient) / curvature)
    return step, float(gradient @ step)


def _unit(v: NDArray[np.float64], otherwise: NDArray[np.float64]) -> NDArray[np.float64]:
    length = np.linalg.norm(v)
    if length > 1e-12:
        return np.asarray(v / length)
    return np.asarray(otherwise / np.linalg.norm(otherwise))
