"""Fast lossless compression of depth images: run-length and variable-length coding (RVL).

Source: A. D. Wilson, *Fast Lossless Depth Image Compression*, ISS 2017. Runs of pixels without and with a
reading alternate. A reading is coded as its difference from the previous one, three bits per nibble.
The header is the one of ROS 2's compressed depth, which Rerun's viewer reads as ``application/rvl``.
"""

import struct

import numpy as np
from numpy.typing import NDArray

from devices.sensor import DeviceError
from fusion.compiling.kernels import compiles, njit

MEDIA_TYPE = "application/rvl"
_HEADER = struct.Struct("<iffii")  # ROS's format and two depth parameters, unused here; width, height
_MOST_PIXELS = 1 << 26


def encode_depth(depth: NDArray[np.uint16]) -> bytes:
    """Encodes (height, width) millimetres, 0 without a reading, as RVL with a header."""
    height, width = depth.shape
    words = np.empty(depth.size + depth.size // 4 + 8, dtype=np.uint32)
    count = _encode(np.ascontiguousarray(depth).ravel(), words)
    return _HEADER.pack(0, 0.0, 0.0, width, height) + words[:count].astype("<u4").tobytes()


def decode_depth(blob: bytes) -> NDArray[np.uint16]:
    """Decodes the output of :func:`encode_depth` to (height, width) millimetres.

    Raises:
        DeviceError: The bytes are not an RVL image.
    """
    if len(blob) < _HEADER.size or (len(blob) - _HEADER.size) % 4:
        raise DeviceError(f"A depth image of {len(blob)} bytes is cut off.")
    _, _, _, width, height = _HEADER.unpack_from(blob)
    if width <= 0 or height <= 0 or width * height > _MOST_PIXELS:
        raise DeviceError(f"A depth image cannot have {width} x {height} pixels.")
    depth = np.zeros(width * height, dtype=np.uint16)
    if not _decode(np.frombuffer(blob, dtype="<u4", offset=_HEADER.size), depth):
        raise DeviceError(f"A depth image of {width} x {height} pixels is damaged.")
    return depth.reshape(height, width)


@njit(nogil=True)
def _put(value, words, at, word, nibbles):  # type: ignore[no-untyped-def]
    while True:
        nibble = value & 7
        value >>= 3
        if value:
            nibble |= 8
        word = (word << 4) | nibble
        nibbles += 1
        if nibbles == 8:
            words[at] = word
            at, word, nibbles = at + 1, 0, 0
        if value == 0:
            return at, word, nibbles


@njit(nogil=True)
def _encode(pixels, words):  # type: ignore[no-untyped-def]
    at, word, nibbles, i, size = 0, 0, 0, 0, len(pixels)
    previous = np.int64(0)
    while i < size:
        start = i
        while i < size and pixels[i] == 0:
            i += 1
        at, word, nibbles = _put(i - start, words, at, word, nibbles)
        end = i
        while end < size and pixels[end] != 0:
            end += 1
        at, word, nibbles = _put(end - i, words, at, word, nibbles)
        while i < end:
            delta = np.int64(pixels[i]) - previous
            at, word, nibbles = _put((delta << 1) ^ (delta >> 63), words, at, word, nibbles)
            previous += delta
            i += 1
    if nibbles:
        words[at] = word << (4 * (8 - nibbles))
        at += 1
    return at


@njit(nogil=True)
def _get(words, nibble):  # type: ignore[no-untyped-def]
    """The value at a nibble and the index of the next nibble; -1 if the words end before the value."""
    value, shift = np.int64(0), 0
    while shift <= 60 and nibble < 8 * len(words):
        bits = (np.int64(words[nibble >> 3]) >> (28 - 4 * (nibble & 7))) & 15
        nibble += 1
        value |= (bits & 7) << shift
        shift += 3
        if bits < 8:
            return value, nibble
    return np.int64(-1), nibble


@njit(nogil=True)
def _decode(words, pixels):  # type: ignore[no-untyped-def]
    """Decodes the words; returns whether they form a whole image."""
    i, nibble, previous, size = 0, 0, 0, len(pixels)
    while i < size:
        zeros, nibble = _get(words, nibble)
        readings, nibble = _get(words, nibble)
        if zeros < 0 or readings < 0 or zeros + readings == 0 or zeros > size or readings > size:
            return False
        if i + zeros + readings > size:
            return False
        i += zeros
        for _ in range(readings):
            code, nibble = _get(words, nibble)
            if code < 0:
                return False
            previous += (code >> 1) ^ -(code & 1)
            if not 0 < previous <= 65535:
                return False
            pixels[i] = previous
            i += 1
    return True


@compiles(_encode)
def warm_up() -> None:
    """Compiles or loads the encoder."""
    encode_depth(np.zeros((1, 1), dtype=np.uint16))
