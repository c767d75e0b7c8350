"""Estimation of the offset between the sensors' clocks, with known delays."""

from dataclasses import replace

import numpy as np
import pytest

from fusion.body import KINECT_V2
from fusion.registration.clock_offset import ClockOffsetEstimator, clock_offset_of
from fusion.skeleton import Skeleton, SkeletonPair
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


@pytest.mark.parametrize("delay", [0.0, 0.012, -0.025, 0.150, -0.300])
def test_the_delay_of_a_recording_is_found_to_a_fraction_of_a_frame(delay):
    found = clock_offset_of(KINECT_V2, swaying(delay), A_FROM_B)
    assert found is not None
    # sd of the regression is 0.1 ms here; interpolation and the slope over five frames add about 1 ms
    assert found.offset_ns * 1e-9 == pytest.approx(delay, abs=0.002)
    assert found.significant == (abs(delay) > 0.0)


def test_known_skew_is_not_counted_again():
    pairs = [replace(pair, skew_ns=12_000_000) for pair in swaying(0.012)]
    found = clock_offset_of(KINECT_V2, pairs, A_FROM_B)
    assert found is not None
    assert abs(found.offset_ns) < 2e6
    assert not found.significant


def test_a_clock_that_runs_slow_is_found_as_skew():
    found = clock_offset_of(KINECT_V2, swaying(0.0, 1800, drift=500e-6), A_FROM_B)
    assert found is not None
    assert found.skew_ppm == pytest.approx(500.0, abs=3.0 * found.skew_sd_ppm)
    assert found.skew_sd_ppm < 50.0


def test_a_person_who_stands_still_gives_no_clock_offset():
    assert clock_offset_of(KINECT_V2, swaying(0.02, speed=0.02), A_FROM_B) is None
    assert clock_offset_of(KINECT_V2, [], A_FROM_B) is None


def test_a_live_session_reports_the_offset_once():
    estimator = ClockOffsetEstimator(KINECT_V2)
    told = [news for pair in swaying(0.012) if (news := estimator.observe(pair, A_FROM_B)) is not None]
    assert len(told) == 1
    assert told[0].offset_ns == pytest.approx(12e6, abs=2e6)
    assert "+1" in told[0].event
