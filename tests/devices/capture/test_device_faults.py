"""Faults of two live sensors, as the pairs show them."""

import signal
import threading
import time

import pytest

from devices.capture.sensor_pair import TwoSensors
from devices.capture.sensor_state import SensorState, TimeLimits
from devices.capture.sensor_thread import SensorThread
from devices.capture.stream_pairing import LivePairing
from devices.sensor import DeviceError, SensorFrame
from tests.helpers.scripted_sensor import PATIENCE_S, ScriptedSensor, all_threads_end, frame_at, unplugged
from tests.helpers.two_clocks import INTERVAL_NS
from tests.helpers.waiting import eventually


class _Bench:
    """Two scripted sensors that run; ``both`` puts a frame on each."""

    def __init__(self, **settings):
        self.a, self.b = ScriptedSensor("000123"), ScriptedSensor("000456")
        self.two = TwoSensors(self.a, self.b, limits=TimeLimits(retry_s=0.05), **settings)
        self.start = time.perf_counter_ns()
        self.index = 0
        self.b_clock_ns = 0

    def put(self, *sensors):
        self.index += 1
        host_ns = self.start + self.index * INTERVAL_NS
        for sensor in sensors:
            clock_ns = self.b_clock_ns if sensor is self.b else 0
            sensor.put(frame_at(self.index * INTERVAL_NS + clock_ns, host_ns))

    def next_pair(self):
        return self.until(lambda pairs: len(pairs) > 0)[-1]

    def until(self, done):
        pairs = []
        end = time.monotonic() + PATIENCE_S
        while not done(pairs):
            assert time.monotonic() < end, "nothing came"
            pairs += self.two.poll()
        return pairs


def test_fusion_goes_on_with_the_sensor_that_is_left_and_takes_the_other_back():
    # Pairing that by itself would wait forever: what goes on does so because the sensor is known to be gone.
    bench = _Bench(pairing=LivePairing(max_lag_ns=10**18, gone_after_ns=10**18))
    with bench.two as two:
        for _ in range(3):
            bench.put(bench.a, bench.b)
            assert bench.next_pair().b is not None
        bench.b.open_faults = [DeviceError("No Kinect with serial 000456.")] * 10_000
        bench.b.put(unplugged("000456"))
        bench.until(lambda _: two.b.state is SensorState.LOST)
        bench.put(bench.a)
        assert bench.next_pair().b is None
        assert two.b.returns == 0
        bench.b.open_faults.clear()
        bench.until(lambda _: two.b.returns == 1)
        # Its clock restarts when it is plugged in, here slightly behind its last time.
        bench.b_clock_ns = -200_000_000

        def paired_again(pairs):
            # A's frames go out alone until B's first one is here, so both go on.
            bench.put(bench.a, bench.b)
            return any(pair.a is not None and pair.b is not None for pair in pairs)

        bench.until(paired_again)
        assert two.figures.offset_ns == -200_000_000
        told = " ".join(event.text for event in two.events())
    assert "unplugged" in told
    assert "Going on without it" in told
    assert "000456 is back" in told


def test_frames_of_two_openings_that_wait_for_the_reader_keep_their_times():
    """The loop is held up; B is plugged in again meanwhile, with the clock of the epoch."""
    bench = _Bench()
    with bench.two as two:
        for _ in range(3):
            bench.put(bench.a, bench.b)
            pairs = [bench.next_pair()]
        bench.put(bench.b)  # it waits for A's
        bench.b.put(unplugged("000456"))
        bench.b_clock_ns = 10**18
        for _ in range(3):
            bench.put(bench.a, bench.b)
        assert eventually(lambda: (two.a.received, two.b.received) == (6, 7), PATIENCE_S)
        pairs += bench.until(lambda pairs: sum(pair.a is not None for pair in pairs) == 3)
    first_ns, *times = [pair.time_ns for pair in pairs]
    assert all(0 < time_ns - first_ns <= 4 * INTERVAL_NS for time_ns in times)
    assert [pair.b is not None for pair in pairs][-3:] == [True] * 3


def test_a_pause_of_the_reader_is_not_one_of_the_sensors():
    now = [100.0]
    bench = _Bench(clock=lambda: now[0])

    def put_and_wait():
        received = bench.two.a.received + 1
        bench.put(bench.a, bench.b)
        end = time.monotonic() + PATIENCE_S
        while min(bench.two.a.received, bench.two.b.received) < received:
            assert time.monotonic() < end, "nothing came"

    with bench.two as two:
        put_and_wait()
        assert len(two.poll()) == 1
        for _ in range(8):  # as many as wait at most, over more time than a sensor may be silent
            now[0] += 0.1
            put_and_wait()
        assert [pair.b is not None for pair in two.poll()] == [True] * 8
        assert (two.a.dropped, two.b.dropped) == (0, 0)


@pytest.mark.parametrize(("lag_ms", "words"), [(90, None), (150, "which wait for them"), (900, "too late")])
@pytest.mark.parametrize("late", ["a", "b"])
def test_a_sensor_whose_frames_come_late_is_named_once(late, lag_ms, words):
    pairing, told = LivePairing(INTERVAL_NS), []
    sensors = ScriptedSensor("000123"), ScriptedSensor("000456")
    two = TwoSensors(*sensors, pairing=pairing, tell=lambda event: told.append(event.text))
    for index in range(60):
        host_ns = index * INTERVAL_NS
        for side in ("a", "b"):
            frame = SensorFrame(host_ns, host_ns=host_ns)
            pairing.add(side, frame, host_ns + (lag_ms * 1_000_000 if side == late else 0))
        two.poll(0.0)
    name, other = ("000123", "000456") if late == "a" else ("000456", "000123")
    expected = [] if words is None else [f"The frames of {name} come {lag_ms} ms later than those of {other}"]
    assert [text[: len(expected[0])] for text in told] == expected
    assert words is None or words in told[0]


