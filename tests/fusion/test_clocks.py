"""The offset between the sensors' clocks: by regression, and by search over the speeds of the joints."""

from functools import cache

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from devices.pairing import clock_by_motion
from devices.simulated.kinect import PERSON, simulated_pair
from fusion.body import AZURE_KINECT, KINECT_V2
from fusion.calibration.calibration import calibrate
from fusion.clocks import search as clock_search
from fusion.clocks.course import find_clock_course
from fusion.clocks.lag import LagEstimator, lag_of
from fusion.clocks.search import View, find_clock_offset
from fusion.plan import plan_recording
from fusion.setup import FuserSettings
from fusion.skeleton import Skeleton, SkeletonPair
from tests.helpers.continuous_motion import RATES, as_pairs, as_view, views_at
from tests.helpers.laws import COSTLY
from tests.helpers.two_views import A_FROM_B, FRAME_NS, standing


def swaying(delay, count=900, speed=1.0, drift=0.0):
    """A person who walks about; B captures later by ``delay`` seconds than its time stamps say."""
    rng = np.random.default_rng(8)
    still, bias = standing(KINECT_V2), rng.normal(0.0, 0.03, (25, 3))

    def at(seconds):
        return still + speed * np.array([0.5 * np.sin(1.7 * seconds), 0.0, 0.4 * np.cos(1.1 * seconds)])

    pairs = []
    for k in range(count):
        seconds = k * FRAME_NS * 1e-9
        late = at(seconds + delay + drift * seconds) + bias
        views = (at(seconds), A_FROM_B.inverse().apply(late))
        a, b = (
            Skeleton.of(KINECT_V2, view + rng.normal(0.0, 0.004, view.shape), None, k * FRAME_NS)
            for view in views
        )
        pairs.append(SkeletonPair(a, b, k * FRAME_NS))
    return pairs


@pytest.mark.parametrize("rate", RATES)
@COSTLY
@given(
    delay=st.floats(-0.12, 0.12),
    phase=st.sampled_from([0.0, 0.3, 0.5]),
    lost=st.sampled_from([0.0, 0.1]),
    seed=st.integers(0, 99),
)
def test_a_delay_is_found_at_any_frame_rate(rate, delay, phase, lost, seed):
    """Live and in a recording, whatever part of a frame B is known to be later, with lost frames."""
    seconds = np.arange(40 * rate) / rate
    seconds = seconds[np.random.default_rng(seed).random(len(seconds)) >= lost]
    skew = phase / rate
    pairs = as_pairs(*views_at(seconds, seconds + skew + delay, seed), seconds, skew)
    found = lag_of(KINECT_V2, pairs, A_FROM_B)
    assert found is not None
    assert found.offset_ns * 1e-9 == pytest.approx(delay, abs=0.005)
    live = LagEstimator(KINECT_V2)
    for pair in pairs:
        live.observe(pair, A_FROM_B)
    # It is not iterated: noise of the velocities of such calm motion takes away up to a quarter.
    assert live.estimate is not None
    assert live.estimate.offset_ns * 1e-9 == pytest.approx(delay, abs=0.005 + 0.25 * abs(delay))


@COSTLY
@given(rate=st.sampled_from(RATES), offset=st.floats(0.5, 20.0), seed=st.integers(0, 99))
@example(rate=5, offset=0.5, seed=0)
@example(rate=13, offset=-0.7, seed=1)
@example(rate=120, offset=5.0, seed=0)
def test_an_offset_of_seconds_is_found_at_any_frame_rate(rate, offset, seed):
    seconds = 30.0 + np.arange(60 * rate) / rate
    seconds_b = seconds + 0.4 / rate
    a, b = views_at(seconds, seconds_b, seed)
    found = find_clock_offset(KINECT_V2, as_view(a, seconds), as_view(b, seconds_b - offset))
    assert found is not None
    assert found.offset_ns * 1e-9 == pytest.approx(offset, abs=0.005)


