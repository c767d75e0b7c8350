"""The binary layouts: round trips, and messages that are damaged, cut off, foreign or absurd."""

import socket
import struct
import threading
import time
import zlib
from contextlib import ExitStack, contextmanager, suppress

import numpy as np
import psutil
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from devices.capture.sensor_state import SensorState, TimeLimits
from devices.capture.sensor_thread import SensorThread
from devices.network import messages, remote_stream
from devices.network.messages import (
    ClockMessage,
    FrameMessage,
    MalformedError,
    SensorMessage,
    decode_clock,
    decode_frame,
    decode_sensor,
    encode_clock,
    encode_frame,
    encode_sensor,
)
from devices.network.publishing import FramePublisher, publish_until
from devices.network.remote_sensor import RemoteSensor
from devices.network.remote_stream import RemoteClock, RemoteStream
from devices.network.zenoh_session import ZenohAddresses, zenoh_session
from devices.sensor import AbsentError, DeviceError, SensorFrame
from fusion.body import AZURE_KINECT, BODIES, KINECT_V2
from fusion.intrinsics import Intrinsics
from fusion.skeleton import Skeleton
from tests.helpers.network import free_address
from tests.helpers.scripted_sensor import ScriptedSensor, frame_at
from tests.helpers.waiting import eventually

CAMERA = Intrinsics(320, 288, 252.0, 252.5, 160.0, 144.0, (0.1, -0.2, 0.0, 0.0, 0.01, 0.0, 0.0, 0.0))


def person(body=AZURE_KINECT, seed=0, time_ns=7):
    rng = np.random.default_rng(seed)
    positions = rng.uniform(0.5, 3.0, (len(body), 3))
    skeleton = Skeleton.of(body, positions, rng.integers(0, 3, len(body)), time_ns)
    return skeleton.with_witness(rng.normal(size=(len(body), 4)).astype(np.float32)) if seed % 2 else skeleton


def message(body=AZURE_KINECT, depth=False):
    image = np.random.default_rng(1).integers(0, 4000, (24, 32)).astype(np.uint16) if depth else None
    people = {"1": person(body, 0), "änother": person(body, 1)}
    return FrameMessage(2**64 - 1, 41, SensorFrame(7, people, image, host_ns=99), 123)


SENT = {
    (name, depth): encode_frame(message(BODIES[name], depth)) for name in BODIES for depth in (False, True)
}


@pytest.mark.parametrize("body", BODIES.values(), ids=lambda body: body.name)
@pytest.mark.parametrize("depth", [False, True])
def test_a_frame_comes_back_bit_for_bit(body, depth):
    sent = message(body, depth)
    got = decode_frame(encode_frame(sent), body)
    assert (got.session, got.sequence, got.sent_ns) == (sent.session, sent.sequence, sent.sent_ns)
    assert (got.frame.time_ns, got.frame.host_ns) == (7, 99)
    assert list(got.frame.people) == list(sent.frame.people)
    for name, skeleton in got.frame.people.items():
        original = sent.frame.people[name]
        assert skeleton.body is body
        assert skeleton.time_ns == 7
        assert np.array_equal(skeleton.positions, original.positions, equal_nan=True)
        assert np.array_equal(skeleton.states, original.states)
        np.testing.assert_equal(skeleton.witness, original.witness)
    np.testing.assert_equal(got.frame.depth, sent.frame.depth)


@pytest.mark.parametrize("camera", [None, CAMERA])
def test_other_messages_come_back(camera):
    sensor, clock = SensorMessage(3, "000123", AZURE_KINECT, camera, 33_333_333), ClockMessage(8, 1, 2, 3)
    assert decode_sensor(encode_sensor(sensor)) == sensor
    assert decode_clock(encode_clock(clock)) == clock
    frame = decode_frame(encode_frame(FrameMessage(1, 0, SensorFrame(-5), 0)), AZURE_KINECT).frame
    assert (frame.people, frame.time_ns) == ({}, -5)


