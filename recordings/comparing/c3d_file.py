"""Reads the points of a .c3d, a format of numbers in blocks of 512 bytes (https://www.c3d.org)."""

from io import BufferedReader
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from recordings.errors import RecordingError

_BLOCK, _KEY = 512, 0x50
_ORDER = {84: "<", 85: "<", 86: ">"}  # of bytes, by the processor: Intel, DEC, MIPS
_DEC = 85
_LAST = 65_535  # the last frame that the header can state
_PART = 1 << 20  # bytes that are read at once


class C3d(NamedTuple):
    """The points of a .c3d."""

    labels: list[str]
    rate: float  # Hz
    points: NDArray[np.float32]  # (N, M, 3) in the file's unit; NaN where a point is not valid
    stated: int  # frames; more may follow where that is as many as the header can state


def read_c3d(file: BufferedReader) -> C3d:
    """Reads a file from its beginning.

    Raises:
        RecordingError: It is no .c3d; the message says why.
    """
    head = file.read(_BLOCK)
    if len(head) < _BLOCK or head[1] != _KEY or head[0] == 0:
        raise RecordingError("it does not begin like one")
    file.seek(_BLOCK * (head[0] - 1))
    _, _, blocks, processor = file.read(4).ljust(4, b"\0")
    if processor not in _ORDER:
        raise RecordingError("it does not tell how its numbers are written")
    words = np.frombuffer(head[:24], f"{_ORDER[processor]}u2").tolist()
    count, analog, first, last, begin = (words[k] for k in (1, 2, 3, 4, 8))
    labels = _labels(file.read(_BLOCK * max(blocks, begin - head[0])), f"{_ORDER[processor]}i2")
    if count == 0 or not labels:
        raise RecordingError("it has no points, or does not name them")
    scale, rate = (float(_floats(head[at : at + 4], processor)[0]) for at in (12, 20))
    kind, width = (4 if scale < 0.0 else 2), 4 * count + analog
    begins, stated = _BLOCK * max(begin - 1, 0), last - first + 1
    there = max(file.seek(0, 2) - begins, 0) // max(kind * width, 1)
    points = np.empty((max(0, there if last == _LAST else min(stated, there)), count, 3), dtype=np.float32)
    file.seek(begins)
    step = max(1, _PART // max(kind * width, 1))
    for k in range(0, len(points), step):
        part = points[k : k + step]
        raw = file.read(len(part) * width * kind)
        numbers = (
            _floats(raw, processor) if kind == 4 else np.frombuffer(raw, f"{_ORDER[processor]}i2") * scale
        )
        at = numbers.reshape(len(part), width)[:, : 4 * count].reshape(len(part), count, 4)
        part[:] = np.where(at[..., 3:] < 0.0, np.nan, at[..., :3])
    return C3d(labels, rate, points, stated)


def _floats(raw: bytes, processor: int) -> NDArray[np.float32]:
    if processor == _DEC:  # words exchanged, and an exponent that is larger by two
        words = np.frombuffer(raw, "<u2").reshape(-1, 2)[:, ::-1]
        return np.ascontiguousarray(words).view(np.float32).ravel() / np.float32(4.0)
    return np.frombuffer(raw, f"{_ORDER[processor]}f4").astype(np.float32, copy=False)


def _labels(section: bytes, integer: str) -> list[str]:
    """The names in POINT:LABELS, LABELS2 and so on.

    A record has the length of its name, its group (negative where it is the group's own), the name, and the
    distance to the next record. Of text then follow -1, the number of dimensions, these, and the characters.
    """
    groups, texts, at = dict[int, bytes](), dict[tuple[int, bytes], bytes](), 0
    while at + 2 < len(section):
        length, group = (abs(int(each)) for each in np.frombuffer(section[at : at + 2], np.int8))
        own, name = section[at + 1] > 127, section[at + 2 : at + 2 + length].upper()
        at += 2 + length
        step = int.from_bytes(section[at : at + 2], "big" if integer[0] == ">" else "little")
        end = at + step if step >= 2 else len(section)  # the last record may state no distance
        if own:
            groups[group] = name
        else:
            texts[group, name] = section[at + 2 : end]
        if length == 0:
            break
        at = end
    labels = []
    for (group, name), text in sorted(texts.items(), key=lambda item: (len(item[0][1]), item[0][1])):
        of_points = groups.get(group) == b"POINT" and name.startswith(b"LABELS")
        if of_points and len(text) > 4 and text[:2] == b"\xff\x02":
            size = max(text[2], 1)
            cells = [text[k : k + size] for k in range(4, min(4 + size * text[3], len(text)), size)]
            labels += [cell.decode("utf-8", "replace").strip(" \0") for cell in cells]
    return labels
