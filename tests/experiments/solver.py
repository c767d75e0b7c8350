"""Random problems against the exact solver: ``python -m tests.experiments.solver --count 100000``.

What a failure is: bones off by more than a micrometre, a point that is not stationary, a NaN, more than 50
iterations (steps to a better point; the linear systems on the way are counted beside them). With ``--slsqp
N``, scipy's SLSQP solves N problems of at most 50 mm noise too, from the same start, and those where it ends
clearly lower are counted. With ``--matrices`` every joint has a 3×3 information matrix of condition up to a
million instead of a weight. (Set OPENBLAS_NUM_THREADS=1: on small matrices threads wait on each other.)
"""

from __future__ import annotations

import argparse
from collections import Counter
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest

from fusion.body import BODIES, Body
from fusion.solvers.solver import MAX_ITERATIONS, Solution
from fusion.solvers.tree_solver import TreeSolver
from tests.helpers.slsqp import slsqp_optimum

BONE_TOLERANCE = 1e-6  # m, the claim
# m: force over the information it acts on, as if it were a joint's distance from its target. The solver's
# own criterion is 3e-11 over the trace, three times the information: 1e-10 of this one. Ten times that.
STATIONARY = 1e-9


@dataclass(frozen=True)
class Problem:
    """One random instance of eq. (1)."""

    body: Body
    targets: NDArray[np.float64]
    weights: NDArray[np.float64]  # (J,) w, or (J, 3, 3) W
    lengths: NDArray[np.float64]
    start: NDArray[np.float64] | None
    noise: float


def random_pose(rng: np.random.Generator, body: Body, lengths: NDArray[np.float64]) -> NDArray[np.float64]:
    """(J, 3) joints with these bone lengths, each bone in any direction."""
    directions = rng.normal(size=(len(body), 3))
    directions *= (lengths / np.linalg.norm(directions, axis=1))[:, None]
    pose = np.tile(rng.uniform([-1.0, -1.0, 1.0], [1.0, 1.0, 4.0]), (len(body), 1))
    for joint in body.order[1:]:
        pose[joint] = pose[body.parents[joint]] + directions[joint]
    return pose


