"""Times several solvers of eq. (1) on the same problems."""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion.body import KINECT_V1, Body
from fusion.calibration.bone_lengths import bone_lengths_of
from fusion.solvers.dense import DenseSolver
from fusion.solvers.published import PaperSolver
from fusion.solvers.tree_solver import TreeSolver
from viewer_app.bench.scipy_solver import slsqp_optimum

_STIFFNESS = 1e2  # of a bone in Ceres, where a joint has √w ≤ 1; stiffer, Ceres takes more steps or fails
_NOISE = 0.01  # metres
_SLOW_FRAMES = 50  # for the solvers that take milliseconds
_FEASIBLE = 1e-9  # metres: bone errors below this change the objective insignificantly


@dataclass(frozen=True)
class Problem:
    """One frame of eq. (1)."""

    body: Body
    targets: NDArray[np.float64]
    weights: NDArray[np.float64]
    lengths: NDArray[np.float64]
    start: NDArray[np.float64] | None = None


@dataclass(frozen=True)
class Timing:
    """Result of one solver.

    Attributes:
        name: Name of the solver.
        frames: Number of frames solved.
        median_us, p99_us, max_us: Microseconds per frame.
        iterations: Median number of iterations.
        systems: Median number of linear systems solved, including line searches and abandoned starts.
        bone_error_mm: The largest bone error of all frames.
        excess: Median of objective / optimal objective - 1. It is negative if wrong bone lengths allow a
            better fit than any skeleton with correct lengths. None if the optimum is unknown.
        off_mm: The largest distance of a joint from the optimum; None if the optimum is unknown.
    """

    name: str
    frames: int
    median_us: float
    p99_us: float
    max_us: float
    iterations: float
    systems: float
    bone_error_mm: float
    excess: float | None
    off_mm: float | None


Solve = Callable[[Problem], tuple[NDArray[np.float64], int, int]]
"""(J, 3) joints, iterations, linear systems."""


def random_frames(count: int, body: Body = KINECT_V1, seed: int = 0) -> list[Problem]:
    """Cold starts: a person with arms and legs in random directions about rest, 10 mm noise."""
    rng = np.random.default_rng(seed)
    problems = []
    for _ in range(count):
        pose = np.zeros((len(body), 3))
        for joint in body.order[1:]:
            direction = body.rest[joint] + 0.4 * rng.normal(size=3)
            direction *= body.nominal_lengths[joint] / np.linalg.norm(direction)
            pose[joint] = pose[body.parents[joint]] + direction
        targets = pose + [0.0, 0.0, 2.5] + rng.normal(0.0, _NOISE, pose.shape)
        problems.append(Problem(body, targets, rng.uniform(0.3, 1.0, len(body)), body.nominal_lengths))
    return problems


def time_solvers(problems: Sequence[Problem]) -> list[Timing]:
    """All solvers on the same frames; the slow ones on the first few only."""
    body = problems[0].body
    few = problems[:_SLOW_FRAMES]
    best = [optimum(problem) for problem in few]
    timings = [
        time_solver("exact", exact(body), problems, best),
        time_solver("paper's scheme (numba)", published(body), problems, best),
        time_solver("SLSQP, all derivatives", slsqp(analytic=True), few, best),
        time_solver("SLSQP, none given", slsqp(analytic=False), few, best),
    ]
    ceres = stiff_ceres()
    if ceres is not None:
        timings.append(time_solver("Ceres, stiff bones", ceres, problems[:30], best))
    return timings


def time_solver(
    name: str, solve: Solve, problems: Sequence[Problem], best: Sequence[NDArray[np.float64]] = ()
) -> Timing:
    """Times one solver on some frames; compares the first frames with the known optima."""
    solve(problems[0])
    nanoseconds, iterations, systems, bones, excess, off = [], [], [], [], [], []
    for problem, known in zip_longest(problems, best[: len(problems)]):
        before = time.perf_counter_ns()
        positions, steps, solved = solve(problem)
        nanoseconds.append(time.perf_counter_ns() - before)
        iterations.append(steps)
        systems.append(solved)
        bones.append(_bones_off(problem, positions))
        if known is not None:
            excess.append(_objective(problem, positions) / _objective(problem, known) - 1.0)
            off.append(np.linalg.norm(positions - known, axis=1).max())
    took = np.array(nanoseconds) * 1e-3
    return Timing(
        name=name,
        frames=len(took),
        median_us=float(np.median(took)),
        p99_us=float(np.percentile(took, 99)),
        max_us=float(took.max()),
        iterations=float(np.median(iterations)),
        systems=float(np.median(systems)),
        bone_error_mm=float(max(bones) * 1e3),
        excess=float(np.median(excess)) if excess else None,
        off_mm=float(max(off) * 1e3) if off else None,
    )