def test_a_clock_that_runs_slow_is_found_as_skew():
    found = lag_of(KINECT_V2, swaying(0.0, 1800, drift=500e-6), A_FROM_B)
    assert found is not None
    assert found.rate_ppm == pytest.approx(500.0, abs=3.0 * found.rate_sd_ppm)
    assert found.rate_sd_ppm < 50.0


def test_a_person_who_stands_still_gives_no_clock_offset():
    assert lag_of(KINECT_V2, swaying(0.02, speed=0.02), A_FROM_B) is None
    assert lag_of(KINECT_V2, [], A_FROM_B) is None


def test_a_live_session_reports_the_offset_once():
    estimator = LagEstimator(KINECT_V2)
    told = [news for pair in swaying(0.012) if (news := estimator.observe(pair, A_FROM_B)) is not None]
    assert len(told) == 1
    assert told[0].offset_ns == pytest.approx(12e6, abs=2e6)
    assert "+1" in told[0].event


@cache
def views_of(motion):
    a, b, _ = simulated_pair(motion=motion, seed=61, body=AZURE_KINECT, angle_deg=90.0, seconds=20.0)
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


def long_views(seconds):
    """What both sensors saw of a person who moves all the time; B captures between A's frames."""
    seconds_a = 30.0 + np.arange(30 * seconds) / 30.0
    seconds_b = seconds_a + 0.4 / 30.0
    a, b = views_at(seconds_a, seconds_b)
    return as_view(a, seconds_a), as_view(b, seconds_b)


@pytest.mark.filterwarnings("error")
def test_the_longest_times_do_not_overflow():
    far_ns = -8_999_000_000_000_000_000
    a, b = views_of("walk")
    found = find_clock_offset(AZURE_KINECT, a._replace(time_ns=a.time_ns + far_ns), b)
    assert found is not None
    assert found.offset_ns == pytest.approx(far_ns, abs=FRAME_NS / 3)


def test_long_recordings_are_compared_where_they_overlap(monkeypatch):
    monkeypatch.setattr(clock_search, "_LONGEST_SPAN_NS", 20_000_000_000)
    a, b = long_views(80)
    early = b.chosen(np.flatnonzero(b.time_ns < 55_000_000_000))
    found = find_clock_offset(KINECT_V2, a, early._replace(time_ns=early.time_ns - 400_000_000))
    assert found is not None
    assert found.offset_ns == pytest.approx(400_000_000, abs=FRAME_NS / 3)


@pytest.mark.filterwarnings("error")
def test_the_growth_of_an_offset_is_found():
    a, b = long_views(50)
    for ppm, far_ns in ((1000.0, 0), (5000.0, 0), (0.0, 8_999_000_000_000_000_000)):
        times = (b.time_ns * (1.0 + 1e-6 * ppm)).astype(np.int64) - 400_000_000
        a, fast = a._replace(time_ns=a.time_ns + far_ns), b._replace(time_ns=times + far_ns)
        found = find_clock_offset(KINECT_V2, a, fast)
        assert found is not None
        found = find_clock_course(a, fast, found)
        assert found.steps == ()
        assert found.rate_ppm == pytest.approx(-ppm, abs=3.0 * found.rate_sd_ppm)
        assert found.rate_sd_ppm < 200.0
        np.testing.assert_allclose(
            fast.time_ns + found.at(fast.time_ns) - far_ns, b.time_ns, atol=FRAME_NS / 5
        )
        assert find_clock_course(a, fast.chosen(np.arange(250)), found) is found, "too short"


@pytest.mark.parametrize("lost", [[300], [200, 201, 900]])
def test_lost_frames_of_a_file_timed_by_frame_numbers_are_steps(lost):
    a, b = long_views(50)
    numbered = b.chosen(np.setdiff1d(np.arange(len(b.time_ns)), lost))
    numbered = numbered._replace(time_ns=b.time_ns[: len(numbered.time_ns)])
    found = clock_by_motion(KINECT_V2, a, numbered)
    assert found is not None
    true = np.delete(b.time_ns, lost)
    off = np.abs(numbered.time_ns + found.at(numbered.time_ns) - true)
    assert found.steps
    assert sum(longer for _, longer in found.steps) == pytest.approx(len(lost) * FRAME_NS, abs=1e6)
    assert np.mean(off < FRAME_NS / 2) > 0.95  # a step is found to within a second


