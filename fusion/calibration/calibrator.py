"""Calibration while pairs come in.

There are three ways, in this order: the start-up pose seen whole by both sensors; the pose seen in part,
where that determines R well enough; and movement, where the pose is never held or never seen.

Movement: far-apart sensors each see one side of the person, so that few joints are tracked by both at once.
Over some seconds of movement all of them are. R and t then follow by the robust fit of the registration. A
tracker that takes a back for a front gives a second, wrong solution, turned by half a circle about the
person, in which the sides of the limbs are exchanged. Both are tried, and the better one must be better by
far.
"""

from collections.abc import Generator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fusion.body import Body
from fusion.calibration.bone_lengths import robust_bone_lengths
from fusion.calibration.calibration import (
    MOVEMENT_APART,
    MOVEMENT_GAIN,
    MOVEMENT_SAME,
    MOVEMENT_SHIFT,
    MOVEMENT_TURN,
    POSE_APART,
    POSE_TURN,
    Calibration,
    calibrate,
    nominal_calibration,
)
from fusion.calibration.start_up_pose import StartUpPose
from fusion.errors import CalibrationError
from fusion.registration.error_model import RobustFitSettings, disagreement
from fusion.registration.keyframes import Evidence, KeyframeSet, match_sides
from fusion.registration.rigid_fit import label_free_fit
from fusion.registration.robust_fit import RobustFit, fit_robust, registration_of
from fusion.rigid import RigidTransform
from fusion.skeleton import SkeletonPair

_EVERY_NS = 1_000_000_000
_FEWEST, _MOST = 16, 64  # keyframes; as for a refinement, and enough for a first fit
_PROVISIONAL_PAIRS = 30


class GradualCalibration:
    """Collects keyframes until they determine R and t."""

    def __init__(self, body: Body) -> None:
        self._body, self._settings = body, RobustFitSettings()
        self._frames = KeyframeSet(body, _MOST)
        self._next_ns: int | None = None
        self._before: RobustFit | None = None
        self._last: RigidTransform | None = None
        self._fitting: Generator[None, None, tuple[RobustFit, Evidence] | None] | None = None

    def watch(self, pair: SkeletonPair, provisional: RigidTransform) -> tuple[RobustFit, Evidence] | None:
        """Takes the next pair. It computes one fit at most: all of them take longer than a frame.

        Args:
            provisional: R and t in force; they may be wrong.

        Returns:
            The fit and its evidence once two fits in a row, a second apart, agree and are certain; else None.
        """
        self._frames.add(pair)
        self._next_ns = pair.time_ns if self._next_ns is None else self._next_ns
        if self._fitting is None:
            if pair.time_ns < self._next_ns or len(self._frames) < _FEWEST:
                return None
            self._next_ns = pair.time_ns + _EVERY_NS
            self._fitting = self._best(provisional)
        try:
            next(self._fitting)
        except StopIteration as end:
            self._fitting = None
            return self._accepted(end.value)
        return None

    def _accepted(self, found: tuple[RobustFit, Evidence] | None) -> tuple[RobustFit, Evidence] | None:
        """The fit, if it is certain and the one before agrees with it; else None."""
        before, self._before = self._before, None
        if found is None:
            return None
        fit, evidence = found
        self._before, self._last = fit, fit.a_from_b
        agree = before is not None and before.a_from_b.angle_to(fit.a_from_b) < MOVEMENT_SAME
        return found if agree and _certain(fit, evidence) else None

    def _best(self, provisional: RigidTransform) -> Generator[None, None, tuple[RobustFit, Evidence] | None]:
        """Returns the best fit, None if another solution is nearly as good; yields after each fit."""
        evidence = self._frames.evidence.copy()
        starts = [provisional if self._last is None else self._last]
        free = label_free_fit(self._body, evidence)
        starts += [] if free is None else [free]
        fits: list[tuple[float, RobustFit, Evidence]] = []
        for start in starts:
            for one in (start, _turned(start, evidence)):
                copy = evidence.copy()
                match_sides(self._body, copy, one)
                try:
                    fit = fit_robust(self._body, copy, one, self._settings, iterations=6, noise_sd=0.03)
                    match_sides(self._body, copy, fit.a_from_b)
                    fit = fit_robust(
                        self._body, copy, fit.a_from_b, self._settings,
                        iterations=4, noise_sd=fit.noise_sd, biases=fit.biases,
                    )  # fmt: skip
                except CalibrationError:
                    continue
                cost = disagreement(self._body, copy, fit.a_from_b, self._settings, 0.03)
                fits.append((cost, fit, copy))
                yield
        if not fits:
            return None
        cost, best, shown = min(fits, key=lambda item: item[0])
        others = [c for c, fit, _ in fits if fit.a_from_b.angle_to(best.a_from_b) > MOVEMENT_SAME]
        return (best, shown) if min(others, default=np.inf) > cost + MOVEMENT_GAIN else None