def random_problem(seed: int, matrices: bool = False) -> Problem:
    """Bones of 20–500 mm, noise of 1–300 mm, weights of 1e-6–1, up to half the joints without data; every
    second one starts from an unrelated pose.

    With `matrices`, the eigenvalues of each joint's W are 1e-6–1, in random directions. All else is the same.
    """
    rng = np.random.default_rng(seed)
    body = tuple(BODIES.values())[seed % len(BODIES)]
    lengths = np.exp(rng.uniform(np.log(0.02), np.log(0.5), len(body)))
    noise = float(np.exp(rng.uniform(np.log(0.001), np.log(0.3))))
    targets = random_pose(rng, body, lengths) + rng.normal(0.0, noise, (len(body), 3))
    weights = 10.0 ** rng.uniform(-6.0, 0.0, len(body))
    without = rng.permutation(len(body))[: rng.integers(0, len(body) // 2 + 1)]
    targets[without], weights[without] = np.nan, 0.0
    start = random_pose(rng, body, lengths) if rng.random() < 0.5 else None
    if matrices:
        weights = random_information(rng, len(body))
        weights[without] = 0.0
    return Problem(body, targets, weights, lengths, start, noise)


def random_information(rng: np.random.Generator, joints: int) -> NDArray[np.float64]:
    """(J, 3, 3) symmetric positive definite, with eigenvalues of 1e-6–1: of condition up to a million."""
    values = 10.0 ** rng.uniform(-6.0, 0.0, (joints, 3))
    directions, _ = np.linalg.qr(rng.normal(size=(joints, 3, 3)))
    W = (directions * values[:, None]) @ directions.transpose(0, 2, 1)
    return np.asarray(0.5 * (W + W.transpose(0, 2, 1)))  # symmetric to the bit


def bone_error(problem: Problem, positions: NDArray[np.float64]) -> float:
    """The largest |length - l|, metres."""
    child = problem.body.bone_joints
    bones = positions[child] - positions[problem.body.parent_indices[child]]
    return float(np.abs(np.linalg.norm(bones, axis=1) - problem.lengths[child]).max())


def projected_gradient(problem: Problem, positions: NDArray[np.float64]) -> float:
    """The largest gradient along what may move, over the information it acts on, metres: 0 if stationary.

    What may move: the end of each bone, normal to it, with all joints below; and the whole.
    """
    body, W = problem.body, problem.weights
    # a weight w is the matrix w I; the information of a matrix is the mean of its eigenvalues
    information = 2 * W if W.ndim == 1 else 2 * np.trace(W, axis1=1, axis2=2) / 3
    apart = np.where(information[:, None] > 0, positions - problem.targets, 0)
    force = 2 * (W[:, None] * apart if W.ndim == 1 else (W @ apart[:, :, None])[:, :, 0])
    largest = 0.0
    for joint in body.order[:0:-1]:
        parent = body.parents[joint]
        bone = positions[joint] - positions[parent]
        tangential = force[joint] - bone * (bone @ force[joint]) / (bone @ bone)
        if information[joint] > 0:
            largest = max(largest, float(np.linalg.norm(tangential)) / information[joint])
        force[parent] += force[joint]
        information[parent] += information[joint]
    root = body.root
    return max(largest, float(np.linalg.norm(force[root])) / information[root])


def failures(problem: Problem, solution: Solution) -> list[str]:
    """What is wrong with a solution; empty where nothing is."""
    if not np.isfinite(solution.positions).all():
        return ["NaN"]
    wrong = []
    if bone_error(problem, solution.positions) > BONE_TOLERANCE:
        wrong.append("bones")
    if projected_gradient(problem, solution.positions) > STATIONARY:
        wrong.append("not stationary")
    if solution.iterations > MAX_ITERATIONS or not solution.converged:
        wrong.append("iterations ran out")
    return wrong


def slsqp(problem: Problem, start: NDArray[np.float64]) -> tuple[NDArray[np.float64], float, bool]:
    """Eq. (1) by scipy, with all derivatives: (positions, objective, whether bones came right)."""
    found = slsqp_optimum(problem.body, problem.targets, problem.weights, problem.lengths, start)
    return found.positions, found.objective, bone_error(problem, found.positions) < BONE_TOLERANCE


def run(count: int, first: int, matrices: bool = False) -> tuple[Counter[str], NDArray[np.int64], list[int]]:
    """Solves ``count`` random problems: failures by kind, (2, count) iterations and systems, seeds failed."""
    solvers = {name: TreeSolver(b.parent_indices, b.order, b.rest) for name, b in BODIES.items()}
    kinds: Counter[str] = Counter()
    work = np.zeros((2, count), dtype=np.int64)
    failed = []
    for k in range(count):
        problem = random_problem(first + k, matrices)
        solution = solvers[problem.body.name].solve(
            problem.targets, problem.weights, problem.lengths, problem.start
        )
        work[:, k] = solution.iterations, solution.systems
        wrong = failures(problem, solution)
        kinds.update(wrong)
        if wrong:
            failed.append(first + k)
    return kinds, work, failed


def run_slsqp(
    count: int, first: int, body: Body | None = None, matrices: bool = False
) -> tuple[int, int, int]:
    """Compares with SLSQP: (problems compared, where its optimum is lower, where it is higher).

    SLSQP's bones may be off by up to the tolerance, which buys a lower objective. So its optimum is the one
    that the exact solver reaches from SLSQP's joints. Lower or higher: by over a millionth.
    """
    compared = lower = higher = 0
    seed = first
    while compared < count:
        problem = random_problem(seed, matrices)
        seed += 1
        if problem.noise > 0.05 or (body is not None and problem.body is not body):
            continue
        solver = TreeSolver(problem.body.parent_indices, problem.body.order, problem.body.rest)
        solution = solver.solve(problem.targets, problem.weights, problem.lengths, problem.start)
        filled = np.where(np.isfinite(problem.targets), problem.targets, solution.positions)
        positions, objective, feasible = slsqp(problem, filled)
        compared += 1
        margin = 1e-6 * solution.objective + 1e-15
        if feasible and objective < solution.objective - margin:
            polished = solver.solve(problem.targets, problem.weights, problem.lengths, positions)
            lower += polished.objective < solution.objective - margin
        higher += not feasible or objective > solution.objective + margin
    return compared, lower, higher


def interval(found: int, of: int) -> tuple[float, float]:
    """The 95 % interval of a share (Clopper–Pearson)."""
    exact = binomtest(found, of).proportion_ci(0.95, method="exact")
    return float(exact.low), float(exact.high)


def main() -> None:
    """Prints what failed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=100_000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--slsqp", type=int, default=0)
    parser.add_argument("--matrices", action="store_true", help="3×3 information instead of weights")
    parser.add_argument("--body", choices=BODIES, help="of the problems that SLSQP gets too")
    options = parser.parse_args()
    kinds, work, failed = run(options.count, options.first, options.matrices)
    print(f"{options.count} problems, {len(failed)} failed: {dict(kinds)}; first seeds {failed[:10]}")
    for name, counts in zip(("iterations", "linear systems"), work, strict=True):
        median, p99, most = np.percentile(counts, [50, 99, 100])
        over = (counts > MAX_ITERATIONS).sum()
        print(f"{name}: median {median:.0f}, p99 {p99:.0f}, max {most:.0f}; over {MAX_ITERATIONS} in {over}")
    body = BODIES[options.body] if options.body else None
    if options.slsqp:
        compared, lower, higher = run_slsqp(options.slsqp, options.first, body, options.matrices)
        low, high = interval(lower, compared)
        print(
            f"{compared} problems of <= 50 mm noise: SLSQP lower in {lower} ({lower / compared:.2%}, 95 % "
            f"interval {low:.2%} to {high:.2%}), higher or infeasible in {higher}"
        )


if __name__ == "__main__":
    main()
