"""Outputs at the command line: ``demo``, ``live`` and ``replay --pace live``."""

import json
import socket
import sys
import threading
import time
from collections import deque
from dataclasses import replace
from uuid import uuid4

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from devices.events import Event
from devices.network.zenoh_session import LOOPBACK, ZenohAddresses, zenoh_session
from devices.sensor import DeviceError
from fusion.body import KINECT_V2
from fusion.calibration.bone_lengths import bone_lengths_of
from tests.helpers.command_line import duplex, one_line
from tests.helpers.frame_pairs import frame_pairs
from tests.helpers.fused_runs import record_fused
from tests.helpers.live_frames import BODY, frames
from tests.helpers.network import free_address, free_port
from tests.helpers.osc import messages
from tests.helpers.two_views import FRAME_NS, calibration_of
from tests.helpers.waiting import eventually
from viewer_app.addresses import zenoh_warning
from viewer_app.outputs.avatars.osc import Address, OscOutput, looked_up
from viewer_app.outputs.avatars.vmc import VmcEncoder
from viewer_app.outputs.even_samples import EvenSamples
from viewer_app.outputs.lab_streaming import LabStreamingOutput
from viewer_app.outputs.output import LATE_NS, LiveOutput, _Presence, confidence
from viewer_app.outputs.zenoh_topic import ZenohOutput
from viewer_app.running.loop import played
from viewer_app.sinks.item_queue import QueuedFrame
from viewer_app.sinks.sink import Sink


@pytest.fixture
def receiver():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as opened:
        opened.bind(("127.0.0.1", 0))
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 21)
        opened.settimeout(0.5)
        yield opened


def datagrams(receiver):
    count = 0
    try:
        while receiver.recv(2000).startswith(b"#bundle"):
            count += 1
    except TimeoutError:
        pass
    return count


def test_demo_sends_to_several_at_once_and_says_how_it_went(receiver, tmp_path, capsys):
    to, port = f"127.0.0.1:{receiver.getsockname()[1]}", free_port()
    options = ("--seconds", 2, "--depth", "none", "--no-viewer", "--save", tmp_path / "s.rrd")
    assert duplex("demo", *options, "--vmc", to, "--vrchat", to, "--websocket", port) == 0
    said = " ".join(capsys.readouterr().out.split())
    for name in (f"VMC to {to}", f"VRChat at {to}", f"WebSocket on ws://127.0.0.1:{port}"):
        assert f"Sending: {name}" in said
        assert f"{name}: " in said
    # 60 frames: two datagrams of VMC and one of VRChat each, unless a busy machine drops some
    assert 60 <= datagrams(receiver) <= 3 * 61


def test_replay_sends_at_the_recorded_times(receiver, tmp_path, capsys):
    session = record_fused(tmp_path / "s.rrd", frame_pairs(KINECT_V2, 30), calibration_of(KINECT_V2))
    to = f"127.0.0.1:{receiver.getsockname()[1]}"
    report = tmp_path / "r.json"
    assert (
        duplex("replay", session.path, "--pace", "live", "--vmc", to, "--no-viewer", "--report", report) == 0
    )
    figures = json.loads(report.read_text(encoding="utf-8"))["outputs"]
    assert [each["to"] for each in figures] == [f"VMC to {to}"]
    assert figures[0]["sent"] + figures[0]["dropped"] == 30
    assert datagrams(receiver) >= figures[0]["sent"]
    assert "frames sent" in capsys.readouterr().out


class Notebook(Sink):
    def __init__(self):
        self.now = 10.0
        self.at = []
        self.said = []

    def write(self, frame):
        del frame
        self.at.append(self.now)

    def event(self, event):
        self.said.append((len(self.at) - 1, event.text))

    def wait(self, seconds):
        self.now += seconds


