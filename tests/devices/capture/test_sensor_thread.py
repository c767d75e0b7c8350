"""Sensors on their own threads, driven step by step. No test sleeps; each waits for an event."""

import gc
import signal
import threading
import time
import weakref

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from devices.capture.sensor_pair import TwoSensors
from devices.capture.sensor_state import FrameBorder, SensorState, TimeLimits
from devices.capture.sensor_thread import SensorThread
from devices.capture.stream_pairing import LivePairing
from devices.sensor import AbsentError, DeviceError, LinkFigures, SensorFrame, SensorWrapper
from fusion.body import AZURE_KINECT, KINECT_V2
from fusion.errors import BodyError
from fusion.skeleton import Skeleton
from tests.helpers.scripted_sensor import PATIENCE_S, ScriptedSensor, all_threads_end, frame_at, unplugged
from tests.helpers.two_clocks import INTERVAL_NS
from tests.helpers.waiting import eventually


def _after(sensor):
    """Returns when the sensor's thread has processed everything that was put before."""
    done = threading.Event()
    sensor.put(done.set)
    assert done.wait(PATIENCE_S)


@pytest.fixture
def sensor():
    return ScriptedSensor()


@pytest.fixture
def thread(sensor):
    with SensorThread(sensor, keep=2) as running:
        yield running


def test_the_newest_frames_win_and_drops_are_counted(sensor, thread):
    sensor.put(*(frame_at(index) for index in range(100)))
    _after(sensor)
    assert [arrival.frame.time_ns for arrival in thread.take()] == [98, 99]
    assert thread.take() == []
    assert (thread.received, thread.dropped) == (100, 98)


def test_dropped_frames_are_freed(sensor, thread):
    frames = [frame_at(index) for index in range(50)]
    alive = [weakref.ref(frame) for frame in frames]
    sensor.put(*frames)
    frames.clear()
    _after(sensor)
    thread.take()
    gc.collect()
    # Delivery adds the arrival time to a copy, so of what was put the generator holds the last at most.
    assert sum(ref() is not None for ref in alive) <= 1


def test_a_skeleton_of_another_body_ends_the_sensor_with_one_line(sensor, thread):
    """As of a class of a user; opening it anew mends nothing."""
    other = SensorFrame(2, {"1": Skeleton.of(KINECT_V2, np.ones((25, 3)))})
    sensor.put(frame_at(1, people=True), other)
    assert eventually(lambda: thread.state is SensorState.ENDED)
    with pytest.raises(
        BodyError, match=r"^A skeleton of 000123 has the 25 joints of kinect_v2, not the 32 of"
    ):
        thread.take()
    assert thread.received == 1


def test_frames_get_their_time_of_arrival(sensor):
    """Those that have one keep it, unless it is of another clock."""
    now_ns, own_ns = 42_500_000_000, 42_400_000_000
    with SensorThread(sensor, clock=lambda: 42.5) as thread:
        sensor.put(frame_at(1), frame_at(2, host_ns=own_ns), frame_at(3, host_ns=time.time_ns()))
        _after(sensor)
        assert [arrival.frame.host_ns for arrival in thread.take()] == [now_ns, own_ns, now_ns]
        assert [event.text for event in thread.events()] == [
            f"{sensor.name}: its host_ns is not on time.perf_counter_ns; the arrivals here are used."
        ]


@pytest.mark.skipif(not hasattr(signal, "pthread_kill"), reason="needs POSIX signals")
def test_ctrl_c_while_a_sensor_opens_closes_it(earlier_threads):
    pressed = threading.Event()

    class Interrupted(ScriptedSensor):
        def __enter__(self):
            signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)
            assert pressed.wait(PATIENCE_S)
            return super().__enter__()

        def interrupt(self):
            pressed.set()

    sensor = Interrupted()
    thread = SensorThread(sensor)
    with pytest.raises(KeyboardInterrupt):
        thread.open()
    assert thread.state is SensorState.CLOSED
    assert all_threads_end(earlier_threads)
    assert sensor.opened == sensor.closed


