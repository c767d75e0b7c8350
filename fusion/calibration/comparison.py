"""Compares a calibration with the placement of the sensors that the last seconds show."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from fusion.body import Body
from fusion.calibration.calibration import Calibration
from fusion.calibration.surface_fit import without_depth_errors
from fusion.errors import CalibrationError
from fusion.registration.error_model import RobustFitSettings
from fusion.registration.keyframes import KeyframeSet
from fusion.registration.rigid_fit import fit_rigid
from fusion.registration.robust_fit import RobustFit, fit_robust, with_frontal_sd
from fusion.rigid import RigidTransform
from fusion.skeleton import SkeletonPair
from fusion.support.types import Array

_FEWEST, _MOST = 8, 48  # keyframes, 0.2 s apart
_EVERY_NS = 1_000_000_000  # between two fits
_KEPT = 3  # fits, of which the median counts: one in twenty of a walk before Kinects v2 is off by 3°


class PlacementOff(NamedTuple):
    """How far B's own placement is from a calibration."""

    turn: float
    """Radians between the rotations."""
    shift: float
    """Metres between the places in which both put the person."""
    turn_sd: float
    """Radians, the standard deviation of this rotation, with the trackers' turn of the person."""


class RecentPlacement:
    """Registers the views of the last seconds by themselves, at most once a second.

    Args:
        seconds: How long a pair counts.
        in_steps: Whether a fit is computed in two steps, one with each call of :meth:`off`, as a live loop
            needs it.
    """

    def __init__(self, body: Body, seconds: float = 6.0, *, in_steps: bool = False) -> None:
        self._body, self._kept_ns = body, round(seconds * 1e9)
        self._keyframes, self._settings = KeyframeSet(body, _MOST), RobustFitSettings()
        self._fits: deque[tuple[RigidTransform, np.ndarray, float]] = deque(maxlen=_KEPT)
        self.newest: RobustFit | None = None  # None before there are enough pairs
        self._now_ns = self._next_ns = 0
        self._in_steps = in_steps
        self._fitting: Iterator[None] = iter(())

    def add(self, pair: SkeletonPair, codes: tuple[int, int] = (0, 0)) -> None:
        """Takes a pair.

        Args:
            codes: Which sides of the views are exchanged; see :class:`fusion.fused_frame.FusedFrame`.
        """
        if self._keyframes.add(pair, codes):
            self._keyframes.forget_before(pair.time_ns - self._kept_ns)
        self._now_ns = pair.time_ns

    def off(self, calibration: Calibration) -> PlacementOff | None:
        """How far R and t of a calibration are off, by the median of the last fits; None of few pairs."""
        if len(self._keyframes) < _FEWEST:
            self._fits.clear()
            self.newest = None
        elif self._now_ns >= self._next_ns:
            self._next_ns = self._now_ns + _EVERY_NS
            self._fitting = self._fit(calibration.depth_errors)
        for _ in self._fitting:
            if self._in_steps:
                break
        if not self._fits:
            return None
        a_from_b = calibration.a_from_b
        each = [
            (fit.angle_to(a_from_b), float(np.linalg.norm(fit.apply(middle) - a_from_b.apply(middle))), sd)
            for fit, middle, sd in self._fits
        ]
        return PlacementOff(*np.median(each, axis=0).tolist())

    def _fit(self, depth_errors: Array) -> Iterator[None]:
        evidence, body = without_depth_errors(self._keyframes.evidence, depth_errors).copy(), self._body
        known = evidence.weights == 1.0
        try:
            start = fit_rigid(evidence.a[known], evidence.b[known])
            fit = fit_robust(body, evidence, start, self._settings)
            yield
            fit = with_frontal_sd(body, evidence, fit, self._settings)
        except CalibrationError:
            return
        self.newest = fit
        self._fits.append((fit.a_from_b, evidence.b[evidence.weights > 0.0].mean(axis=0), fit.rotation_sd))
