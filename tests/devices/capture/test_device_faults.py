"""Faults of live sensors, from the bus up to the pairs that fusion gets.

The module is long because it contains one test per fault.
"""

from __future__ import annotations

import gc
import os
import signal
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from itertools import islice, pairwise
from pathlib import Path

import pytest

from devices.azure import pyk4a_access
from devices.azure.kinect import KinectSensor
from devices.azure.pyk4a_access import connected_kinects
from devices.azure.settings import KinectSettings
from devices.azure.tracking.body_tracker import BodyTracker, TrackerSettings
from devices.capture.connected import choose_two
from devices.capture.sensor_pair import TwoSensors
from devices.capture.sensor_state import SensorState, TimeLimits
from devices.capture.sensor_thread import SensorThread
from devices.capture.stream_pairing import LivePairing
from devices.capture.usb import usb_kinects
from devices.pairing import FramePair
from devices.sensor import DeviceError
from tests.helpers.scripted_sensor import PATIENCE_S, ScriptedSensor, all_threads_end, frame_at, unplugged
from tests.helpers.standin_camera import VirtualTime
from tests.helpers.standin_library import Standin
from tests.helpers.standin_pyk4a import Bus, Device
from tests.helpers.two_clocks import INTERVAL_NS, SECOND_NS, run, shots
from tests.helpers.usb_tree import plug_in


def _kinect(serial: str = "000123", **settings: object) -> KinectSensor:
    return KinectSensor(serial, KinectSettings(**settings), track=False)  # type: ignore[arg-type]


def test_no_device(bus: Bus) -> None:
    assert bus.devices == []
    with pytest.raises(DeviceError, match=r"No Kinect is connected\. Plug in two"):
        choose_two(connected_kinects())
    with pytest.raises(DeviceError, match=r"No Kinect with serial 000123, and no other\. Plug it in"):
        _kinect().__enter__()


def test_one_device(bus: Bus) -> None:
    bus.devices = [Device("000456")]
    with pytest.raises(DeviceError, match="Only one Kinect is connected, 000456; fusion needs two"):
        choose_two(connected_kinects())
    with pytest.raises(DeviceError, match=r"No Kinect with serial 000123\. Connected: 000456"):
        _kinect().__enter__()


def test_device_busy(bus: Bus) -> None:
    bus.devices = [Device("000123", busy=True), Device("000456")]
    with pytest.raises(DeviceError, match=r"000123 cannot be opened: it is busy.*k4aviewer.*Open: 000456"):
        _kinect().__enter__()
    with pytest.raises(DeviceError, match=r"cannot be opened.*busy"):
        choose_two(connected_kinects())
    assert bus.open_serials == []