def test_each_frame_is_played_when_it_is_due_and_events_with_theirs(fuser):
    book = Notebook()
    made = frames(fuser, 20)
    events = [Event("first", "INFO"), Event("later", "WARN").placed(7, 7 * FRAME_NS)]

    def slow():
        for k, frame in enumerate(made):
            book.now += 0.5 if k == 10 else 0.001  # fusing takes a millisecond, once half a second
            yield frame

    yielded = list(played(slow(), book, {}, events, clock=lambda: book.now, wait=book.wait))
    assert yielded == made
    due = book.at[0] + np.arange(20) * FRAME_NS * 1e-9
    np.testing.assert_allclose(book.at[:10], due[:10], atol=1e-9)
    np.testing.assert_allclose(
        book.at[10:], np.maximum(due[10:], due[9] + 0.5 + 0.001 * np.arange(10)), atol=1e-6
    )
    assert book.said == [(0, "first"), (7, "later")]


def test_a_name_with_addresses_of_both_kinds_is_that_of_ipv4(monkeypatch):
    """Receivers of VMC and OSC listen there."""
    both = [
        (socket.AF_INET6, socket.SOCK_DGRAM, 17, "", ("::1", 39539, 0, 0)),
        (socket.AF_INET, socket.SOCK_DGRAM, 17, "", ("127.0.0.1", 39539)),
    ]
    for found in (both, both[::-1]):
        monkeypatch.setattr(socket, "getaddrinfo", lambda *_, found=found, **__: found)
        assert looked_up(Address("localhost", 39539), "--vmc") == (socket.AF_INET, ("127.0.0.1", 39539))
    monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: both[:1])
    assert looked_up(Address("::1", 39539), "--vmc")[0] == socket.AF_INET6


def test_a_port_in_use_gives_one_line_and_opens_nothing(capsys):
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        assert duplex("demo", "--no-viewer", "--depth", "none", "--vmc", 39539, "--websocket", port) == 2
    assert f"--websocket {port}: cannot listen" in one_line(capsys)


@pytest.mark.parametrize(("option", "package"), [("lsl", "pylsl"), ("zenoh", "zenoh")])
def test_a_missing_extra_is_named(option, package, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, package, None)
    assert duplex("demo", "--no-viewer", f"--{option}", "name") == 2
    assert f'pip install "duplex-kinects[{option}]"' in one_line(capsys)


# --- Lab Streaming Layer and Zenoh, read back by an inlet and by a second session.


def lsl():
    try:
        import pylsl
    except (ImportError, RuntimeError, OSError):
        pytest.skip("no pylsl: pip install -e '.[lsl]'")
    return pylsl


def test_an_inlet_reads_joints_confidences_times_and_events(fuser):
    lsl()
    name = f"test-{uuid4().hex[:8]}"
    output = LabStreamingOutput(name, KINECT_V2, 30.0)
    import pylsl

    try:
        found = pylsl.resolve_byprop("name", name, timeout=30.0)
        assert len(found) == 1
        inlet = pylsl.StreamInlet(found[0])
        events = pylsl.StreamInlet(pylsl.resolve_byprop("name", f"{name}-events", timeout=30.0)[0])
        info = inlet.info(timeout=30.0)
        assert (info.type(), info.channel_count(), info.nominal_srate()) == ("MoCap", 100, 30.0)
        inlet.open_stream(timeout=30.0)
        events.open_stream(timeout=30.0)
        made = frames(fuser, 30)
        read = []
        for frame in made:
            output.write(frame)
            sample, stamp = inlet.pull_sample(timeout=30.0)
            read.append((sample, stamp))
        output.event(Event("sensor B lost", "WARN"))
        assert events.pull_sample(timeout=30.0)[0] == ["WARN: sensor B lost"]
        assert abs(pylsl.local_clock() - read[-1][1]) < 30.0
    finally:
        output.close()
    values = np.array([sample for sample, _ in read]).reshape(30, 25, 4)
    positions = np.array([frame.fused.positions for frame in made])
    np.testing.assert_allclose(values[..., :3], positions, atol=1e-6)
    np.testing.assert_allclose(values[..., 3], [confidence(f.fused) for f in made], atol=1e-6)
    assert (np.diff([stamp for _, stamp in read]) > 0.0).all()
    channel = info.desc().child("channels").child("channel")
    labels = []
    while not channel.empty():
        kinds = ("label", "marker", "type", "unit")
        labels.append(tuple(channel.child_value(kind) for kind in kinds))
        channel = channel.next_sibling()
    assert len(labels) == 100
    assert labels[0] == ("SpineBase_PositionX", "SpineBase", "PositionX", "meters")
    assert labels[3] == ("SpineBase_Confidence", "SpineBase", "Confidence", "normalized")
    assert info.desc().child("acquisition").child_value("manufacturer") == "duplex-kinects"