def optimum(problem: Problem) -> NDArray[np.float64]:
    """The best feasible solution of three independent solvers."""
    body = problem.body
    dense = (
        DenseSolver(body).solve(problem.targets, problem.weights, problem.lengths, problem.start).positions
    )
    ends = [exact(body)(problem)[0], dense, slsqp(analytic=True)(problem)[0]]
    right = [end for end in ends if _bones_off(problem, end) < _FEASIBLE]
    return min(right, key=lambda end: _objective(problem, end))


def exact(body: Body) -> Solve:
    """The tree solver."""
    solver = TreeSolver(body.parent_indices, body.order, body.rest)

    def solve(problem: Problem) -> tuple[NDArray[np.float64], int, int]:
        found = solver.solve(problem.targets, problem.weights, problem.lengths, problem.start)
        return found.positions, found.iterations, found.systems

    return solve


def published(body: Body) -> Solve:
    """Eqs. (3)–(9) with the line search."""
    solver = PaperSolver(body.parent_indices)

    def solve(problem: Problem) -> tuple[NDArray[np.float64], int, int]:
        found = solver.solve(problem.targets, problem.weights, problem.lengths, problem.start)
        return found.positions, found.iterations, found.systems

    return solve


def slsqp(analytic: bool) -> Solve:
    """scipy's SLSQP with one constraint per bone, with or without analytic derivatives."""

    def solve(problem: Problem) -> tuple[NDArray[np.float64], int, int]:
        found = slsqp_optimum(
            problem.body,
            problem.targets,
            problem.weights,
            problem.lengths,
            problem.targets,
            analytic=analytic,
            max_steps=500,
        )
        return found.positions, found.steps, found.steps  # one least-squares system per step

    return solve


def stiff_ceres() -> Solve | None:
    """Ceres through pyceres: a residual √w (x − m) per joint and a stiff residual k (‖e‖ − l) per bone.

    The residuals are Python callbacks, as pyceres requires; their time is included.

    Returns:
        None if pyceres is not installed.
    """
    try:
        ceres = importlib.import_module("pyceres")
    except ImportError:
        return None

    class Joint(ceres.CostFunction):  # type: ignore[misc, name-defined]
        def __init__(self, target: NDArray[np.float64], weight: float) -> None:
            super().__init__()
            self.set_num_residuals(3)
            self.set_parameter_block_sizes([3])
            self._target, self._root = target, np.sqrt(weight)
            self._jacobian = (self._root * np.eye(3)).ravel()

        def Evaluate(self, parameters: Any, residuals: Any, jacobians: Any) -> bool:  # noqa: N802
            residuals[:] = self._root * (parameters[0] - self._target)
            if jacobians is not None and jacobians[0] is not None:
                jacobians[0][:] = self._jacobian
            return True

    class Bone(ceres.CostFunction):  # type: ignore[misc, name-defined]
        def __init__(self, length: float) -> None:
            super().__init__()
            self.set_num_residuals(1)
            self.set_parameter_block_sizes([3, 3])
            self._length = length

        def Evaluate(self, parameters: Any, residuals: Any, jacobians: Any) -> bool:  # noqa: N802
            bone = parameters[0] - parameters[1]
            length = float(np.sqrt(bone @ bone))
            residuals[0] = _STIFFNESS * (length - self._length)
            if jacobians is not None:
                for sign, jacobian in zip((1.0, -1.0), jacobians, strict=True):
                    if jacobian is not None:
                        jacobian[:] = sign * _STIFFNESS * bone / length
            return True

    def solve(problem: Problem) -> tuple[NDArray[np.float64], int, int]:
        body = problem.body
        points = [row.copy() for row in problem.targets]
        model = ceres.Problem()
        for joint in range(len(body)):
            model.add_residual_block(
                Joint(problem.targets[joint], problem.weights[joint]), None, [points[joint]]
            )
        for joint in body.bone_joints:
            ends = [points[joint], points[body.parents[joint]]]
            model.add_residual_block(Bone(problem.lengths[joint]), None, ends)
        options = ceres.SolverOptions()
        options.linear_solver_type = ceres.LinearSolverType.SPARSE_NORMAL_CHOLESKY
        options.max_num_iterations = 200
        options.function_tolerance = options.gradient_tolerance = options.parameter_tolerance = 1e-14
        options.minimizer_progress_to_stdout = False
        options.logging_type = ceres.LoggingType.SILENT
        options.num_threads = 1
        summary = ceres.SolverSummary()
        ceres.solve(options, model, summary)
        steps = int(summary.num_successful_steps + summary.num_unsuccessful_steps)
        return np.array(points), steps, steps

    return solve


def _bones_off(problem: Problem, positions: NDArray[np.float64]) -> float:
    off = np.abs(bone_lengths_of(problem.body, positions) - problem.lengths)
    return float(off[problem.body.bone_joints].max())


def _objective(problem: Problem, positions: NDArray[np.float64]) -> float:
    return float((problem.weights[:, None] * (positions - problem.targets) ** 2).sum())
