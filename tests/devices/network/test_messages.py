"""The binary layouts: round trips, and messages that are damaged, cut off, foreign or absurd."""

import struct
import zlib

import numpy as np
import pytest

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


@pytest.mark.parametrize("body", BODIES.values(), ids=lambda body: body.name)
@pytest.mark.parametrize("depth", [False, True])
def test_a_frame_comes_back_bit_for_bit(body, depth):
    sent = message(body, depth)
    got = decode_frame(encode_frame(sent))
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
    frame = decode_frame(encode_frame(FrameMessage(1, 0, SensorFrame(-5), 0))).frame
    assert (frame.people, frame.time_ns) == ({}, -5)


@pytest.mark.parametrize("depth", [False, True])
def test_every_cut_and_every_flipped_bit_is_noticed(depth):
    whole = encode_frame(message(depth=depth))
    for end in range(len(whole)):
        with pytest.raises(MalformedError):
            decode_frame(whole[:end])
    with pytest.raises(MalformedError):
        decode_frame(whole + b"\0")
    for at in range(0, 8 * len(whole), 7):  # 7 is prime to 8: every bit of a byte has its turn
        damaged = bytearray(whole)
        damaged[at // 8] ^= 1 << at % 8
        with pytest.raises(MalformedError):
            decode_frame(bytes(damaged))


def test_a_message_of_another_kind_or_version_is_refused():
    clock = encode_clock(ClockMessage(1, 2))
    with pytest.raises(MalformedError, match="another kind"):
        decode_frame(clock)
    with pytest.raises(MalformedError, match="of version 2; this program speaks version 1"):
        decode_clock(resealed(clock[:4] + b"\x02" + clock[5:]))


def test_well_formed_nonsense_is_refused():
    """Messages of a faulty sender, with a correct checksum."""
    whole = encode_frame(message())
    for at in range(28, len(whole) - 4):
        for value in (0, 255):
            nonsense = resealed(whole[:at] + bytes((value,)) + whole[at + 1 :])
            try:
                frame = decode_frame(nonsense).frame
            except MalformedError:
                continue
            for skeleton in frame.people.values():  # decoded skeletons are valid input of the method
                assert np.isfinite(skeleton.positions[skeleton.has_position]).all()


def test_an_image_of_absurd_size_is_refused_before_it_is_made():
    image = struct.pack("<iffii", 0, 0.0, 0.0, 1 << 15, 1 << 15) + b"\x88" * 4
    whole = encode_frame(FrameMessage(1, 0, SensorFrame(0), 0))
    forged = whole[:4] + whole[4:-8] + struct.pack("<I", len(image)) + image + whole[-4:]
    forged = forged[:8] + struct.pack("<I", len(forged)) + forged[12:]
    with pytest.raises(MalformedError, match="a size that no sensor has"):
        decode_frame(resealed(forged))


def resealed(data):
    """The message with its checksum made right."""
    return data[:-4] + struct.pack("<I", zlib.crc32(data[:-4]))
