"""The dense solver and the compiled one agree."""

from __future__ import annotations

import numpy as np
import pytest

from fusion.body import BODIES, Body
from tests.experiments.solver import bone_error, projected_gradient, slsqp
from tests.helpers.dense_solver import DenseSolver
from tests.helpers.solver_problems import SAME, ordinary_problem, solver_of


@pytest.mark.parametrize("body", BODIES.values(), ids=BODIES)
@pytest.mark.parametrize("seed", range(8))
def test_both_solvers_end_at_the_same_joints(body: Body, seed: int) -> None:
    problem = ordinary_problem(seed, body, noise=0.03)
    dense = DenseSolver(body).solve(problem.targets, problem.weights, problem.lengths)
    tree = solver_of(body).solve(problem.targets, problem.weights, problem.lengths)
    assert dense.converged
    assert tree.converged
    np.testing.assert_allclose(tree.positions, dense.positions, rtol=0, atol=SAME)
    assert tree.objective == pytest.approx(dense.objective, rel=1e-12)


@pytest.mark.parametrize("body", BODIES.values(), ids=BODIES)
@pytest.mark.parametrize("seed", range(8))
def test_both_solvers_agree_with_holes(body: Body, seed: int) -> None:
    """A joint without data may turn freely about its neighbours; the joints with data may not.

    Both start near the person, as after a previous frame. Otherwise a hole can lead to two minima.
    """
    before = ordinary_problem(seed, body, noise=0.0).targets
    problem = ordinary_problem(seed, body, noise=0.03)
    holes = np.random.default_rng(seed).choice(len(body), 1 + seed, replace=False)
    problem.targets[holes], problem.weights[holes] = np.nan, 0.0
    seen = problem.weights > 0.0
    dense = DenseSolver(body).solve(problem.targets, problem.weights, problem.lengths, before)
    tree = solver_of(body).solve(problem.targets, problem.weights, problem.lengths, before)
    np.testing.assert_allclose(tree.positions[seen], dense.positions[seen], rtol=0, atol=SAME)
    for solution in (dense, tree):
        assert np.isfinite(solution.positions).all()
        assert bone_error(problem, solution.positions) < 1e-12
        assert projected_gradient(problem, solution.positions) < 1e-8


def test_a_warm_start_leads_both_to_the_same_joints() -> None:
    body = BODIES["kinect_v2"]
    before, now = ordinary_problem(1, body), ordinary_problem(2, body)
    start = solver_of(body).solve(before.targets, before.weights, before.lengths).positions
    arguments = (now.targets, now.weights, now.lengths, start)
    np.testing.assert_allclose(
        solver_of(body).solve(*arguments).positions,
        DenseSolver(body).solve(*arguments).positions,
        rtol=0,
        atol=SAME,
    )


def information(seed: int, joints: int, rank: int = 3) -> np.ndarray:
    """(J, 3, 3) W of random axes and this rank, eigenvalues over two orders of magnitude."""
    rng = np.random.default_rng(seed)
    axes = np.linalg.qr(rng.normal(size=(joints, 3, 3)))[0]
    eigenvalues = 10.0 ** rng.uniform(-2.0, 0.0, (joints, 3))
    eigenvalues[:, rank:] = 0.0
    return np.einsum("jik,jk,jlk->jil", axes, eigenvalues, axes)


@pytest.mark.parametrize("body", BODIES.values(), ids=BODIES)
@pytest.mark.parametrize("seed", range(8))
def test_both_solvers_agree_on_information_matrices(body: Body, seed: int) -> None:
    problem = ordinary_problem(seed, body, noise=0.005)  # with more noise, short bones can have two minima
    W = information(seed, len(body))
    dense = DenseSolver(body).solve(problem.targets, W, problem.lengths)
    tree = solver_of(body).solve(problem.targets, W, problem.lengths)
    assert dense.converged
    assert tree.converged
    np.testing.assert_allclose(tree.positions, dense.positions, rtol=0, atol=SAME)
    assert tree.objective == pytest.approx(dense.objective, rel=1e-9)


@pytest.mark.parametrize("body", BODIES.values(), ids=BODIES)
@pytest.mark.parametrize("seed", range(8))
def test_the_readable_solver_stays_where_the_compiled_one_ends(body: Body, seed: int) -> None:
    """Every other joint lacks a direction, as of a camera that does not see depth: W of rank 2."""
    before = ordinary_problem(seed, body, noise=0.0).targets
    problem = ordinary_problem(seed, body, noise=0.01)
    W = information(seed, len(body))
    W[::2] = information(seed, len(body), rank=2)[::2]
    tree = solver_of(body).solve(problem.targets, W, problem.lengths, before)
    assert tree.converged
    assert bone_error(problem, tree.positions) < 1e-12
    dense = DenseSolver(body).solve(problem.targets, W, problem.lengths, tree.positions)
    assert dense.converged
    np.testing.assert_allclose(dense.positions, tree.positions, rtol=0, atol=SAME)


@pytest.mark.parametrize("seed", range(3))
def test_optimum_under_information_matrices_is_that_of_slsqp(seed: int) -> None:
    body = BODIES["kinect_v1"]
    problem = ordinary_problem(seed, body)
    W = information(seed, len(body))
    tree = solver_of(body).solve(problem.targets, W, problem.lengths)
    positions, objective, feasible = slsqp(problem, problem.targets, W)
    assert feasible
    assert np.abs(positions - tree.positions).max() < 1e-5  # the claim: 0.01 mm
    assert tree.objective <= objective * (1 + 1e-9)