@pytest.mark.parametrize("depth", [False, True])
def test_every_cut_and_every_flipped_bit_is_noticed(depth):
    whole = encode_frame(message(depth=depth))
    for end in range(len(whole)):
        with pytest.raises(MalformedError):
            decode_frame(whole[:end], AZURE_KINECT)
    with pytest.raises(MalformedError):
        decode_frame(whole + b"\0", AZURE_KINECT)
    for at in range(0, 8 * len(whole), 7):  # 7 is prime to 8: every bit of a byte has its turn
        damaged = bytearray(whole)
        damaged[at // 8] ^= 1 << at % 8
        with pytest.raises(MalformedError):
            decode_frame(bytes(damaged), AZURE_KINECT)


def test_a_message_of_another_kind_or_version_is_refused():
    clock = encode_clock(ClockMessage(1, 2))
    with pytest.raises(MalformedError, match="another kind"):
        decode_frame(clock, AZURE_KINECT)
    with pytest.raises(MalformedError, match="of version 2, not 1"):
        decode_clock(resealed(clock[:4] + b"\x02" + clock[5:]))


def mutated(data, edits, cut):
    """A message of a faulty sender: other bytes here and there, another length, and a correct checksum."""
    changed = bytearray(data[:-4])
    for at, value in edits:
        changed[at % len(changed)] = value
    if cut:
        changed = changed[: len(changed) - cut]
    changed[8:12] = struct.pack("<I", len(changed) + 4)
    return resealed(bytes(changed) + b"1234")


@given(
    body=st.sampled_from(list(BODIES.values())),
    depth=st.booleans(),
    edits=st.lists(
        st.tuples(st.one_of(st.integers(0, 120), st.integers(0, 1 << 12)), st.integers(0, 255)), max_size=4
    ),
    cut=st.sampled_from((0, 0, 0, 0, 1, 12, 37)),
)
def test_no_frame_of_a_faulty_sender_reaches_a_kernel_with_arrays_of_another_length(body, depth, edits, cut):
    """Other bodies, counts, versions, sizes, states, NaN: refused, or a frame of the body described."""
    stream = RemoteStream()
    stream.begin(SensorMessage(2**64 - 1, "x", AZURE_KINECT, None, 33_333_333))
    frame = stream.receive(mutated(SENT[body.name, depth], edits, cut), 0)
    if frame is None:
        return
    for skeleton in frame.people.values():
        assert skeleton.body is AZURE_KINECT
        assert skeleton.positions.shape == (32, 3)
        assert skeleton.states.shape == (32,)
        assert skeleton.witness is None or skeleton.witness.shape == (32, 4)
        assert np.isfinite(skeleton.positions[skeleton.has_position]).all()


@pytest.mark.parametrize("value", [np.inf, -np.inf, 1e6, np.nan, 65_504.0])
def test_a_witness_that_no_image_gives_is_refused(value):
    """Else it would reach the method as a reading; NaN says that there is none."""
    witness = np.full((len(AZURE_KINECT), 4), 0.01, np.float32)
    witness[3, 1] = value
    sent = SensorFrame(7, {"1": person().with_witness(witness)})
    if np.isnan(value) or abs(value) <= 65_504.0:
        got = decode_frame(encode_frame(FrameMessage(1, 0, sent, 0)), AZURE_KINECT)
        np.testing.assert_equal(got.frame.people["1"].witness, witness)
    else:
        with pytest.raises(MalformedError, match="A witness that cannot be"):
            decode_frame(encode_frame(FrameMessage(1, 0, sent, 0)), AZURE_KINECT)


def test_people_beyond_the_most_are_left_out_and_long_ids_stay_apart():
    skeleton = person()
    many = FrameMessage(1, 0, SensorFrame(7, {str(k): skeleton for k in range(20)}), 0)
    assert list(decode_frame(encode_frame(many), AZURE_KINECT).frame.people) == [str(k) for k in range(16)]
    long = FrameMessage(1, 0, SensorFrame(7, {"x" * 255 + end: skeleton for end in ("", "a", "b")}), 0)
    assert len(decode_frame(encode_frame(long), AZURE_KINECT).frame.people) == 3


def test_an_image_of_absurd_size_is_refused_before_it_is_made():
    image = struct.pack("<iffii", 0, 0.0, 0.0, 1 << 15, 1 << 15) + b"\x88" * 4
    whole = encode_frame(FrameMessage(1, 0, SensorFrame(0), 0))
    forged = whole[:4] + whole[4:-8] + struct.pack("<I", len(image)) + image + whole[-4:]
    forged = forged[:8] + struct.pack("<I", len(forged)) + forged[12:]
    with pytest.raises(MalformedError, match="a size that no sensor has"):
        decode_frame(resealed(forged), AZURE_KINECT)


def resealed(data):
    """The message with its checksum made right."""
    return data[:-4] + struct.pack("<I", zlib.crc32(data[:-4]))


# --- Losses, clocks and restarts of remote sensors in virtual time; losses and jitter are injected.


MS, SECOND = 1_000_000, 1_000_000_000
HOST_AHEAD_NS = 7 * SECOND  # the publishing PC's clock minus ours


def opened(session=1):
    stream = RemoteStream()
    stream.begin(SensorMessage(session, "k", AZURE_KINECT, None, 33_333_333))
    return stream


def frame(sequence, session=1, host_ns=0):
    return encode_frame(FrameMessage(session, sequence, SensorFrame(sequence * 33 * MS, host_ns=host_ns), 0))


def number(frame):
    return None if frame is None else frame.time_ns // (33 * MS)


def test_missing_numbers_are_counted_and_nothing_waits_for_them():
    stream = opened()
    assert [number(stream.receive(frame(k), k * 33 * MS)) for k in (5, 6, 9)] == [5, 6, 9]
    assert (stream.figures.received, stream.figures.lost) == (3, 2)


@given(ppm=st.integers(-40, 40), seconds=st.integers(10, 600), seed=st.integers(0, 99))
def test_the_clock_of_another_pc_is_known_within_the_bound_that_is_told(ppm, seconds, seed):
    """One-way delays are 0.2 ms at least and differ by up to 30 ms, all of it on the way back."""
    rng, clock, offset = np.random.default_rng(seed), RemoteClock(), 0
    for now_ns in range(0, seconds * SECOND, SECOND // 2):
        there, back = 200_000, 200_000 + round(rng.exponential(10 * MS))
        offset = HOST_AHEAD_NS + round(ppm * 1e-6 * now_ns)
        received = now_ns + there + offset
        assert clock.add(now_ns, received, received + 50_000, now_ns + there + 50_000 + back)
    bound = clock.bound_ns(now_ns)
    assert abs(clock.offset_ns(now_ns) - offset) <= bound
    # of 20 delays of 10 ms the shortest is below 1.5 ms in 95 %; 0.5 ms of drift in 10 s
    assert bound < 5 * MS


@pytest.mark.parametrize("reply", [(0, 5, 4, 10), (10, 0, 0, 5), (0, 0, 100, 10)])
def test_an_impossible_reply_is_left_out(reply):
    clock = RemoteClock()
    assert not clock.add(*reply)
    assert clock.offset_ns(0) is None


def test_the_clock_is_read_while_a_reply_arrives(monkeypatch):
    """The loop reads the figures, the sensor's thread takes the replies; a deque raised RuntimeError."""
    clock, bound = RemoteClock(), remote_stream._bound
    for now_ns in (1_000, 2_000):
        assert clock.add(now_ns - 1_000, 0, 0, now_ns)

    def meanwhile(reply, now_ns):
        assert clock.add(2_000, 0, 0, 2_500)
        return bound(reply, now_ns)

    monkeypatch.setattr(remote_stream, "_bound", meanwhile)
    assert clock.bound_ns(2_000) == 500
    assert clock.replies > 2


@given(st.integers(-(10**13), 10**13), st.integers(-5000, 5000))
@example(HOST_AHEAD_NS, 50)
def test_capture_times_come_to_this_machines_clock_and_none_is_in_the_future(ahead_ns, late_ms):
    stream = opened()
    stream.clock_request(1000 * MS)
    reply = ClockMessage(1, 1000 * MS, 1001 * MS + ahead_ns, 1001 * MS + ahead_ns)
    assert stream.clock_reply(encode_clock(reply), 1002 * MS)
    now_ns = 10**13 + 1530 * MS
    got = stream.receive(frame(0, host_ns=now_ns - late_ms * MS + ahead_ns), now_ns)
    assert got.host_ns == min(now_ns - late_ms * MS, now_ns)


def test_another_run_of_the_program_is_noticed_and_its_numbers_start_anew():
    stream = opened(session=1)
    assert number(stream.receive(frame(500, 1), 0)) == 500
    assert stream.receive(frame(0, 2), 1) is None
    assert stream.strange
    assert not stream.restarted(1)
    stream.clock_request(5)
    assert not stream.clock_reply(encode_clock(ClockMessage(2, 5, 6, 7)), 8)
    assert not stream.restarted(8)  # the first run may still answer
    assert stream.restarted(8 + 100 * MS)
    stream.begin(SensorMessage(2, "k", AZURE_KINECT, None, 33_333_333))
    assert number(stream.receive(frame(1, 2), 9)) == 1
    assert stream.receive(frame(501, 1), 10) is None  # still on its way when the program ended
    assert stream.figures.restarts == 1
    assert stream.figures.received == 2


@pytest.mark.parametrize("order", [(1, 2), (2, 1)])
def test_two_programs_that_answer_one_request_are_a_double_key_and_no_restart(order):
    stream = opened(session=1)
    for k in range(20):
        asked = k * SECOND // 2
        stream.clock_request(asked)
        for delay, session in enumerate(order, 1):
            stream.clock_reply(encode_clock(ClockMessage(session, asked, 0, 0)), asked + delay * MS)
            assert not stream.restarted(asked + delay * MS)
        assert not stream.restarted(asked + 400 * MS)
    assert stream.doubled == stream.replies == 20
    assert stream.figures.malformed == 0


def test_a_reply_that_nobody_asked_for_or_that_comes_twice_is_left_out():
    stream = opened()
    reply = encode_clock(ClockMessage(1, 5, 6, 7))
    assert not stream.clock_reply(reply, 7)
    stream.clock_request(5)
    assert [stream.clock_reply(reply, 8 + k) for k in range(2)] == [True, False]
    assert (stream.replies, stream.doubled, stream.figures.malformed) == (1, 0, 2)


def test_one_absurd_number_does_not_end_a_sensor():
    stream = opened()
    absurd = encode_frame(FrameMessage(1, 2**64 - 1, SensorFrame(0), 0))
    assert number(stream.receive(frame(0), 0)) == 0
    stream.receive(absurd, 1)
    assert [number(stream.receive(frame(k), 2)) for k in (1, 2)] == [1, 2]


def test_a_broken_connection_to_the_same_run_is_no_restart():
    stream = opened()
    stream.receive(frame(0), 0)
    stream.begin(SensorMessage(1, "k", AZURE_KINECT, None, 33_333_333))
    assert number(stream.receive(frame(31), SECOND)) == 31
    assert (stream.figures.lost, stream.figures.restarts) == (30, 0)


# --- Zenoh sessions: explicit addresses, one session per set of addresses, one line for each mistake.


zenoh = pytest.importorskip("zenoh", reason="eclipse-zenoh is not installed: pip install -e '.[zenoh]'")


def test_blocks_with_the_same_addresses_share_a_session():
    addresses = ZenohAddresses(listen=(free_address(),))
    with zenoh_session(addresses) as one:
        with zenoh_session(addresses) as two:
            assert one is two
        assert not one.is_closed()
    assert one.is_closed()


def test_a_session_listens_where_it_was_told_and_nowhere_else():
    address = free_address()
    before = _sockets()
    with zenoh_session(ZenohAddresses(listen=(address,))):
        opened = _sockets() - before
        assert opened == {("127.0.0.1", int(address.rpartition(":")[2]))}
    with zenoh_session(ZenohAddresses(connect=(address,))):
        assert _sockets() - before == set()


def test_a_busy_address_gives_one_line():
    address = free_address()
    with socket.socket() as other:
        other.bind(("127.0.0.1", int(address.rpartition(":")[2])))
        other.listen()
        busy = zenoh_session(ZenohAddresses(listen=(address,)))
        with pytest.raises(DeviceError, match="Zenoh cannot use") as fault:
            busy.__enter__()
    assert address in str(fault.value)
    assert "\n" not in str(fault.value)
    assert ".rs" not in str(fault.value)


def _sockets():
    """Addresses on which this process waits for others, by TCP or UDP."""
    found = psutil.Process().net_connections(kind="inet")
    return {(c.laddr.ip, c.laddr.port) for c in found if c.status in ("LISTEN", "NONE")}


# --- A remote sensor over real Zenoh sessions: frames, clocks, absence, restarts, hostile input.


pytest.importorskip("zenoh", reason="eclipse-zenoh is not installed: pip install -e '.[zenoh]'")

KEY = "lab/a"
CAMERA_OF_REMOTE_SENSOR = Intrinsics(64, 48, 50.0, 50.0, 31.5, 23.5)


@pytest.fixture
def address():
    return free_address()


@contextmanager
def publisher(address, sensor=None, **more):
    sensor = sensor or ScriptedSensor("000123")
    with FramePublisher(KEY, ZenohAddresses(connect=(address,)), sensor, **more) as open_publisher:
        yield open_publisher


def remote(address, appear_s=20.0):
    return RemoteSensor(KEY, ZenohAddresses(listen=(address,)), appear_s=appear_s)


class Ticking:
    """A clock that a test moves on, added to the real one."""

    now = 0.0

    def __call__(self):
        return time.perf_counter() + self.now


def frames_through(published, thread, wanted):
    """Publishes frames until so many have arrived."""
    came = []

    def more():
        published.publish(frame_at(1_000_000 * published.published, people=True))
        came.extend(arrival.frame for arrival in thread.take())
        return len(came) >= wanted

    assert eventually(more)
    return came


def test_published_frames_arrive_in_order_with_their_capture_times(address):
    with publisher(address) as published, SensorThread(remote(address), keep=64) as thread:
        clock = published._clock
        sent_from = clock()
        came = frames_through(published, thread, 20)
        assert thread.sensor.body is AZURE_KINECT
        times = [frame.time_ns for frame in came]
        assert times == sorted(set(times))
        assert set(came[0].people) == {"1"}
        link = thread.sensor.link
        assert link.lost == 0
        # both programs run on one clock here: what the relation of the clocks claims can be checked
        for frame in came:
            assert sent_from - link.clock_bound_ns <= frame.host_ns <= clock()


def test_depth_images_arrive_if_asked_for(address):
    image = np.arange(64 * 48, dtype=np.uint16).reshape(48, 64)
    sensor = ScriptedSensor()
    sensor.intrinsics = CAMERA_OF_REMOTE_SENSOR
    for depth in (True, False):
        with publisher(address, sensor, depth=depth) as published, remote(address) as far:
            assert far.intrinsics == CAMERA_OF_REMOTE_SENSOR
            frames = far.frames()

            def send(to=published):
                to.publish(SensorFrame(to.published, depth=image))
                return bool(far._inbox)

            assert eventually(send)
            got = next(frames)
            frames.close()
            assert (got.depth is not None) == depth
            if got.depth is not None:
                assert np.array_equal(got.depth, image)


def test_an_absent_sensor_gives_one_line(address):
    with pytest.raises(AbsentError, match=r"Nobody publishes 'lab/a' at tcp/.*Start duplex sensor --publ"):
        remote(address, appear_s=0.0).__enter__()


def test_waiting_for_a_sensor_can_be_interrupted(address):
    far = remote(address, appear_s=3600.0)
    thread = SensorThread(far, limits=TimeLimits(open_s=3600.0))

    def open_it():
        with suppress(DeviceError):
            thread.open()

    opening = threading.Thread(target=open_it)
    opening.start()
    assert eventually(lambda: far.waits_for == "duplex sensor --publish lab/a")
    thread.end()
    opening.join(20.0)
    assert not opening.is_alive()


def test_a_program_that_is_started_anew_is_taken_back(address):
    with ExitStack() as stack:
        stack.enter_context(zenoh_session(ZenohAddresses(listen=(address,))))
        far = remote(address)
        with publisher(address) as published:
            thread = stack.enter_context(SensorThread(far, keep=64, limits=TimeLimits(retry_s=0.05)))
            frames_through(published, thread, 5)
        assert eventually(lambda: thread.state is SensorState.LOST)
        with publisher(address) as published:
            assert eventually(lambda: thread.state is SensorState.RUNNING)
            frames_through(published, thread, 5)
        assert thread.returns == 1
        assert far.link.restarts == 1
        said = [event.text for event in thread.events()]
        assert any("zenoh:lab/a is silent for 1.5 s" in line or "started anew" in line for line in said)
        assert "zenoh:lab/a is back." in said


def test_another_body_after_a_restart_gives_one_line(address):
    far = remote(address)
    with publisher(address), far:
        pass
    sensor = ScriptedSensor()
    sensor.body = KINECT_V2
    with (
        publisher(address, sensor),
        pytest.raises(DeviceError, match="reports kinect_v2 now and reported azure"),
    ):
        far.__enter__()


@pytest.mark.parametrize("change", ["body", "version"])
def test_what_is_not_understood_is_named_once_and_is_no_silence(address, change, monkeypatch):
    """Another body than described, as after its driver was started anew; another version of the program."""
    second = [SensorFrame(k, {"1": Skeleton.of(KINECT_V2, np.ones((25, 3)))}) for k in range(60)]
    seconds, said, came = Ticking(), [], []
    thread = SensorThread(remote(address), keep=64, clock=seconds)
    with publisher(address) as published, thread:
        frames_through(published, thread, 3)
        if change == "version":
            monkeypatch.setattr(messages, "PROTOCOL_VERSION", 2)
        encoded = [encode_frame(FrameMessage(published.session, 10 + k, f, 0)) for k, f in enumerate(second)]
        monkeypatch.undo()

        def refused():
            published._publisher.put(encoded[len(encoded) // 2])
            came.extend(arrival.frame for arrival in thread.take())
            said.extend(event.text for event in thread.events())
            seconds.now += 0.2
            return len(said) > 0 and thread.sensor.link.malformed > 50

        assert eventually(refused)
        assert all(frame.people["1"].body is AZURE_KINECT for frame in came)  # sent before
        named = "'kinect_v2', not of 'azure_kinect'" if change == "body" else "messages of version 2, not 1"
        assert len(said) == 1
        assert said[0].startswith("zenoh:lab/a stalls")
        assert named in said[0]
        assert thread.returns == 0
        frames_through(published, thread, 3)
        assert thread.sensor.waits_for == ""


def test_a_sensor_of_another_version_is_named_at_once(address, monkeypatch):
    monkeypatch.setattr(messages, "PROTOCOL_VERSION", 2)
    with publisher(address):
        monkeypatch.undo()
        with pytest.raises(
            AbsentError, match=r"^zenoh:lab/a sends messages of version 2, not 1 \(run the same"
        ):
            remote(address).__enter__()


def test_publishing_ends_with_its_sensor_and_keeps_the_order(address):
    sensor = ScriptedSensor()
    told = []
    with remote_after(publisher(address, sensor), address) as (published, far):
        with SensorThread(sensor, keep=8) as thread:
            sensor.put(*(frame_at(k, people=True) for k in range(5)), None)
            assert eventually(lambda: thread.state is SensorState.ENDED)
            publish_until(thread, published, threading.Event(), lambda event: told.append(event.text))
        assert published.published == 5
        frames = far.frames()
        assert [next(frames).time_ns for _ in range(5)] == [0, 1, 2, 3, 4]
    assert told == []


@contextmanager
def remote_after(opening, address):
    """A publisher and a remote sensor that receives its frames."""
    with opening as published, remote(address) as far:

        def heard():
            return bool(published._publisher.matching_status.matching)

        assert eventually(heard)
        yield published, far
