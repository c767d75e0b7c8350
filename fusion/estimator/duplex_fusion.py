"""The method ``duplex``: owns the estimator's arrays and returns its results as fused frames."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import typeof

from fusion.body import KINECT_V2
from fusion.calibration.calibration import Calibration, nominal_calibration
from fusion.compiling.kernels import compiles
from fusion.compiling.references import by_reference
from fusion.estimator.arrays import Filter, LastSkeletons, Model, Output, Solve, State, Views, new_model
from fusion.estimator.bones import joint_covariances, solve_bones
from fusion.estimator.constants import Constants
from fusion.estimator.covariance import find_covers
from fusion.estimator.estimator import estimate_pairs
from fusion.estimator.kalman import start_joints, update_common_error
from fusion.estimator.measurements.displacement import remove_displacements
from fusion.estimator.measurements.evidence import measure_surface
from fusion.estimator.measurements.offsets import update_offsets
from fusion.estimator.measurements.outliers import outlier_probabilities, store_outlier_state
from fusion.estimator.measurements.views import relabel
from fusion.estimator.process import inflate_where_astray
from fusion.estimator.smoother import Trace, smooth_pairs
from fusion.facing.exchange import exchange
from fusion.facing.labels import Labels
from fusion.facing.model import FacingState, new_facing_model
from fusion.fused_frame import FusedFrames
from fusion.pair_arrays import PairArrays, PairStacker
from fusion.registration.lasting_errors import COMMON_SD
from fusion.rigid import NOWHERE
from fusion.setup import FusionSetup
from fusion.skeleton import SkeletonPair, nearer
from fusion.support.array_fields import new_arrays
from fusion.support.read_only import read_only
from fusion.support.types import Array

_UNSTATED = 0.035, 0.05
"""Standard deviations where a calibration states none: radians, and metres at the person."""
_ANYWHERE = 1.0, 1.0
"""rad², m²: variances where nothing is known."""


class DuplexFusion:
    """``duplex``; see :class:`fusion.setup.FuserSettings`.

    Args:
        setup: Calibration and settings.
        constants: Of the filter; the body's fitted ones where None.
    """

    def __init__(self, setup: FusionSetup, constants: Constants | None = None) -> None:
        body = setup.body
        self._constants = constants
        joints = len(body)
        self._filter = Filter(
            model=self._model_of(setup),
            facing_model=new_facing_model(body),
            state=new_arrays(State, J=joints),
            last=new_arrays(LastSkeletons, J=joints),
            facing=new_arrays(FacingState, J=joints),
            views=new_arrays(Views, J=joints),
            solve=new_arrays(Solve, J=joints),
        )
        self._setup = setup
        self._no_trace = by_reference(new_arrays(Trace, T=0, J=joints))
        self._reference = by_reference(self._filter)

    def recalibrate(self, setup: FusionSetup) -> None:
        """Continues with another calibration without a jump of S*.

        A change of R and t moves S_B. B's offsets absorb the change at the last position of each joint in B,
        as it was labelled, and decay within a second afterwards. Until then S* lags behind by B's share of
        the change, and its covariance has the square of that. Displacements become offsets if the new
        calibration explains them. The usual offsets stay and adapt over time: it is not known whether they
        were learned under the same error or before a sensor was moved.
        """
        before, of = self._setup.calibration.a_from_b, self._filter
        reported, states = of.last.positions[1].astype(np.float64), of.last.states[1]
        last, unused = np.empty_like(reported), np.empty_like(states)
        exchange(by_reference(of.facing_model), reported, states, of.views.codes[1], last, unused)
        moved = setup.calibration.a_from_b.apply(last) - before.apply(last)
        seen = np.isfinite(moved).all(axis=1)
        own, of_b = of.state.displacements.copy()
        apart, explained = own - of_b, moved[seen].sum(axis=0) / max(seen.sum(), 1)
        if np.linalg.norm(apart - explained) < 0.5 * np.linalg.norm(apart):
            of.state.displacements[:] = 0.0
        else:
            own, of_b = np.zeros((2, 3))
        moved += of_b
        of.state.offsets[1][seen] += moved[seen]
        of.state.offsets[0][:] += own
        slow = np.trace(of.views.slow, axis1=2, axis2=3)
        share = np.where(of.views.states[0] != 0, slow[0] / np.maximum(slow.sum(axis=0), 1e-12), 1.0)
        of.state.lag[seen] += share[seen, None] * moved[seen] + (1.0 - share[seen, None]) * own
        of.state.recalibrated[0] = 0.0
        self._setup, self._filter = setup, self._filter._replace(model=self._model_of(setup))
        self._reference = by_reference(self._filter)

    def _model_of(self, setup: FusionSetup) -> Model:
        calibration = setup.calibration
        return new_model(
            setup.body,
            calibration.bone_lengths,
            calibration.a_from_b,
            setup.settings.smoothing,
            self._constants,
            _registration_variances(calibration),
            getattr(calibration.registration, "centre", NOWHERE),
        )

    def run(self, pairs: PairArrays, smooth: bool = False) -> FusedFrames:
        """Fuses the next pairs.

        Args:
            pairs: T pairs.
            smooth: Whether these pairs are a whole recording, to be smoothed over all of it.
        """
        frames, joints = pairs.a.shape[:2]
        if (errors := self._setup.calibration.depth_errors).any():
            pairs = _nearer(pairs, errors)
        output = new_arrays(Output, T=frames, J=joints)
        trace = by_reference(new_arrays(Trace, T=frames, J=joints)) if smooth else self._no_trace
        estimate_pairs(self._reference, trace, pairs, output)
        if smooth:
            smooth_pairs(self._reference, trace, output)
        return FusedFrames(output, self._setup.calibration.a_from_b, pairs.time_ns)


def _nearer(pairs: PairArrays, by: Array) -> PairArrays:
    """The pairs with all joints of A and of B nearer to their sensor by (2,) metres along the ray."""
    a, b = (read_only(nearer(at, metres)) for metres, at in zip(by.tolist(), (pairs.a, pairs.b), strict=True))
    gap_a, gap_b = (np.float32(metres) * (np.arange(4) == 0) for metres in by)
    return pairs._replace(a=a, b=b, witness_a=pairs.witness_a + gap_a, witness_b=pairs.witness_b + gap_b)


def _registration_variances(calibration: Calibration) -> tuple[float, float]:
    """Variances of R, rad², and of R q + t at the person, m², beyond the trackers' lasting errors, which the
    estimator knows. Without data, B may stand anywhere.
    """
    registration = calibration.registration
    if registration is None and calibration.provisional:
        return _ANYWHERE
    stated = getattr(registration, "rotation_sd", math.nan), getattr(registration, "translation_sd", math.nan)
    turn, shift = (sd if math.isfinite(sd) else usual for sd, usual in zip(stated, _UNSTATED, strict=True))
    return turn**2, max(shift**2 - COMMON_SD**2, 0.0)


@compiles(estimate_pairs)
def compile_estimator() -> None:
    """Compiles everything but the smoother; all bodies have its types."""
    _fuse_nobody(smooth=False)


@compiles(smooth_pairs)
def compile_smoother() -> None:
    """Compiles the smoother, too."""
    _fuse_nobody(smooth=True)


def _fuse_nobody(smooth: bool) -> None:
    nobody = PairStacker(KINECT_V2).of_pair(SkeletonPair(None, None, 0))
    DuplexFusion(FusionSetup(nominal_calibration(KINECT_V2))).run(nobody, smooth)


@compiles(relabel)
def compile_steps() -> None:
    """Compiles large steps of :func:`fusion.estimator.estimator.estimate_pairs`; all bodies have their types.

    The first one is needed early; the others are in reverse order, because the process that compiles
    everything begins with the first.
    """
    fusion = DuplexFusion(FusionSetup(nominal_calibration(KINECT_V2)))
    model, facing_model, state, _, facing, views, solve = map(by_reference, fusion._filter)
    k, dt = 0, 0.0
    output, labels = new_arrays(Output, T=1, J=len(KINECT_V2)), Labels.unknown(1)
    steps: list[tuple[Any, ...]] = [
        (relabel, model, facing_model, facing, views, labels, k, dt),
        (joint_covariances, model, solve, output.covariance[k], output.sigma[k]),
        (solve_bones, model, state, solve),
        (store_outlier_state, model, state, views, dt),
        (start_joints, model, state, views, solve),
        (update_common_error, model, state, views, solve, dt),
        (update_offsets, model, state, views, solve),
        (inflate_where_astray, model, state, views, fusion._no_trace, k, dt),
        (outlier_probabilities, model, state, views, dt),
        (measure_surface, model, views, solve),
        (find_covers, model, views),
        (remove_displacements, model, state, views, dt),
    ]
    for step, *given in steps:
        step.compile(tuple(map(typeof, given)))