def test_a_lost_sensor_is_reopened_until_it_is_back(sensor):
    pauses = []

    def pause(stopping, seconds):
        pauses.append(seconds)
        return stopping.is_set()

    with SensorThread(sensor, limits=TimeLimits(retry_s=1.5), wait=pause) as thread:
        sensor.put(frame_at(1))
        _after(sensor)
        sensor.open_faults = [of("No Kinect with serial 000123.") for of in (AbsentError, *[DeviceError] * 3)]
        sensor.put(unplugged())
        sensor.put(frame_at(2))
        _after(sensor)
        assert [arrival.frame.time_ns for arrival in thread.take()] == [1, 2]
        assert pauses == [1.5, 1.5, 3.0, 6.0, 10.0], "each opening that is refused leaks in pyk4a"
        assert thread.returns == 1
        assert thread.state is SensorState.RUNNING
        told = [event.text for event in thread.events()]
        sensor.put(unplugged())
        _after(sensor)
        assert pauses[5:] == [1.5], "short again after one that succeeded"
    # Lost, tried again in vain (told once, not four times), back.
    assert ["unplugged" in told[0], "No Kinect" in told[1], "back" in told[2]] == [True] * 3
    assert len(told) == 3
    assert (sensor.opened, sensor.closed) == (3, 3)


def test_a_lost_sensor_is_reported_before_its_driver_has_closed_it(sensor):
    seen = []
    with SensorThread(sensor) as thread:
        sensor.close_hook = lambda: seen.append(thread.state)
        sensor.put(unplugged())
        assert eventually(lambda: bool(seen), PATIENCE_S)
    assert seen[0] is SensorState.LOST
    assert sum("unplugged" in event.text for event in thread.events()) == 1


def test_a_slow_first_frame_is_allowed_and_reported_once(sensor):
    now = [100.0]
    with SensorThread(
        sensor, limits=TimeLimits(60.0, 2.0), clock=lambda: now[0], wait=lambda *_: False
    ) as thread:
        for opening in range(2):
            now[0] += 1.9
            assert all("is back" in event.text for event in thread.events())
            now[0] += 57.9
            assert thread.state is SensorState.RUNNING
            assert [event.text for event in thread.events()] == ["000123: waiting for its first frame."]
            assert thread.events() == []
            if opening == 0:
                sensor.put(frame_at(1), unplugged())
                _after(sensor)
                thread.events()
        now[0] += 0.3
        assert thread.state is SensorState.STALLED
        assert ["stalls: no frame for 60 s" in event.text for event in thread.events()] == [True]


def test_a_sensor_whose_tracker_takes_seconds_is_not_called_stalled(sensor):
    now = [100.0]
    with SensorThread(sensor, limits=TimeLimits(stall_s=2.0), clock=lambda: now[0]) as thread:
        sensor.put(frame_at(0))
        _after(sensor)
        thread.set_interval(2.5)
        now[0] = 109.9
        assert thread.state is SensorState.RUNNING
        now[0] = 110.1
        assert ["stalls: no frame for 10 s" in event.text for event in thread.events()] == [True]
        thread.set_interval(1 / 30)
        sensor.put(frame_at(1))
        _after(sensor)
        assert ["gives frames again" in event.text for event in thread.events()] == [True]
        now[0] = 112.2
        assert thread.state is SensorState.STALLED


def test_a_source_that_ends_is_ended_not_lost(sensor):
    with SensorThread(sensor) as thread:
        sensor.put(frame_at(1))
        _after(sensor)
        thread.arrival.clear()
        sensor.put(None)
        assert thread.arrival.wait(PATIENCE_S)
        assert thread.state is SensorState.ENDED
        assert [arrival.frame.time_ns for arrival in thread.take()] == [1]
    assert sensor.opened == 1


class DamagedRecording(ScriptedSensor):
    recorded = True


@pytest.mark.parametrize("wrapped", [False, True])
def test_damage_ends_a_recording_once_and_no_cable_is_blamed(wrapped):
    recording = DamagedRecording("a.db3")
    with SensorThread(SensorWrapper(recording) if wrapped else recording) as thread:
        recording.put(frame_at(1), frame_at(2), DeviceError("a.db3 is damaged (…)."))
        assert eventually(lambda: thread.state is SensorState.ENDED, PATIENCE_S)
        assert [arrival.frame.time_ns for arrival in thread.take()] == [1, 2]
        assert [event.text for event in thread.events()] == ["a.db3 is damaged (…). Going on without it."]
        assert (recording.opened, recording.closed, thread.returns) == (1, 1, 0)


def test_a_fault_of_the_program_reaches_the_reader(sensor, thread):
    thread.arrival.clear()
    sensor.put(ZeroDivisionError("a bug"))
    assert thread.arrival.wait(PATIENCE_S)
    with pytest.raises(DeviceError, match=r"000123 failed .*\(ZeroDivisionError: a bug\)") as told:
        thread.take()
    assert isinstance(told.value.__cause__, ZeroDivisionError)