def test_no_permission(bus: Bus, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    bus.devices = [Device("000123", busy=True)]  # the SDK gives no reason in both cases
    plug_in(tmp_path)
    monkeypatch.setattr(os, "access", lambda *_: False)
    monkeypatch.setattr(pyk4a_access, "usb_kinects", lambda: usb_kinects(tmp_path))
    with pytest.raises(DeviceError, match=r"no permission for .*007.*99-k4a\.rules"):
        _kinect().__enter__()


def test_unplugged_at_open(bus: Bus, monkeypatch: pytest.MonkeyPatch) -> None:
    device = Device("000123")
    bus.devices = [device]
    check_jack = KinectSensor._check_jack

    def pull_the_plug(self: KinectSensor) -> None:
        device.plugged = False
        check_jack(self)

    monkeypatch.setattr(KinectSensor, "_check_jack", pull_the_plug)
    with pytest.raises(DeviceError, match="Kinect 000123"):
        _kinect().__enter__()
    assert device.opened_by is None


def test_unplugged_mid_stream(bus: Bus) -> None:
    device = Device("000123")
    bus.devices = [device]
    with _kinect() as sensor:
        frames = sensor.frames()
        next(frames)
        device.plugged = False
        with pytest.raises(DeviceError, match="Kinect 000123 was unplugged or lost its power. Plug it in"):  # noqa: RUF043
            next(frames)
    assert device.opened_by is None


def test_unplugged_mid_stream_beside_another(
    bus: Bus, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    device = Device("000123")
    bus.devices = [device, Device("000456")]
    plug_in(tmp_path, "000456", number=8)
    plug_in(tmp_path, "000123", number=7)
    monkeypatch.setattr(pyk4a_access, "usb_kinects", lambda: usb_kinects(tmp_path))
    with _kinect() as sensor:
        frames = sensor.frames()
        next(frames)
        device.plugged = False
        (tmp_path / "sys/bus/usb/devices/2-7/serial").write_text("")
        with pytest.raises(DeviceError, match="unplugged"):
            next(frames)


@pytest.mark.filterwarnings("error::pytest.PytestUnraisableExceptionWarning")
def test_unplugged_at_close(bus: Bus) -> None:
    device = Device("000123")
    bus.devices = [device]
    sensor = _kinect().__enter__()
    device.plugged = False
    sensor.__exit__()
    assert device.opened_by is None
    gc.collect()  # pyk4a's own destructor must find nothing left to stop: it would raise
    assert sensor.warnings == [], "libk4a reports success"
    device.plugged = True
    with sensor:  # the same sensor can be opened again
        next(sensor.frames())


@pytest.mark.parametrize("fault", ["silent", "blind"])
def test_stream_stalls(bus: Bus, fault: str) -> None:
    device = Device("000123")
    bus.devices = [device]
    with _kinect(stall_s=5.0) as sensor:
        frames = sensor.frames()
        next(frames)
        setattr(device, fault, True)
        with pytest.raises(DeviceError, match=r"stalls: no depth for 5 s.*USB 3"):
            next(frames)


def test_stream_of_a_subordinate_stalls(bus: Bus) -> None:
    device = Device("000123", jacks=(True, False), silent=True)
    bus.devices = [device]
    with _kinect(sync="subordinate", start_s=30.0, stall_s=5.0) as sensor:
        with pytest.raises(DeviceError, match=r"no depth for 30 s.*check the master"):
            next(sensor.frames())
        device.silent = False
        frames = sensor.frames()
        next(frames)
        device.silent = True
        with pytest.raises(DeviceError, match="no depth for 5 s"):
            next(frames)


@pytest.mark.parametrize(
    ("status", "message"), [(2, "body tracker stalls"), (1, r"body tracker failed \(status 1\)")]
)
def test_tracker_stalls_or_crashes_to_an_error_code(
    bus: Bus, standin: Standin, status: int, message: str
) -> None:
    bus.native, bus.devices = standin.library, [Device("000123")]
    with KinectSensor("000123", tracker=TrackerSettings(library=standin.path)) as sensor:
        frames = sensor.frames()
        assert len(list(islice(frames, 2))) == 2
        standin.pop_status = status
        with pytest.raises(DeviceError, match=message):
            list(islice(frames, 5))
        frames.close()


def test_clock_reset() -> None:
    a, b = shots("a", 4), shots("b", 4, clock_ns=900 * SECOND_NS)
    reset_ns = b[60].frame.time_ns
    for index in range(60, len(b)):
        frame = b[index].frame
        b[index] = replace(b[index], frame=replace(frame, time_ns=frame.time_ns - reset_ns))
    pairing = LivePairing(INTERVAL_NS)
    pairs = run(pairing, a, b)
    assert pairing.figures.resets == 1
    assert [pair.a for pair in pairs if pair.a is not None] == [shot.frame for shot in a]
    assert all(pair.b is not None for pair in pairs[65:])


def test_one_sensor_5_fps_slower() -> None:
    a, b = shots("a", 10), shots("b", 10, fps=25)
    pairing = LivePairing(INTERVAL_NS)
    pairs = run(pairing, a, b)
    assert len(pairs) == len(a)
    # Never two frames in a row without B: the slower sensor leaves one of six alone.
    alone = [pair.b is None for pair in pairs]
    assert not any(first and second for first, second in pairwise(alone))


class _Bench:
    """Two scripted sensors that run; ``both`` puts a frame on each."""

    def __init__(self, **settings: object) -> None:
        self.a, self.b = ScriptedSensor("000123"), ScriptedSensor("000456")
        self.two = TwoSensors(self.a, self.b, limits=TimeLimits(retry_s=0.05), **settings)  # type: ignore[arg-type]
        self.start = time.perf_counter_ns()
        self.index = 0
        self.b_clock_ns = 0

    def put(self, *sensors: ScriptedSensor) -> None:
        self.index += 1
        host_ns = self.start + self.index * INTERVAL_NS
        for sensor in sensors:
            clock_ns = self.b_clock_ns if sensor is self.b else 0
            sensor.put(frame_at(self.index * INTERVAL_NS + clock_ns, host_ns))

    def next_pair(self) -> FramePair:
        return self.until(lambda pairs: len(pairs) > 0)[-1]

    def until(self, done: Callable[[list[FramePair]], bool]) -> list[FramePair]:
        pairs: list[FramePair] = []
        end = time.monotonic() + PATIENCE_S
        while not done(pairs):
            assert time.monotonic() < end, "nothing came"
            pairs += self.two.poll()
        return pairs


def test_fusion_goes_on_with_the_sensor_that_is_left_and_takes_the_other_back() -> None:
    # Pairing that by itself would wait forever: what goes on does so because the sensor is known to be gone.
    bench = _Bench(pairing=LivePairing(max_wait_ns=10**18, gone_after_ns=10**18))
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

        def paired_again(pairs: list[FramePair]) -> bool:
            # A's frames go out alone until B's first one is here, so both go on.
            bench.put(bench.a, bench.b)
            return any(pair.a is not None and pair.b is not None for pair in pairs)

        bench.until(paired_again)
        assert two.figures.offset_ns == -200_000_000
        told = " ".join(event.text for event in two.events())
    assert "unplugged" in told
    assert "Going on without it" in told
    assert "000456 is back" in told


def test_a_pause_of_the_reader_is_not_one_of_the_sensors() -> None:
    now = [100.0]
    bench = _Bench(clock=lambda: now[0])

    def put_and_wait() -> None:
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


def test_a_sensor_that_does_not_open_closes_the_other() -> None:
    bench = _Bench()
    bench.a.open_faults = [DeviceError("No Kinect with serial 000123.")]
    with pytest.raises(DeviceError, match="No Kinect with serial 000123"):
        bench.two.__enter__()
    assert (bench.b.opened, bench.b.closed) == (1, 1)
    assert all_threads_end()


def test_the_subordinate_starts_first() -> None:
    order: list[str] = []

    class Noting(ScriptedSensor):
        def __enter__(self) -> ScriptedSensor:
            order.append(self.name)
            return super().__enter__()

    for delay_ns in (-160_000, 160_000, None):
        with TwoSensors(Noting("a"), Noting("b"), pairing=LivePairing(sync_delay_ns=delay_ns)):
            pass
    assert order == ["a", "b", "b", "a", "b", "a"]


def test_both_sources_ended_end_the_pairs() -> None:
    bench = _Bench()
    with bench.two as two:
        bench.put(bench.a, bench.b)
        bench.put(bench.a)
        bench.a.put(None)
        bench.b.put(None)
        pairs = list(two.pairs())
    assert [(pair.a is not None, pair.b is not None) for pair in pairs] == [(True, True), (True, False)]


def test_tracker_hangs_at_close_and_the_other_sensor_gives_no_more_frames() -> None:
    told: list[str] = []
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
    assert all_threads_end()


@pytest.mark.skipif(not hasattr(signal, "pthread_kill"), reason="needs POSIX signals")
@pytest.mark.parametrize("moment", ["opening a", "opening b", "between frames", "in a pair", "closing"])
def test_ctrl_c_at_any_moment(moment: str) -> None:
    class Interrupted(ScriptedSensor):
        def __enter__(self) -> ScriptedSensor:
            if moment == f"opening {self.name}":
                _press_ctrl_c()
            return super().__enter__()

        def __exit__(self, *exc_info: object) -> None:
            super().__exit__()
            if moment == "closing" and self.name == "a":
                _press_ctrl_c()

    a, b = Interrupted("a"), Interrupted("b")
    two = TwoSensors(a, b)
    with pytest.raises(KeyboardInterrupt):
        _session(two, a, b, moment)
    assert (two.a.state, two.b.state) == (SensorState.CLOSED, SensorState.CLOSED)
    # After Ctrl-C interrupts the wait, the thread finishes by itself.
    assert all_threads_end()
    for sensor in (a, b):
        assert sensor.opened == sensor.closed


def _session(two: TwoSensors, a: ScriptedSensor, b: ScriptedSensor, moment: str) -> None:
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


def _press_ctrl_c() -> None:
    signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)


def test_unplugged_beside_another_without_a_usb_list(bus: Bus) -> None:
    # As on Windows: only the SDK's count of sensors shows that one is missing.
    bus.devices = [Device("000123"), Device("000456")]
    with _kinect("000456"), _kinect("000123") as sensor:
        frames = sensor.frames()
        next(frames)
        bus.devices[0].plugged = False
        with pytest.raises(DeviceError, match="000123 was unplugged or lost its power"):
            next(frames)


def test_an_orbbec_that_is_unplugged_shows_by_time_outs_and_is_called_so(bus: Bus) -> None:
    device = Device("CL8H741005K", orbbec=True)
    bus.devices = [device]
    device.time = VirtualTime()
    with _kinect("CL8H741005K", stall_s=3.0) as sensor:
        frames = sensor.frames()
        next(frames)
        device.plugged = False
        with pytest.raises(DeviceError, match="was unplugged"):
            next(frames)


@pytest.mark.parametrize("sync", ["standalone", "master"])
def test_a_busy_orbbec_shows_late_and_is_called_busy(bus: Bus, sync: str) -> None:
    bus.devices = [Device("CL8H741005K", orbbec=True, busy=True)]
    with pytest.raises(DeviceError, match="cannot be opened: it is busy"):
        _kinect("CL8H741005K", sync=sync, trust_jacks=False).__enter__()


def test_frames_are_counted_from_when_both_are_open() -> None:
    bench = _Bench()
    came = threading.Event()

    class Loading(ScriptedSensor):
        """A sensor whose tracker loads for as long as the other gives a hundred frames."""

        def __enter__(self) -> ScriptedSensor:
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


@pytest.mark.parametrize(
    ("waits_for", "message"),
    [
        (
            "its body tracker, which loads its network",
            "it waits for its body tracker, which loads its network",
        ),
        ("", "it is left behind. Unplug it"),
    ],
)
def test_a_sensor_that_still_loads_is_not_called_hung(waits_for: str, message: str) -> None:
    release = threading.Event()

    class Loading(ScriptedSensor):
        def __enter__(self) -> ScriptedSensor:
            assert release.wait(PATIENCE_S)
            return super().__enter__()

    sensor = Loading()
    sensor.waits_for = waits_for
    thread = SensorThread(sensor, limits=TimeLimits(open_s=0.01))
    with pytest.raises(DeviceError, match="did not open in"):
        thread.open()
    (told,) = (event.text for event in thread.events())
    assert message in told
    assert ("Unplug" in told) == (waits_for == "")
    release.set()
    assert all_threads_end()


def test_a_kinect_says_what_it_waits_for(bus: Bus, standin: Standin, monkeypatch: pytest.MonkeyPatch) -> None:
    bus.native, bus.devices = standin.library, [Device("000123")]
    heard: list[str] = []
    sensor = KinectSensor("000123", tracker=TrackerSettings(library=standin.path))
    open_tracker = BodyTracker.open

    def loading(tracker: BodyTracker, calibration: int) -> None:
        heard.append(sensor.waits_for)
        open_tracker(tracker, calibration)

    monkeypatch.setattr(BodyTracker, "open", loading)
    with sensor:
        heard.append(sensor.waits_for)
        frames = sensor.frames()
        next(frames)
        heard.append(sensor.waits_for)
        frames.close()
    assert heard == ["its body tracker, which loads its network", "", ""]
    gc.collect()
