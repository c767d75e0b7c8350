"""The paper's methods: owns their arrays and returns the results as fused frames."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import typeof
from numpy.typing import NDArray

from fusion.fused_frame import FusedFrame
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
            method.EQUAL if setup.settings.weights == "equal" else method.TRUST,
        )
        self._memory.translation[:] = setup.calibration.a_from_b.translation

    def compile(self, positions: NDArray[np.float32], states: NDArray[np.uint8]) -> None:
        """Compiles everything but the solver."""
        result = method.new_result(1, len(states))
        given = self._model, self._memory, result, 0, 0, positions, states, positions, states
        method.prepare.compile(tuple(map(typeof, given)))  # type: ignore[attr-defined]

    def run(
        self,
        time_ns: NDArray[np.int64],
        skew_ns: NDArray[np.int64],
        codes: NDArray[np.int64],
        witnesses: tuple[NDArray[np.float32], NDArray[np.float32]],
        *views: NDArray[Any],
    ) -> list[FusedFrame]:
        """Fuses the next pairs. The paper uses neither skew, nor exchanged sides, nor images."""
        del skew_ns, codes, witnesses
        result = method.new_result(len(time_ns), views[1].shape[1])
        published = self._setup.settings.method == "published"
        fuse = method.fuse_frames_as_published if published else method.fuse_frames
        fuse(self._model, self._memory, result, time_ns, *views)
        return [self._fused(result, k, int(time)) for k, time in enumerate(time_ns)]

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
