"""The quality of each second of a session."""

from collections.abc import Iterable, Iterator, Sequence
from itertools import groupby
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from recordings.data.session_data import SessionData
from recordings.quality.doubtful_time import LIMBS, UNCERTAIN, seen_people, time_of_frames, uncertain_limbs
from recordings.quality.figures import calibration_figures
from recordings.quality.limits import GOOD, USABLE, beside, graded
from recordings.quality.verdict import DOUBTFUL, OFFSETS, not_trusted

Word = Literal["good", "usable", "poor"]
_WORDS: tuple[Word, ...] = ("poor", "usable", "good")


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
    """The good seconds, those that follow each other as one stretch; the last one ends with the session."""
    spans: list[Span] = []
    last = max(float(session.rows.time_ns[-1]) * 1e-9, seconds[-1].start)
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
    """The quality of each second, by limits of the verdict; the last one may be shorter.

    A second is judged by the share of it without frames or without a person, in which one view alone has the
    person, and in which a wrist or ankle is uncertain; by the median distance of the views; and by the offset
    of the clocks. Before the calibration, and with one that is provisional or of too few frames, it is poor.
    Of equally bad reasons, it has the first of these.
    """
    rows = session.rows
    lasts, starts = time_of_frames(rows), rows.time_ns * 1e-9
    end = starts[-1] + lasts[-1]
    edges = np.append(np.arange(max(1.0, np.ceil(end))), max(end, 1e-9))
    length = np.diff(edges)

    def share(doubtful: NDArray[np.bool_]) -> NDArray[np.float64]:
        """(S,) of the time of each second."""
        spent = np.cumsum(np.where(doubtful, lasts, 0.0))
        knots = np.stack((starts, starts + lasts), axis=1).ravel()
        total = np.stack((np.append(0.0, spent[:-1]), spent), axis=1).ravel()
        return np.asarray(np.diff(np.interp(edges, knots, total)) / length)

    seen, uncertain = seen_people(rows), uncertain_limbs(rows)
    without_frames = 1.0 - share(np.ones(len(rows), dtype=bool))
    nobody, alone = share(np.asarray(~seen.any(axis=0))), share(seen[0] ^ seen[1])
    of_limbs = np.stack([share(limb) for limb in (*uncertain.T, uncertain.any(axis=1))])
    uncalibrated = share(np.arange(len(rows), dtype=np.int64) < session.first_compared_frame)
    apart = 1e3 * rows.disagreement
    frames = np.searchsorted(starts, edges)
    clock, why = session.clock, not_trusted(calibration_figures(session.calibrations[-1][1]))

    def reasons(k: int) -> Iterator[tuple[Word, str]]:
        def doubt(part: float, words: str) -> tuple[Word, str]:
            return graded(part, DOUBTFUL), f"{words} for {100.0 * part:.0f} % of it"

        yield doubt(without_frames[k], "no frame")
        yield doubt(nobody[k], "nobody in view")
        yield ("poor" if uncalibrated[k] > DOUBTFUL[0] else "good"), "before the calibration"
        yield ("poor" if why else "good"), why
        yield doubt(alone[k], "one view alone has the person")
        known = apart[frames[k] : frames[k + 1]]
        known = known[np.isfinite(known)]
        if len(known):
            median = float(np.median(known))
            yield graded(median, (GOOD, USABLE)), f"the views are {beside(median, GOOD, USABLE)} mm apart"
        *limbs, any_limb = of_limbs[:, k]
        limb = list(LIMBS)[int(np.argmax(limbs))]
        yield doubt(any_limb, f"a limb, mostly the {limb}, is uncertain by more than {UNCERTAIN:.0f} mm")
        if clock is not None:
            certain = abs(clock["offset_ms"]) - 2.0 * clock["sd_ms"]
            yield graded(certain, OFFSETS), f"the clocks are {clock['offset_ms']:+.0f} ms apart"

    def judged(k: int) -> SecondQuality:
        word, reason = min(reasons(k), key=lambda each: _WORDS.index(each[0]))
        return SecondQuality(float(edges[k]), word, "" if word == "good" else reason)

    return tuple(judged(k) for k in range(len(length)))
