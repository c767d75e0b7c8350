"""Decimation: two trackers get the same moments."""

import math
from dataclasses import replace
from itertools import count, pairwise

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from devices.capture.frame_decimation import FrameDecimation
from devices.capture.sensor_pair import TwoSensors
from devices.capture.stream_pairing import LivePairing
from devices.events import Event
from devices.sensor import Sensor, SensorFrame
from devices.simulated.real_time import PacedSensor
from tests.helpers.scripted_sensor import ScriptedSensor
from tests.helpers.slow_trackers import run_slow_trackers

MS = 1_000_000
PERIOD_NS = 33_333_333
SECOND_NS = 1_000_000_000


@pytest.mark.parametrize(
    ("latency_ms", "tracking_ms"),
    [(0, (20, 20)), (0, (60, 20)), (100, (40, 40)), (200, (20, 60)), (200, (20, 20))],
)
def test_frames_that_both_trackers_can_process_are_paired_and_new(bus, latency_ms, tracking_ms):
    a, b = tracking_ms
    outcome = run_slow_trackers(
        bus, color_latency_ns=latency_ms * MS, tracking_ns=(a * MS, b * MS), seconds=9.0
    )
    assert outcome.paired >= 0.99
    assert outcome.age_ns <= max(tracking_ms) * MS + PERIOD_NS
    assert outcome.step == (1 if max(tracking_ms) < 33 else 2)


def test_without_a_cable_the_same_moments_survive_too(bus):
    outcome = run_slow_trackers(bus, tracking_ns=(60 * MS, 40 * MS), cable=False, seconds=9.0)
    assert outcome.paired >= 0.99
    assert outcome.age_ns <= 60 * MS + PERIOD_NS


def _run(decimation, clock, seconds, took_ms):
    """Gives the results of trackers that work at the step's rate; returns the steps."""
    steps, until_ns = [], clock.now_ns + round(seconds * 1e9)
    while clock.now_ns < until_ns:
        clock.now_ns += decimation.interval_ns
        for sensor, took in took_ms(decimation.step).items():
            decimation.tracked(sensor, round(took * MS))
        steps.append(decimation.step)
    return steps


class Clock:
    now_ns = 10**12

    def __call__(self):
        return self.now_ns


@pytest.fixture
def clock():
    return Clock()


@pytest.mark.parametrize(("tracking_ms", "step"), [(10, 1), (31, 1), (34, 2), (60, 2), (70, 3), (1000, 32)])
def test_the_step_follows_from_the_slowest_tracker(tracking_ms, step, clock):
    decimation = FrameDecimation(30, clock)
    for index in range(30):
        clock.now_ns += decimation.interval_ns
        for sensor, ms in (("a", 10), ("b", 10_000 if index < 2 else tracking_ms)):
            decimation.tracked(sensor, ms * MS)
    assert decimation.step == step
    assert decimation.interval_ns == step * decimation.period_ns
    choice = decimation.choice
    assert (choice.slowest, choice.slowest_s) == (
        ("b", pytest.approx(tracking_ms / 1000)) if step > 1 else (None, 0)
    )


