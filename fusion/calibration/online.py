"""Refinement of a calibration while pairs come in: R, t and bone lengths, with events."""

from collections import deque
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple

import numpy as np

from fusion.body import Body
from fusion.calibration.bone_lengths import robust_bone_lengths
from fusion.calibration.calibration import Calibration
from fusion.calibration.person_size import AWAY_NS, PersonSize, sizes_of_pair
from fusion.clocks import Clock
from fusion.clocks.lag import LagEstimator
from fusion.errors import CalibrationError
from fusion.registration.keyframes import Evidence, evidence_of, match_sides
from fusion.registration.knock import KnockDetector, KnockFit, KnockSettings, fit_knock
from fusion.registration.refinement import Refinement, RefinementSettings
from fusion.registration.robust_fit import Prior, RobustFit, registration_of, with_frontal_sd
from fusion.rigid import RigidTransform
from fusion.skeleton import SkeletonPair
from fusion.support.types import Array

Kind = Literal["refined", "knocked", "bones", "person", "clock"]

_BONES_AT_NS = (10_000_000_000, 30_000_000_000, 60_000_000_000)
"""When a person's bone lengths are learned, in time with them; after the last they are fixed."""
_BONE_CHANGE = 0.002  # metres; if no bone changes by more, the lengths are kept
_FEWEST_BONE_KEYFRAMES = 24
_RECENT, _RECENT_NS = 60, 95_000_000
"""Pairs kept for judging a knock, and their distance: 6 s at 30 pairs per second."""
_UNKNOWN_TURN, _LEAST_TURN, _UNKNOWN_SHIFT = 0.035, 0.01, 0.05  # radians, radians, metres at the person
_FOLLOWED_TURN, _FOLLOWED_SHIFT = 0.1, 0.1  # the same after a knock


@dataclass(frozen=True)
class LearnerSettings:
    """Which quantities are learned, and how."""

    refine: bool = True  # whether R and t are refined
    follow: bool = True  # whether a knocked sensor is registered anew
    bones: bool = True
    """Whether bone lengths are learned of the person who was calibrated; they are of other people."""
    clock: bool = True  # whether the offset of the sensors' clocks is estimated
    refinement: RefinementSettings = field(default_factory=RefinementSettings)  # of R and t
    knock: KnockSettings = field(default_factory=KnockSettings)  # when a sensor counts as knocked

    def if_learned(self, learned: bool) -> "LearnerSettings":
        """These; or those of a calibration that is kept: only bones of people of another size are learned."""
        return self if learned else replace(self, refine=False, follow=False, bones=False, clock=False)


@dataclass(frozen=True, eq=False)
class CalibrationChange:
    """A change of the calibration, or an event that concerns it."""

    kind: Kind
    """``refined``: R and t improved. ``knocked``: a sensor was moved, and is registered anew. ``bones``: new
    bone lengths. ``person``: another person is there. ``clock``: the clocks' offset is known."""
    event: str  # a sentence for the event log
    time_ns: int  # time of the pair that caused it
    calibration: Calibration  # in force from the next pair on
    since_ns: int | None = None  # for ``knocked`` and ``person``, since when
    clock: Clock | None = None  # for ``clock``, the offset


class Known(NamedTuple):
    """What the joints say of R and t."""

    calibration: Calibration  # by the joints alone
    fit: RobustFit | None  # its fit; None of a calibration that comes from elsewhere
    evidence: Evidence  # the keyframes so far


class _Bones:
    """Bone lengths of one person.

    Args:
        first: (J,) metres, until they are learned.
    """

    def __init__(self, first: Array) -> None:
        self.first = self.lengths = first
        self.seen_ns = 0  # time in which both sensors saw the person
        self.learned = 0  # times that the lengths were learned


