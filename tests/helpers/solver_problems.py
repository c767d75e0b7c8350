"""Instances of eq. (1), ordinary and random ones, and what is wrong with a solution."""

from collections import Counter
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fusion.body import BODIES, KINECT_V2, Body
from fusion.solvers import MAX_ITERATIONS
from tests.helpers.slsqp import slsqp_optimum
from tests.helpers.solvers import TreeSolver

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


def random_pose(rng, body, lengths):
    """(J, 3) joints with these bone lengths, each bone in any direction."""
    directions = rng.normal(size=(len(body), 3))
    directions *= (lengths / np.linalg.norm(directions, axis=1))[:, None]
    pose = np.tile(rng.uniform([-1.0, -1.0, 1.0], [1.0, 1.0, 4.0]), (len(body), 1))
    for joint in body.order[1:]:
        pose[joint] = pose[body.parents[joint]] + directions[joint]
    return pose


def random_problem(seed, matrices=False):
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


def random_information(rng, joints):
    """(J, 3, 3) symmetric positive definite, with eigenvalues of 1e-6–1: of condition up to a million."""
    values = 10.0 ** rng.uniform(-6.0, 0.0, (joints, 3))
    directions, _ = np.linalg.qr(rng.normal(size=(joints, 3, 3)))
    W = (directions * values[:, None]) @ directions.transpose(0, 2, 1)
    return np.asarray(0.5 * (W + W.transpose(0, 2, 1)))  # symmetric to the bit


def bone_error(problem, positions):
    """The largest |length - l|, metres."""
    child = problem.body.bone_joints
    bones = positions[child] - positions[problem.body.parent_indices[child]]
    return float(np.abs(np.linalg.norm(bones, axis=1) - problem.lengths[child]).max())


def projected_gradient(problem, positions):
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


def failures(problem, solution):
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


def slsqp(problem, start):
    """Eq. (1) by scipy, with all derivatives: (positions, objective, whether bones came right)."""
    found = slsqp_optimum(problem.body, problem.targets, problem.weights, problem.lengths, start)
    return found.positions, found.objective, bone_error(problem, found.positions) < BONE_TOLERANCE


def run(count, first, matrices=False):
    """Solves ``count`` random problems: failures by kind, (2, count) iterations and systems, seeds failed."""
    solvers = {name: TreeSolver(b.parent_indices, b.order, b.rest) for name, b in BODIES.items()}
    kinds = Counter()
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


# m: at 3e-11 m of projected gradient and pivots of at least a hundredth of the information (moderate weights
# and noise), two solutions of one problem lie within 3e-9 m of each other
SAME = 1e-8


def solver_of(body):
    """The exact solver for a body."""
    return TreeSolver(body.parent_indices, body.order, body.rest)


def ordinary_problem(seed, body=KINECT_V2, noise=0.02):
    """A person facing the sensor, bones of 80–450 mm, all joints with data of like weight."""
    rng = np.random.default_rng(seed)
    lengths = rng.uniform(0.08, 0.45, len(body))
    pose = np.tile([0.1, 0.2, 2.5], (len(body), 1))
    for joint in body.order[1:]:
        direction = body.rest[joint] + 0.4 * rng.normal(size=3)
        pose[joint] = pose[body.parents[joint]] + lengths[joint] * direction / np.linalg.norm(direction)
    targets = pose + rng.normal(0.0, noise, pose.shape)
    return Problem(body, targets, rng.uniform(0.3, 1.0, len(body)), lengths, None, noise)