def _certain(fit: RobustFit, evidence: Evidence) -> bool:
    sure = evidence.weights > 0.5
    apart = np.linalg.norm((evidence.a - fit.a_from_b.apply(evidence.b))[sure], axis=1)
    return bool(
        fit.rotation_sd < MOVEMENT_TURN
        and fit.translation_sd < MOVEMENT_SHIFT
        and len(apart) > 0
        and np.median(apart) < MOVEMENT_APART
    )


def _turned(a_from_b: RigidTransform, evidence: Evidence) -> RigidTransform:
    """The transform followed by half a turn about A's y axis through the person.

    The axis is vertical only where sensor A is not tilted. The result is the start of a fit.
    """
    centre: NDArray[np.float64] = evidence.a[evidence.weights > 0.5].mean(axis=0)
    half = Rotation.from_euler("y", 180.0, degrees=True).as_matrix()
    return RigidTransform.of(half, centre - half @ centre) @ a_from_b


class Calibrator:
    """Finds a calibration while pairs come in: a provisional one at once, the final one on pose or movement.

    Args:
        calibration: An earlier calibration, which is then kept.
    """

    def __init__(self, body: Body, calibration: Calibration | None = None) -> None:
        self._body = body
        self._pose, self._partly = StartUpPose(body), StartUpPose(body, partly=True)
        self._gradual = GradualCalibration(body)
        self._seen: list[SkeletonPair] = []
        self._final = calibration is not None
        self.calibration = calibration or nominal_calibration(body)

    @property
    def final(self) -> bool:
        """Whether the calibration is final."""
        return self._final

    @property
    def held(self) -> float:
        """Seconds for which the start-up pose has been held."""
        return self._pose.held

    def watch(self, pair: SkeletonPair) -> Calibration | None:
        """The new calibration where the next pair completes one, else None.

        Raises:
            BodyError: A skeleton is of another body.
        """
        pair.require(self._body)
        if self._final or pair.a is None or pair.b is None:
            return None
        found = self._from_pose(pair) or self._from_movement(pair)
        if found is not None:
            self._final, self.calibration = True, found
            return found
        if len(self._seen) < _PROVISIONAL_PAIRS:
            self._seen.append(pair)
            if len(self._seen) in (1, _PROVISIONAL_PAIRS):
                frames = "frame" if len(self._seen) == 1 else "frames"
                return self._try(self._seen, f"provisional, {len(self._seen)} {frames} of any pose")
        return None

    def _from_pose(self, pair: SkeletonPair) -> Calibration | None:
        """The calibration of a start-up pose that ends with this pair."""
        held, partly = self._pose.watch(pair), self._partly.watch(pair)
        try:
            if held is not None:
                return calibrate(self._body, held, f"start-up pose, {len(held)} frames")
            if partly is not None and self._pose.held == 0.0:
                found = calibrate(self._body, partly, f"start-up pose seen in part, {len(partly)} frames")
                known = found.registration
                if known is not None and known.rotation_sd < POSE_TURN and known.residual_median < POSE_APART:
                    return found
        except CalibrationError:
            pass
        return None

    def _from_movement(self, pair: SkeletonPair) -> Calibration | None:
        """The calibration of the movement so far, once it is certain."""
        fitted = self._gradual.watch(pair, self.calibration.a_from_b)
        if fitted is None:
            return None
        fit, evidence = fitted
        nominal = self._body.nominal_lengths
        try:
            lengths = robust_bone_lengths(self._body, evidence, fit.a_from_b, nominal)
        except CalibrationError:
            lengths = self.calibration.bone_lengths
        how = f"movement, {len(evidence.a)} keyframes"
        registration = registration_of(self._body, evidence, fit)
        return Calibration(self._body, fit.a_from_b, lengths, how, registration)

    def _try(self, pairs: list[SkeletonPair], how: str) -> Calibration | None:
        try:
            self.calibration = replace(calibrate(self._body, pairs, how), provisional=True)
        except CalibrationError:
            return None
        return self.calibration
