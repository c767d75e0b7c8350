"""The binary layouts: round trips, and messages that are damaged, cut off, foreign or absurd."""

import struct
import zlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

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
from devices.network.remote_stream import RemoteStream
from devices.sensor import SensorFrame
from fusion.body import AZURE_KINECT, BODIES
from fusion.intrinsics import Intrinsics
from fusion.skeleton import Skeleton

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