def test_closing_a_driver_that_hangs_leaves_it_behind(sensor):
    release = threading.Event()
    thread = SensorThread(sensor).open()
    sensor.put(lambda: release.wait(PATIENCE_S))
    assert not thread.close(within_s=0.01)
    assert any("left behind" in event.text for event in thread.events())
    with pytest.raises(DeviceError, match="left behind"):
        thread.open()
    release.set()


def test_a_lost_sensor_says_so_and_closing_ends_its_retries(sensor):
    reached = threading.Event()

    def pause(stopping, _seconds):
        reached.set()
        return stopping.wait(PATIENCE_S)

    thread = SensorThread(sensor, wait=pause).open()
    assert not thread.gone
    sensor.put(unplugged())
    assert reached.wait(PATIENCE_S)
    assert thread.state is SensorState.LOST
    assert thread.gone
    assert thread.close(PATIENCE_S)
    assert sensor.opened == 1


def test_a_class_that_only_has_a_sensors_methods_runs():
    class OwnSensor:
        name, body, intrinsics, warnings = "own", AZURE_KINECT, None, ()

        def __enter__(self):
            return self

        def __exit__(self, *error): ...

        def frames(self):
            yield from map(frame_at, (1, 2))

    thread = SensorThread(OwnSensor())
    with thread:
        assert eventually(lambda: thread.state is SensorState.ENDED)
        assert [arrival.frame.time_ns for arrival in thread.take()] == [1, 2]
    assert (thread.sensor.body, thread.dropped, thread.sensor.link) == (AZURE_KINECT, 0, None)


# --- Faults of two live sensors, as the pairs show them.


class _Bench:
    """Two scripted sensors that run; ``both`` puts a frame on each."""

    def __init__(self, **settings):
        self.a, self.b = ScriptedSensor("000123"), ScriptedSensor("000456")
        self.two = TwoSensors(self.a, self.b, limits=TimeLimits(retry_s=0.05), **settings)
        self.start = round(1e9 * settings.get("clock", time.perf_counter)())
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


@pytest.mark.parametrize(("lag_ms", "words"), [(90, None), (150, "which wait for them"), (900, "too late")])
@pytest.mark.parametrize(
    ("late", "origin", "blamed"),
    [
        ("a", {}, "USB controller"),
        ("b", {"link": LinkFigures()}, "network"),
        ("a", {"simulated": True}, "This machine is too slow"),
        ("b", {"recorded": True}, "disk or this machine is too slow"),
    ],
)
def test_a_sensor_whose_frames_come_late_is_named_once(late, origin, blamed, lag_ms, words):
    """And of what may be the cause, only what this sensor has; the other one is on USB."""
    pairing, told = LivePairing(INTERVAL_NS), []
    sensors = ScriptedSensor("000123"), ScriptedSensor("000456")
    vars(sensors["ab".index(late)]).update(origin)
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
    assert words is None or (words in told[0] and blamed in told[0])
    for cause in ("USB", "network", "disk", "too slow"):
        assert cause in blamed or cause not in str(told)


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


@pytest.mark.parametrize("frame", [None, (0, {})])
def test_what_is_no_frame_ends_a_sensor_of_ones_own(frame):
    with pytest.raises(BodyError, match=rf"^The frames of 000123 .*; got a {type(frame).__name__}\."):
        FrameBorder(ScriptedSensor(), print).check(frame)


def test_a_wrong_shape_is_told_with_the_name_of_the_sensor(sensor, thread):
    sensor.put(lambda: Skeleton.of(AZURE_KINECT, np.ones((32, 2))))
    with pytest.raises(BodyError, match=r"^000123: azure_kinect has 32 joints; .* shape \(32, 2\)\."):
        eventually(lambda: bool(thread.take()), PATIENCE_S)


@pytest.mark.parametrize("tracked_by", ["", "k4abt"])
@pytest.mark.parametrize("far", [1000.0, -1.0, np.nan])
@given(before=st.sampled_from([0, 1, 29]), more=st.booleans())
def test_skeletons_without_a_joint_are_told_once_unless_one_came(far, tracked_by, before, more):
    before += 30 * more
    sensor, told = ScriptedSensor(), []
    sensor.tracked_by = tracked_by
    border = FrameBorder(sensor, told.append)
    positions = np.full((32, 3), far)
    lost = SensorFrame(0, {"1": Skeleton.of(AZURE_KINECT, positions)})
    positions[7] = 1.0
    found = SensorFrame(0, {"1": Skeleton.of(AZURE_KINECT, positions)})
    for frame in (*[lost] * before, found, *[lost] * 60):
        border.check(frame)
    assert len(told) == (more and not tracked_by)
    assert all(text.startswith("000123: its skeletons have no joint") for text in told)
