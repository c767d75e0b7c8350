"""The messages between a sensor's machine and the machine that fuses; docs/protocols.md shows every byte.

Little endian. Every length is checked before it is used and a checksum covers the message, so that a message
which is damaged, cut off or not ours raises :class:`MalformedError` and changes nothing.
"""

import struct
import zlib
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from devices.depth.rvl import decode_depth, encode_depth
from devices.network.zenoh_session import LARGEST_MESSAGE
from devices.sensor import DeviceError, SensorFrame
from fusion.body import BODIES, Body
from fusion.errors import FusionError
from fusion.intrinsics import Intrinsics
from fusion.skeleton import Skeleton

PROTOCOL_VERSION = 1
_MAGIC = b"DXKN"
_HEADER = struct.Struct("<4sBBHIQQ")  # magic, version, kind, reserved, length, session, sequence number
_TIMES = struct.Struct("<qqq")
_SIZE = struct.Struct("<I")
_RVL_SIZE = struct.Struct("<12xii")  # place of width and height in an RVL image
_CAMERA = struct.Struct("<II4dB")
MOST_PEOPLE = 16
"""In one frame; further ones are not sent."""
_MOST_PIXELS = 1 << 21
_MOST_DISTORTION = 8
_LATEST_NS = 1 << 62
_LARGEST_WITNESS = 65_504.0  # metres, that a session can hold; NaN is where there was no reading


class MalformedError(DeviceError):
    """A message that is damaged, cut off, of another version, or not of this program."""


class ForeignError(MalformedError):
    """A message that this program will not understand later either: of another version, or another body.

    The message completes the sentence "the sensor sends …".
    """


class Kind(IntEnum):
    """Kind of a message."""

    FRAME = 1
    SENSOR = 2
    CLOCK = 3


@dataclass(frozen=True, eq=False)
class FrameMessage:
    """A frame on its way."""

    session: int  # random number of the publishing program's run; a restart has another one
    sequence: int  # number of the frame in that run, from 0
    frame: SensorFrame  # the frame; its ``host_ns`` is on the publishing machine's clock
    sent_ns: int  # when it was sent, on the publishing machine's clock


@dataclass(frozen=True)
class SensorMessage:
    """Description of a sensor."""

    session: int  # as in :class:`FrameMessage`
    name: str  # of the sensor
    body: Body  # the body that its tracker reports
    intrinsics: Intrinsics | None  # of the depth images that it sends; None if unknown
    interval_ns: int  # nominal time between two frames


@dataclass(frozen=True)
class ClockMessage:
    """A clock request or its reply."""

    session: int  # of the program that replies; 0 in a request
    asked_ns: int  # when it was asked, on the asking machine's clock
    received_ns: int = 0  # on the replying machine's clock; 0 in a request
    answered_ns: int = 0


def encode_frame(message: FrameMessage) -> bytes:
    """Encodes a frame: its first 16 people with their witness, and its depth image if it has one.

    An id of more than 255 bytes is shortened to another one, the same in every frame.
    """
    frame = message.frame
    people = list(frame.people.items())[:MOST_PEOPLE]
    body = people[0][1].body.name if people else ""
    parts = [
        _TIMES.pack(frame.time_ns, frame.host_ns or 0, message.sent_ns),
        _text(body),
        bytes((len(people),)),
    ]
    for name, person in people:
        parts += [
            _identity(name),
            bytes((person.witness is not None,)),
            person.states.tobytes(),
            person.positions.astype("<f4").tobytes(),
        ]
        if person.witness is not None:
            parts.append(person.witness.astype("<f4").tobytes())
    image = b"" if frame.depth is None else encode_depth(frame.depth)
    return _whole(Kind.FRAME, message.session, message.sequence, *parts, _SIZE.pack(len(image)), image)


def decode_frame(data: bytes, body: Body) -> FrameMessage:
    """Decodes a frame.

    Args:
        body: That of the sensor, as it described itself.

    Raises:
        ForeignError: It is of another version, or its people are of another body.
        MalformedError: It is not a whole frame.
    """
    session, sequence, rest = _opened(data, Kind.FRAME)
    time_ns, host_ns, sent_ns = rest.times()
    body_name = rest.text()
    count = rest.byte()
    if count > MOST_PEOPLE:
        raise MalformedError(f"A frame with {count} people.")
    if body_name != body.name and (count or body_name):
        raise ForeignError(
            f"skeletons of {body_name[:40]!r}, not of {body.name!r} as described (start duplex sensor again)"
        )
    people: dict[str, Skeleton] = {}
    for _ in range(count):
        name, flags, joints = rest.text(), rest.byte(), len(body)
        states = np.frombuffer(rest.take(joints), dtype=np.uint8)
        positions = np.frombuffer(rest.take(12 * joints), dtype="<f4").reshape(joints, 3)
        if flags > 1 or name in people:
            raise MalformedError(f"A person with flags {flags}, or two of one id.")
        try:
            person = Skeleton.of(body, positions, states, time_ns)
        except FusionError as fault:
            raise MalformedError(str(fault)) from fault
        if flags:
            witness = np.frombuffer(rest.take(16 * joints), dtype="<f4").reshape(joints, 4)
            if (np.abs(witness) > _LARGEST_WITNESS).any():
                raise MalformedError("A witness that cannot be.")
            person = person.with_witness(witness.astype(np.float32))
        people[name] = person
    image = rest.take(_SIZE.unpack(rest.take(_SIZE.size))[0])
    rest.end()
    depth = _depth(image) if image else None
    return FrameMessage(session, sequence, SensorFrame(time_ns, people, depth, host_ns=host_ns), sent_ns)


