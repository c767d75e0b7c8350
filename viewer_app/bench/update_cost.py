"""Measures the time of ``Fuser.update``, in total and by stage, and the throughput of batches."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from devices.pairing import FramePair, pair_recordings
from devices.simulated.kinect import PERSON, Scene, SimulatedKinect, movement
from devices.simulated.rig import Rig
from fusion.body import Body
from fusion.calibration.calibration import Calibration, calibrate
from fusion.calibration.start_up_pose import find_start_up_pose
from fusion.compiling.kernels import kernel
from fusion.fuser import Fuser
from fusion.paper import method as paper
from fusion.setup import FuserSettings, FusionSetup, Method
from fusion.skeleton import Skeleton, SkeletonPair
from fusion.solvers.tree_solver import TreeSolver, solve_tree
from fusion.solvers.tree_steps import copy
from viewer_app.bench.solvers import Problem

STAGES = ("carry", "trust", "blend", "solve")
_ROUNDS = 15
FRAME_NS = 33_333_333


@dataclass(frozen=True)
class UpdateTiming:
    """Processor time per pair: time in which other processes run does not count.

    Attributes:
        name: The body and the source of the pairs.
        frames: Number of pairs.
        method: Name of the method.
        stages_us: Of each stage of the method ``paper`` inside its compiled loop, microseconds; else empty.
        median_us, p99_us, p999_us, max_us: Of ``Fuser.update`` as called from Python.
        iterations: Median number of iterations.
        batch_per_s: Pairs per second with ``fuse_sequence``.
    """

    name: str
    method: Method
    frames: int
    stages_us: dict[str, float]
    median_us: float
    p99_us: float
    p999_us: float
    max_us: float
    iterations: float
    batch_per_s: float


def simulated_pairs(body: Body, seconds: float) -> list[FramePair]:
    """A walk in front of two simulated sensors."""
    scene = Scene(movement("walk"), body, seconds=seconds)
    a, b = (list(SimulatedKinect(scene, Rig(), which).frames()) for which in (0, 1))
    return pair_recordings(a, b, PERSON, PERSON).pairs


def start_up(pairs: Sequence[SkeletonPair], body: Body) -> Calibration:
    """The calibration of a recording."""
    return calibrate(body, *find_start_up_pose(body, pairs))


def repeated(pairs: Sequence[SkeletonPair], times: int) -> list[SkeletonPair]:
    """Repeats a recording forwards and backwards in turn, so that it has no jumps."""
    shown = [pair for k in range(times) for pair in (pairs if k % 2 == 0 else pairs[::-1])]
    return [replace(pair, time_ns=k * FRAME_NS) for k, pair in enumerate(shown)]


def time_update(
    name: str, pairs: Sequence[SkeletonPair], calibration: Calibration, method: Method = "duplex"
) -> UpdateTiming:
    """Measures one recording with a method."""
    setup = FusionSetup(calibration, FuserSettings(method=method))
    fuser = Fuser(setup)
    fuser.warm_up()
    took, iterations = [], []
    for pair in pairs:
        before = time.thread_time_ns()
        fused = fuser.update(pair)
        took.append(time.thread_time_ns() - before)
        iterations.append(fused.iterations)
    many = repeated(pairs, max(1, 6000 // len(pairs)))
    rates = []
    for _ in range(3):
        fuser = Fuser(setup)
        before = time.thread_time_ns()
        fuser.fuse_sequence(many)
        rates.append(len(many) / (time.thread_time_ns() - before) * 1e9)
    microseconds = np.array(took) * 1e-3
    median, p99, p999, most = np.percentile(microseconds, [50, 99, 99.9, 100])
    return UpdateTiming(
        name=name,
        method=method,
        frames=len(pairs),
        stages_us=time_stages(pairs, calibration) if method == "paper" else {},
        median_us=float(median),
        p99_us=float(p99),
        p999_us=float(p999),
        max_us=float(most),
        iterations=float(np.median(iterations)),
        batch_per_s=float(np.median(rates)),
    )


def time_stages(pairs: Sequence[SkeletonPair], calibration: Calibration) -> dict[str, float]:
    """Microseconds that each stage of :mod:`fusion.paper.method` adds per pair.

    The fastest of several rounds counts, because it is disturbed least by other processes.
    """
    body = calibration.body
    nobody = Skeleton.of(body, np.full((len(body), 3), np.nan))
    a, b = [pair.a or nobody for pair in pairs], [pair.b or nobody for pair in pairs]
    views = [
        np.array(values)
        for values in (
            [s.positions for s in a], [s.states for s in a], [s.positions for s in b], [s.states for s in b],
        )
    ]  # fmt: skip
    setup = FusionSetup(calibration)
    model = paper.new_model(
        body, calibration.bone_lengths, calibration.a_from_b.rotation, setup.intrinsics,
        setup.settings.h, paper.TRUST,
    )  # fmt: skip
    result = paper.new_result(1, len(body))

    def loop(stages: int) -> float:
        memory = paper.new_memory(len(body), calibration.a_from_b.translation)
        before = time.thread_time_ns()
        _some_stages(stages, model, memory, result, *views)
        return (time.thread_time_ns() - before) * 1e-3 / len(pairs)

    loop(len(STAGES))
    upto = [min(loop(k) for _ in range(_ROUNDS)) for k in range(len(STAGES) + 1)]
    return {stage: float(upto[k + 1] - upto[k]) for k, stage in enumerate(STAGES)}


@kernel
def _some_stages(stages, model, memory, result, a, states_a, b, states_b):  # type: ignore[no-untyped-def]
    """The first few stages of :func:`fusion.paper.method.fuse_frames` over all pairs."""
    weights_a, weights_b = result.weights_a[0], result.weights_b[0]
    positions = result.positions[0]
    for k in range(len(a)):
        if stages > 0:
            paper.carry(model, memory, a[k], states_a[k], b[k], states_b[k])
        if stages > 1:
            paper.trust(
                model,
                memory,
                a[k],
                states_a[k],
                b[k],
                states_b[k],
                weights_a,
                weights_b,
                result.misleading[0],
            )
        anyone = stages > 2 and paper.blend(memory, a[k], weights_a, weights_b, result.predicted[0])
        if stages > 3 and anyone:
            if memory.before_ns[1] == 0:
                paper.first_guess(model, memory)
            solve_tree(
                model.parents, model.order, model.rest, memory.targets, memory.weights, model.bone_lengths,
                memory.before, memory.tree_work, positions,
            )  # fmt: skip
            copy(positions, memory.before)
            memory.before_ns[1] = 1


def warm_frames(pairs: Sequence[SkeletonPair], calibration: Calibration) -> list[Problem]:
    """Eq. (1) of ``paper`` for every pair that both sensors see, each started from the solution before."""
    body = calibration.body
    fuser = Fuser(FusionSetup(calibration, FuserSettings(method="paper")))
    solver = TreeSolver(body.parent_indices, body.order, body.rest)
    problems: list[Problem] = []
    before: NDArray[np.float64] | None = None
    for pair in pairs:
        fused = fuser.update(pair)
        if pair.a is None or pair.b is None:
            continue
        p, q = pair.a.positions.astype(np.float64), fused.a_from_b.apply(pair.b.positions)
        w_a, w_b = fused.weights_a[:, None], fused.weights_b[:, None]
        weights = fused.weights_a + fused.weights_b
        sums = np.where(w_a > 0.0, w_a * p, 0.0) + np.where(w_b > 0.0, w_b * q, 0.0)
        targets = np.where(weights[:, None] > 0.0, sums / np.maximum(weights[:, None], 1e-300), 0.0)
        problems.append(Problem(body, targets, weights, calibration.bone_lengths, before))
        before = solver.solve(targets, weights, calibration.bone_lengths, before).positions
    return problems


def time_growth(joints: Sequence[int], frames: int = 300) -> dict[int, float]:
    """Median microseconds a linear system by number of joints, in cold solves of synthetic trees.

    Every joint's parent is one of the eight before it; noise is 10 mm.
    """
    figures = {}
    for count in joints:
        rng = np.random.default_rng(count)
        parents = np.array([-1] + [int(rng.integers(max(0, i - 8), i)) for i in range(1, count)])
        lengths = rng.uniform(0.1, 0.4, count)
        solver = TreeSolver(parents, np.arange(count), np.ones((count, 3)))
        each = []
        for _ in range(frames):
            pose = np.zeros((count, 3))
            for i in range(1, count):
                direction = rng.normal(size=3)
                pose[i] = pose[parents[i]] + lengths[i] * direction / np.linalg.norm(direction)
            targets = pose + rng.normal(0.0, 0.01, pose.shape)
            before = time.perf_counter_ns()
            systems = solver.solve(targets, np.ones(count), lengths).systems
            each.append((time.perf_counter_ns() - before) / max(systems, 1))
        figures[count] = float(np.median(each)) * 1e-3
    return figures
