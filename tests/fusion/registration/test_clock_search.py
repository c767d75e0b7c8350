"""The search for the offset of two clocks by the speeds of the joints, with known offsets."""

import numpy as np
import pytest

from devices.simulated.kinect import PERSON, simulated_pair
from fusion.body import AZURE_KINECT
from fusion.registration import clock_search
from fusion.registration.clock_search import View, find_clock_offset
from tests.helpers.two_views import FRAME_NS


def views_of(motion, seed, seconds=20.0):
    a, b, _ = simulated_pair(motion=motion, seed=seed, body=AZURE_KINECT, angle_deg=90.0, seconds=seconds)
    seen = [[(f.time_ns, f.people[PERSON]) for f in side.frames() if PERSON in f.people] for side in (a, b)]
    one, two = (
        View(
            np.array([time for time, _ in each]),
            np.array([skeleton.positions for _, skeleton in each]),
            np.array([skeleton.states for _, skeleton in each]),
        )
        for each in seen
    )
    return one, two


@pytest.mark.parametrize("motion", ["walk", "arms"])
def test_an_offset_of_seconds_is_found_to_a_fraction_of_a_frame(motion):
    a, b = views_of(motion, 61)
    for offset_ns in (100_000_000, -2_000_000_000, 7_000_000_000):
        found = find_clock_offset(AZURE_KINECT, a, b._replace(time_ns=b.time_ns - offset_ns))
        assert found is not None
        assert found.offset_ns == pytest.approx(offset_ns, abs=FRAME_NS / 3)
        assert found.sd_ns < FRAME_NS / 3


def test_recordings_that_begin_at_their_own_zero_on_another_day_are_aligned():
    a, b = views_of("walk", 62)
    a, b = a._replace(time_ns=a.time_ns[30:], positions=a.positions[30:], states=a.states[30:]), b
    found = find_clock_offset(AZURE_KINECT, a, b._replace(time_ns=b.time_ns + 86_400_000_000_000))
    assert found is not None
    assert found.offset_ns == pytest.approx(-86_400_000_000_000, abs=FRAME_NS / 3)


def test_long_recordings_are_compared_where_they_overlap(monkeypatch):
    monkeypatch.setattr(clock_search, "_LONGEST_SPAN_NS", 20_000_000_000)
    a, b = views_of("walk", 67, seconds=80.0)
    early = b.chosen(np.flatnonzero(b.time_ns < 25_000_000_000))
    found = find_clock_offset(AZURE_KINECT, a, early._replace(time_ns=early.time_ns - 400_000_000))
    assert found is not None
    assert found.offset_ns == pytest.approx(400_000_000, abs=FRAME_NS / 3)


def test_people_who_hardly_move_tell_no_offset():
    a, b = views_of("idle", 63)
    assert find_clock_offset(AZURE_KINECT, a, b._replace(time_ns=b.time_ns + 2_000_000_000)) is None


def test_two_people_with_different_movements_have_no_certain_offset():
    """An offset is applied if it is certain to two frames (:mod:`devices.files`)."""
    a, b = views_of("arms", 64)[0], views_of("walk", 65)[1]
    found = find_clock_offset(AZURE_KINECT, a, b)
    assert found is None or found.sd_ns > 4 * FRAME_NS


def test_one_stray_time_does_not_make_the_search_long():
    a, b = views_of("walk", 66)
    time_ns = a.time_ns + 1_700_000_000_000_000_000
    time_ns[0] = 0
    found = find_clock_offset(AZURE_KINECT, a._replace(time_ns=time_ns), b)
    assert found is not None
    assert found.offset_ns == pytest.approx(1_700_000_000_000_000_000, abs=FRAME_NS / 3)
