"""Eq. (1) by scipy's SLSQP: it shares no code with the solvers of :mod:`fusion.solvers`."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize


class Optimum(NamedTuple):
    """(J, 3) joints in metres, and the objective of eq. (1) there."""

    positions: NDArray[np.float64]
    objective: float


def slsqp_optimum(body, targets, information, lengths, start):
    """Minimises Σ (x − m)ᵀ W (x − m) over the joints x, subject to (‖e‖² − l²)/2 = 0 for each bone e.

    Args:
        body: The tree of bones.
        targets: (J, 3) m, metres; ignored where the information is zero.
        information: (J,) weights w, or (J, 3, 3) symmetric matrices W.
        lengths: (J,) l, metres, of the bone that ends in each joint.
        start: (J, 3) starting point, metres.
    """
    child = body.bone_joints
    parent = body.parent_indices[child]
    rows = np.arange(len(child))
    scale = information.max()  # SLSQP's tolerance is absolute
    W = information / scale
    seen = W.reshape(len(body), -1).any(axis=1)
    m = np.where(seen[:, None], targets, 0.0)

    def pull(x):
        apart = x.reshape(-1, 3) - m
        return np.asarray(W[:, None] * apart if W.ndim == 1 else (W @ apart[:, :, None])[:, :, 0])

    def objective(x):
        return float(((x.reshape(-1, 3) - m) * pull(x)).sum())

    def gradient(x):
        return 2.0 * pull(x).ravel()

    def constraint(x):
        bone = x.reshape(-1, 3)[child] - x.reshape(-1, 3)[parent]
        return np.asarray(0.5 * ((bone**2).sum(axis=1) - lengths[child] ** 2))

    def jacobian(x):
        bone = x.reshape(-1, 3)[child] - x.reshape(-1, 3)[parent]
        J = np.zeros((len(child), len(body), 3))
        J[rows, child], J[rows, parent] = bone, -bone
        return J.reshape(len(child), -1)

    found = minimize(
        objective,
        start.ravel(),
        jac=gradient,
        constraints={"type": "eq", "fun": constraint, "jac": jacobian},
        method="SLSQP",
        options={"maxiter": 1000, "ftol": 1e-15},
    )
    return Optimum(found.x.reshape(-1, 3), float(found.fun * scale))
