"""Analysis of a whole recording before fusion: its calibrations and the exchanged sides of each view.

There are two passes. The first uses the start-up pose and the labels under its registration to learn
registration and bones from the whole recording. The second finds the labels again under that registration. A
live run has neither pass, because both use later frames.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fusion.body import Body
from fusion.calibration.calibration import Calibration
from fusion.calibration.offline import (
    LearnedCalibration,
    Progress,
    learn_from_recording,
    start_up_calibration,
)
from fusion.calibration.online import CalibrationChange
from fusion.errors import CalibrationError
from fusion.facing.exchange import with_doubt
from fusion.facing.model import WHOLE
from fusion.facing.sequence import relabel_sequence, reported_pairs
from fusion.medians import median_of_known
from fusion.pair_arrays import PairStacker
from fusion.registration.clock_offset import ClockOffset
from fusion.setup import FuserSettings
from fusion.skeleton import SkeletonPair


@dataclass(frozen=True, eq=False)
class RecordingPlan:
    """The calibrations and labels that a recording of T pairs is fused with."""

    segments: tuple[tuple[Calibration, slice], ...]
    """Each calibration, with the pairs that it holds for; in order, without gaps."""
    codes: NDArray[np.int64] | None = None
    """(T, 2) which sides of A and of B are exchanged, with the doubt about it
    (:func:`fusion.facing.exchange.with_doubt`); None where the method or the settings use no later frames."""
    changes: tuple[CalibrationChange, ...] = ()  # events of the learner: a sensor that was moved
    clock: ClockOffset | None = None  # offset of B's clock, from the motion; None where unknown
    views_differ: float = float("nan")
    """Metres between p and R q + t: the median over the joints that both see, and over the pairs; NaN where
    no joint is seen by both."""


def plan_recording(
    body: Body,
    pairs: Sequence[SkeletonPair],
    settings: FuserSettings,
    calibration: Calibration | None = None,
    refine: bool = True,
    progress: Progress = iter,
) -> RecordingPlan:
    """Finds the calibrations and labels of a recording.

    The paper's methods keep the calibration of the start-up pose and the sides as reported.

    Args:
        settings: The method; ``hindsight`` determines whether labels are found here.
        calibration: An earlier calibration; that of the start-up pose where None.
        refine: Whether the method ``duplex`` refines it over the whole recording.

    Raises:
        CalibrationError: None is given, and none can be found.
    """
    whole = slice(0, len(pairs))
    start = calibration or start_up_calibration(body, pairs)
    views = _Views(body, pairs)
    segments: tuple[tuple[Calibration, slice], ...] = ((start, whole),)
    if settings.method != "duplex":
        return RecordingPlan(segments, views_differ=views.difference(segments))
    learned: LearnedCalibration | None = None
    if refine:
        try:
            learned = learn_from_recording(
                body,
                pairs,
                [(int(a) & WHOLE, int(b) & WHOLE) for a, b in views.labels(segments)],
                start,
                skews_ns=[pair.skew_ns for pair in pairs],
                progress=progress,
            )
        except CalibrationError:
            learned = None  # nothing to learn from: the start-up pose's calibration remains
    if learned is not None:
        segments = _segments(learned, views.time_ns)
    return RecordingPlan(
        segments,
        None if settings.hindsight == "none" else views.labels(segments),
        () if learned is None else learned.events,
        None if learned is None else learned.clock,
        views.difference(segments),
    )


class _Views:
    """Both views of a recording as arrays."""

    def __init__(self, body: Body, pairs: Sequence[SkeletonPair]) -> None:
        self._body, self._pairs = body, PairStacker(body).of_pairs(pairs)
        self.time_ns = self._pairs.time_ns

    def difference(self, segments: Sequence[tuple[Calibration, slice]]) -> float:
        """Metres; see :attr:`RecordingPlan.views_differ`."""
        apart = np.linalg.norm(self._pairs.a - self._b_in_a(segments), axis=2)
        seen = np.isfinite(apart).any(axis=1)
        return float(np.median(median_of_known(apart[seen]))) if seen.any() else float("nan")

    def _b_in_a(self, segments: Sequence[tuple[Calibration, slice]]) -> NDArray[np.float64]:
        return np.concatenate([one.a_from_b.apply(self._pairs.b[own]) for one, own in segments])

    def labels(self, segments: Sequence[tuple[Calibration, slice]]) -> NDArray[np.int64]:
        """(T, 2) exchange codes with doubt, given these calibrations."""
        pairs = self._pairs
        views, states = (pairs.a, self._b_in_a(segments)), (pairs.states_a, pairs.states_b)
        reported = reported_pairs(self._body, views, states, segments[0][0].a_from_b.translation)
        labels = relabel_sequence(self._body, reported, self.time_ns)
        return with_doubt(labels.codes, labels.doubt)


def _segments(
    learned: LearnedCalibration, time_ns: NDArray[np.int64]
) -> tuple[tuple[Calibration, slice], ...]:
    """The spans of a learned calibration as slices of the pairs."""
    firsts = [0, *(int(np.searchsorted(time_ns, span.first_ns)) for span in learned.spans[1:])]
    ends = [*firsts[1:], len(time_ns)]
    spans = zip(learned.spans, firsts, ends, strict=True)
    return tuple((span.calibration, slice(first, end)) for span, first, end in spans if first < end)
