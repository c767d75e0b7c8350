"""The quality of each second of a session."""

from collections.abc import Iterable, Iterator, Sequence
from itertools import groupby
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from devices.findings.finding import Finding, followed, judge
from devices.findings.rules import RULES, of_error, of_views
from recordings.data.session_data import SessionData
from recordings.quality.doubtful_time import (
    DOUBTS,
    LIMBS,
    doubts_of,
    expected_error,
    seen_people,
    time_of_frames,
    uncertain_limbs,
)
from recordings.quality.figures import calibration_figures, of_finite
from recordings.quality.verdict import DOUBT_WORDS, clocks_apart, untrusted

Word = Literal["good", "usable", "poor"]
_ROUNDING = 1e-6  # seconds, by which sums of times may pass a whole second


class SecondQuality(NamedTuple):
    """The quality of one second."""

    start: float
    """Seconds since the first frame."""
    word: Word
    """``good``, ``usable`` or ``poor``: the worst of what follows."""
    reason: str
    """Why it is not good, or empty."""


class Span(NamedTuple):
    """A stretch of time, seconds since the first frame."""

    start: float
    end: float


def good_spans(session: SessionData, seconds: Sequence[SecondQuality]) -> tuple[Span, ...]:
    """The good seconds, those that follow each other as one stretch; the last one ends with a frame."""
    spans: list[Span] = []
    last = float(session.rows.time_ns[-1]) * 1e-9 + float(time_of_frames(session.rows)[-1])
    for each in seconds:
        if each.word == "good":
            end = min(each.start + 1.0, last)
            begin = spans.pop().start if spans and spans[-1].end == each.start else each.start
            spans.append(Span(begin, end))
    return tuple(spans)


def merged_by_word(seconds: Iterable[SecondQuality]) -> tuple[SecondQuality, ...]:
    """One for those that follow each other with the same word, with the reason that all of them have."""
    merged = []
    for word, each in groupby(seconds, key=lambda second: second.word):
        starts, _, reasons = zip(*each, strict=True)
        merged.append(SecondQuality(starts[0], word, reasons[0] if len(set(reasons)) == 1 else ""))
    return tuple(merged)


def good_frames(session: SessionData, seconds: Sequence[SecondQuality]) -> NDArray[np.bool_]:
    """(T,) whether a frame is in a good second."""
    good = np.array([each.word == "good" for each in seconds])
    starts = np.array([each.start for each in seconds])
    return np.asarray(good[np.searchsorted(starts, session.rows.time_ns * 1e-9, side="right") - 1])


def quality_per_second(session: SessionData) -> tuple[SecondQuality, ...]:
    """The quality of each second, by the rules of the verdict; the last one may be shorter.

    A second is judged by the share of it without frames or without a person, and of doubt, by the medians of
    the distance between the views and of the expected error of S*, and by the offset of the clocks. Before
    the calibration, and with one that is provisional or of too few frames, it is poor. Of equally bad
    reasons, it has the first in the table of rules.
    """
    rows, first = session.rows, session.first_compared_frame
    lasts, starts = time_of_frames(rows), rows.time_ns * 1e-9
    end = starts[-1] + lasts[-1]
    edges = np.append(np.arange(max(1.0, np.ceil(end - _ROUNDING))), max(end, 1e-9))
    length = np.diff(edges)

    def share(doubtful: NDArray[np.bool_]) -> NDArray[np.float64]:
        """(S,) of the time of each second."""
        spent = np.cumsum(np.where(doubtful, lasts, 0.0))
        knots = np.stack((starts, starts + lasts), axis=1).ravel()
        total = np.stack((np.append(0.0, spent[:-1]), spent), axis=1).ravel()
        return np.asarray(np.diff(np.interp(edges, knots, total)) / length)

    seen = seen_people(rows)
    doubts = doubts_of(rows, first, seen)
    of_doubts = np.stack([share(each) for each in doubts.values()])
    of_limbs = np.stack([share(limb) for limb in uncertain_limbs(rows).T])
    nobody = 1.0 - share(np.asarray(seen.any(axis=0))) if end > 0.0 else share(np.asarray(~seen.any(axis=0)))
    doubtful = share(np.any(list(doubts.values()), axis=0))
    uncalibrated = share(np.arange(len(rows), dtype=np.int64) < first)
    apart, error = 1e3 * rows.disagreement, expected_error(rows)
    frames = np.searchsorted(starts, edges)
    body = rows.body.name
    millimetres = (("views", apart, of_views(body)), ("error", error, of_error(body)))
    of_all = [*untrusted(calibration_figures(session.calibrations[-1][1])), *clocks_apart(session.clock)]

    def findings(k: int) -> Iterator[Finding]:
        yield from of_all
        if 100.0 * uncalibrated[k] > RULES["doubtful"].limits.good[1]:
            yield from judge("uncalibrated", 0, live=False, calibrated="before the calibration", calibrate="")
        yield from judge("nobody", 100.0 * nobody[k], live=False, lasts=_of_it(nobody[k]))
        limb = list(LIMBS)[int(np.argmax(of_limbs[:, k]))]
        doubt = DOUBT_WORDS[DOUBTS[int(np.argmax(of_doubts[:, k]))]].format(limb=limb)
        yield from judge("doubtful", 100.0 * doubtful[k], live=False, doubt=doubt, lasts=_of_it(doubtful[k]))
        for name, values, limits in millimetres:
            median = of_finite(np.median, values[frames[k] : frames[k + 1]])
            yield from judge(name, median, live=False, limits=limits, calibrate="")

    def judged(k: int) -> SecondQuality:
        found = followed(findings(k))
        if not found:
            return SecondQuality(float(edges[k]), "good", "")
        word = found[0].word
        return SecondQuality(float(edges[k]), "poor" if word == "unknown" else word, found[0].what)

    return tuple(judged(k) for k in range(len(length)))


def _of_it(share: float) -> str:
    return f"{100.0 * share:.0f} % of it"
