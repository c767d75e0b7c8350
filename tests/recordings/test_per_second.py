"""Laws of the quality of each second, and of the time that is doubtful."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

from recordings.quality.doubtful_time import doubtful_seconds, seen_people
from recordings.quality.limits import graded
from recordings.quality.per_second import SecondQuality, good_spans, merged_by_word
from recordings.quality.verdict import DOUBTFUL
from tests.helpers.captures import Capture, captures

WORDS = "good", "usable", "poor"
HALF = (0.0, 0.5), (1.0, 1.8)
words = st.sampled_from(WORDS)


@given(st.lists(st.tuples(words, st.sampled_from(("", "one view alone", "no frame"))), min_size=1))
def test_merged_seconds_have_the_words_of_each_and_no_reason_that_one_lacks(of):
    seconds = [SecondQuality(float(k), *each) for k, each in enumerate(of)]
    merged = merged_by_word(seconds)
    assert all(one.word != other.word for one, other in pairwise(merged))
    for second in seconds:
        (*_, held) = (each for each in merged if each.start <= second.start)
        assert held.word == second.word
        assert held.reason in ("", second.reason)
    runs_of_one = [each for each in merged if [s.word for s in seconds].count(each.word) == 1]
    assert all(each in seconds for each in runs_of_one)


# of whole nanoseconds: else a session's last second may be of nanoseconds, and without a frame (issue 57)
RATES = st.sampled_from((5.0, 8.0, 10.0, 20.0, 25.0, 32.0, 50.0)).map(lambda rate: (rate, rate))


@given(captures(rates=RATES, seconds=st.integers(1, 5).map(float)), st.booleans())
@example(Capture(rates=(25.0, 25.0), calibrated_s=0.5), False)
@example(Capture(rates=(25.0, 25.0), present=(((0.0, 9.0),), HALF)), False)
def test_a_second_is_as_good_as_the_worst_share_of_its_frames(capture, without_feet):
    """Of nobody, of frames before the calibration and of one view alone; the first of the worst is told.

    A limb that nobody ever saw is not uncertain.
    """
    session, rate = capture.session(), int(capture.rates[0])
    if without_feet:
        session = session_without_feet(session)
    times = capture.times(0)
    a, b = (capture.sees(side, times) for side in (0, 1))
    first = min(int(np.searchsorted(times, 1e9 * capture.calibrated_s)), len(times) - 1)
    shares = np.stack([~(a | b), np.arange(len(times)) < first, a ^ b]).reshape(3, -1, rate).mean(axis=2)
    assume(np.abs(np.subtract.outer(shares, DOUBTFUL)).min() > 1e-6)
    assert len(session.quality_per_second) == capture.seconds
    for second, (nobody, uncalibrated, alone) in zip(session.quality_per_second, shares.T, strict=True):
        reasons = (
            (graded(nobody, DOUBTFUL), f"nobody in view for {100 * nobody:.0f} % of it"),
            ("poor" if uncalibrated > DOUBTFUL[0] else "good", "before the calibration"),
            (graded(alone, DOUBTFUL), f"one view alone has the person for {100 * alone:.0f} % of it"),
        )
        word, reason = max(reasons, key=lambda each: WORDS.index(each[0]))
        assert second[1:] == (word, "" if word == "good" else reason)


def session_without_feet(session):
    """That nobody ever saw; S* guesses them."""
    rows = session.rows
    feet = [k for k, name in enumerate(rows.body.joints) if "ankle" in name.lower() or "foot" in name.lower()]
    states, sigma = [each.copy() for each in (rows.states_a, rows.states_b)], rows.sigma.copy()
    for each in states:
        each[:, feet] = 0
    sigma[:, feet] = 0.3
    return replace(session, rows=replace(rows, states_a=states[0], states_b=states[1], sigma=sigma))


@given(
    captures(rates=RATES), st.lists(words, min_size=7, max_size=7), st.sampled_from((0, 3_600_000_000_000))
)
def test_good_spans_are_the_good_seconds_and_seconds_of_doubt_those_of_the_frames(capture, judged, gap_ns):
    """Whatever gap follows the third frame: it counts as three frames."""
    session = capture.session()
    rows, rate = session.rows, capture.rates[0]
    end = session.time[-1]
    seconds = [SecondQuality(float(k), word, "") for k, word in enumerate(judged) if k <= end]
    spans = good_spans(session, seconds)
    assert all(0.0 <= one.start <= one.end <= max(end, seconds[-1].start) for one in spans)
    assert all(one.end < other.start for one, other in pairwise(spans))
    for k, second in enumerate(seconds):
        inside = [span for span in spans if span.start <= k < span.end or span.start == k]
        assert bool(inside) == (second.word == "good")
    later = np.where(np.arange(len(rows)) > 2, gap_ns, 0)
    moved = replace(rows, time_ns=rows.time_ns + later)
    seen = seen_people(moved)
    found = doubtful_seconds(moved, np.full(len(rows), 0.09), seen)
    gap = 2.0 / rate if gap_ns and len(rows) > 3 else 0.0
    assert (
        found["all"] == found["views_apart"] == pytest.approx(len(rows) / rate + gap if len(rows) > 1 else 0)
    )
    assert found["one_view"] <= found["all"]
    assert found["limb_uncertain"] == 0.0
