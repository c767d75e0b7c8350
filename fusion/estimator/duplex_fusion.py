"""The method ``duplex``: owns the estimator's arrays and returns its results as fused frames."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import typeof
from numpy.typing import NDArray

from fusion.estimator.arrays import Output, new_model, new_output, new_solve, new_state, new_views
from fusion.estimator.constants import Constants
from fusion.estimator.estimator import estimate_pairs
from fusion.estimator.smoother import new_trace, smooth_pairs
from fusion.estimator.views import relabel
from fusion.facing.model import new_facing_model, new_facing_state
from fusion.fused_frame import FusedFrame
from fusion.setup import FusionSetup


class DuplexFusion:
    """``duplex``; see :class:`fusion.setup.FuserSettings`.

    Args:
        setup: Calibration and settings.
        constants: Of the filter; the body's fitted ones where None.
    """

    kernel: Any = estimate_pairs
    """The kernel that takes longest to compile."""

    def __init__(self, setup: FusionSetup, constants: Constants | None = None) -> None:
        body = setup.body
        self._constants = constants
        self._facing_model, self._facing = new_facing_model(body), new_facing_state(body)
        joints = len(body)
        self._state, self._views, self._solve = new_state(joints), new_views(joints), new_solve(joints)
        self._no_trace = new_trace(0, joints)
        self._calibrate(setup)

    def compile(self, positions: NDArray[np.float32], states: NDArray[np.uint8]) -> None:
        """Compiles a large part of the code that does not call the solver."""
        del positions, states
        given = self._model, self._facing_model, self._facing, self._views, 0.0, 0, 0
        relabel.compile(tuple(map(typeof, given)))  # type: ignore[attr-defined]

    def recalibrate(self, setup: FusionSetup) -> None:
        """Continues with another calibration without a jump of S*.

        A change of R and t moves S_B. B's offsets absorb the change at the last position of each joint in B,
        and decay afterwards. The usual offsets stay and adapt over time: it is not known whether they were
        learned under the same error or before a sensor was moved.
        """
        before = self._setup.calibration.a_from_b
        last = self._state.last_positions[1].astype(np.float64)
        moved = setup.calibration.a_from_b.apply(last) - before.apply(last)
        seen = np.isfinite(moved).all(axis=1)
        self._state.offsets[1][seen] += moved[seen]
        self._calibrate(setup)

    def _calibrate(self, setup: FusionSetup) -> None:
        self._setup = setup
        a_from_b = setup.calibration.a_from_b
        self._model = new_model(
            setup.body,
            setup.calibration.bone_lengths,
            a_from_b.rotation,
            a_from_b.translation,
            setup.settings.smoothing,
            self._constants,
        )

    def run(
        self,
        time_ns: NDArray[np.int64],
        skew_ns: NDArray[np.int64],
        codes: NDArray[np.int64],
        witnesses: tuple[NDArray[np.float32], NDArray[np.float32]],
        *views: NDArray[Any],
        smooth: bool = False,
    ) -> list[FusedFrame]:
        """Fuses the next pairs.

        Args:
            time_ns, skew_ns, codes, witnesses, views: As
                :func:`fusion.estimator.estimator.estimate_pairs` takes them.
            smooth: Whether these pairs are a whole recording, to be smoothed over all of it.
        """
        a, states_a, b, states_b = views
        joints = states_a.shape[1]
        output = new_output(len(time_ns), joints)
        trace = new_trace(len(time_ns), joints) if smooth else self._no_trace
        estimate_pairs(
            self._model, self._facing_model, self._state, self._facing, self._views, self._solve, output,
            trace, time_ns, skew_ns, codes, a, states_a, witnesses[0], b, states_b, witnesses[1],
        )  # fmt: skip
        if smooth:
            smooth_pairs(self._model, self._solve, trace, output)
        return [self._fused(output, k, int(time)) for k, time in enumerate(time_ns)]

    def _fused(self, output: Output, k: int, time_ns: int) -> FusedFrame:
        iterations, stale_a, stale_b = output.counts[k].tolist()
        return FusedFrame(
            positions=output.positions[k],
            predicted=output.predicted[k],
            weights_a=output.weights_a[k],
            weights_b=output.weights_b[k],
            misleading=output.misleading[k],
            a_from_b=self._setup.calibration.a_from_b,
            iterations=iterations,
            stale_a=bool(stale_a),
            stale_b=bool(stale_b),
            time_ns=time_ns,
            sigma=output.sigma[k],
            covariance=output.covariance[k],
            exchanged_a=int(output.codes[k, 0]),
            exchanged_b=int(output.codes[k, 1]),
            doubt_a=float(output.side_doubt[k, 0]),
            doubt_b=float(output.side_doubt[k, 1]),
        )
