"""Laws of the quality of each second."""

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from recordings.quality.per_second import SecondQuality, merged_by_word

words = st.sampled_from(("good", "usable", "poor"))


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
