"""The calibration of a whole recording in two passes: knocks first, then R, t and bones between them."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion.body import Body
from fusion.calibration.bone_lengths import robust_bone_lengths
from fusion.calibration.calibration import Calibration, calibrate
from fusion.calibration.online import CalibrationChange, CalibrationLearner, LearnerSettings, prior_of
from fusion.calibration.person_size import sizes_of
from fusion.calibration.start_up_pose import find_start_up_pose
from fusion.clocks import Clock
from fusion.clocks.lag import lag_of
from fusion.errors import CalibrationError
from fusion.pair_arrays import Pairs
from fusion.registration.keyframes import Evidence, KeyframeSet, evidence_of, match_sides, relabelled
from fusion.registration.knock import fit_knock
from fusion.registration.refinement import held_out_gain
from fusion.registration.rigid_fit import label_free_fit
from fusion.registration.robust_fit import RobustFit, better_fit, fit_robust, registration_of, with_frontal_sd
from fusion.rigid import RigidTransform
from fusion.skeleton import NO_FRAME, SkeletonPair, stale_frames
from fusion.support.large_arrays import PART, give_back, parts
from fusion.support.medians import median_of_known
from fusion.support.progress import Progress, quietly
from fusion.support.types import Array

if TYPE_CHECKING:
    from fusion.calibration.surface_fit import SharedSurface

_KEYFRAMES = 128  # per span; the tempering of the fit was chosen for this number
_BONE_PAIRS = 256
"""Pairs, evenly spaced, from which a recording's bone lengths are learned. Bone lengths need no variety of
poses but many moments, because a tracker's scale changes within a second."""
_FEWEST = 12
_SPACING_NS, _PROPOSED_NS = 95_000_000, 3_000_000_000
"""Pairs and refinements of the first pass, which only has to find when a sensor was moved."""
_PROPOSALS = 200  # at most; in recordings longer than ten minutes the refinements are farther apart
_OTHER_START = "fit of the first half minute"
_MOMENTS, _APART_NS, _IMAGES_NS = 12, 500_000_000, 20_000_000_000
"""Moments of which depth images are taken, the least time between them, and the time that they are from."""

Surfaces = Callable[[Pairs], "SharedSurface | None"]
"""What the depth images of some pairs show to both sensors; None without images."""


@dataclass(frozen=True, eq=False)
class CalibrationSpan:
    """A calibration and the time from which it holds."""

    first_ns: int  # time of the first pair that it holds for; it holds until the next span
    calibration: Calibration  # R, t and bone lengths


@dataclass(frozen=True, eq=False)
class LearnedCalibration:
    """The calibration of a whole recording, with events."""

    spans: tuple[CalibrationSpan, ...]
    """One, and one more for each time that a sensor was moved or another person came; in order of time."""
    clock: Clock | None  # offset and skew of B's clock; None where there is too little motion
    events: tuple[CalibrationChange, ...]  # events of the learner, as live; knocks with their times