def test_a_second_session_reads_the_description_frames_and_events(fuser):
    pytest.importorskip("zenoh", reason="eclipse-zenoh is not installed: pip install -e '.[zenoh]'")
    address = free_address()
    got = {"hello": [], "frame": [], "event": []}

    def take(sample):
        got[str(sample.key_expr).rpartition("/")[2]].append(json.loads(bytes(sample.payload)))

    output = ZenohOutput("lab/person", ZenohAddresses(listen=(address,)), fuser.setup)
    try:
        with zenoh_session(ZenohAddresses(connect=(address,))) as other:
            other.declare_subscriber("lab/person/*", take)
            made = frames(fuser, 40)

            def reached():
                output.write(made[0])
                return bool(got["frame"])

            assert eventually(reached)
            assert eventually(lambda: output.counts.sent > 0)
            before = len(got["frame"])
            for frame in made:
                output.write(frame)
                assert eventually(lambda f=frame: got["frame"][-1]["time_s"] >= f.pair.time_ns * 1e-9 - 1e-5)
            output.event(Event("B lost", "WARN"))
            assert eventually(lambda: bool(got["event"]))
    finally:
        output.close()
    assert len(got["frame"]) - before >= 40
    np.testing.assert_allclose(got["frame"][-1]["positions"], made[-1].fused.positions, atol=1e-4)
    assert got["hello"][-1]["schema"] == "duplex-kinects/skeleton"
    # 1.3 s of frames: at the start, and again after a second for latecomers
    assert len(got["hello"]) <= 2
    assert got["event"][-1]["text"] == "B lost"


@pytest.mark.parametrize(
    ("listening", "reached"),
    [
        (LOOPBACK, ""),
        ("tcp/[::1]:7447", ""),
        ("udp/localhost:7447", ""),
        ("tcp/0.0.0.0:7447", "Anyone who can reach tcp/0.0.0.0:7447"),
        ("tcp/[::]:7447", "Anyone who can reach tcp/[::]:7447"),
        ("tcp/lab-pc:7447", "Anyone who can reach tcp/lab-pc:7447"),
    ],
)
def test_addresses_that_others_reach_are_warned_of(listening, reached):
    warning = zenoh_warning((LOOPBACK, listening))
    assert bool(warning) == bool(reached)
    assert warning.startswith(reached)
    assert LOOPBACK not in warning


def test_this_machine_only_unless_an_address_is_given():
    assert ZenohAddresses.of_meeting_point((), ()) == ZenohAddresses(listen=(LOOPBACK,))
    elsewhere = ("tcp/192.0.2.7:7447",)
    assert ZenohAddresses.of_meeting_point((), elsewhere) == ZenohAddresses(connect=elsewhere)
    with pytest.raises(DeviceError, match="not a Zenoh address"):
        ZenohAddresses.of_meeting_point(("192.0.2.7",), ())


# --- S* at a constant rate from uneven frames.


MS = 1_000_000


def queued(fuser, times_ms, delays_ms):
    """Frames at uneven times whose root moves at 1 m/s along x."""
    made = frames(fuser, 2)[-1]
    for k, (time_ms, delay_ms) in enumerate(zip(times_ms, delays_ms, strict=True)):
        at = made.fused.positions + (1e-3 * time_ms, 0.0, 0.0)
        fused = replace(made.fused, positions=at, velocities=np.full_like(at, 0.0) + (1.0, 0.0, 0.0))
        yield QueuedFrame(k, replace(made, fused=fused), time_ms * MS, (time_ms + delay_ms) * MS)


