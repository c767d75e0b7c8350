"""The method, pair by pair or a whole recording at once: S_A and S_B in, S* out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fusion.calibration.calibration import Calibration
from fusion.compiling.parallel_compilation import tree_solver_compiled_meanwhile
from fusion.errors import FusionError
from fusion.estimator.duplex_fusion import DuplexFusion
from fusion.fused_frame import FusedFrame as FusedFrame
from fusion.intrinsics import NOMINAL_INTRINSICS, Intrinsics
from fusion.methods.paper_fusion import PaperFusion
from fusion.settings import FuserSettings as FuserSettings
from fusion.skeleton import Skeleton, SkeletonPair


class Fuser:
    """Makes one skeleton of two, pair by pair.

    The steps of a frame are those of ``docs/method.md``, compiled in :mod:`fusion.estimator.estimator` and
    :mod:`fusion.methods.paper`.

    Args:
        calibration: R, t and the bone lengths.
        settings: The method's choices.
        intrinsics_a, intrinsics_b: The sensors' depth cameras; the family's nominal ones where None.
    """

    def __init__(
        self,
        calibration: Calibration,
        settings: FuserSettings | None = None,
        intrinsics_a: Intrinsics | None = None,
        intrinsics_b: Intrinsics | None = None,
    ) -> None:
        body = calibration.body
        _check_bones(calibration)
        self.calibration = calibration
        self.settings = settings or FuserSettings()
        self.intrinsics_a = intrinsics_a or NOMINAL_INTRINSICS[body.name]
        self.intrinsics_b = intrinsics_b or NOMINAL_INTRINSICS[body.name]
        self._nobody = Skeleton.of(body, np.full((len(body), 3), np.nan))
        self._unlabelled = np.full((1, 2), -1, dtype=np.int64)
        self._fusion: DuplexFusion | PaperFusion
        if self.settings.method == "duplex":
            self._fusion = DuplexFusion(calibration, self.settings)
        else:
            self._fusion = PaperFusion(calibration, self.settings, (self.intrinsics_a, self.intrinsics_b))

    def warm_up(self, meanwhile: Callable[[], object] = lambda: None) -> None:
        """Compiles everything that :meth:`update` runs, without touching what this fuser remembers.

        Args:
            meanwhile: What else there is to compile: on a first run another process is at work too.
        """
        other = Fuser(self.calibration, self.settings)
        if self.settings.method == "published":
            meanwhile()
        else:
            with tree_solver_compiled_meanwhile(self._fusion.kernel, self.settings.method == "duplex"):
                meanwhile()
                other._fusion.compile(self._nobody.positions, self._nobody.states)
        other.update(SkeletonPair(None, None, 0))

    def recalibrate(self, calibration: Calibration) -> None:
        """Goes on with another calibration of the same body; what is known of the person stays.

        Raises:
            FusionError: Another body, or a bone without a length.
        """
        if calibration.body is not self.calibration.body:
            raise FusionError(f"The fuser is for {self.calibration.body.name}; got {calibration.body.name}.")
        _check_bones(calibration)
        self.calibration = calibration
        self._fusion.recalibrate(calibration)

    def update(self, pair: SkeletonPair, codes: tuple[int, int] | None = None) -> FusedFrame:
        """Fuses the next pair.

        Args:
            pair: Both skeletons in their own sensors' frames, of the calibration's body. A sensor that sees
                no one gives None, and S* comes from the other alone; with neither there is no S*.
            codes: Which sides of A and of B are exchanged, where that is known
                (:func:`fusion.facing.sequence.relabel_sequence`); found pair by pair where None.
        """
        a, b = pair.a or self._nobody, pair.b or self._nobody
        return self._fusion.run(
            np.array([pair.time_ns], dtype=np.int64),
            np.array([pair.skew_ns], dtype=np.int64),
            self._unlabelled if codes is None else np.array([codes], dtype=np.int64),
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
        """Fuses a whole recording with what comes before and after each pair: no lag, and calmer.

        Args:
            pairs, codes: As in :meth:`fuse_sequence`.

        Raises:
            FusionError: The method is one of the paper's, which know no time.
        """
        if not isinstance(self._fusion, DuplexFusion):
            raise FusionError(
                f"Only the method duplex can smooth a recording; this is {self.settings.method}."
            )
        return self._fusion.run(*self._rows(pairs, codes), smooth=True) if pairs else []

    def _rows(self, pairs: Sequence[SkeletonPair], codes: ArrayLike | None) -> tuple[NDArray[Any], ...]:
        return (
            np.array([pair.time_ns for pair in pairs], dtype=np.int64),
            np.array([pair.skew_ns for pair in pairs], dtype=np.int64),
            np.full((len(pairs), 2), -1, dtype=np.int64)
            if codes is None
            else np.array(codes, dtype=np.int64),
            *self._stacked([pair.a or self._nobody for pair in pairs]),
            *self._stacked([pair.b or self._nobody for pair in pairs]),
        )

    @staticmethod
    def _stacked(skeletons: Sequence[Skeleton]) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
        positions = np.array([skeleton.positions for skeleton in skeletons])
        states = np.array([skeleton.states for skeleton in skeletons])
        positions.flags.writeable = states.flags.writeable = False  # the type update() calls with
        return positions, states


def _check_bones(calibration: Calibration) -> None:
    bones = calibration.bone_lengths[calibration.body.bone_joints]
    if not (np.isfinite(bones).all() and (bones > 0.0).all()):
        raise FusionError(f"Every bone needs a length of more than 0 m; the shortest is {bones.min()} m.")