def test_a_sensor_that_does_not_open_closes_the_other(earlier_threads):
    bench = _Bench()
    bench.a.open_faults = [DeviceError("No Kinect with serial 000123.")]
    with pytest.raises(DeviceError, match="No Kinect with serial 000123"):
        bench.two.__enter__()
    assert (bench.b.opened, bench.b.closed) == (1, 1)
    assert all_threads_end(earlier_threads)


def test_the_subordinate_starts_first():
    order = []

    class Noting(ScriptedSensor):
        def __enter__(self):
            order.append(self.name)
            return super().__enter__()

    for delay_ns in (-160_000, 160_000, None):
        with TwoSensors(Noting("a"), Noting("b"), pairing=LivePairing(sync_delay_ns=delay_ns)):
            pass
    assert order == ["a", "b", "b", "a", "b", "a"]


def test_both_sources_ended_end_the_pairs():
    bench = _Bench()
    with bench.two as two:
        bench.put(bench.a, bench.b)
        bench.put(bench.a)
        bench.a.put(None)
        bench.b.put(None)
        pairs = list(two.pairs())
    assert [(pair.a is not None, pair.b is not None) for pair in pairs] == [(True, True), (True, False)]


def test_tracker_hangs_at_close_and_the_other_sensor_gives_no_more_frames(earlier_threads):
    told = []
    release, closed = threading.Event(), threading.Event()
    a, b = ScriptedSensor("a"), ScriptedSensor("b")
    two = TwoSensors(a, b, tell=lambda event: told.append(event.text))
    a.close_hook = lambda: release.wait(PATIENCE_S) and None
    with two:
        b.close_hook = closed.set
        a.put(frame_at(1))
        b.put(frame_at(1))
        for _ in two.pairs():
            two.stop()
        # while the session closes and A hangs
        b.put(*(frame_at(2 + index) for index in range(100)))
        assert closed.wait(PATIENCE_S), "B is closed before A's end is waited for"
    assert two.b.dropped == 0
    assert told == ["a does not close; it is left behind. Unplug it before using it again."]
    assert [event.text for event in two.events()] == told
    release.set()
    assert all_threads_end(earlier_threads)


@pytest.mark.skipif(not hasattr(signal, "pthread_kill"), reason="needs POSIX signals")
@pytest.mark.parametrize("moment", ["opening a", "opening b", "between frames", "in a pair", "closing"])
def test_ctrl_c_at_any_moment(earlier_threads, moment):
    class Interrupted(ScriptedSensor):
        def __enter__(self):
            if moment == f"opening {self.name}":
                _press_ctrl_c()
            return super().__enter__()

        def __exit__(self, *exc_info):
            super().__exit__()
            if moment == "closing" and self.name == "a":
                _press_ctrl_c()

    a, b = Interrupted("a"), Interrupted("b")
    two = TwoSensors(a, b)
    with pytest.raises(KeyboardInterrupt):
        _session(two, a, b, moment)
    assert (two.a.state, two.b.state) == (SensorState.CLOSED, SensorState.CLOSED)
    # After Ctrl-C interrupts the wait, the thread finishes by itself.
    assert all_threads_end(earlier_threads)
    for sensor in (a, b):
        assert sensor.opened == sensor.closed


def _session(two, a, b, moment):
    if moment == "between frames":
        b.put(_press_ctrl_c)
    if moment in ("in a pair", "closing"):
        a.put(frame_at(1))
        b.put(frame_at(1))
    with two:
        for _ in two.pairs():
            if moment == "in a pair":
                _press_ctrl_c()
            if moment == "closing":
                return


def _press_ctrl_c():
    signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)


def test_frames_are_counted_from_when_both_are_open():
    bench = _Bench()
    came = threading.Event()

    class Loading(ScriptedSensor):
        """A sensor whose tracker loads for as long as the other gives a hundred frames."""

        def __enter__(self):
            bench.b.put(*(frame_at(index * INTERVAL_NS) for index in range(100)), came.set)
            assert came.wait(PATIENCE_S)
            return super().__enter__()

    bench.a = Loading("000123")
    bench.two = TwoSensors(bench.a, bench.b)
    with bench.two as two:
        assert (two.b.received, two.b.dropped) == (0, 0)
        for _ in range(3):
            bench.put(bench.a, bench.b)
            bench.next_pair()
        assert (two.b.received, two.b.dropped) == (3, 0)
        assert two.figures.unmatched_b == 0


@pytest.mark.parametrize("waits_for", ["its body tracker, which loads its network", ""])
def test_a_sensor_that_still_loads_is_not_called_hung(earlier_threads, waits_for):
    release = threading.Event()

    class Loading(ScriptedSensor):
        def __enter__(self):
            assert release.wait(PATIENCE_S)
            return super().__enter__()

    sensor = Loading()
    sensor.waits_for = waits_for
    thread = SensorThread(sensor, limits=TimeLimits(open_s=0.01))
    with pytest.raises(DeviceError, match="did not open in"):
        thread.open()
    (told,) = (event.text for event in thread.events())
    assert (f"it waits for {waits_for}" if waits_for else "it is left behind. Unplug it") in told
    assert ("Unplug" in told) == (waits_for == "")
    release.set()
    assert all_threads_end(earlier_threads)
