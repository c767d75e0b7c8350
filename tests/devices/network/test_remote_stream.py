"""Losses, clocks and restarts of remote sensors in virtual time; losses and jitter are injected."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from devices.capture.stream_pairing import LivePairing
from devices.frame_pairs import FramePair
from devices.network import remote_stream
from devices.network.messages import ClockMessage, FrameMessage, SensorMessage, encode_clock, encode_frame
from devices.network.remote_stream import RemoteClock, RemoteStream
from devices.sensor import SensorFrame
from fusion.body import AZURE_KINECT
from tests.helpers.network import arrivals

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


def test_the_clock_of_another_pc_is_known_within_half_of_the_shortest_round_trip():
    """One-way delays are 0.2 ms at least and differ by up to 30 ms, all of it on the way back."""
    rng = np.random.default_rng(0)
    clock, now_ns = RemoteClock(), 0
    for _ in range(20):
        now_ns += SECOND // 2
        there, back = 200_000, 200_000 + round(rng.exponential(10 * MS))
        received = now_ns + there + HOST_AHEAD_NS
        assert clock.add(now_ns, received, received + 50_000, now_ns + there + 50_000 + back)
    bound, offset = clock.bound_ns(now_ns), clock.offset_ns(now_ns)
    assert abs(offset - HOST_AHEAD_NS) <= bound
    assert bound < 2 * MS  # the shortest of 20 delays of 10 ms is about 0.5 ms; 0.5 ms of drift in 10 s


def test_a_clock_that_drifts_is_followed():
    """40 ppm for ten minutes are 24 ms; the newest seconds must count."""
    clock, offset, now_ns = RemoteClock(), 0, 0
    for k in range(1200):
        now_ns = k * SECOND // 2
        offset = HOST_AHEAD_NS + round(40e-6 * now_ns)
        clock.add(now_ns, now_ns + MS + offset, now_ns + MS + offset, now_ns + 2 * MS)
    found, bound = clock.offset_ns(now_ns), clock.bound_ns(now_ns)
    assert abs(found - offset) <= bound <= 2 * MS


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


def test_a_slow_reply_is_taken_after_many_further_requests():
    stream = opened()
    for k in range(40):  # two seconds
        stream.clock_request(k * 50 * MS)
    assert stream.clock_reply(encode_clock(ClockMessage(1, 0, SECOND, SECOND)), 2 * SECOND)
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


def test_damaged_messages_are_counted_and_change_nothing():
    stream, rng, given = opened(), np.random.default_rng(3), []
    for sequence in range(300):
        good = frame(sequence)
        bad = bytearray(good)
        bad[int(rng.integers(len(bad)))] ^= int(rng.integers(1, 256))
        assert stream.receive(bytes(bad), sequence * 33 * MS) is None
        given.append(number(stream.receive(good, sequence * 33 * MS)))
    assert given == list(range(300))
    assert stream.figures.malformed == 300


def test_pairs_go_on_with_loss_and_jitter():
    """5 % loss on each side leaves 28.5 frames of A per second; each gives a pair.

    In 120 s that is 3420 ± 13 frames; 28.0 per second are 3360, more than four deviations below. A pair is
    late by the jitter and the wait for a partner at most.
    """
    seconds = 120
    streams = {"a": opened(), "b": opened()}
    pairing, pairs = LivePairing(), list[FramePair]()
    events = sorted(
        (arrived_ns, side, data)
        for side, seed in (("a", 1), ("b", 2))
        for arrived_ns, data in arrivals(
            seconds, lost=0.05, jitter_ns=20 * MS, seed=seed, host_ahead_ns=HOST_AHEAD_NS
        )
    )
    for stream in streams.values():
        stream.clock_request(0)
        there = MS + HOST_AHEAD_NS
        assert stream.clock_reply(encode_clock(ClockMessage(1, 0, there, there)), 2 * MS)
    now_ns, due = 0, 0
    for arrived_ns, side, data in events:
        while due <= arrived_ns:  # the loop looks every 10 ms
            pairs += pairing.poll(due)
            due += 10 * MS
        got = streams[side].receive(data, arrived_ns)
        assert got is not None
        pairs += pairing.add(side, got, arrived_ns)
        now_ns = arrived_ns
    pairs += pairing.poll(now_ns + SECOND)
    in_order = [pair.time_ns for pair in pairs]
    assert in_order == sorted(set(in_order))
    assert len(pairs) >= 28.0 * seconds
    assert pairing.figures.late == pairing.figures.repeated == pairing.figures.reordered == 0
    for stream in streams.values():
        figures = stream.figures
        assert figures.received + figures.lost == pytest.approx(30 * seconds, abs=2)
        assert figures.lost == pytest.approx(0.05 * 30 * seconds, abs=60)
    both = [pair for pair in pairs if pair.a is not None and pair.b is not None]
    assert len(both) > 0.88 * 30 * seconds  # 0.95² = 0.90 of the moments have both
    # both sensors captured at the same moments: no pair may be of different ones
    assert all(pair.a.time_ns == pair.b.time_ns for pair in both if pair.a and pair.b)