def test_samples_are_even_and_predicted_whatever_the_frames_do(fuser):
    body = fuser.setup.body
    even = EvenSamples(body, 100.0)
    given = list(queued(fuser, (0, 33, 40, 67, 100), (20, 20, 24, 50, 21)))
    samples = []
    for now_ms in range(130):
        new = [frame for frame in given if frame.written_ns == now_ms * MS]
        samples += even.passed_on(new, now_ms * MS)
        wait_s = even.wait_s(now_ms * MS)
        assert (wait_s is None) == (now_ms < 20)
        assert wait_s is None or 0.0 < wait_s <= 0.01
    assert [sample.time_ns for sample in samples] == [k * 10 * MS for k in range(len(samples))]
    # the least delay is 20 ms: at 129 ms the moment 100 ms is there
    assert samples[-1].time_ns == 100 * MS
    x = [sample.fused.positions[body.root, 0] for sample in samples]
    np.testing.assert_allclose(np.diff(x), 0.01, atol=1e-9)
    for sample in samples:
        lengths = [bone_lengths_of(body, at.positions) for at in (sample.fused, given[0].fused)]
        np.testing.assert_allclose(*lengths, atol=1e-9)


@given(pause_s=st.floats(1.0, 1e6), rate=st.sampled_from([1.0, 50.0, 240.0]))
def test_what_a_pause_leaves_out_is_not_counted_moment_by_moment(fuser, pause_s, rate):
    even, back_ms = EvenSamples(fuser.setup.body, rate), round(1e3 * pause_s)
    before, after = queued(fuser, (0, back_ms), (0, 0))
    even.passed_on([before], 0)
    begun = time.process_time()
    samples = even.passed_on([after], back_ms * MS)
    assert time.process_time() - begun < 0.5
    assert all(0 <= back_ms * MS - sample.time_ns <= 300 * MS for sample in samples)
    assert len(samples) >= int(0.3 * rate)


# --- An output never delays the loop: its queue is bounded, the oldest frames are dropped and counted.


class Receiver(LiveOutput):
    """An output whose receiver takes a frame only when the test permits it."""

    def __init__(self, keep=1):
        super().__init__("Receiver of a test", keep, clock=lambda: self.now_ns)
        self.now_ns = 0
        self.let, self.taking = threading.Semaphore(0), threading.Semaphore(0)
        self.got = []
        self.said = []
        self.refuses = self.breaks = False
        self.start()

    def send_frame(self, frame):
        self.taking.release()
        self.let.acquire()
        if self.breaks:
            raise ValueError("a fault of the program")
        if self.refuses:
            raise OSError("network unreachable")
        self.got.append(frame.number)
        return 1

    def send_event(self, event):
        self.said.append(event.text)


def test_a_blocked_receiver_loses_the_oldest_frames(fuser):
    output = Receiver(keep=3)
    made = frames(fuser, 50)
    output.write(made[0])
    assert output.taking.acquire(timeout=10)  # the thread has frame 0 and waits
    for frame in made[1:]:
        output.write(frame)  # none of these waits: the thread stands still all the while
    assert output.counts.dropped == 49 - 3
    for _ in range(4):
        output.let.release()
    assert eventually(lambda: output.got == [0, 47, 48, 49])
    output.close()
    assert output.counts.sent == 4


def test_lateness_is_counted(fuser):
    output = Receiver()
    for k, (frame, age) in enumerate(zip(frames(fuser, 2), (LATE_NS, LATE_NS + 1), strict=True)):
        output.write(frame)
        assert output.taking.acquire(timeout=10)
        output.now_ns += age
        output.let.release()
        assert eventually(lambda k=k: output.counts.sent == k + 1)
    output.close()
    assert output.counts.late == 1


@given(kinds=st.lists(st.tuples(st.booleans(), st.sampled_from(["sent", "refused", "nobody"])), max_size=12))
def test_every_frame_is_sent_or_dropped_and_an_event_is_neither(fuser, kinds):
    """Whatever the network refuses; without a receiver there is nothing to count."""
    todo = deque(outcome for _, outcome in kinds)

    class Output(LiveOutput):
        def send_frame(self, _):
            outcome = todo.popleft()
            if outcome == "refused":
                raise OSError("network unreachable")
            return 1 if outcome == "sent" else None

        def send_event(self, _):
            self.send_frame(None)

    output, (frame,) = Output("x", keep=20), frames(fuser, 1)
    for is_frame, _ in kinds:
        if is_frame:
            output.write(frame)
        else:
            output.event(Event("something"))
    output.start()
    output.close()
    counts, of_frames = output.counts, [outcome for is_frame, outcome in kinds if is_frame]
    assert (counts.sent, counts.dropped) == (of_frames.count("sent"), of_frames.count("refused"))
    assert output.failure is None


