"""Ordinary instances of eq. (1) for tests and benchmarks of the solvers."""

from __future__ import annotations

import numpy as np

from fusion.body import KINECT_V2, Body
from fusion.solvers.tree_solver import TreeSolver
from tests.experiments.solver import Problem

# m: at 3e-11 m of projected gradient and pivots of at least a hundredth of the information (moderate weights
# and noise), two solutions of one problem lie within 3e-9 m of each other
SAME = 1e-8


def solver_of(body: Body) -> TreeSolver:
    """The exact solver for a body."""
    return TreeSolver(body.parent_indices, body.order, body.rest)


def ordinary_problem(seed: int, body: Body = KINECT_V2, noise: float = 0.02) -> Problem:
    """A person facing the sensor, bones of 80–450 mm, all joints with data of like weight."""
    rng = np.random.default_rng(seed)
    lengths = rng.uniform(0.08, 0.45, len(body))
    pose = np.tile([0.1, 0.2, 2.5], (len(body), 1))
    for joint in body.order[1:]:
        direction = body.rest[joint] + 0.4 * rng.normal(size=3)
        pose[joint] = pose[body.parents[joint]] + lengths[joint] * direction / np.linalg.norm(direction)
    targets = pose + rng.normal(0.0, noise, pose.shape)
    return Problem(body, targets, rng.uniform(0.3, 1.0, len(body)), lengths, None, noise)
