"""Fuses S_A and S_B to S*, pair by pair or a whole recording at once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from fusion.compiling.kernels import WarmUp
from fusion.errors import FusionError
from fusion.estimator.constants import Constants
from fusion.estimator.duplex_fusion import DuplexFusion
from fusion.facing.labels import Labels
from fusion.fused_frame import FusedFrame as FusedFrame
from fusion.fused_frame import FusedFrames
from fusion.pair_arrays import PairArrays, Pairs, PairStacker
from fusion.setup import FusionSetup, Method
from fusion.skeleton import SkeletonPair
from fusion.support.read_only import read_only

if TYPE_CHECKING:
    from fusion.paper.paper_fusion import PaperFusion


class Fuser:
    """Fuses two skeletons into one, pair by pair.

    The steps of a frame are those of ``docs/method.md``, compiled in :mod:`fusion.estimator.estimator` and
    :mod:`fusion.paper.method`.

    Args:
        setup: Calibration, settings and cameras.
        constants: Of the method ``duplex``, for ablations and fits; those of the body if None.
    """

    def __init__(self, setup: FusionSetup, constants: Constants | None = None) -> None:
        self.setup = setup
        self._stacker = PairStacker(setup.body)
        self._fusion: DuplexFusion | PaperFusion
        if setup.settings.method == "duplex":
            self._fusion = DuplexFusion(setup, constants)
        else:
            from fusion.paper.paper_fusion import PaperFusion

            self._fusion = PaperFusion(setup)

    @staticmethod
    def warm_ups(method: Method) -> tuple[list[WarmUp], list[WarmUp]]:
        """What two processes compile on a first run, for :meth:`update` and the live calibration."""
        if method == "duplex":
            from fusion.estimator.duplex_fusion import compile_estimator, compile_steps
            from fusion.registration import error_model

            return [compile_estimator], [compile_steps, error_model.warm_up]
        from fusion.paper.paper_fusion import compile_paper, compile_published

        return [compile_paper if method == "paper" else compile_published], []

    def warm_up(self) -> None:
        """Compiles or loads everything that :meth:`update` and the live calibration run."""
        from fusion.compiling.first_run import FirstRun

        with FirstRun(*self.warm_ups(self.setup.settings.method)) as first_run:
            first_run.finish()

    def recalibrate(self, setup: FusionSetup) -> None:
        """Continues with another calibration and keeps the state of the person.

        Args:
            setup: Must have the body and the settings of this fuser.

        Raises:
            FusionError: The body or the settings differ.
        """
        if setup.body is not self.setup.body or setup.settings != self.setup.settings:
            raise FusionError("A fuser goes on with another calibration only: its body and settings stay.")
        self.setup = setup
        self._fusion.recalibrate(setup)

    def update(self, pair: SkeletonPair, labels: Labels | None = None) -> FusedFrame:
        """Fuses the next pair.

        Args:
            pair: Both skeletons in their own sensors' frames, of the calibration's body. None for a
                sensor that sees no one: S* then comes from the other alone, or is missing without both.
            labels: One row, if sides and heading are known beforehand.

        Raises:
            BodyError: A skeleton is of another body.
        """
        return self._fusion.run(self._placed(self._stacker.of_pair(pair, labels)))[0]

    def fuse_sequence(self, pairs: Sequence[SkeletonPair], labels: Labels | None = None) -> FusedFrames:
        """Fuses the next pairs in one compiled loop, with the same bits as :meth:`update` pair by pair.

        Args:
            pairs: In time order.
            labels: Of each pair; found pair by pair if None.
        """
        return self._fusion.run(self._placed(Pairs.of(self.setup.body, pairs).arrays(labels)))

    def smooth_sequence(self, pairs: Sequence[SkeletonPair], labels: Labels | None = None) -> FusedFrames:
        """Fuses a whole recording, using the pairs before and after each pair: smoother, without lag.

        Args:
            pairs, labels: As in :meth:`fuse_sequence`.

        Raises:
            FusionError: The method is one of the paper's, which treat each frame on its own.
        """
        if not isinstance(self._fusion, DuplexFusion):
            raise FusionError(
                f"Only the method duplex can smooth a recording; this is {self.setup.settings.method}."
            )
        return self._fusion.run(self._placed(Pairs.of(self.setup.body, pairs).arrays(labels)), smooth=True)

    def _placed(self, pairs: PairArrays) -> PairArrays:
        """The pairs; without B while its place is unknown."""
        if self.setup.calibration.placed:
            return pairs
        b, witness = (np.full_like(of, np.nan) for of in (pairs.b, pairs.witness_b))
        unseen = np.zeros_like(pairs.states_b)
        return pairs._replace(b=read_only(b), states_b=read_only(unseen), witness_b=witness)
