"""Analysis of a whole recording before fusion: its calibrations and the exchanged sides of each view.

There are two passes. The first uses the start-up pose and the labels under its registration to learn
registration and bones from the whole recording. The second finds the labels again under that registration. A
live run has neither pass, because both use later frames.
"""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fusion.body import Body
from fusion.calibration.calibration import Calibration
from fusion.calibration.offline import (
    LearnedCalibration,
    Surfaces,
    fresh_pairs,
    learn_from_recording,
    spaced,
    start_up_calibration,
)
from fusion.calibration.online import CalibrationChange, LearnerSettings
from fusion.clocks import Clock
from fusion.errors import CalibrationError
from fusion.facing.labels import Labels
from fusion.facing.model import WHOLE
from fusion.facing.sequence import relabel_sequence, reported_pairs
from fusion.pair_arrays import PairArrays, Pairs
from fusion.setup import FuserSettings
from fusion.skeleton import SkeletonPair
from fusion.support.large_arrays import parts
from fusion.support.medians import median_of_known
from fusion.support.progress import Progress, quietly

Segments = Sequence[tuple[Calibration, slice]]
_LONG = 18_000
"""Pairs, ten minutes at 30 per second. The registration of a longer recording is learned from pairs a tenth
of a second apart, and its sides are found in parts."""
_OF_ONE_MOMENT = 0.12  # metres between the views, median: 40 real pairs have at most 0.09, two captures 0.17
_AROUND = 900  # pairs before and after a part that count for it


@dataclass(frozen=True, eq=False)
class RecordingPlan:
    """The calibrations and labels that a recording of T pairs is fused with."""

    segments: tuple[tuple[Calibration, slice], ...]
    """Each calibration, with the pairs that it holds for; in order, without gaps."""
    labels: Labels | None = None  # None where the method or the settings use no later frames
    changes: tuple[CalibrationChange, ...] = ()  # events of the learner: a sensor that was moved
    clock: Clock | None = None
    """Offset of B's clock, from the motion; None where unknown, or where the views show other motions."""
    views_differ: float = float("nan")
    """Metres between p and R q + t: the median over the joints that both see, and over the pairs; NaN where
    no joint is seen by both."""


def plan_recording(
    body: Body,
    pairs: Sequence[SkeletonPair],
    settings: FuserSettings,
    calibration: Calibration | None = None,
    refine: bool = True,
    progress: Progress = quietly,
    surfaces: Surfaces | None = None,
) -> RecordingPlan:
    """Finds the calibrations and labels of a recording.

    The paper's methods keep the calibration of the start-up pose and the sides as reported.

    Args:
        settings: The method; ``hindsight`` determines whether labels are found here.
        calibration: An earlier calibration; that of the start-up pose where None.
        refine: Whether the method ``duplex`` refines it over the whole recording. The bones of people of
            another size are learned all the same.
        surfaces: Gives the depth images of a recording that has them.

    Raises:
        CalibrationError: None is given, and none can be found.
    """
    pairs = Pairs.of(body, pairs)
    start = calibration or start_up_calibration(body, pairs, frontal=settings.method == "duplex")
    segments: tuple[tuple[Calibration, slice], ...] = ((start, slice(0, len(pairs))),)
    if settings.method != "duplex":
        return RecordingPlan(segments, views_differ=_difference(pairs, segments))
    learned: LearnedCalibration | None = None
    few = pairs if len(pairs) <= _LONG else pairs[spaced(pairs.time_ns, fresh_pairs(pairs))]
    if len(few):
        codes = _labels(few, ((start, slice(0, len(few))),), progress).codes & WHOLE if refine else None
        with suppress(CalibrationError):  # nothing to learn from: the start-up pose's calibration remains
            learned = learn_from_recording(
                body, few, codes, start, LearnerSettings().if_learned(refine), progress, pairs, surfaces
            )
    if learned is not None:
        segments = _segments(learned, pairs.time_ns)
    differ = _difference(pairs, segments)
    return RecordingPlan(
        segments,
        None if settings.hindsight == "none" else _labels(pairs, segments, progress),
        () if learned is None else learned.events,
        None if learned is None or differ > _OF_ONE_MOMENT else learned.clock,
        differ,
    )


def _difference(pairs: Pairs, segments: Segments) -> float:
    """Metres; see :attr:`RecordingPlan.views_differ`."""
    apart = [
        median_of_known(np.linalg.norm(of.a - _b_in_a(of, part, segments), axis=2))
        for part in parts(len(pairs))
        for of in [pairs[part].arrays()]
    ]
    known = np.concatenate([np.zeros(0), *apart])
    known = known[np.isfinite(known)]
    return float(np.median(known)) if len(known) else float("nan")


def _b_in_a(pairs: PairArrays, part: slice, segments: Segments) -> NDArray[np.float64]:
    """(T, J, 3) view B of a part of the pairs in K_A's frame."""
    in_a = np.empty(pairs.b.shape)
    for calibration, held in _held(part, segments):
        in_a[held] = calibration.a_from_b.apply(pairs.b[held])
    return in_a


def _place_of_b(part: slice, segments: Segments) -> NDArray[np.float64]:
    """(T, 3) the position of K_B in K_A's frame during a part of the pairs."""
    place = np.empty((part.stop - part.start, 3))
    for calibration, held in _held(part, segments):
        place[held] = calibration.a_from_b.translation
    return place


def _held(part: slice, segments: Segments) -> Iterator[tuple[Calibration, slice]]:
    """Yields each calibration, with the slice of a part's pairs that were taken under it."""
    for calibration, own in segments:
        first, end = (min(max(at - part.start, 0), part.stop - part.start) for at in (own.start, own.stop))
        yield calibration, slice(first, end)


def _labels(pairs: Pairs, segments: Segments, progress: Progress) -> Labels:
    """Exchanged sides and heading under these calibrations, from earlier and later pairs."""
    labels, size = [], _LONG if len(pairs) <= _LONG else _LONG // 2
    for part in progress(parts(len(pairs), size), "finding left and right", -(-len(pairs) // size)):
        around = slice(max(part.start - _AROUND, 0), min(part.stop + _AROUND, len(pairs)))
        of = pairs[around].arrays()
        views = of.a, _b_in_a(of, around, segments)
        reported = reported_pairs(views, (of.states_a, of.states_b), _place_of_b(around, segments))
        found = relabel_sequence(pairs.body, reported, of.time_ns)
        own = slice(part.start - around.start, part.stop - around.start)
        labels.append(found.rows(own).as_stored())
    return Labels.joined(labels)


def _segments(
    learned: LearnedCalibration, time_ns: NDArray[np.int64]
) -> tuple[tuple[Calibration, slice], ...]:
    """The spans of a learned calibration as slices of the pairs."""
    firsts = [0, *(int(np.searchsorted(time_ns, span.first_ns)) for span in learned.spans[1:])]
    ends = [*firsts[1:], len(time_ns)]
    spans = zip(learned.spans, firsts, ends, strict=True)
    return tuple((span.calibration, slice(first, end)) for span, first, end in spans if first < end)
