import numpy as np
import pytest

from fusion import baselines
from fusion.accuracy import accuracy
from fusion.body import KINECT_V1
from tests.conftest import FRAME_NS, moving

DT = FRAME_NS * 1e-9
TRACKED = np.full((150, 20), 2, dtype=np.uint8)


@pytest.fixture(scope="module")
def truth() -> np.ndarray:
    return moving(KINECT_V1, 150)


def measure(found: np.ndarray, truth: np.ndarray, a: np.ndarray = TRACKED, b: np.ndarray = TRACKED):
    return accuracy(KINECT_V1, found, truth, a, b, DT)


def test_the_truth_itself_has_no_error(truth: np.ndarray) -> None:
    of = measure(truth, truth)
    assert (of.mpjpe, of.p95, of.acceleration, of.swapped) == (0.0, 0.0, 0.0, 0.0)
    assert of.bone_error < 1e-12
    assert of.lag == pytest.approx(0.0, abs=0.01)  # what a parabola makes of an uneven peak
    assert np.isnan(of.hidden_one)


def test_an_offset_is_the_error_and_nothing_else(truth: np.ndarray) -> None:
    of = measure(truth + [0.03, 0.0, 0.04], truth)
    assert of.mpjpe == pytest.approx(0.05)
    assert of.bone_error < 1e-12
    assert of.acceleration < 1e-12


def test_noise_while_still_is_jitter(truth: np.ndarray) -> None:
    rng = np.random.default_rng(0)
    of = measure(truth + rng.normal(0, 0.01, truth.shape), truth)
    # white noise against its own mean over 5: variance (1 - 1/5) a coordinate, three coordinates
    assert of.jitter == pytest.approx(0.01 * np.sqrt(3 * 0.8), rel=0.1)


def test_exchanged_sides_are_seen(truth: np.ndarray) -> None:
    found = np.array(truth)
    found[100:130] = found[100:130][:, KINECT_V1.mirror]
    assert measure(found, truth).swapped == pytest.approx(30 / 150)


@pytest.mark.parametrize("frames", [1, 3])
def test_a_delay_is_the_lag(truth: np.ndarray, frames: int) -> None:
    assert measure(
        np.concatenate([truth[:1].repeat(frames, axis=0), truth[:-frames]]), truth
    ).lag == pytest.approx(frames, abs=0.15)


def test_errors_of_hidden_joints_are_told_apart(truth: np.ndarray) -> None:
    a, b, found = TRACKED.copy(), TRACKED.copy(), np.array(truth)
    a[:, 4] = 1
    a[:, 8] = b[:, 8] = 0
    found[:, 4, 0] += 0.1
    found[:, 8, 0] += 0.2
    of = measure(found, truth, a, b)
    assert of.hidden_one == pytest.approx(0.1)
    assert of.hidden_both == pytest.approx(0.2)


def test_baselines_agree_on_two_flawless_views(truth: np.ndarray) -> None:
    for found in (
        baselines.alone(truth),
        baselines.mean(truth, truth),
        baselines.tracked_wins(truth, truth, TRACKED, TRACKED),
    ):
        np.testing.assert_allclose(found, truth, atol=1e-15)


def test_a_lost_joint_stays_where_it_was(truth: np.ndarray) -> None:
    a = np.array(truth)
    a[50:60, 7] = np.nan
    assert (baselines.alone(a)[50:60, 7] == truth[49, 7]).all()
    np.testing.assert_allclose(baselines.mean(a, truth), truth, atol=1e-15)


def test_the_tracked_view_wins(truth: np.ndarray) -> None:
    wrong, states = truth + 1.0, TRACKED.copy()
    states[:] = 1
    np.testing.assert_allclose(baselines.tracked_wins(wrong, truth, states, TRACKED), truth)


def test_the_kalman_filter_settles_on_a_still_person_and_follows_a_steady_one() -> None:
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