def encode_sensor(message: SensorMessage) -> bytes:
    """Encodes the description of a sensor."""
    parts = [_text(message.name[:80]), _text(message.body.name), struct.pack("<q", message.interval_ns)]
    camera = message.intrinsics
    if camera is None:
        parts.append(_CAMERA.pack(0, 0, 0.0, 0.0, 0.0, 0.0, 0))
    else:
        lens = camera.distortion
        parts.append(
            _CAMERA.pack(camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy, len(lens))
        )
        parts.append(struct.pack(f"<{len(lens)}d", *lens))
    return _whole(Kind.SENSOR, message.session, 0, *parts)


def decode_sensor(data: bytes) -> SensorMessage:
    """Decodes the description of a sensor.

    Raises:
        ForeignError: It is of another version, or its body is unknown here.
        MalformedError: It is not a whole description.
    """
    session, _, rest = _opened(data, Kind.SENSOR)
    name, body_name = rest.text(), rest.text()
    (interval_ns,) = struct.unpack("<q", rest.take(8))
    width, height, fx, fy, cx, cy, count = _CAMERA.unpack(rest.take(_CAMERA.size))
    if count > _MOST_DISTORTION:
        raise MalformedError(f"A lens with {count} coefficients.")
    lens = struct.unpack(f"<{count}d", rest.take(8 * count))
    rest.end()
    if body_name not in BODIES:
        raise ForeignError(f"skeletons of {body_name[:40]!r}, unknown here (run the same duplex on both PCs)")
    if not 1_000_000 <= interval_ns <= 10_000_000_000:
        raise MalformedError(f"Frames every {interval_ns} ns.")
    camera = None
    if width:
        numbers = np.array((fx, fy, cx, cy, *lens))
        if not (np.isfinite(numbers).all() and fx > 0 and fy > 0 and 0 < width * height <= _MOST_PIXELS):
            raise MalformedError("A camera that cannot be.")
        camera = Intrinsics(width, height, fx, fy, cx, cy, lens)
    return SensorMessage(session, name, BODIES[body_name], camera, interval_ns)


def encode_clock(message: ClockMessage) -> bytes:
    """Encodes a clock request or reply."""
    times = _TIMES.pack(message.asked_ns, message.received_ns, message.answered_ns)
    return _whole(Kind.CLOCK, message.session, 0, times)


def decode_clock(data: bytes) -> ClockMessage:
    """Decodes a clock request or reply.

    Raises:
        MalformedError: It is neither.
    """
    session, _, rest = _opened(data, Kind.CLOCK)
    asked_ns, received_ns, answered_ns = rest.times()
    rest.end()
    return ClockMessage(session, asked_ns, received_ns, answered_ns)


class _Rest:
    """The part of a message that is not read yet."""

    def __init__(self, data: memoryview) -> None:
        self._data, self._at = data, 0

    def take(self, size: int) -> memoryview:
        if size > len(self._data) - self._at:
            raise MalformedError("A message that ends too early.")
        taken = self._data[self._at : self._at + size]
        self._at += size
        return taken

    def byte(self) -> int:
        return self.take(1)[0]

    def text(self) -> str:
        try:
            return bytes(self.take(self.byte())).decode("utf-8")
        except UnicodeDecodeError as fault:
            raise MalformedError("A name that is not UTF-8.") from fault

    def times(self) -> tuple[int, int, int]:
        first, second, third = _TIMES.unpack(self.take(_TIMES.size))
        if not all(abs(time) < _LATEST_NS for time in (first, second, third)):
            raise MalformedError("A time that cannot be.")
        return first, second, third

    def end(self) -> None:
        if self._at != len(self._data):
            raise MalformedError("A message with bytes left over.")


def _whole(kind: Kind, session: int, sequence: int, *parts: bytes) -> bytes:
    length = _HEADER.size + sum(map(len, parts)) + 4
    header = _HEADER.pack(_MAGIC, PROTOCOL_VERSION, kind, 0, length, session, sequence)
    message = b"".join((header, *parts))
    return message + _SIZE.pack(zlib.crc32(message))


def _opened(data: bytes, kind: Kind) -> tuple[int, int, _Rest]:
    """Session, sequence number and body of a whole message of this kind."""
    if not _HEADER.size + 4 <= len(data) <= LARGEST_MESSAGE or data[:4] != _MAGIC:
        raise MalformedError(f"{len(data)} bytes that are no message of this program.")
    _, version, got, reserved, length, session, sequence = _HEADER.unpack_from(data)
    if version != PROTOCOL_VERSION:
        raise ForeignError(
            f"messages of version {version}, not {PROTOCOL_VERSION} (run the same duplex on both PCs)"
        )
    if got != kind or reserved or length != len(data):
        raise MalformedError("A message of another kind or length.")
    if zlib.crc32(data[:-4]) != _SIZE.unpack(data[-4:])[0]:
        raise MalformedError("A damaged message.")
    return session, sequence, _Rest(memoryview(data)[_HEADER.size : -4])


def _depth(image: memoryview) -> NDArray[np.uint16]:
    if len(image) >= _RVL_SIZE.size:
        width, height = _RVL_SIZE.unpack_from(image)
        if not 0 < width * height <= _MOST_PIXELS:
            raise MalformedError("A depth image of a size that no sensor has.")
    try:
        return decode_depth(bytes(image))
    except DeviceError as fault:
        raise MalformedError(str(fault)) from fault


def _identity(name: str) -> bytes:
    """The id of a person; a long one ends with a checksum, so that two long ones remain two."""
    coded = name.encode("utf-8", "replace")
    return _text(name if len(coded) <= 255 else f"{name[:50]}…{zlib.crc32(coded):08x}")


def _text(text: str) -> bytes:
    coded = text.encode("utf-8")[:255].decode("utf-8", "ignore").encode("utf-8")  # no half of a character
    return bytes((len(coded),)) + coded
