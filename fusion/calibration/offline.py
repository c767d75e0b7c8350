"""The calibration of a whole recording in two passes: knocks first, then R, t and bones between them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

from fusion.body import Body
from fusion.calibration.bone_lengths import robust_bone_lengths
from fusion.calibration.calibration import Calibration, calibrate
from fusion.calibration.online import CalibrationChange, CalibrationLearner, LearnerSettings, prior_of
from fusion.calibration.start_up_pose import find_start_up_pose
from fusion.errors import CalibrationError
from fusion.registration.clock_offset import ClockOffset, clock_offset_of
from fusion.registration.error_model import disagreement
from fusion.registration.keyframes import Evidence, KeyframeSet, evidence_of, match_sides
from fusion.registration.knock import fit_knock
from fusion.registration.refinement import held_out_gain
from fusion.registration.rigid_fit import label_free_fit
from fusion.registration.robust_fit import RobustFit, fit_robust, registration_of
from fusion.rigid import RigidTransform
from fusion.skeleton import SkeletonPair

Progress = Callable[[Sequence[int]], Iterable[int]]
_KEYFRAMES = 128  # per span; the tempering of the fit was chosen for this number
_BONE_PAIRS = 256
"""Pairs, evenly spaced, from which a recording's bone lengths are learned. Bone lengths need no variety of
poses but many moments, because a tracker's scale changes within a second."""
_FEWEST = 12
_SPACING_NS, _PROPOSED_NS = 95_000_000, 3_000_000_000
"""Pairs and refinements of the first pass, which only has to find when a sensor was moved."""
_LABEL_FREE = "label-free fit of the first half minute"


@dataclass(frozen=True, eq=False)
class CalibrationSpan:
    """A calibration and the time from which it holds."""

    first_ns: int  # time of the first pair that it holds for; it holds until the next span
    calibration: Calibration  # R, t and bone lengths


@dataclass(frozen=True, eq=False)
class LearnedCalibration:
    """The calibration of a whole recording, with events."""

    spans: tuple[CalibrationSpan, ...]
    """One, and one more for each time that a sensor was moved; in order of time."""
    clock: ClockOffset | None  # offset and skew of B's clock; None where there is too little motion
    events: tuple[CalibrationChange, ...]  # events of the learner, as live; knocks with their times


