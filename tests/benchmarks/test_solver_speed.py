"""What a frame costs: solve, weights, the whole update. ``pytest tests/benchmarks --benchmark-only``."""

from __future__ import annotations

from itertools import cycle

import numpy as np
import pytest

from fusion.body import BODIES, KINECT_V1
from fusion.fuser import Fuser
from fusion.paper.reliability import reliability_weights
from fusion.setup import FusionSetup
from fusion.solvers.published import PaperSolver
from fusion.solvers.tree_solver import TreeSolver
from tests.experiments.solver import slsqp
from tests.helpers.solver_problems import ordinary_problem, solver_of
from tests.helpers.two_views import FRAME_NS, calibration_of, moving, noisy, pair_of


@pytest.mark.parametrize("body", BODIES.values(), ids=BODIES)
def test_exact_cold(benchmark, body):
    problem = ordinary_problem(0, body, noise=0.01)
    benchmark(solver_of(body).solve, problem.targets, problem.weights, problem.lengths)


def test_exact_warm(benchmark):
    problem = ordinary_problem(0, noise=0.01)
    solver = solver_of(problem.body)
    start = solver.solve(problem.targets, problem.weights, problem.lengths).positions
    near = problem.targets + np.random.default_rng(1).normal(0.0, 0.005, problem.targets.shape)
    benchmark(solver.solve, near, problem.weights, problem.lengths, start)


def test_published_scheme(benchmark):
    problem = ordinary_problem(0, KINECT_V1, noise=0.01)
    solver = PaperSolver(KINECT_V1.parents)
    benchmark(solver.solve, problem.targets, problem.weights, problem.lengths)


def test_slsqp(benchmark):
    problem = ordinary_problem(0, KINECT_V1, noise=0.01)
    benchmark.pedantic(slsqp, (problem, problem.targets), rounds=3)


@pytest.mark.parametrize("joints", [20, 32, 160])
def test_growth(benchmark, joints):
    """A synthetic tree in which every joint's parent is one of the eight before it."""
    rng = np.random.default_rng(joints)
    parents = np.array([-1] + [int(rng.integers(max(0, i - 8), i)) for i in range(1, joints)])
    lengths = rng.uniform(0.1, 0.4, joints)
    pose = np.zeros((joints, 3))
    for i in range(1, joints):
        direction = rng.normal(size=3)
        pose[i] = pose[parents[i]] + lengths[i] * direction / np.linalg.norm(direction)
    solver = TreeSolver(parents, np.arange(joints), np.ones((joints, 3)))
    targets = pose + rng.normal(0.0, 0.01, pose.shape)
    benchmark.extra_info["iterations"] = solver.solve(targets, np.ones(joints), lengths).iterations
    benchmark(solver.solve, targets, np.ones(joints), lengths)


@pytest.mark.parametrize("body", BODIES.values(), ids=BODIES)
def test_weights(benchmark, body):
    rng = np.random.default_rng(0)
    pixels_a, pixels_b = rng.uniform(0, 500, (2, len(body), 2))
    states = np.full(len(body), 2, np.uint8)
    benchmark(reliability_weights, pixels_a, pixels_b, states, states, body.linked)


@pytest.mark.parametrize("body", BODIES.values(), ids=BODIES)
def test_update(benchmark, body):
    rng = np.random.default_rng(0)
    truth = moving(body, 90)[45:]  # after the stillness at its start
    pairs = cycle([noisy(pair_of(body, at, t * FRAME_NS), rng, 0.01) for t, at in enumerate(truth)])
    fuser = Fuser(FusionSetup(calibration_of(body)))
    benchmark(lambda: fuser.update(next(pairs)))
