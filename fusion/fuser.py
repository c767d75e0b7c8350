"""Fuses S_A and S_B to S*, pair by pair or a whole recording at once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fusion.compiling.parallel_compilation import compiled_meanwhile
from fusion.errors import FusionError
from fusion.estimator.constants import Constants
from fusion.estimator.duplex_fusion import DuplexFusion
from fusion.fused_frame import FusedFrame as FusedFrame
from fusion.paper.paper_fusion import PaperFusion
from fusion.registration import robust_fit
from fusion.setup import FusionSetup
from fusion.skeleton import Skeleton, SkeletonPair


class Fuser:
    """Fuses two skeletons to one, pair by pair.

    The steps of a frame are those of ``docs/method.md``, compiled in :mod:`fusion.estimator.estimator` and
    :mod:`fusion.paper.method`.

    Args:
        setup: Calibration, settings and cameras.
        constants: Of the method ``duplex``, for ablations and fits; the body's fitted ones where None.
    """

    def __init__(self, setup: FusionSetup, constants: Constants | None = None) -> None:
        self.setup = setup
        self._nobody = Skeleton.of(setup.body, np.full((len(setup.body), 3), np.nan))
        self._no_image = np.full((len(setup.body), 4), np.nan, dtype=np.float32)
        self._unlabelled = np.full((1, 2), -1, dtype=np.int64)
        self._fusion: DuplexFusion | PaperFusion
        if setup.settings.method == "duplex":
            self._fusion = DuplexFusion(setup, constants)
        else:
            self._fusion = PaperFusion(setup)

    def warm_up(self, meanwhile: Callable[[], object] = lambda: None) -> None:
        """Compiles everything that :meth:`update` and the live calibration run.

        The state of this fuser does not change.

        Args:
            meanwhile: Called while another process compiles, on a first run; for further compilation.
        """
        other = Fuser(self.setup)
        if self.setup.settings.method == "published":
            meanwhile()
        else:
            matrices = self.setup.settings.method == "duplex"
            solver = f"from fusion.solvers import tree_solver; tree_solver.compile_tree_solver({matrices})"
            with compiled_meanwhile(self._fusion.kernel, solver):
                meanwhile()
                other._fusion.compile(self._nobody.positions, self._nobody.states)
        other.update(SkeletonPair(None, None, 0))
        if self.setup.settings.method == "duplex":
            robust_fit.warm_up()

    def recalibrate(self, setup: FusionSetup) -> None:
        """Continues with another calibration and keeps the state of the person.

        Args:
            setup: With the body and the settings of this fuser.

        Raises:
            FusionError: Another body, or other settings.
        """
        if setup.body is not self.setup.body or setup.settings != self.setup.settings:
            raise FusionError("A fuser goes on with another calibration only: its body and settings stay.")
        self.setup = setup
        self._fusion.recalibrate(setup)

    def update(self, pair: SkeletonPair, codes: tuple[int, int] | None = None) -> FusedFrame:
        """Fuses the next pair.

        Args:
            pair: Both skeletons in their own sensors' frames, of the calibration's body. A sensor that sees
                no one gives None, and S* comes from the other alone; with neither there is no S*.
            codes: Which sides of A and of B are exchanged, where that is known
                (:func:`fusion.facing.sequence.relabel_sequence`), with the doubt about it
                (:func:`fusion.facing.exchange.with_doubt`) or without; found pair by pair where None.
        """
        a, b = pair.a or self._nobody, pair.b or self._nobody
        return self._fusion.run(
            np.array([pair.time_ns], dtype=np.int64),
            np.array([pair.skew_ns], dtype=np.int64),
            self._unlabelled if codes is None else np.array([codes], dtype=np.int64),
            (self._witness(a)[None], self._witness(b)[None]),
            a.positions[None],
            a.states[None],
            b.positions[None],
            b.states[None],
        )[0]

    def fuse_sequence(
        self, pairs: Sequence[SkeletonPair], codes: ArrayLike | None = None
    ) -> list[FusedFrame]:
        """Fuses the next pairs in one compiled loop; bit for bit what :meth:`update` gives one by one.

        Args:
            pairs: In time order.
            codes: (T, 2) as in :meth:`update`.
        """
        return self._fusion.run(*self._rows(pairs, codes)) if pairs else []

    def smooth_sequence(
        self, pairs: Sequence[SkeletonPair], codes: ArrayLike | None = None
    ) -> list[FusedFrame]:
        """Fuses a whole recording, using the pairs before and after each pair: smoother, without lag.

        Args:
            pairs, codes: As in :meth:`fuse_sequence`.

        Raises:
            FusionError: The method is one of the paper's, which treat each frame on its own.
        """
        if not isinstance(self._fusion, DuplexFusion):
            raise FusionError(
                f"Only the method duplex can smooth a recording; this is {self.setup.settings.method}."
            )
        return self._fusion.run(*self._rows(pairs, codes), smooth=True) if pairs else []

    def _rows(self, pairs: Sequence[SkeletonPair], codes: ArrayLike | None) -> tuple[Any, ...]:
        return (
            np.array([pair.time_ns for pair in pairs], dtype=np.int64),
            np.array([pair.skew_ns for pair in pairs], dtype=np.int64),
            np.full((len(pairs), 2), -1, dtype=np.int64)
            if codes is None
            else np.array(codes, dtype=np.int64),
            tuple(
                np.array([self._witness(skeleton or self._nobody) for skeleton in view])
                for view in zip(*((pair.a, pair.b) for pair in pairs), strict=True)
            ),
            *self._stacked([pair.a or self._nobody for pair in pairs]),
            *self._stacked([pair.b or self._nobody for pair in pairs]),
        )

    def _witness(self, skeleton: Skeleton) -> NDArray[np.float32]:
        """(J, 4) of its image; NaN without one."""
        if skeleton.witness is None:
            return self._no_image
        return np.array(skeleton.witness, dtype=np.float32)  # of one type, whoever made it

    @staticmethod
    def _stacked(skeletons: Sequence[Skeleton]) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
        positions = np.array([skeleton.positions for skeleton in skeletons])
        states = np.array([skeleton.states for skeleton in skeletons])
        positions.flags.writeable = states.flags.writeable = False  # the type update() calls with
        return positions, states
