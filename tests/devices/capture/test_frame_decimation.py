"""Decimation: two trackers get the same moments."""

from itertools import pairwise

import pytest

from devices.capture.frame_decimation import FrameDecimation
from devices.capture.sensor_pair import TwoSensors
from devices.capture.stream_pairing import LivePairing
from devices.events import Event
from tests.helpers.scripted_sensor import ScriptedSensor
from tests.helpers.slow_trackers import run_slow_trackers

MS = 1_000_000
PERIOD_NS = 33_333_333


@pytest.mark.parametrize("tracking_ms", [(20, 20), (40, 40), (20, 60), (60, 20)])
@pytest.mark.parametrize("latency_ms", [0, 100, 200])
def test_frames_that_both_trackers_can_process_are_paired_and_new(bus, latency_ms, tracking_ms):
    a, b = tracking_ms
    outcome = run_slow_trackers(
        bus, color_latency_ns=latency_ms * MS, tracking_ns=(a * MS, b * MS), seconds=12.0
    )
    assert outcome.paired >= 0.99
    assert outcome.age_ns <= max(tracking_ms) * MS + PERIOD_NS
    assert outcome.step == (1 if max(tracking_ms) < 33 else 2)


def test_without_a_cable_the_same_moments_survive_too(bus):
    outcome = run_slow_trackers(bus, tracking_ns=(60 * MS, 40 * MS), cable=False, seconds=12.0)
    assert outcome.paired >= 0.99
    assert outcome.age_ns <= 60 * MS + PERIOD_NS


@pytest.mark.parametrize(("tracking_ms", "step"), [(10, 1), (31, 1), (34, 2), (60, 2), (70, 3), (1000, 32)])
def test_the_step_follows_from_the_slowest_tracker(tracking_ms, step):
    decimation = FrameDecimation(30)
    for index in range(30):
        for sensor, ms in (("a", 10), ("b", 10_000 if index < 2 else tracking_ms)):
            decimation.tracked(sensor, ms * MS)
    assert decimation.step == step
    assert decimation.interval_ns == step * decimation.period_ns
    assert (decimation.slowest, decimation.slowest_s) == (
        ("b", pytest.approx(tracking_ms / 1000)) if step > 1 else ("", 0)
    )


def test_a_tracker_that_recovers_gets_every_frame_again_and_a_short_hitch_changes_nothing():
    decimation, steps = FrameDecimation(30), []
    for ms in [20] * 20 + [200, 200] + [20] * 20 + [50] * 10 + [20] * 90:
        decimation.tracked("a", ms * MS)
        steps.append(decimation.step)
    assert set(steps[:42]) == {1}
    assert 2 in steps
    assert steps[-1] == 1
    assert sum(first != later for first, later in pairwise(steps)) == 2


@pytest.mark.parametrize("second_ms", [40, 80])
def test_two_trackers_that_wait_for_one_gpu_in_turn_keep_one_rate(second_ms):
    decimation, steps = FrameDecimation(30), []
    for index in range(1300):
        behind = decimation.step < 3  # the GPU is busy with 80 ms for both
        first, second = (80, 80) if behind else ((40, second_ms), (second_ms, 40))[index // 7 % 2]
        decimation.tracked("a", first * MS)
        decimation.tracked("b", second * MS)
        steps.append(decimation.step)
    changes = [index for index in range(1, len(steps)) if steps[index] != steps[index - 1]]
    if second_ms == 80:
        assert set(steps[changes[0] :]) == {3}
    # Where both seem fast enough, more frames are tried after 5 s, then after 10, 20 and 40.
    assert len(changes) <= 1 + 2 * 4


def _moments(decimation, sensor, times_ns, clock_ns, ppm=0.0):
    return [
        decimation.moment(sensor, round(at_ns * (1 + ppm * 1e-6)) + clock_ns, at_ns + 15 * MS)
        for at_ns in times_ns
    ]


@pytest.mark.parametrize("clock_ns", [0, 12_345_678_901, -500 * MS])
def test_both_count_the_same_moments_whatever_their_clocks_say(clock_ns):
    decimation = FrameDecimation(30)
    times = [10**12 + index * PERIOD_NS for index in range(200)]
    a, b = [], []
    for at_ns in times:
        a += _moments(decimation, "a", [at_ns], 0)
        if at_ns != times[50]:  # a frame that B missed
            b += _moments(decimation, "b", [at_ns + 160_000], 10**12 + clock_ns)
    del a[50]
    assert a == b
    assert [later - first for first, later in pairwise(a)].count(2) == 1


def test_clocks_that_drift_apart_for_an_hour_stay_on_one_grid():
    decimation = FrameDecimation(30)
    off = 0
    for index in range(108_000):
        at_ns = 10**12 + index * PERIOD_NS
        (a,) = _moments(decimation, "a", [at_ns], 0, ppm=30.0)
        # B captures 50 ppm slower: after an hour its camera is 5.4 frames behind
        (b,) = _moments(decimation, "b", [round(10**12 + index * PERIOD_NS * (1 + 50e-6))], 7 * MS, ppm=-20.0)
        behind = index * 50e-6
        off = max(off, abs((b - a) - behind))
    assert off <= 0.75  # the hysteresis is 0.6; a period of B is 50 ppm longer


def test_a_clock_that_is_reset_finds_its_place_again():
    decimation = FrameDecimation(30)
    for index in range(200):
        at_ns = 10**12 + index * PERIOD_NS
        (a,) = _moments(decimation, "a", [at_ns], 0 if index < 90 else 10**13)
        (b,) = _moments(decimation, "b", [at_ns], 500 * MS if index < 120 else -(10**12))
        if index not in (90, 120):
            assert a == b, index


def test_pairing_is_as_patient_as_the_frames_are_few():
    pairing = LivePairing(PERIOD_NS)
    assert (pairing.max_lag_ns, pairing._gone_after_ns) == (250 * MS, 500 * MS)
    pairing.set_interval(300 * MS)
    assert (pairing.max_lag_ns, pairing._gone_after_ns) == (300 * MS, 1200 * MS)
    pairing.set_interval(PERIOD_NS)
    assert (pairing.max_lag_ns, pairing._gone_after_ns) == (250 * MS, 500 * MS)


def test_sensors_are_given_as_long_as_a_tracker_of_seconds_takes():
    decimation, told = FrameDecimation(30), list[Event]()
    sensors = TwoSensors(ScriptedSensor("a"), ScriptedSensor("b"), decimation=decimation, tell=told.append)
    sensors.poll(0.0)
    assert (sensors.step, sensors.a._stall_s) == (1, 2.0)
    for _ in range(7):
        decimation.tracked("a", 2300 * MS)
    sensors.poll(0.0)
    assert sensors.step == decimation.step > 60
    assert sensors.a._stall_s == sensors.b._stall_s == pytest.approx(4e-9 * decimation.interval_ns)
    assert [event.text.split(":")[0] for event in told] == ["The body tracker of a takes 2300 ms per frame"]