def start_up_calibration(body: Body, pairs: Sequence[SkeletonPair]) -> Calibration:
    """The calibration on a recording's start-up pose; on its calmest window where there is none.

    Where one view of the pose is mirrored, R and t are those of the label-free fit of the recording.

    Raises:
        CalibrationError: No frame shows a person to both sensors, or the views cannot be registered.
    """
    held, how = find_start_up_pose(body, pairs)
    try:
        return calibrate(body, held, how)
    except CalibrationError:
        fresh = [pairs[k] for k in _fresh(pairs)]
        found = label_free_fit(body, evidence_of(body, fresh[:: max(1, len(fresh) // _KEYFRAMES)]))
        if found is None:
            raise
        return Calibration(body, found, body.nominal_lengths, "label-free fit of the recording")


def learn_from_recording(
    body: Body,
    pairs: Sequence[SkeletonPair],
    codes: Sequence[tuple[int, int]] | None = None,
    start: Calibration | None = None,
    settings: LearnerSettings | None = None,
    skews_ns: Sequence[int] | None = None,
    progress: Progress = iter,
) -> LearnedCalibration:
    """Learns one calibration from a recording, or one for each span between knocks.

    The first pass runs the live learner over the recording and finds when a sensor was moved. The second fits
    R and t to all keyframes of each span, and the bone lengths to evenly spaced pairs of the longest span.

    Args:
        codes: (T, 2) exchange codes of A and B: bit 0 arms, bit 1 legs; 0 where None.
        start: The initial calibration; that of the recording's start-up pose where None.
        skews_ns: Capture time of B minus that of A by the time stamps; 0 where None.

    Raises:
        CalibrationError: No frame shows a person to both sensors, or too few joints.
    """
    settings = settings or LearnerSettings()
    codes = [(0, 0)] * len(pairs) if codes is None else codes
    skews_ns = [0] * len(pairs) if skews_ns is None else skews_ns
    fresh = _fresh(pairs)
    start = start or start_up_calibration(body, pairs)
    start = _best_start(body, [pairs[k] for k in fresh], [codes[k] for k in fresh], start, settings)

    rarely = replace(settings.refinement, interval_ns=_PROPOSED_NS)
    learner = CalibrationLearner(body, start, replace(settings, refinement=rarely, clock=False, bones=False))
    changes: list[CalibrationChange] = []
    for k in progress(_spaced(pairs, fresh)):
        changes += learner.observe(pairs[k], codes[k], (False, False), skews_ns[k])

    knocks = _lasting_knocks(
        body, [pairs[k] for k in fresh], [codes[k] for k in fresh], changes, start, settings
    )
    begins = [pairs[0].time_ns, *(int(change.since_ns or 0) for change in knocks)]
    starts = [start, *(change.calibration for change in knocks)]
    spans, bone_evidence = [], []
    for number, (begin_ns, first) in enumerate(zip(begins, starts, strict=True)):
        end_ns = begins[number + 1] if number + 1 < len(begins) else None
        within = [
            k for k in fresh
            if pairs[k].time_ns >= begin_ns and (end_ns is None or pairs[k].time_ns < end_ns)
        ]  # fmt: skip
        frames = KeyframeSet(body, _KEYFRAMES)
        for k in within:
            frames.add(pairs[k], codes[k])
        calibration = _refit(body, frames.evidence, first, settings) if settings.refine else first
        spans.append(CalibrationSpan(begin_ns, calibration))
        even = within[:: max(1, len(within) // _BONE_PAIRS)]
        evidence = evidence_of(body, [pairs[k] for k in even], [codes[k] for k in even])
        match_sides(body, evidence, calibration.a_from_b)
        bone_evidence.append((evidence, calibration))
    if settings.bones:
        spans = _with_bones(body, spans, bone_evidence)
    clock = None
    if settings.clock:
        last = [k for k in fresh if len(begins) == 1 or pairs[k].time_ns < begins[1]]
        clock = clock_offset_of(
            body, [pairs[k] for k in last], spans[0].calibration.a_from_b, [skews_ns[k] for k in last]
        )
    return LearnedCalibration(tuple(spans), clock, tuple(knocks))


def _lasting_knocks(
    body: Body,
    pairs: Sequence[SkeletonPair],
    codes: Sequence[tuple[int, int]],
    changes: Sequence[CalibrationChange],
    start: Calibration,
    settings: LearnerSettings,
) -> list[CalibrationChange]:
    """The knocks that were followed and that explain all pairs up to the next, not only the first seconds."""
    followed = [change for change in changes if change.kind == "knocked"]
    times = [int(change.since_ns or 0) for change in followed]
    knocks: list[CalibrationChange] = []
    begin_ns = pairs[0].time_ns if pairs else 0
    for number, change in enumerate(followed):
        moved_ns = times[number]
        end_ns = times[number + 1] if number + 1 < len(times) else pairs[-1].time_ns + 1
        before, after = KeyframeSet(body, _KEYFRAMES), KeyframeSet(body, _KEYFRAMES)
        for pair, code in zip(pairs, codes, strict=True):
            if begin_ns <= pair.time_ns < moved_ns:
                before.add(pair, code)
            elif moved_ns + settings.knock.moving_ns <= pair.time_ns < end_ns:
                after.add(pair, code)
        old = next((c.calibration for c in reversed(changes) if c.time_ns < moved_ns), start)
        if _is_knock(body, before.evidence, after.evidence, old.a_from_b, settings):
            knocks.append(change)
            begin_ns = moved_ns
    return knocks


def _is_knock(
    body: Body, before: Evidence, after: Evidence, old: RigidTransform, settings: LearnerSettings
) -> bool:
    if min(len(before.a), len(after.a)) == 0:
        return True  # nothing contradicts it
    match_sides(body, before, old)
    try:
        found = fit_knock(body, before, after, old, settings.refinement.fit)
    except CalibrationError:
        return True
    return found.gain > settings.knock.needed(found.keyframes)


def _fresh(pairs: Sequence[SkeletonPair]) -> list[int]:
    """Indices of the pairs with two views, neither of which is stale."""
    fresh = []
    before: SkeletonPair | None = None
    for k, pair in enumerate(pairs):
        if pair.a is not None and pair.b is not None:
            stale = before is not None and (pair.a.repeats(before.a) or pair.b.repeats(before.b))
            if not stale:
                fresh.append(k)
        before = pair
    return fresh


def _spaced(pairs: Sequence[SkeletonPair], chosen: Sequence[int]) -> list[int]:
    """Those of the chosen pairs that lie a tenth of a second apart: errors of neighbours are alike."""
    spaced: list[int] = []
    for k in chosen:
        if not spaced or pairs[k].time_ns - pairs[spaced[-1]].time_ns >= _SPACING_NS:
            spaced.append(k)
    return spaced


def _best_start(
    body: Body,
    pairs: Sequence[SkeletonPair],
    codes: Sequence[tuple[int, int]],
    start: Calibration,
    settings: LearnerSettings,
) -> Calibration:
    """The given start, or the label-free fit of the first half minute if that fits it far better."""
    until_ns = pairs[0].time_ns + 30_000_000_000 if pairs else 0
    frames = KeyframeSet(body, _KEYFRAMES)
    for pair, code in zip(pairs, codes, strict=True):
        if pair.time_ns <= until_ns:
            frames.add(pair, code)
    evidence = frames.evidence
    if len(evidence.a) < _FEWEST:
        return start
    other = label_free_fit(body, evidence)
    if other is None:
        return start
    costs = []
    for transform in (start.a_from_b, other):
        copy = evidence.copy()
        match_sides(body, copy, transform)
        costs.append(disagreement(body, copy, transform, settings.refinement.fit, 0.03))
    if costs[1] > costs[0] - max(settings.refinement.gain, 0.2 * costs[0]):
        return start
    return replace(start, a_from_b=other, how=_LABEL_FREE)


def _refit(body: Body, evidence: Evidence, start: Calibration, settings: LearnerSettings) -> Calibration:
    """R and t from all keyframes of a span, if they explain held-out ones better."""
    fit_settings = settings.refinement.fit
    if len(evidence.a) < _FEWEST:
        return start
    try:
        match_sides(body, evidence, start.a_from_b)
        prior = prior_of(start)
        fit: RobustFit = fit_robust(body, evidence, start.a_from_b, fit_settings, prior=prior)
        match_sides(body, evidence, fit.a_from_b)
        fit = fit_robust(body, evidence, fit.a_from_b, fit_settings, noise_sd=fit.noise_sd, biases=fit.biases)
        gain = held_out_gain(body, evidence, start.a_from_b, fit, fit_settings, prior)
    except CalibrationError:
        return start
    if gain < settings.refinement.gain:
        if start.how != _LABEL_FREE:
            return start
        kept = replace(fit, a_from_b=start.a_from_b)  # the start-up pose's registration is of another R and t
        return replace(start, registration=registration_of(body, evidence, kept))
    return replace(
        start,
        a_from_b=fit.a_from_b,
        how=f"robust fit of {len(evidence.a)} keyframes of the recording",
        registration=registration_of(body, evidence, fit),
    )


def _with_bones(
    body: Body, spans: list[CalibrationSpan], seen: list[tuple[Evidence, Calibration]]
) -> list[CalibrationSpan]:
    """The spans with one set of bone lengths, because a knock does not change the person."""
    evidence, calibration = max(seen, key=lambda item: len(item[0].a))
    if len(evidence.a) < _FEWEST:
        return spans
    try:
        lengths = robust_bone_lengths(body, evidence, calibration.a_from_b, spans[0].calibration.bone_lengths)
    except CalibrationError:
        return spans
    return [replace(s, calibration=replace(s.calibration, bone_lengths=lengths)) for s in spans]