def test_a_fault_ends_the_output_and_not_the_session(fuser):
    output = Receiver()
    output.breaks = True
    output.let.release()
    output.write(frames(fuser, 1)[0])
    assert eventually(lambda: output.failure is not None)
    assert "ValueError: a fault of the program" in str(output.failure)
    for frame in frames(fuser, 3):
        output.write(frame)
    output.close()
    output.close()  # again: no effect


def test_confidence_falls_with_the_standard_deviation(fuser):
    fused = frames(fuser, 3)[-1].fused
    trust = confidence(fused)
    assert ((trust > 0.0) & (trust < 1.0)).all()
    order = np.argsort(fused.sigma)
    assert (np.diff(trust[order]) <= 0.0).all()
    half = replace(fused, sigma=np.full(len(trust), 0.05))
    np.testing.assert_allclose(confidence(half), 0.5, rtol=1e-12)
    nobody = replace(fused, positions=np.full_like(fused.positions, np.nan))
    assert (confidence(nobody) == 0.0).all()
    paper = replace(fused, sigma=None, predicted=np.arange(len(trust)) == 4)
    assert sorted(set(confidence(paper).tolist())) == [0.25, 1.0]


def with_person(frame, present):
    positions = np.full_like(frame.fused.positions, 0.0 if present else np.nan)
    return replace(frame, fused=replace(frame.fused, positions=positions))


@given(present=st.lists(st.booleans(), min_size=1, max_size=60))
def test_a_person_leaves_after_half_a_second_and_returns(fuser, present):
    template = frames(fuser, 1)[0]
    presence, missing, gone, seen = _Presence(), 0, False, False
    for k, there in enumerate(present):
        queued = QueuedFrame(k, with_person(template, there), k * 100_000_000, 0)
        news = presence.news(queued)
        missing, seen = 0 if there else missing + 1, seen or there
        expected = "person returned" if there and gone else ""
        gone = gone and not there
        if seen and missing == 5:
            expected, gone = "person left", True
        assert (news.text if news else "") == expected


def test_that_no_frames_come_is_said_once_until_they_come_again(fuser):
    class Quiet(Receiver):
        silent = ()

        def send_silence(self, time_ns):
            self.silent += (time_ns,)

    output, made = Quiet(), frames(fuser, 2)
    output.let.release(2)
    output.write(made[0])
    assert eventually(lambda: output.got == [0])
    output.now_ns = 1_000_000_000
    assert eventually(lambda: output.said == ["no frames for 1 s"])
    output.now_ns = 9_000_000_000
    output.write(made[1])
    assert eventually(lambda: output.got == [0, 1])
    assert output.silent == (1_000_000_000,)  # since the first frame
    output.close()
    assert len(output.silent) == 2  # the end
    assert output.said == ["no frames for 1 s"]


def test_at_an_even_rate_too_it_is_said_that_no_frames_come(fuser):
    output = Receiver()
    output.even = EvenSamples(BODY, 10.0)
    output.let.release(4)
    output.write(frames(fuser, 1)[0])
    assert eventually(lambda: output.got == [0])
    output.now_ns = 400_000_000
    assert eventually(lambda: output.got == [0, 1, 2, 3])  # S* is not predicted farther ahead
    output.now_ns = 1_000_000_000
    assert eventually(lambda: output.said == ["no frames for 1 s"])
    output.close()


def test_the_last_word_of_vmc_is_that_nobody_is_tracked(fuser):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(10.0)
        address = Address("127.0.0.1", receiver.getsockname()[1])
        frame = frames(fuser, 1)[0]
        output = OscOutput("VMC", address, "--vmc", VmcEncoder(BODY).encode)
        output.write(frame)
        output.close()
        said = []
        while not said or said[-1] != ("/VMC/Ext/OK", [1, 3, 0, 0]):
            said += [m for m in messages([receiver.recv(2000)]) if m[0] == "/VMC/Ext/OK"]