class CalibrationLearner:
    """Learns from each pair; deterministic, with bounded memory.

    R and t by the surface of depth images, once they are seen, are in force before those by the joints. These
    are refined as ever: views are compared by joints, and a better t puts the joints farther apart.
    """

    def __init__(self, body: Body, calibration: Calibration, settings: LearnerSettings | None = None) -> None:
        self._body, self._settings = body, settings or LearnerSettings()
        self.calibration = calibration
        self._joints: Calibration = calibration
        self._fit: RobustFit | None = None
        self._refinement = Refinement(
            body, calibration.a_from_b, self._settings.refinement, prior=prior_of(calibration)
        )
        self._knock = KnockDetector(body, calibration.a_from_b, self._settings.knock)
        self._clock = LagEstimator(body)
        self._recent: deque[tuple[SkeletonPair, tuple[int, int]]] = deque(maxlen=_RECENT)
        self._test_ns = 0  # a suspected knock is tested from this time on
        self._last_ns: int | None = None
        self._meet(calibration)

    def _meet(self, calibration: Calibration) -> None:
        """Begins with the person of a calibration."""
        self._size, self._bones = PersonSize(), [_Bones(calibration.bone_lengths)]
        self._first_person = calibration.person

    @property
    def person(self) -> int:
        """The number of the person present; 0 is who was calibrated."""
        return self._size.present

    @property
    def sizes(self) -> list[float]:
        """The logarithm of each person's scale relative to the bones of the first calibration."""
        return self._size.people

    @property
    def known(self) -> Known:
        """What a fit to the surface starts from; see :meth:`see_surface`."""
        return Known(self._joints, self._fit, self._refinement.keyframes.evidence.copy())

    def see_surface(self, found: Calibration, known: Known, now_ns: int) -> list[CalibrationChange]:
        """Takes a calibration by the surface; returns the change, if R and t become others or much surer.

        Args:
            known: What it started from.
        """
        old, registration = self.calibration, found.registration
        if found.a_from_b is known.calibration.a_from_b or registration is None:
            return []  # too little of the surface is seen
        turn, shift = _difference(old.a_from_b, found.a_from_b, registration.centre)
        settings, before = self._settings.refinement, old.registration
        surer_sd = settings.surer * (_UNKNOWN_TURN if before is None else before.rotation_sd)
        if not settings.worth(turn, shift) and registration.rotation_sd > surer_sd:
            return []
        self.calibration = replace(found, bone_lengths=old.bone_lengths, person=old.person)
        return [self._refined(turn, shift, now_ns, " by the surface that both sensors see")]

    def adopt(self, calibration: Calibration) -> None:
        """Puts another calibration in force and keeps the evidence."""
        self.calibration = self._joints = calibration
        self._fit = None
        self._meet(calibration)
        self._refinement.adopt(calibration.a_from_b, prior_of(calibration))
        self._knock.adopt(calibration.a_from_b)

    def observe(
        self,
        pair: SkeletonPair,
        codes: tuple[int, int] = (0, 0),
        stale: tuple[bool, bool] = (False, False),
        sizes: tuple[float, float] | None = None,
    ) -> list[CalibrationChange]:
        """Takes the next pair.

        Args:
            codes: Exchange codes of A and of B: bit 0 the arms, bit 1 the legs.
            stale: Whether A and B repeat their last skeletons.
            sizes: Of both views, if known, as :func:`sizes_of_pair` gives them for the first bones.

        Returns:
            The changes, in order; usually none.

        Raises:
            BodyError: A skeleton is of another body.
        """
        pair.require(self._body)
        if pair.a is None or pair.b is None or any(stale):
            return []
        known = self._bones[self._size.present]
        if self._last_ns is not None and 0 < pair.time_ns - self._last_ns < AWAY_NS:
            known.seen_ns += pair.time_ns - self._last_ns
        self._last_ns = pair.time_ns
        changes: list[CalibrationChange] = []
        if not self._recent or not 0 <= pair.time_ns - self._recent[-1][0].time_ns < _RECENT_NS:
            self._recent.append((pair, codes))
            changes += self._recognize(pair, sizes)
        if self._settings.follow:
            self._knock.observe(pair)
        if self._knock.since_ns is not None:
            self._refinement.keyframes.add(pair, codes)
            changes += self._test_knock(pair.time_ns, self._knock.since_ns)
        elif self._settings.refine:
            changes += self._refine(pair, codes)
        elif self._settings.bones or self._size.present:
            self._refinement.keyframes.add(pair, codes)
        if self._settings.bones or self._size.present:
            changes += self._learn_bones(pair.time_ns)
        if self._settings.clock:
            clock = self._clock.observe(pair, self.calibration.a_from_b)
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
        self._knock.a_from_b = fit.a_from_b
        evidence = self._refinement.keyframes.evidence
        if not self._replace(fit, evidence, f"refined on {len(evidence.a)} keyframes"):
            return []
        return [self._refined(*_difference(old, fit.a_from_b, fit.centre), pair.time_ns)]

    def _refined(self, turn: float, shift: float, now_ns: int, how: str = "") -> CalibrationChange:
        known = self.calibration.registration
        assert known is not None
        event = (
            f"Registration refined{how}: the view of B turns by {np.degrees(turn):.2f}°, and moves by "
            f"{shift * 1e3:.0f} mm where the person stands; now certain to "
            f"{np.degrees(known.rotation_sd):.2f}° and {known.translation_sd * 1e3:.0f} mm."
        )
        return CalibrationChange("refined", event, now_ns, self.calibration)

    def _test_knock(self, now_ns: int, since_ns: int) -> list[CalibrationChange]:
        """Registers the sensors anew once a knock explains the pairs far better."""
        settings = self._settings.knock
        if now_ns < max(self._test_ns, since_ns + settings.tested_ns):
            return []
        self._test_ns = now_ns + settings.retested_ns
        found = self._fit_knock(since_ns)
        excess = -np.inf if found is None else settings.excess(found)
        if found is not None and excess > 1.0:
            return [self._restart(now_ns, since_ns, found)]
        if now_ns - since_ns > settings.dropped_ns * (1 if excess < 0.5 else 2):
            self._knock.withdraw(now_ns)
        return []

    def _fit_knock(self, since_ns: int) -> KnockFit | None:
        """The test of a knock at ``since_ns`` on the keyframes before and the pairs since it ended."""
        known = self._refinement.keyframes.evidence
        before = known.chosen(known.time_ns < since_ns)
        after = self._evidence_since(since_ns + self._settings.knock.moving_ns)
        old = self._joints.a_from_b
        match_sides(self._body, before, old)
        try:
            return fit_knock(
                self._body, before, after, old, self._settings.refinement.fit, self._refinement.prior
            )
        except CalibrationError:
            return None

    def _evidence_since(self, time_ns: int) -> Evidence:
        later = [(pair, codes) for pair, codes in self._recent if pair.time_ns >= time_ns]
        return evidence_of(self._body, [pair for pair, _ in later], [codes for _, codes in later])

    def _restart(self, now_ns: int, since_ns: int, found: KnockFit) -> CalibrationChange:
        """Puts the registration after the knock in force, and learns from the pairs since then."""
        old, fit, still_ns = self._joints.a_from_b, found.fit, since_ns + self._settings.knock.moving_ns
        self.calibration = replace(self.calibration, a_from_b=old)
        prior = Prior(fit.a_from_b, _FOLLOWED_TURN, _FOLLOWED_SHIFT)
        self._refinement.restart(fit.a_from_b, keep_from_ns=still_ns, prior=prior)
        self._knock.adopt(fit.a_from_b)
        evidence = self._evidence_since(still_ns)
        match_sides(self._body, evidence, fit.a_from_b)
        with suppress(CalibrationError):
            fit = with_frontal_sd(self._body, evidence, fit, self._settings.refinement.fit, prior)
        self._replace(fit, evidence, f"registered anew on {len(evidence.a)} frames after a sensor moved")
        turn, shift = _difference(old, fit.a_from_b, fit.centre)
        event = (
            f"A sensor was moved; registration follows it. The view of B turns by {np.degrees(turn):.1f}°, "
            f"and moves by {shift * 1e3:.0f} mm where the person stands."
        )
        return CalibrationChange("knocked", event, now_ns, self.calibration, since_ns)

    def _recognize(self, pair: SkeletonPair, sizes: tuple[float, float] | None) -> list[CalibrationChange]:
        """Puts the bones of another person in force once their size shows that they are there."""
        size, before = self._size, self._size.present
        if sizes is None:
            sizes = sizes_of_pair(self._body, pair, self._bones[0].first)
        if not size.observe(pair.time_ns, *sizes):
            return []
        if size.present == len(self._bones):
            self._bones.append(_Bones(self._bones[0].first * np.exp(size.people[-1])))
        lengths, person = self._bones[size.present].lengths, self._first_person + size.present
        self.calibration = replace(self.calibration, bone_lengths=lengths, person=person)
        event = person_event(size.people[size.present] - size.people[before])
        return [CalibrationChange("person", event, pair.time_ns, self.calibration, size.since_ns)]

    def _learn_bones(self, now_ns: int) -> list[CalibrationChange]:
        known, since_ns = self._bones[self._size.present], self._size.since_ns
        if known.learned == len(_BONES_AT_NS) or known.seen_ns < _BONES_AT_NS[known.learned]:
            return []
        evidence = self._refinement.keyframes.evidence
        if since_ns is not None:
            evidence = evidence.chosen(evidence.time_ns >= since_ns)
        if len(evidence.a) < _FEWEST_BONE_KEYFRAMES:
            return []
        known.learned += 1
        old = self.calibration.bone_lengths
        try:
            lengths = robust_bone_lengths(self._body, evidence, self._joints.a_from_b, old)
        except CalibrationError:
            return []
        changed = int(np.argmax(np.abs(lengths - old)))
        if abs(lengths[changed] - old[changed]) < _BONE_CHANGE:
            return []
        known.lengths = lengths
        self.calibration = replace(self.calibration, bone_lengths=lengths)
        mean = float(np.mean(np.abs(lengths - old)[self._body.bone_joints]))
        event = (
            f"Bone lengths learned from {len(evidence.a)} keyframes: mean change {mean * 1e3:.1f} mm, most "
            f"{self._body.bones[changed]}, {old[changed] * 1e3:.0f} to {lengths[changed] * 1e3:.0f} mm"
            f"{'; fixed from now on' if known.learned == len(_BONES_AT_NS) else ''}."
        )
        return [CalibrationChange("bones", event, now_ns, self.calibration)]

    def _replace(self, fit: RobustFit, evidence: Evidence, how: str) -> bool:
        """Takes a fit of the joints; returns whether it is in force."""
        registration = registration_of(self._body, evidence, fit)
        by_joints = self.calibration.a_from_b is self._joints.a_from_b
        self._joints, self._fit = self.calibration.by_joints(fit.a_from_b, how, registration), fit
        if by_joints:
            self.calibration = self._joints
        return by_joints


def person_event(change: float) -> str:
    """The event that another person is there, by the logarithm of their scale relative to the bones of S*."""
    ratio = float(np.exp(change))
    size = f"{100 * abs(ratio - 1.0):.0f} % {'smaller' if ratio < 1.0 else 'larger'}"
    return f"The person is {size} than the bones of S*, which has theirs from now on."


def prior_of(calibration: Calibration) -> Prior:
    """The prior of R and t from a calibration, with a lower limit of its standard deviation."""
    registration = calibration.registration
    rotation_sd = _UNKNOWN_TURN if registration is None else registration.rotation_sd
    return Prior(calibration.a_from_b, max(rotation_sd, _LEAST_TURN), _UNKNOWN_SHIFT)


def _difference(old: RigidTransform, new: RigidTransform, centre: Array) -> tuple[float, float]:
    """Rotation, radians, and shift, metres at the person's centre, between two calibrations."""
    shift = centre - old.apply(new.inverse().apply(centre))
    return new.angle_to(old), float(np.linalg.norm(shift))
