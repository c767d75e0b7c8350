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

from fusion.body import Body
from fusion.calibration.bone_lengths import robust_bone_lengths
from fusion.calibration.calibration import (
    MOVEMENT_GAIN,
    MOVEMENT_SAME,
    MOVEMENT_SHIFT,
    MOVEMENT_TURN,
    POSE_TURN,
    USABLE_TURN_DEG,
    VIEWS_APART,
    Calibration,
    calibrate,
    nominal_calibration,
)
from fusion.calibration.start_up_pose import StartUpPose
from fusion.errors import CalibrationError
from fusion.registration.error_model import RobustFitSettings
from fusion.registration.keyframes import Evidence, KeyframeSet, evidence_of
from fusion.registration.lasting_errors import FrontalTurn, common_variance
from fusion.registration.rigid_fit import label_free_fit
from fusion.registration.robust_fit import Found, RobustFit, fits_from, registration_of, with_frontal_sd
from fusion.rigid import RigidTransform
from fusion.skeleton import SkeletonPair
from fusion.support.types import Array

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
        if not (agree and _certain(self._body, fit, evidence)):
            return None
        try:
            return with_frontal_sd(self._body, evidence, fit, self._settings), evidence
        except CalibrationError:
            return None

    def _best(self, provisional: RigidTransform) -> Generator[None, None, tuple[RobustFit, Evidence] | None]:
        """Returns the best fit, None if another solution is nearly as good; yields after each fit."""
        evidence = self._frames.evidence.copy()
        starts = [provisional if self._last is None else self._last]
        free = label_free_fit(self._body, evidence)
        starts += [] if free is None else [free]
        fits: list[Found] = []
        for found in fits_from(self._body, evidence, starts, self._settings):
            fits.append(found)
            yield
        if not fits:
            return None
        best = min(fits, key=lambda found: found.cost)
        others = [
            found.cost for found in fits if found.fit.a_from_b.angle_to(best.fit.a_from_b) > MOVEMENT_SAME
        ]
        if min(others, default=np.inf) <= best.cost + MOVEMENT_GAIN:
            return None
        return best.fit, best.evidence


def _certain(body: Body, fit: RobustFit, evidence: Evidence) -> bool:
    lasting = common_variance(fit.a_from_b, fit.centre)
    apart = np.linalg.norm(evidence.a - fit.a_from_b.apply(evidence.b), axis=2)[evidence.weights > 0.5]
    return bool(
        fit.rotation_sd < MOVEMENT_TURN
        and fit.translation_sd**2 < MOVEMENT_SHIFT**2 + lasting
        and len(apart) > 0
        and np.median(apart) < VIEWS_APART[body.name]
    )


class Calibrator:
    """Calibrates while pairs arrive: provisionally at once, finally from the start-up pose or from movement.

    Args:
        calibration: An earlier calibration to keep.
        frontal: Whether a pose's R is corrected because trackers show a standing person too frontal; see
            :func:`fusion.registration.rigid_fit.register`. The paper's methods do not correct it.
    """

    def __init__(self, body: Body, calibration: Calibration | None = None, *, frontal: bool = True) -> None:
        self._body, self._frontal = body, frontal
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
        """Takes the next pair; returns the new calibration if the pair completes one, else None.

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
                how = f"start-up pose, {len(held)} frames"
                return calibrate(self._body, held, how, frontal=self._frontal)
            if partly is not None and self._pose.held == 0.0:
                how = f"start-up pose seen in part, {len(partly)} frames"
                found = calibrate(self._body, partly, how, frontal=self._frontal)
                known, angle = found.registration, found.axes_angle
                lasting = FrontalTurn.of(self._body).sd_where(
                    np.sin(angle), np.cos(angle), known=self._frontal
                )
                most = min(np.hypot(POSE_TURN, lasting), np.radians(USABLE_TURN_DEG))
                apart = VIEWS_APART[self._body.name]
                if known is not None and known.rotation_sd < most and known.residual_median < apart:
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
        lengths = self._bone_lengths(evidence, fit.a_from_b, self.calibration.bone_lengths)
        how = f"movement, {len(evidence.a)} keyframes"
        registration = registration_of(self._body, evidence, fit)
        return Calibration(self._body, fit.a_from_b, lengths, how, registration)

    def _bone_lengths(self, evidence: Evidence, a_from_b: RigidTransform, otherwise: Array) -> Array:
        try:
            return robust_bone_lengths(self._body, evidence, a_from_b, self._body.nominal_lengths)
        except CalibrationError:
            return otherwise

    def _try(self, pairs: list[SkeletonPair], how: str) -> Calibration | None:
        try:
            found = replace(calibrate(self._body, pairs, how, frontal=self._frontal), provisional=True)
        except CalibrationError:
            return None
        if self._frontal:  # where R is wrong or sides are exchanged, eq. (13) has short limbs
            usual = self._body.nominal_lengths
            bones = self._body.bone_joints
            usual = usual * np.median(found.bone_lengths[bones] / usual[bones])
            evidence = evidence_of(self._body, pairs)
            found = replace(found, bone_lengths=self._bone_lengths(evidence, found.a_from_b, usual))
        self.calibration = found
        return found