def start_up_calibration(body: Body, pairs: Sequence[SkeletonPair], *, frontal: bool = True) -> Calibration:
    """The calibration on a recording's start-up pose; on its calmest window where there is none.

    Where one view of the pose is mirrored, R and t are those of the label-free fit of the recording.

    Args:
        frontal: See :func:`fusion.registration.rigid_fit.register`.

    Raises:
        CalibrationError: No frame shows a person to both sensors, or the views cannot be registered.
    """
    pairs = Pairs.of(body, pairs)
    held, how = find_start_up_pose(body, pairs)
    try:
        return calibrate(body, held, how, frontal=frontal)
    except CalibrationError:
        fresh = fresh_pairs(pairs)
        found = label_free_fit(body, evidence_of(body, pairs[fresh[:: max(1, len(fresh) // _KEYFRAMES)]]))
        if found is None:
            raise
        return Calibration(body, found, body.nominal_lengths, "label-free fit of the recording")


def learn_from_recording(
    body: Body,
    pairs: Sequence[SkeletonPair],
    codes: NDArray[np.int64] | None = None,
    start: Calibration | None = None,
    settings: LearnerSettings | None = None,
    progress: Progress = quietly,
    timed: Sequence[SkeletonPair] | None = None,
    surfaces: Surfaces | None = None,
) -> LearnedCalibration:
    """Learns one calibration from a recording, or one for each span between knocks and of each person.

    The first pass runs the live learner over the recording and finds when a sensor was moved. The second fits
    R and t to all keyframes of each span between knocks, and the bone lengths of each person to evenly spaced
    pairs of the longest span with them.

    Args:
        codes: (T, 2) exchange codes of A and B: bit 0 arms, bit 1 legs; 0 where None.
        start: The initial calibration; that of the recording's start-up pose where None.
        timed: All pairs, for the offset of the clocks, where ``pairs`` are some of them.
        surfaces: Gives the depth images of a recording that has them.

    Raises:
        CalibrationError: No frame shows a person to both sensors, or too few joints.
    """
    settings = settings or LearnerSettings()
    pairs = Pairs.of(body, pairs)
    fresh = fresh_pairs(pairs)
    codes = np.zeros((len(pairs), 2), dtype=np.int64) if codes is None else np.asarray(codes)
    seen = _Fresh(pairs[fresh], codes[fresh])
    start = start or start_up_calibration(body, pairs)
    if settings.refine:
        start = _best_start(seen, start, settings)
    chosen = spaced(pairs.time_ns, fresh)

    length_ns = int(pairs.time_ns[-1] - pairs.time_ns[0]) if len(pairs) else 0
    rarely = replace(settings.refinement, interval_ns=max(_PROPOSED_NS, length_ns // _PROPOSALS))
    learner = CalibrationLearner(body, start, replace(settings, refinement=rarely, clock=False, bones=False))
    changes: list[CalibrationChange] = []
    people = [(int(pairs.time_ns[0]), 0)]
    sizes = _sizes(body, pairs, chosen, start.bone_lengths)
    for number, k in enumerate(progress(chosen.tolist(), "learning the registration", len(chosen))):
        if number % PART == 0:
            give_back()
        exchanged = int(codes[k, 0]), int(codes[k, 1])
        new = learner.observe(pairs[k], exchanged, sizes=sizes[number])
        people += [(int(of.since_ns or 0), learner.person) for of in new if of.kind == "person"]
        changes += new

    knocks = _lasting_knocks(seen, changes, start, settings)
    begins = [int(pairs.time_ns[0]), *(int(change.since_ns or 0) for change in knocks)]
    starts = [start, *(change.calibration for change in knocks)]
    spans = []
    for begin_ns, end_ns, first in zip(begins, [*begins[1:], None], starts, strict=True):
        calibration = first
        if settings.refine:
            evidence = seen.keyframes(begin_ns, end_ns)
            calibration, fit = _refit(body, evidence, first, settings)
            if surfaces is not None:
                from fusion.calibration.surface_fit import with_surface  # where there are images

                still_ns = begin_ns + settings.knock.moving_ns * (first is not start)
                shared = surfaces(seen.still(still_ns, end_ns))
                calibration = with_surface(body, evidence, calibration, fit, shared)
        spans.append(CalibrationSpan(begin_ns, calibration))
    came = [change for change in changes if change.kind == "person"]
    measured = next((k for k, of in zip(chosen, sizes, strict=True) if not np.isnan(sum(of))), 0)
    if len(people) > 1 and people[1][0] <= pairs.time_ns[measured]:  # the calibration's bones are nobody's
        people = [(people[0][0], people[1][1]), *people[2:]]
        came = came[settings.refine :]
    spans = _with_bones(body, seen, spans, people, learner.sizes, settings.bones)
    clock = None
    if settings.clock:
        if timed is not None:
            pairs = Pairs.of(body, timed)
            fresh = fresh_pairs(pairs)
        if len(begins) > 1:
            fresh = fresh[pairs.time_ns[fresh] < begins[1]]
        clock = lag_of(body, pairs[fresh], spans[0].calibration.a_from_b)
    return LearnedCalibration(tuple(spans), clock, tuple(sorted((*knocks, *came), key=lambda of: of.time_ns)))


def _sizes(body: Body, pairs: Pairs, chosen: NDArray[np.int64], lengths: Array) -> list[tuple[float, float]]:
    """The sizes of both views in the chosen pairs."""
    found: list[tuple[float, float]] = []
    for part in parts(len(chosen)):
        of = pairs[chosen[part]].arrays()
        views = (of.a, of.states_a), (of.b, of.states_b)
        found += zip(*(sizes_of(body, *view, lengths).tolist() for view in views), strict=True)
    return found


class _Fresh(NamedTuple):
    """The pairs of a recording that show something new, and their exchange codes."""

    pairs: Pairs
    codes: NDArray[np.int64]

    def within(self, begin_ns: int, end_ns: int | None) -> slice:
        """The pairs from one time to another, or to the end."""
        times = self.pairs.time_ns
        end = len(times) if end_ns is None else int(np.searchsorted(times, end_ns))
        return slice(int(np.searchsorted(times, begin_ns)), end)

    def still(self, begin_ns: int, end_ns: int | None) -> Pairs:
        """The stillest pair of each twelfth of a span's first 20 s, or of each half second of it."""
        within = self.within(begin_ns, end_ns)
        pairs = self.pairs[within]
        pairs = pairs[: int(np.searchsorted(pairs.time_ns, pairs.time_ns[:1].sum() + _IMAGES_NS))]
        if len(pairs) < 3:
            return pairs[:0]
        of, times = pairs.arrays(), pairs.time_ns
        speed = larger_speeds(of.a, of.b, times)
        speed = np.where(np.isfinite(speed) & (times[2:] - times[:-2] < _APART_NS), speed, np.inf)
        part = (times[1:-1] - times[0]) // max(_APART_NS, int(times[-1] - times[0]) // _MOMENTS + 1)
        best = [np.flatnonzero(part == of)[np.argmin(speed[part == of])] for of in np.unique(part)]
        return pairs[1 + np.array([k for k in best if np.isfinite(speed[k])], dtype=np.int64)]

    def keyframes(self, begin_ns: int, end_ns: int | None) -> Evidence:
        """The keyframes of the pairs within these times."""
        frames = KeyframeSet(self.pairs.body, _KEYFRAMES)
        within = self.within(begin_ns, end_ns)
        for part in parts(within.stop - within.start):
            own = slice(within.start + part.start, within.start + part.stop)
            of, codes = self.pairs[own].arrays(), self.codes[own].T
            a, weight_a = relabelled(self.pairs.body, of.a, of.states_a, codes[0])
            b, weight_b = relabelled(self.pairs.body, of.b, of.states_b, codes[1])
            for k, time_ns in enumerate(of.time_ns.tolist()):
                if frames.due(time_ns):
                    frames.add_views((a[k], b[k]), (weight_a[k], weight_b[k]), time_ns)
        return frames.evidence


def _lasting_knocks(
    seen: _Fresh, changes: Sequence[CalibrationChange], start: Calibration, settings: LearnerSettings
) -> list[CalibrationChange]:
    """The knocks that were followed and that explain all pairs up to the next, not only the first seconds."""
    followed = [change for change in changes if change.kind == "knocked"]
    times = [int(change.since_ns or 0) for change in followed]
    knocks: list[CalibrationChange] = []
    begin_ns = NO_FRAME
    for change, moved_ns, end_ns in zip(followed, times, [*times[1:], None], strict=False):
        before = seen.keyframes(begin_ns, moved_ns)
        after = seen.keyframes(moved_ns + settings.knock.moving_ns, end_ns)
        old = next((c.calibration for c in reversed(changes) if c.time_ns < moved_ns), start)
        if _is_knock(seen.pairs.body, before, after, old.a_from_b, settings):
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
    return settings.knock.excess(found) > 1.0


def larger_speeds(a: NDArray[np.floating], b: NDArray[np.floating], time_ns: NDArray[np.int64]) -> Array:
    """(T - 2,) metres per second, the larger of both views' median speeds of joints; NaN where unknown.

    Args:
        a, b: (T, J, 3) metres, each in its sensor's frame.
    """
    moved = (np.linalg.norm(at[2:] - at[:-2], axis=2) for at in (a, b))
    seconds = 1e-9 * np.maximum(time_ns[2:] - time_ns[:-2], 1)
    return np.asarray(np.maximum(*(median_of_known(by) for by in moved)) / seconds)


def fresh_pairs(pairs: Pairs) -> NDArray[np.int64]:
    """Indices of the pairs with two views, neither of which is stale."""
    fresh: list[NDArray[np.int64]] = []
    j = len(pairs.body)
    nobody = np.full((1, j, 3), np.nan, dtype=np.float32), np.zeros((1, j), dtype=np.uint8)
    last = [nobody, nobody]  # each sensor's last skeleton in an earlier part: joints and states
    for part in parts(len(pairs)):
        now = pairs[part].arrays()
        both = np.ones(part.stop - part.start, dtype=np.bool_)
        for side, (at, states) in enumerate(((now.a, now.states_a), (now.b, now.states_b))):
            (last_at, last_states), seen = last[side], states.any(axis=1)
            after = np.concatenate((last_at, at)), np.concatenate((last_states, states))
            both &= seen & ~stale_frames(*after)[1:]
            if seen.any():
                k = int(np.flatnonzero(seen)[-1])
                last[side] = at[k : k + 1], states[k : k + 1]
        fresh.append(part.start + np.flatnonzero(both))
    return np.concatenate([np.zeros(0, dtype=np.int64), *fresh])


def spaced(time_ns: NDArray[np.int64], chosen: NDArray[np.int64]) -> NDArray[np.int64]:
    """Those of the chosen pairs that lie a tenth of a second apart: errors of neighbours are alike."""
    times, k = time_ns[chosen], 0
    kept: list[int] = []
    while k < len(times):
        kept.append(k)
        k = int(np.searchsorted(times, times[k] + _SPACING_NS))
    return chosen[kept]


def _best_start(seen: _Fresh, start: Calibration, settings: LearnerSettings) -> Calibration:
    """The given start, or the fit of the first half minute from another start if it is certainly better."""
    body, fit_settings = seen.pairs.body, settings.refinement.fit
    evidence = seen.keyframes(NO_FRAME, int(seen.pairs.time_ns[:1].sum()) + 30_000_000_001)
    if len(evidence.a) < _FEWEST:
        return start
    best = better_fit(body, evidence, start.a_from_b, fit_settings)
    if best is None:
        return start
    fit = with_frontal_sd(body, best.evidence, best.fit, fit_settings)
    registration = registration_of(body, best.evidence, fit)
    return start.by_joints(fit.a_from_b, _OTHER_START, registration)


def _refit(
    body: Body, evidence: Evidence, start: Calibration, settings: LearnerSettings
) -> tuple[Calibration, RobustFit | None]:
    """R and t from all keyframes of a span, if they explain held-out ones better; and their fit."""
    fit_settings = settings.refinement.fit
    if len(evidence.a) < _FEWEST:
        return start, None
    prior = None if start.how == _OTHER_START else prior_of(start)
    try:
        match_sides(body, evidence, start.a_from_b)
        fit: RobustFit = fit_robust(body, evidence, start.a_from_b, fit_settings, prior=prior)
        match_sides(body, evidence, fit.a_from_b)
        fit = fit_robust(
            body, evidence, fit.a_from_b, fit_settings,
            noise_sd=fit.noise_sd, biases=fit.biases, prior=prior,
        )  # fmt: skip
        gain = held_out_gain(body, evidence, start.a_from_b, fit, fit_settings, prior)
        fit = with_frontal_sd(body, evidence, fit, fit_settings, prior)
    except CalibrationError:
        return start, None
    if gain < settings.refinement.gain and start.how != _OTHER_START:
        return start, fit
    how = f"robust fit of {len(evidence.a)} keyframes of the recording"
    registration = registration_of(body, evidence, fit)
    return start.by_joints(fit.a_from_b, how, registration), fit


def _with_bones(
    body: Body,
    seen: _Fresh,
    spans: list[CalibrationSpan],
    people: list[tuple[int, int]],
    sizes: Sequence[float],
    first_learned: bool,
) -> list[CalibrationSpan]:
    """The spans with the bone lengths of who is there, because a knock does not change the person.

    Args:
        people: Since when each person is there, and their number.
        sizes: By number, the logarithm of their scale relative to the bones of the spans.
        first_learned: Whether the bones of the first person are learned, too.
    """
    begins = sorted({span.first_ns for span in spans} | {since_ns for since_ns, _ in people})
    pieces = []
    longest: dict[int, tuple[int, slice, Calibration]] = {}
    for begin_ns, end_ns in zip(begins, [*begins[1:], None], strict=True):
        calibration = next(span.calibration for span in reversed(spans) if span.first_ns <= begin_ns)
        person = next(number for since_ns, number in reversed(people) if since_ns <= begin_ns)
        within = seen.within(begin_ns, end_ns)
        pieces.append((begin_ns, calibration, person))
        if within.stop - within.start > longest.get(person, (-1,))[0]:
            longest[person] = within.stop - within.start, within, calibration
    lengths = {}
    for person, (count, within, calibration) in longest.items():
        bones, few = spans[0].calibration.bone_lengths, min(count, _BONE_PAIRS)
        if person:
            bones = bones * np.exp(sizes[person])
        if person or first_learned:
            even = within.start + np.arange(few) * count // max(few, 1)
            evidence = evidence_of(body, seen.pairs[even], seen.codes[even].tolist())
            match_sides(body, evidence, calibration.a_from_b)
            with suppress(CalibrationError):
                if len(evidence.a) >= _FEWEST:
                    bones = robust_bone_lengths(body, evidence, calibration.a_from_b, bones)
        lengths[person] = bones
    return [
        CalibrationSpan(begin_ns, replace(calibration, bone_lengths=lengths[person], person=person))
        for begin_ns, calibration, person in pieces
    ]
