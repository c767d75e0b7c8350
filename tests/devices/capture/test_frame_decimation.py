"""Decimation: two trackers get the same moments."""

import math
import threading
from itertools import count

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from devices.capture.frame_decimation import FrameDecimation, Newest
from devices.capture.sensor_pair import TwoSensors
from devices.events import Event
from tests.helpers.scripted_sensor import ScriptedSensor

MS = 1_000_000
PERIOD_NS = 33_333_333
SECOND_NS = 1_000_000_000


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


def _moments(decimation, sensor, times_ns, clock_ns, ppm=0.0):
    return [
        decimation.moment(sensor, round(at_ns * (1 + ppm * 1e-6)) + clock_ns, at_ns + 15 * MS)
        for at_ns in times_ns
    ]


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


# --- Frames on a thread of their own: the newest for a slow reader, none unseen without a count.


class Source:
    """Numbers that come when they are let go, and what became of them."""

    def __init__(self, fault=None):
        self.dropped, self.interrupted, self._fault = 0, threading.Event(), fault
        self._let, self._came, self._at = threading.Condition(), 0, 0

    def items(self):
        while True:
            with self._let:
                assert self._let.wait_for(lambda: self._came > self._at or self.interrupted.is_set(), 60.0)
                if self.interrupted.is_set():
                    if self._fault is not None:
                        raise self._fault
                    return
                self._at += 1
            yield self._at

    def let(self, count):
        """Lets so many more come."""
        with self._let:
            self._came += count
            self._let.notify_all()

    def interrupt(self):
        with self._let:
            self.interrupted.set()
            self._let.notify_all()

    def drop(self):
        self.dropped += 1

    def newest(self):
        return Newest(self.items(), "numbers", drop=self.drop, interrupt=self.interrupt)


@given(st.lists(st.integers(1, 5), min_size=1, max_size=8))
def test_a_reader_of_any_speed_gets_the_newest_and_the_rest_are_counted(bursts):
    source = Source()
    reader, seen = source.newest(), []
    for burst in bursts:
        source.let(burst)
        seen.append(next(reader))
    source.interrupt()
    seen += reader
    assert seen == sorted(set(seen))
    assert seen[-1] == sum(bursts), "the last one is never lost"
    assert len(seen) + source.dropped == sum(bursts)


def test_a_fault_is_raised_after_the_item_before_it():
    source = Source(fault=ValueError("unplugged"))
    reader = source.newest()
    source.let(1)
    assert next(reader) == 1
    source.interrupt()
    with pytest.raises(ValueError, match="unplugged"):
        next(reader)


def test_a_reader_that_ends_first_ends_the_thread():
    source = Source()
    reader = source.newest()
    source.let(1)
    assert next(reader) == 1
    reader.close()
    assert source.interrupted.is_set()
    assert "numbers" not in {thread.name for thread in threading.enumerate()}
    reader.close()
