"""Refinement of a calibration while pairs come in: R, t and bone lengths, with events."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from fusion.body import Body
from fusion.calibration.bone_statistics import robust_bone_lengths
from fusion.calibration.calibration import Calibration
from fusion.errors import CalibrationError
from fusion.registration.clock_offset import ClockOffset, ClockOffsetEstimator
from fusion.registration.keyframes import Evidence, evidence_of, match_sides
from fusion.registration.knocked import KnockDetector, KnockSettings, SensorState
from fusion.registration.refinement import Refinement, RefinementSettings
from fusion.registration.rigid_fit import Registration
from fusion.registration.robust_fit import Prior, RobustFit, RobustFitSettings, disagreement, fit_robust
from fusion.rigid import RigidTransform
from fusion.skeleton import SkeletonPair

Kind = Literal["refined", "knocked", "followed", "bones", "clock"]

_BONES_AT_NS = (10_000_000_000, 30_000_000_000, 60_000_000_000)
"""When bone lengths are learned, counted from the first pair; after the last they are fixed."""
_BONE_CHANGE = 0.002  # metres; if no bone changes by more, the lengths are kept
_FEWEST_BONE_KEYFRAMES = 24
_RECENT = 60  # pairs kept for registering anew after a knock
_UNKNOWN_TURN, _LEAST_TURN, _UNKNOWN_SHIFT = 0.035, 0.01, 0.05  # radians, radians, metres at the person
_KNOCK_TURN, _KNOCK_SHIFT = np.radians(8.0), 0.4  # standard deviations of a knock; metres at the person


@dataclass(frozen=True)
class LearnerSettings:
    """Which quantities are learned, and how.

    Attributes:
        refine: Whether R and t are refined.
        follow: Whether a knocked sensor is registered anew.
        bones: Whether bone lengths are learned.
        clock: Whether the offset of the sensors' clocks is estimated.
        refinement: Of R and t.
        knock: When a sensor counts as knocked.
    """

    refine: bool = True
    follow: bool = True
    bones: bool = True
    clock: bool = True
    refinement: RefinementSettings = field(default_factory=RefinementSettings)
    knock: KnockSettings = field(default_factory=KnockSettings)


@dataclass(frozen=True, eq=False)
class CalibrationChange:
    """A change of the calibration, or an event that concerns it.

    Attributes:
        kind: ``refined``: R and t improved. ``knocked``: a sensor seems to have moved; the calibration is the
            old one. ``followed``: registered anew after that. ``bones``: new bone lengths. ``clock``: the
            clocks' offset is known; the calibration is unchanged.
        event: A sentence for the event log.
        time_ns: Time of the pair that caused it.
        calibration: In force from the next pair on.
        since_ns: For ``knocked`` and ``followed``, when the views moved apart.
        clock: For ``clock``, the offset.
    """

    kind: Kind
    event: str
    time_ns: int
    calibration: Calibration
    since_ns: int | None = None
    clock: ClockOffset | None = None


class CalibrationLearner:
    """Learns from each pair; deterministic, with bounded memory.

    Args:
        body: Of both views.
        calibration: In force at the start; approximately right.
        settings: Which quantities are learned.

    Attributes:
        calibration: In force.
    """

    def __init__(self, body: Body, calibration: Calibration, settings: LearnerSettings | None = None) -> None:
        self._body, self._settings = body, settings or LearnerSettings()
        self.calibration = calibration
        self._refinement = Refinement(
            body, calibration.a_from_b, self._settings.refinement, prior=prior_of(calibration)
        )
        self._knock = KnockDetector(body, calibration.a_from_b, self._settings.knock)
        self._clock = ClockOffsetEstimator(body)
        self._recent: deque[tuple[SkeletonPair, tuple[int, int]]] = deque(maxlen=_RECENT)
        self._knocked = False
        self._first_ns: int | None = None
        self._bones_learned = 0

    def adopt(self, calibration: Calibration) -> None:
        """Puts another calibration in force and keeps the evidence."""
        self.calibration = calibration
        self._refinement.adopt(calibration.a_from_b, prior_of(calibration))
        self._knock.adopt(calibration.a_from_b)
        self._knocked = False

    def observe(
        self,
        pair: SkeletonPair,
        codes: tuple[int, int] = (0, 0),
        stale: tuple[bool, bool] = (False, False),
        skew_ns: int = 0,
    ) -> list[CalibrationChange]:
        """Takes the next pair.

        Args:
            pair: As the sensors reported it.
            codes: Exchange codes of A and of B: bit 0 the arms, bit 1 the legs.
            stale: Whether A and B repeat their last skeletons.
            skew_ns: Capture time of B minus that of A by the time stamps.

        Returns:
            The changes, in order; usually none.
        """
        if pair.a is None or pair.b is None or any(stale):
            return []
        self._first_ns = pair.time_ns if self._first_ns is None else self._first_ns
        self._recent.append((pair, codes))
        changes: list[CalibrationChange] = []
        state = self._knock.observe(pair) if self._settings.follow else SensorState.STEADY
        if state is SensorState.STEADY:
            self._knocked = False
            if self._settings.refine:
                changes += self._refine(pair, codes)
        else:
            self._refinement.keyframes.add(pair, codes)
            if not self._knocked:
                self._knocked = True
                changes.append(self._notice(pair.time_ns))
            if state is SensorState.SETTLED:
                changes += self._follow(pair.time_ns)
        if self._settings.bones and not self._knocked:
            changes += self._learn_bones(pair.time_ns)
        if self._settings.clock and not self._knocked:
            clock = self._clock.observe(pair, self.calibration.a_from_b, skew_ns)
            if clock is not None:
                changes.append(
                    CalibrationChange("clock", clock.event, pair.time_ns, self.calibration, clock=clock)
                )
        return changes

    def _refine(self, pair: SkeletonPair, codes: tuple[int, int]) -> list[CalibrationChange]:
        fit = self._refinement.observe(pair, codes)
        if fit is None:
            return []
        old = self.calibration.a_from_b
        self._knock.refine(fit.a_from_b, fit.centre)
        evidence = self._refinement.keyframes.evidence
        self._replace(fit, evidence, f"refined on {len(evidence.a)} keyframes")
        turn, shift = _difference(old, fit)
        event = (
            f"Registration refined: the view of B turns by {np.degrees(turn):.2f}°, and moves by "
            f"{shift * 1e3:.0f} mm where the person stands; now certain to "
            f"{np.degrees(fit.rotation_sd):.2f}° and {fit.translation_sd * 1e3:.0f} mm."
        )
        return [CalibrationChange("refined", event, pair.time_ns, self.calibration)]

    def _notice(self, now_ns: int) -> CalibrationChange:
        event = (
            f"A sensor seems to have been moved: the two views parted by {self._knock.offset * 1e3:.0f} mm. "
            "Registration follows once it is still."
        )
        return CalibrationChange("knocked", event, now_ns, self.calibration, self._knock.since_ns)

    def _follow(self, now_ns: int) -> list[CalibrationChange]:
        """Registers again on the pairs since the sensor is still, if the views then agree better."""
        since_ns, old = self._knock.since_ns, self.calibration.a_from_b
        if since_ns is None:
            return []
        still_ns = now_ns - self._settings.knock.settled_ns
        still = [(pair, codes) for pair, codes in self._recent if pair.time_ns >= still_ns]
        evidence = evidence_of(self._body, [pair for pair, _ in still], [codes for _, codes in still])
        fit = register_anew(self._body, evidence, old, self._settings.refinement.fit)
        if fit is None:
            return []
        self._refinement.restart(fit.a_from_b, keep_from_ns=still_ns)
        self._knock.adopt(fit.a_from_b)
        self._knocked = False
        self._replace(fit, evidence, f"registered anew on {len(evidence.a)} frames after a sensor moved")
        turn, shift = _difference(old, fit)
        event = (
            f"Registration follows the sensor that was moved: the view of B turns by "
            f"{np.degrees(turn):.1f}°, and moves by {shift * 1e3:.0f} mm where the person stands."
        )
        return [CalibrationChange("followed", event, now_ns, self.calibration, since_ns)]

    def _learn_bones(self, now_ns: int) -> list[CalibrationChange]:
        if self._bones_learned == len(_BONES_AT_NS) or self._first_ns is None:
            return []
        if now_ns - self._first_ns < _BONES_AT_NS[self._bones_learned]:
            return []
        self._bones_learned += 1
        evidence = self._refinement.keyframes.evidence
        if len(evidence.a) < _FEWEST_BONE_KEYFRAMES:
            return []
        old = self.calibration.bone_lengths
        try:
            lengths = robust_bone_lengths(self._body, evidence, self.calibration.a_from_b, old)
        except CalibrationError:
            return []
        changed = int(np.argmax(np.abs(lengths - old)))
        if abs(lengths[changed] - old[changed]) < _BONE_CHANGE:
            return []
        self.calibration = replace(self.calibration, bone_lengths=lengths)
        mean = float(np.mean(np.abs(lengths - old)[self._body.bone_joints]))
        event = (
            f"Bone lengths learned from {len(evidence.a)} keyframes: mean change {mean * 1e3:.1f} mm, most "
            f"{self._body.bones[changed]}, {old[changed] * 1e3:.0f} to {lengths[changed] * 1e3:.0f} mm"
            f"{'; fixed from now on' if self._bones_learned == len(_BONES_AT_NS) else ''}."
        )
        return [CalibrationChange("bones", event, now_ns, self.calibration)]

    def _replace(self, fit: RobustFit, evidence: Evidence, how: str) -> None:
        self.calibration = replace(
            self.calibration,
            a_from_b=fit.a_from_b,
            how=how,
            registration=registration_of(self._body, evidence, fit),
        )


def prior_of(calibration: Calibration) -> Prior:
    """The prior of R and t from a calibration, with a lower limit of its standard deviation."""
    registration = calibration.registration
    rotation_sd = _UNKNOWN_TURN if registration is None else registration.rotation_sd
    return Prior(calibration.a_from_b, max(rotation_sd, _LEAST_TURN), _UNKNOWN_SHIFT)


def register_anew(
    body: Body, evidence: Evidence, old: RigidTransform, settings: RobustFitSettings
) -> RobustFit | None:
    """The transform after a knock, near the old one; None if it explains the evidence no better."""
    prior = Prior(old, float(_KNOCK_TURN), _KNOCK_SHIFT)
    try:
        fit = fit_robust(body, evidence, old, settings, iterations=6, noise_sd=0.05, prior=prior)
        match_sides(body, evidence, fit.a_from_b)
        fit = fit_robust(body, evidence, fit.a_from_b, settings, iterations=6, prior=prior)
    except CalibrationError:
        return None
    gain = disagreement(body, evidence, old, settings, fit.noise_sd) - disagreement(
        body, evidence, fit.a_from_b, settings, fit.noise_sd
    )
    apart = [float(np.median(_residuals(evidence, transform))) for transform in (old, fit.a_from_b)]
    return fit if gain > 0.0 and apart[1] < 0.8 * apart[0] else None


def registration_of(body: Body, evidence: Evidence, fit: RobustFit) -> Registration:
    """Converts a fit, with its residuals, to a ``Registration``."""
    sure = evidence.weights > 0.5
    distance = np.where(sure, np.linalg.norm(evidence.a - fit.a_from_b.apply(evidence.b), axis=2), np.nan)
    joints = np.full(len(body), np.nan)
    for joint in np.flatnonzero(sure.any(axis=0)):
        joints[joint] = np.nanmedian(distance[:, joint])
    known = distance[sure]
    return Registration(
        a_from_b=fit.a_from_b,
        residual_median=float(np.median(known)),
        residual_rms=float(np.sqrt(np.mean(known**2))),
        joint_residuals=joints,
        rotation_sd=fit.rotation_sd,
        frames=len(evidence.a),
        body=body,
        translation_sd=fit.translation_sd,
    )


def _residuals(evidence: Evidence, a_from_b: RigidTransform) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    sure = evidence.weights > 0.5
    return np.asarray(np.linalg.norm(evidence.a[sure] - a_from_b.apply(evidence.b[sure]), axis=1))


def _difference(old: RigidTransform, fit: RobustFit) -> tuple[float, float]:
    """Radians, and metres at the person's centre."""
    shift = fit.centre - old.apply(fit.a_from_b.inverse().apply(fit.centre))
    return fit.a_from_b.angle_to(old), float(np.linalg.norm(shift))
