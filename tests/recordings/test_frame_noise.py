"""Noise and what is shown of the last second, at any frame rate."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from recordings.appearance.joint_trust import _RunningMean
from recordings.data.frame_noise import FrameDeviations, frame_noise_of, noise_of

SPEED = np.array([0.6, -0.5, 0.9])  # m/s


def times_of(rng, rate, uneven, count):
    """Nanoseconds of frames whose intervals differ by up to a share of the usual one."""
    return (np.cumsum(1.0 + rng.uniform(-uneven, uneven, count)) * 1e9 / rate).astype(np.int64)


@given(
    rate=st.sampled_from([8, 10, 15, 30, 60, 90]),
    uneven=st.sampled_from([0.0, 0.1, 0.45]),
    every=st.sampled_from([1, 2]),
    sigma=st.sampled_from([0.0, 0.002, 0.02]),
    seed=st.integers(0, 99),
)
def test_noise_is_its_own_size_and_even_movement_is_none(rate, uneven, every, sigma, seed):
    """Whatever the rate, the times, and whether a sensor gives every second frame only."""
    rng, count = np.random.default_rng(seed), 3000
    time_ns = times_of(rng, rate * every, uneven, count)
    at = SPEED * (time_ns * 1e-9)[:, None, None] + rng.normal(0.0, sigma, (count, 2, 3))
    at[np.arange(count) % every != 0] = np.nan
    # The median of 1,500 correlated lengths has a standard error of 2 %.
    expected = pytest.approx(np.sqrt(3.0) * sigma, rel=0.08, abs=1e-9)
    assert frame_noise_of(at, time_ns).tolist() == [expected, expected]
    parts = FrameDeviations()
    each = [parts.add(at[k : k + 7], time_ns[k : k + 7]) for k in range(0, count, 7)]
    np.testing.assert_array_equal(np.concatenate(each), FrameDeviations().add(at, time_ns))


def test_no_noise_is_told_across_a_gap_or_below_seven_frames_per_second():
    still = np.zeros((9, 1, 3))
    still[5:] += 0.3
    time_ns = np.array([0, 1, 2, 3, 4, 19, 20, 21, 22]) * 33_333_333
    assert frame_noise_of(still, time_ns)[0] == 0.0
    assert np.isnan(frame_noise_of(still, np.arange(9) * 200_000_000)[0])
    still[3] = np.nan
    assert np.isnan(noise_of(FrameDeviations().add(np.full((10, 5, 3), np.nan), np.arange(10))))


@given(rate=st.sampled_from([5, 10, 30, 90]), uneven=st.sampled_from([0.0, 0.45]), seed=st.integers(0, 99))
def test_what_is_shown_of_the_last_second_does_not_depend_on_the_rate(rate, uneven, seed):
    """The answer to a step from 1 to 0 is an exponential in seconds: e⁻¹ remains after the time constant."""
    time_ns = times_of(np.random.default_rng(seed), rate, uneven, 4 * rate)
    values = np.concatenate(([1.0], np.zeros(len(time_ns))))
    mean = _RunningMean(0.5).add(values, np.concatenate(([0], time_ns)))[1:]
    np.testing.assert_allclose(mean, np.exp(-time_ns * 2e-9), rtol=1e-9)