@given(
    fps=st.sampled_from([5, 10, 15, 30, 60, 90]),
    slow=st.floats(0.2, 6.0),
    share=st.floats(0.05, 1.0),
    swapped=st.booleans(),
)
def test_steady_trackers_get_the_most_frames_that_they_keep_up_with(fps, slow, share, swapped):
    """Of two unequal ones the slower decides, and nothing more is tried."""
    clock = Clock()
    decimation, names = FrameDecimation(fps, clock), ("b", "a") if swapped else ("a", "b")
    ms = 1000 / fps
    steps = _run(decimation, clock, 60, lambda _: {names[0]: slow * ms, names[1]: slow * share * ms})
    assert set(steps[-len(steps) // 2 :]) == {math.ceil(slow / 0.95)}


@pytest.mark.parametrize("fps", [5, 15, 30, 90])
def test_more_frames_are_tried_after_five_seconds_and_a_short_hitch_changes_nothing(fps, clock):
    decimation, ms = FrameDecimation(fps, clock), 1000 / fps
    assert set(_run(decimation, clock, 20 / fps, lambda _: {"a": 0.6 * ms})) == {1}
    assert set(_run(decimation, clock, 2 / fps, lambda _: {"a": 6 * ms})) == {1}
    assert set(_run(decimation, clock, 20 / fps, lambda _: {"a": 0.6 * ms})) == {1}
    while decimation.step == 1:
        _run(decimation, clock, 1 / fps, lambda _: {"a": 1.5 * ms})
    begun_ns = clock.now_ns
    while decimation.step > 1:
        _run(decimation, clock, 1 / fps, lambda _: {"a": 0.6 * ms})
    # Five results are needed before the five seconds begin, and they end with a result.
    assert 5e9 < clock.now_ns - begun_ns <= 5e9 + 7 * 2e9 / fps
    assert set(_run(decimation, clock, 30, lambda _: {"a": 0.6 * ms})) == {1}


@pytest.mark.parametrize("second_ms", [40, 80])
def test_two_trackers_that_wait_for_one_gpu_in_turn_keep_one_rate(second_ms, clock):
    decimation, turn = FrameDecimation(30, clock), count()

    def took(step):
        if step < 3:  # the GPU is busy with 80 ms for both
            return {"a": 80, "b": 80}
        first, second = ((40, second_ms), (second_ms, 40))[next(turn) // 7 % 2]
        return {"a": first, "b": second}

    steps = _run(decimation, clock, 120, took)
    changes = [index for index in range(1, len(steps)) if steps[index] != steps[index - 1]]
    if second_ms == 80:
        assert set(steps[changes[0] :]) == {3}
    # Where both seem fast enough, more frames are tried after 5 s, then after 10, 20, 40 and 80.
    assert len(changes) <= 1 + 2 * 5


def test_a_tracker_that_is_gone_does_not_hold_the_other_up(clock):
    decimation = FrameDecimation(30, clock)
    _run(decimation, clock, 10, lambda _: {"a": 60, "b": 15})
    assert (decimation.step, decimation.choice.slowest) == (2, "a")
    # Two seconds until it counts as gone, and five in which the other could do more.
    _run(decimation, clock, 7.5, lambda _: {"b": 15})
    assert decimation.step == 1
    decimation.restart("a")  # it is back, as slow as before: that is no attempt that failed
    _run(decimation, clock, 1, lambda _: {"a": 60, "b": 15})
    assert (decimation.step, decimation.choice.taken_back) == (2, False)


def test_the_first_results_of_a_tracker_do_not_count_when_it_is_reopened(clock):
    decimation = FrameDecimation(30, clock)
    _run(decimation, clock, 1, lambda _: {"a": 20, "b": 20})
    decimation.restart("b")
    _run(decimation, clock, 2 / 30, lambda _: {"a": 20, "b": 10_000})
    assert set(_run(decimation, clock, 1, lambda _: {"a": 20, "b": 20})) == {1}
    assert max(decimation.choice._trackers["b"].took_ns) == 20 * MS


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


def test_clocks_that_drift_apart_stay_on_one_grid():
    decimation = FrameDecimation(30)
    off = 0
    for index in range(36_000):
        at_ns = 10**12 + index * PERIOD_NS
        (a,) = _moments(decimation, "a", [at_ns], 0, ppm=30.0)
        # B captures 50 ppm slower: after twenty minutes its camera is 1.8 frames behind
        (b,) = _moments(decimation, "b", [round(10**12 + index * PERIOD_NS * (1 + 50e-6))], 7 * MS, ppm=-20.0)
        behind = index * 50e-6
        off = max(off, abs((b - a) - behind))
    assert off <= 0.75  # the hysteresis is 0.6; a period of B is 50 ppm longer


@given(
    phase=st.floats(-0.4, 0.4),
    reset=st.sampled_from("ab"),
    moved_ms=st.one_of(st.integers(-600, 600), st.integers(-(10**9), 10**9)),
    told=st.booleans(),
    lost=st.sets(st.tuples(st.sampled_from("ab"), st.integers(1, 199)), max_size=20),
)
def test_a_clock_that_is_reset_finds_its_place_again(phase, reset, moved_ms, told, lost):
    """Unless it is told, a reset by less than half a second cannot be seen."""
    assume(told or abs(moved_ms) > 600)
    decimation, clock_ns = FrameDecimation(30), {"a": 0, "b": 500 * MS}
    for index in range(200):
        if index == 90:
            clock_ns[reset] += moved_ms * MS
            if told:
                decimation.restart(reset)
        numbers = {}
        for sensor in "ab":
            if (sensor, index) not in lost:
                at_ns = 10**12 + round((index + (phase if sensor == "b" else 0)) * PERIOD_NS)
                (numbers[sensor],) = _moments(decimation, sensor, [at_ns], clock_ns[sensor])
        # One frame may look late; the one that shows the reset may be lost.
        if not 90 <= index < 96 and len(numbers) == 2:
            assert numbers["a"] == numbers["b"], index


@given(
    late=st.sampled_from("ab"),
    phase=st.floats(-0.4, 0.4),
    begin=st.integers(1, 60),
    held=st.integers(1, 90),
    apart=st.floats(0.0, 0.6),
)
def test_frames_that_were_held_up_change_no_number(late, phase, begin, held, apart):
    """They come ``apart`` of a period after each other until no more wait."""
    decimation, arrivals, free_ns = FrameDecimation(30), [], 10**12 + (begin + held) * PERIOD_NS
    for index in range(400):
        for name in "ab":
            at_ns = host_ns = 10**12 + round((index + (phase if name == "b" else 0)) * PERIOD_NS)
            if name == late and index >= begin:
                host_ns = max(at_ns, free_ns)
                free_ns = host_ns + round(apart * PERIOD_NS)
            arrivals.append((host_ns, index, name, at_ns))
    for host_ns, index, name, at_ns in sorted(arrivals):
        assert decimation.moment(name, at_ns, host_ns) == index


def test_two_sensors_of_one_name_have_clocks_and_trackers_of_their_own():
    frames = [SensorFrame(k * PERIOD_NS, depth=np.ones((2, 2), np.uint16)) for k in range(60)]

    class Recording(Sensor):
        name = "output.mkv"

        def __init__(self, begins_ns):
            self.begins_ns = begins_ns

        def frames(self):
            return (replace(frame, time_ns=self.begins_ns + frame.time_ns) for frame in frames)

    decimation, now = FrameDecimation(30), [100.0]
    decimation.choice.step = 2

    def wait(_, seconds):
        now[0] += seconds

    for begins_ns in (10 * SECOND_NS, 500 * SECOND_NS):
        now[0] = 100.0
        played = PacedSensor(Recording(begins_ns), None, decimation, clock=lambda: now[0], wait=wait)
        assert len(list(played.frames())) == 30


def test_pairing_is_as_patient_as_the_frames_are_few():
    pairing = LivePairing(PERIOD_NS)
    assert (pairing.max_lag_ns, pairing._gone_after_ns) == (300 * MS, 500 * MS)
    pairing.set_interval(300 * MS)
    assert (pairing.max_lag_ns, pairing._gone_after_ns) == (300 * MS, 1200 * MS)
    pairing.set_interval(PERIOD_NS)
    assert (pairing.max_lag_ns, pairing._gone_after_ns) == (300 * MS, 500 * MS)


def test_sensors_are_given_as_long_as_a_tracker_of_seconds_takes(clock):
    decimation, told = FrameDecimation(30, clock), list[Event]()
    sensors = TwoSensors(ScriptedSensor("a"), ScriptedSensor("b"), decimation=decimation, tell=told.append)
    sensors.poll(0.0)
    assert (sensors.step, sensors.a._stall_s) == (1, 2.0)
    for _ in range(7):
        clock.now_ns += 2300 * MS
        decimation.tracked("a", 2300 * MS)
    sensors.poll(0.0)
    assert sensors.step == decimation.step > 60
    assert sensors.a._stall_s == sensors.b._stall_s == pytest.approx(4e-9 * decimation.interval_ns)
    assert [event.text.split(":")[0] for event in told] == ["The body tracker of a takes 2300 ms per frame"]
