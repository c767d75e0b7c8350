import numpy as np
import pytest
from scipy.stats import chi

from fusion.body import KINECT_V1
from tests.benchmarks import baselines
from tests.benchmarks.baselines import oracle
from tests.benchmarks.scores import accuracy
from tests.helpers.two_views import FRAME_NS, moving

DT = FRAME_NS * 1e-9
TRACKED = np.full((150, 20), 2, dtype=np.uint8)


@pytest.fixture(scope="module")
def truth():
    return moving(KINECT_V1, 150)


def measure(found, truth, a=TRACKED, b=TRACKED):
    return accuracy(KINECT_V1, found, truth, a, b, DT)


def test_the_truth_itself_has_no_error(truth):
    of = measure(truth, truth)
    assert (of["mpjpe"], of["p95"]) == (0.0, 0.0)
    assert of["bone_error"] < 1e-12
    assert of["lag"] == pytest.approx(0.0, abs=0.01)  # error of a parabola through an asymmetric peak
    assert np.isnan(of["hidden_one"])


def test_an_offset_is_the_error_and_nothing_else(truth):
    of = measure(truth + [0.03, 0.0, 0.04], truth)
    assert of["mpjpe"] == pytest.approx(0.05)
    assert of["bone_error"] < 1e-12


def test_noise_while_still_is_jitter(truth):
    rng = np.random.default_rng(0)
    of = measure(truth + rng.normal(0, 0.01, truth.shape), truth)
    # white noise minus its mean over 5 frames: variance (1 - 1/5) per coordinate, three coordinates
    assert of["jitter"] == pytest.approx(0.01 * np.sqrt(3 * 0.8), rel=0.1)


def test_bone_error_is_the_largest(truth):
    hand = KINECT_V1.joint("HandLeft")  # an end: one bone
    found = truth.copy()
    found[::2, hand] += 0.4 * (truth[::2, hand] - truth[::2, KINECT_V1.parents[hand]])
    expected = 0.4 * np.linalg.norm(truth[0, hand] - truth[0, KINECT_V1.parents[hand]])
    assert measure(found, truth)["bone_error"] == pytest.approx(expected)


def test_95_of_100_errors_are_smaller_than_p95(truth):
    # 3000 errors, evenly from 0 to 0.3 m, over joints and frames
    size = np.random.default_rng(3).permutation(np.linspace(0.0, 0.3, 3000)).reshape(150, 20)
    of = measure(truth + size[..., None] * [1.0, 0.0, 0.0], truth)
    assert of["p95"] == pytest.approx(0.95 * 0.3)
    assert of["mpjpe"] == pytest.approx(0.5 * 0.3)


@pytest.mark.parametrize("frames", [1, 3])
def test_a_delay_is_the_lag(truth, frames):
    assert measure(np.concatenate([truth[:1].repeat(frames, axis=0), truth[:-frames]]), truth)[
        "lag"
    ] == pytest.approx(frames, abs=0.15)


@pytest.mark.parametrize("frames", [10, 14])
def test_a_lag_at_the_end_of_the_search_range_is_nan(frames):
    # a speed that rises once and falls once: the nearer the delays, the larger the correlation
    t = np.arange(150.0)
    along = np.cumsum(np.exp(-(((t - 75.0) / 30.0) ** 2)) * 0.03)
    truth = moving(KINECT_V1, 1).repeat(150, axis=0) + along[:, None, None]
    late = np.concatenate([truth[:1].repeat(frames, axis=0), truth[:-frames]])
    assert np.isnan(measure(late, truth)["lag"])
    assert measure(np.concatenate([truth[:1].repeat(8, axis=0), truth[:-8]]), truth)["lag"] == pytest.approx(
        8
    )


def test_errors_of_hidden_joints_are_told_apart(truth):
    a, b, found = TRACKED.copy(), TRACKED.copy(), np.array(truth)
    a[:, 4] = 1
    a[:, 8] = b[:, 8] = 0
    found[:, 4, 0] += 0.1
    found[:, 8, 0] += 0.2
    of = measure(found, truth, a, b)
    assert of["hidden_one"] == pytest.approx(0.1)
    assert of["hidden_both"] == pytest.approx(0.2)


def test_baselines_agree_on_two_flawless_views(truth):
    for found in (
        baselines.alone(truth),
        baselines.mean(truth, truth),
        baselines.tracked_wins(truth, truth, TRACKED, TRACKED),
    ):
        np.testing.assert_allclose(found, truth, atol=1e-15)


def test_a_lost_joint_stays_where_it_was(truth):
    a = np.array(truth)
    a[50:60, 7] = np.nan
    assert (baselines.alone(a)[50:60, 7] == truth[49, 7]).all()
    np.testing.assert_allclose(baselines.mean(a, truth), truth, atol=1e-15)


def test_the_tracked_view_wins(truth):
    wrong, states = truth + 1.0, TRACKED.copy()
    states[:] = 1
    np.testing.assert_allclose(baselines.tracked_wins(wrong, truth, states, TRACKED), truth)


def test_the_kalman_filter_settles_on_a_still_person_and_follows_a_steady_one():
    rng = np.random.default_rng(1)
    states = np.full((300, 20), 2, dtype=np.uint8)
    line = np.arange(300)[:, None, None] * DT * np.array([0.5, 0.0, -0.2]) + rng.normal(size=(1, 20, 3))
    noisy = [line + rng.normal(0, 0.02, line.shape) for _ in range(2)]
    found = baselines.kalman(*noisy, states, states, DT)
    raw = np.linalg.norm(noisy[0] - line, axis=2)[50:].mean()
    # two views' mean alone would be raw/√2; time makes it better still
    assert np.linalg.norm(found - line, axis=2)[50:].mean() < raw / np.sqrt(2)
    # the steady-state filter of a constant velocity has no bias
    assert np.abs((found - line)[50:].mean(axis=(0, 1))).max() < 4 * 0.02 / np.sqrt(250 * 20)


def test_coverage_is_the_share_within_what_a_method_states(truth):
    rng = np.random.default_rng(1)
    sd = rng.uniform(0.005, 0.05, TRACKED.shape)
    found = truth + sd[..., None] / np.sqrt(3.0) * rng.normal(size=truth.shape)
    of = accuracy(KINECT_V1, found, truth, TRACKED, TRACKED, DT, sd)
    # 9,000 coordinates: a share of 0.68 is known to 0.005
    assert of["within_1sd"] == pytest.approx(chi(3).cdf(np.sqrt(3.0)), abs=0.015)
    assert of["within_2sd"] == pytest.approx(chi(3).cdf(2.0 * np.sqrt(3.0)), abs=0.008)
    assert np.isnan(measure(found, truth)["within_1sd"])


def test_the_oracle_takes_the_nearer_view_of_each_joint():
    truth = np.zeros((4, 3, 3))
    a, b = truth + 0.02, truth + 0.01
    a[:, 0] = 0.0
    b[2, 1] = np.nan  # holds its last position
    a[3, 2] = np.nan
    found = oracle(a, b, truth)
    np.testing.assert_array_equal(found[:, 0], 0.0)
    np.testing.assert_array_equal(found[:, 1:], 0.01)
