"""The method, pair by pair or a whole recording at once: S_A and S_B in, S* out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import typeof
from numpy.typing import NDArray

from fusion.compiling.parallel_compilation import tree_solver_compiled_meanwhile
from fusion.methods import paper
from fusion.rigid import RigidTransform
from fusion.setup import FusionSetup
from fusion.skeleton import Skeleton, SkeletonPair


@dataclass(frozen=True, eq=False)
class FusedFrame:
    """S* of one pair, and why it is so.

    Attributes:
        positions: (J, 3) metres, in K_A's frame; NaN throughout where neither sensor sees a person.
        predicted: (J,) whether a joint has no data and hangs on its bones and the frame before.
        weights_a, weights_b: (J,) w^A and w^B of eq. (11); both 0 where predicted.
        misleading: (J,) the mis-leading joint m of sec. 3; -1 where there is none.
        a_from_b: R, and t of this frame.
        iterations: Steps the solver took.
        stale_a, stale_b: Whether the sensor's skeleton repeats its last one.
        time_ns: The pair's time.
    """

    positions: NDArray[np.float64]
    predicted: NDArray[np.bool_]
    weights_a: NDArray[np.float64]
    weights_b: NDArray[np.float64]
    misleading: NDArray[np.int64]
    a_from_b: RigidTransform
    iterations: int
    stale_a: bool
    stale_b: bool
    time_ns: int

    @property
    def has_person(self) -> bool:
        """Whether there is an S* at all."""
        return not self.predicted.all()


class Fuser:
    """Makes one skeleton of two, pair by pair; it remembers only the frame before.

    The steps of a frame are those of ``docs/method.md``, compiled in :mod:`fusion.methods.paper`.

    Args:
        setup: Calibration, settings and cameras.
    """

    def __init__(self, setup: FusionSetup) -> None:
        self.setup = setup
        body, calibration = setup.body, setup.calibration
        self._nobody = Skeleton.of(body, np.full((len(body), 3), np.nan))
        self._model = paper.new_model(
            body,
            calibration.bone_lengths,
            calibration.a_from_b.rotation,
            setup.intrinsics,
            setup.settings.h,
            paper.EQUAL if setup.settings.weights == "equal" else paper.TRUST,
        )
        self._memory = paper.new_memory(len(body), calibration.a_from_b.translation)

    def warm_up(self, meanwhile: Callable[[], object] = lambda: None) -> None:
        """Compiles everything that :meth:`update` runs, without touching what this fuser remembers.

        Args:
            meanwhile: What else there is to compile: on a first run another process is at work too.
        """
        other = Fuser(self.setup)
        if self.setup.settings.solver == "paper":
            meanwhile()
        else:
            with tree_solver_compiled_meanwhile():
                meanwhile()
                other._compile_preparation()
        other.update(SkeletonPair(None, None, 0))

    def _compile_preparation(self) -> None:
        positions, states = self._nobody.positions, self._nobody.states
        result = paper.new_result(1, len(states))
        given = self._model, self._memory, result, 0, 0, positions, states, positions, states
        paper.prepare.compile(tuple(map(typeof, given)))  # type: ignore[attr-defined]

    def update(self, pair: SkeletonPair) -> FusedFrame:
        """Fuses the next pair.

        Args:
            pair: Both skeletons in their own sensors' frames, of the calibration's body. A sensor that sees
                no one gives None, and S* comes from the other alone; with neither there is no S*.
        """
        a, b = pair.a or self._nobody, pair.b or self._nobody
        result = self._run(
            np.array([pair.time_ns], dtype=np.int64),
            a.positions[None],
            a.states[None],
            b.positions[None],
            b.states[None],
        )
        return self._fused(result, 0, pair.time_ns)

    def fuse_sequence(self, pairs: Sequence[SkeletonPair]) -> list[FusedFrame]:
        """Fuses the next pairs in one compiled loop; bit for bit what :meth:`update` gives one by one."""
        if not pairs:
            return []
        result = self._run(
            np.array([pair.time_ns for pair in pairs], dtype=np.int64),
            *self._stacked([pair.a or self._nobody for pair in pairs]),
            *self._stacked([pair.b or self._nobody for pair in pairs]),
        )
        return [self._fused(result, k, pair.time_ns) for k, pair in enumerate(pairs)]

    @staticmethod
    def _stacked(skeletons: Sequence[Skeleton]) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
        positions = np.array([skeleton.positions for skeleton in skeletons])
        states = np.array([skeleton.states for skeleton in skeletons])
        positions.flags.writeable = states.flags.writeable = False  # the type update() calls with
        return positions, states

    def _run(self, time_ns: NDArray[np.int64], *views: NDArray[Any]) -> paper.Result:
        result = paper.new_result(len(time_ns), len(self._nobody.states))
        fuse = paper.fuse_frames_as_published if self.setup.settings.solver == "paper" else paper.fuse_frames
        fuse(self._model, self._memory, result, time_ns, *views)
        return result

    def _fused(self, result: paper.Result, k: int, time_ns: int) -> FusedFrame:
        iterations, stale_a, stale_b = result.counts[k].tolist()
        return FusedFrame(
            positions=result.positions[k],
            predicted=result.predicted[k],
            weights_a=result.weights_a[k],
            weights_b=result.weights_b[k],
            misleading=result.misleading[k],
            a_from_b=RigidTransform(self.setup.calibration.a_from_b.rotation, result.translation[k]),
            iterations=iterations,
            stale_a=bool(stale_a),
            stale_b=bool(stale_b),
            time_ns=time_ns,
        )
