"""The paper's methods: owns their arrays and returns the results as fused frames."""

from __future__ import annotations

from typing import Any

from numba import typeof

from fusion.fused_frame import FusedFrame
from fusion.pair_arrays import PairArrays
from fusion.paper import method
from fusion.rigid import RigidTransform
from fusion.setup import FusionSetup
from fusion.solvers.tree_solver import solve_tree


class PaperFusion:
    """``paper`` and ``published``; see :class:`fusion.setup.FuserSettings`.

    Args:
        setup: Calibration, settings and cameras.
    """

    kernel: Any = solve_tree
    """The kernel that takes longest to compile."""

    def __init__(self, setup: FusionSetup) -> None:
        self._memory = method.new_memory(len(setup.body), setup.calibration.a_from_b.translation)
        self.recalibrate(setup)

    def recalibrate(self, setup: FusionSetup) -> None:
        """Continues with another calibration."""
        self._setup = setup
        self._model = method.new_model(
            setup.body,
            setup.calibration.bone_lengths,
            setup.calibration.a_from_b.rotation,
            setup.intrinsics,
            setup.settings.h,
            method.EQUAL if setup.settings.weights == "equal" else method.PAPER,
        )
        self._memory.translation[:] = setup.calibration.a_from_b.translation

    def compile(self, pairs: PairArrays) -> None:
        """Compiles everything but the solver, for arrays like these."""
        result = method.new_result(1, pairs.a.shape[1])
        given = self._model, self._memory, result, pairs, 0
        method.prepare.compile(tuple(map(typeof, given)))  # type: ignore[attr-defined]

    def run(self, pairs: PairArrays) -> list[FusedFrame]:
        """Fuses the next pairs. The paper uses neither skew, nor exchanged sides, nor images."""
        result = method.new_result(len(pairs.time_ns), pairs.a.shape[1])
        published = self._setup.settings.method == "published"
        fuse = method.fuse_frames_as_published if published else method.fuse_frames
        fuse(self._model, self._memory, result, pairs)
        return [self._fused(result, k, int(time)) for k, time in enumerate(pairs.time_ns)]

    def _fused(self, result: method.Result, k: int, time_ns: int) -> FusedFrame:
        iterations, stale_a, stale_b = result.counts[k].tolist()
        return FusedFrame(
            positions=result.positions[k],
            predicted=result.predicted[k],
            weights_a=result.weights_a[k],
            weights_b=result.weights_b[k],
            misleading=result.misleading[k],
            a_from_b=RigidTransform(self._setup.calibration.a_from_b.rotation, result.translation[k]),
            iterations=iterations,
            stale_a=bool(stale_a),
            stale_b=bool(stale_b),
            time_ns=time_ns,
        )