def test_a_rate_is_found_in_half_a_minute_without_an_offset():
    a, b = long_views(30)
    slow = b._replace(time_ns=(b.time_ns[0] + 0.996 * (b.time_ns - b.time_ns[0])).astype(np.int64))
    found = clock_by_motion(KINECT_V2, a, slow)
    assert found is not None
    assert found.steps == ()
    np.testing.assert_allclose(slow.time_ns + found.at(slow.time_ns), b.time_ns, atol=FRAME_NS / 3)
    assert clock_by_motion(KINECT_V2, a, b) is None


def test_people_who_hardly_move_tell_no_offset():
    a, b = views_of("idle")
    assert find_clock_offset(AZURE_KINECT, a, b._replace(time_ns=b.time_ns + 2_000_000_000)) is None


def test_two_people_with_different_movements_have_no_certain_offset():
    """An offset is applied if it is certain to two frames (:mod:`devices.pairing`)."""
    a, b = views_of("arms")[0], views_of("walk")[1]
    found = find_clock_offset(AZURE_KINECT, a, b)
    assert found is None or found.sd_ns > 4 * FRAME_NS


@COSTLY
@given(
    first=st.floats(0.0, 15.0), seconds=st.floats(1.5, 4.5), offset=st.floats(1.0, 8.0), swapped=st.booleans()
)
@example(first=14.0, seconds=4.0, offset=3.0, swapped=False)
def test_a_piece_as_long_as_a_repetition_has_no_certain_clock(first, seconds, offset, swapped):
    """The other view has seen all of it, a part, or nothing: squats look alike, and take as long as it."""
    a, b = views_of("squat")
    seen = a.chosen(np.flatnonzero(a.time_ns < a.time_ns[0] + 12_000_000_000))
    from_first = (b.time_ns - b.time_ns[0]) * 1e-9
    piece = b.chosen(np.flatnonzero((from_first >= first) & (from_first < first + seconds)))
    views = [seen, piece._replace(time_ns=piece.time_ns - round(1e9 * offset))]
    found = find_clock_offset(AZURE_KINECT, *(views[::-1] if swapped else views))
    right = -offset if swapped else offset
    assert found is None or found.offset_ns * 1e-9 == pytest.approx(right, abs=0.04)


@pytest.mark.parametrize("swapped", [False, True])
def test_equal_first_times_on_another_day_are_no_evidence(swapped):
    """Steps of another moment look alike, too; but the parts of the recording contradict."""
    a, b = (
        view.chosen(np.flatnonzero(np.abs(1e-9 * (view.time_ns - view.time_ns[0]) - middle) < 1.5))
        for view, middle in zip(views_of("walk"), (4.5, 9.0), strict=True)
    )
    views = [a, b._replace(time_ns=b.time_ns - 86_400_000_000_000)]
    assert find_clock_offset(AZURE_KINECT, *(views[::-1] if swapped else views)) is None


@pytest.mark.parametrize(("delay", "found"), [(0.05, True), (2.5, False)])
def test_a_recording_states_no_clock_where_its_views_show_other_motions(delay, found):
    """The regression has an offset for those of two people, too."""
    pairs = swaying(delay)
    plan = plan_recording(KINECT_V2, pairs, FuserSettings(), calibrate(KINECT_V2, swaying(0.0)[:30], "known"))
    assert lag_of(KINECT_V2, pairs, A_FROM_B) is not None
    assert (plan.clock is not None) == found == (plan.views_differ < 0.12)
    if found:
        assert plan.clock.offset_ns == pytest.approx(1e9 * delay, abs=2e6)
