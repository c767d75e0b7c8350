"""The paper's methods: owns their arrays and returns the results as fused frames."""

from typing import Any

from numba import typeof

from fusion.compiling.references import by_reference
from fusion.fused_frame import FusedFrames
from fusion.pair_arrays import PairArrays
from fusion.paper import method
from fusion.rigid import RigidTransform
from fusion.setup import FusionSetup
from fusion.solvers.tree_solver import solve_tree
from fusion.support.array_fields import new_arrays


class PaperFusion:
    """``paper`` and ``published``; see :class:`fusion.setup.FuserSettings`."""

    kernel: Any = solve_tree
    """The kernel that takes longest to compile."""
    beside = "from fusion.solvers.tree_solver import compile_tree_solver; compile_tree_solver()"
    """What another process compiles meanwhile."""

    def __init__(self, setup: FusionSetup) -> None:
        self._memory = by_reference(new_arrays(method.Memory, J=len(setup.body)))
        self.recalibrate(setup)

    def recalibrate(self, setup: FusionSetup) -> None:
        """Continues with another calibration."""
        self._setup = setup
        self._model = by_reference(method.new_model(setup))
        self._memory.translation[:] = setup.calibration.a_from_b.translation

    def compile(self, pairs: PairArrays) -> None:
        """Compiles everything but the solver, for arrays like these."""
        result = new_arrays(method.Result, T=1, J=pairs.a.shape[1])
        given = self._model, self._memory, result, pairs, 0
        method.prepare.compile(tuple(map(typeof, given)))  # type: ignore[attr-defined]

    def run(self, pairs: PairArrays) -> FusedFrames:
        """Fuses the next pairs. The paper uses neither skew, nor exchanged sides, nor images."""
        result = new_arrays(method.Result, T=len(pairs.time_ns), J=pairs.a.shape[1])
        published = self._setup.settings.method == "published"
        fuse = method.fuse_frames_as_published if published else method.fuse_frames
        fuse(self._model, self._memory, result, pairs)
        a_from_b = RigidTransform(self._setup.calibration.a_from_b.rotation, result.translation)
        return FusedFrames(result, a_from_b, pairs.time_ns)
