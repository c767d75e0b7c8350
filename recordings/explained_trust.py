"""Why S* is where it is, for eyes: joints coloured by their source, a matrix joint × time, state lanes.

"Why did the right elbow follow B at 12.4 s?" is answered by the joint's colour, by the row of the matrix, and
by the data that :func:`details` lays beside the joint.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Iterator, Sequence
from typing import Any

import cv2
import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from fusion.body import Body
from recordings import layout
from recordings.arrays import SessionArrays

_SHADES = 16  # more than an eye tells apart here; few colours compress well
_BINS = 150
_BIN_NS = 200_000_000
_BIN_WIDTH, _ROW_HEIGHT, _NAMES_WIDTH, _AXIS_HEIGHT = 5, 20, 172, 52  # pixels of the picture
_BACKGROUND, _INK = (27, 27, 31), (214, 214, 220)
_INKS = 16  # between background and ink: smooth letters
_FONT, _TEXT_SIZE = cv2.FONT_HERSHEY_SIMPLEX, 0.6


def _palette() -> NDArray[np.uint8]:
    """(_INKS + _SHADES + 2, 3) RGB: from background to ink, from B's colour to A's, and predicted."""

    def between(first: layout.Color, last: layout.Color, steps: int) -> NDArray[np.float64]:
        return np.linspace(np.array(first), np.array(last), steps)

    from_b_to_a = between(layout.SKELETON_COLORS["b"], layout.SKELETON_COLORS["a"], _SHADES + 1)
    ramps = (between(_BACKGROUND, _INK, _INKS), from_b_to_a, np.array([layout.PREDICTED_COLOR]))
    return np.concatenate(ramps).astype(np.uint8)


_PALETTE = _palette()
_FROM_B, _FROM_A, _PREDICTED = _INKS, _INKS + _SHADES, _INKS + _SHADES + 1


def trust_colors(rows: SessionArrays) -> NDArray[np.uint8]:
    """(T, J, 3) RGB: between A's colour and B's by the share each has in the joint; grey where predicted."""
    return np.asarray(_PALETTE[_shades(rows)])


def _shades(rows: SessionArrays) -> NDArray[np.uint8]:
    """(T, J) the same as places in the palette."""
    total = rows.weights_a + rows.weights_b
    share = np.where(total > 0.0, rows.weights_a / np.where(total > 0.0, total, 1.0), 0.0)
    return np.where(rows.predicted, _PREDICTED, _FROM_B + np.round(share * _SHADES)).astype(np.uint8)


def details(rows: SessionArrays) -> dict[str, pa.Array]:
    """T · J values each: what a person wants to read beside a joint of S* that is clicked."""
    weights = {
        layout.weight(side): pa.array(of.astype(np.float16).ravel())
        for side, of in (("a", rows.weights_a), ("b", rows.weights_b))
    }
    states = {
        layout.state(side): _named(of, layout.STATE_NAMES)
        for side, of in (("a", rows.states_a), ("b", rows.states_b))
    }
    misleading = np.where(rows.misleading < 0, len(rows.body), rows.misleading)
    return {
        **weights,
        **states,
        "misleading_joint": _named(misleading, (*rows.body.joints, "none")),
        "view_difference_mm": pa.array(np.round(rows.view_difference * 1e3).astype(np.float16).ravel()),
        "predicted": pa.array(rows.predicted.ravel()),
    }


def _named(which: NDArray[Any], names: Sequence[str]) -> pa.DictionaryArray:
    return pa.DictionaryArray.from_arrays(pa.array(which.ravel().astype(np.int8)), pa.array(names))


class TrustMatrix:
    """The last half minute as a picture: a row a joint, coloured as in :func:`trust_colors`.

    Args:
        body: Whose joints.
        every_ns: How often there is a new picture.
    """

    def __init__(self, body: Body, every_ns: int = 1_000_000_000) -> None:
        self._every_ns = every_ns
        self._frame = _frame_of_matrix(body)
        self._bins = np.zeros((len(body), _BINS), dtype=np.uint8)
        self._newest = -1  # bin
        self._next_ns = 0

    def add(self, rows: SessionArrays) -> Iterator[tuple[int, bytes]]:
        """Takes frames in time order.

        Returns:
            (index in `rows`, PNG file) whenever a new picture is due.
        """
        for t, shades in enumerate(_shades(rows)):
            now = int(rows.time_ns[t])
            self._put(now // _BIN_NS, shades)
            if now >= self._next_ns:
                self._next_ns = now - now % self._every_ns + self._every_ns
                yield t, self._picture(now)

    def _put(self, number: int, shades: NDArray[np.uint8]) -> None:
        moved = min(max(number - self._newest, 0), _BINS)
        if moved:
            self._bins = np.roll(self._bins, -moved, axis=1)
            self._bins[:, _BINS - moved :] = 0
            self._newest = number
        self._bins[:, -1] = shades

    def _picture(self, now_ns: int) -> bytes:
        cells = self._bins.repeat(_ROW_HEIGHT, axis=0).repeat(_BIN_WIDTH, axis=1)
        cells[_ROW_HEIGHT - 1 :: _ROW_HEIGHT] = 0  # a line between the joints
        height, width = cells.shape[:2]
        picture = self._frame.copy()
        picture[:height, _NAMES_WIDTH : _NAMES_WIDTH + width] = cells
        _text(picture, f"until {now_ns * 1e-9:.1f} s", _NAMES_WIDTH + _BINS * _BIN_WIDTH - 140, height + 47)
        return _png(picture)


def _frame_of_matrix(body: Body) -> NDArray[np.uint8]:
    """What stays the same from picture to picture: names, time axis, legend; as places in the palette."""
    height, width = len(body) * _ROW_HEIGHT, _BINS * _BIN_WIDTH
    picture = np.zeros((height + _AXIS_HEIGHT, _NAMES_WIDTH + width + 30), dtype=np.uint8)
    for joint, name in enumerate(body.joints):
        _text(picture, _in_words(name), 4, (joint + 1) * _ROW_HEIGHT - 6)
    seconds = _BINS * _BIN_NS * 1e-9
    for ago in np.arange(0.0, seconds + 1.0, 5.0):
        x = _NAMES_WIDTH + round(width * (1.0 - ago / seconds))
        cv2.line(picture, (x, height), (x, height + 5), _INKS - 1, 1)
        label = "now" if ago == 0.0 else f"-{ago:.0f} s"
        _text(picture, label, x - 18, height + 21)
    left = _NAMES_WIDTH
    for words, shade in (
        ("from A", _FROM_A),
        ("from B", _FROM_B),
        ("predicted", _PREDICTED),
    ):
        picture[height + 33 : height + 48, left : left + 22] = shade
        _text(picture, words, left + 28, height + 47)
        left += 150
    return picture


class StateLanes:
    """Tracking states where they change; a joint that never changes gets no lane."""

    def __init__(self) -> None:
        self._before: dict[str, NDArray[np.uint8]] = {}
        self._open: set[tuple[str, int]] = set()

    def add(self, rows: SessionArrays) -> Iterator[tuple[str, int, list[tuple[int | None, int]]]]:
        """Takes frames in time order.

        Returns:
            For each side and joint with news, (side, joint, changes); a change is (index in `rows`, state).
            A joint's first change is preceded by what it was from the beginning, at index None.
        """
        for side, states in (("a", rows.states_a), ("b", rows.states_b)):
            before = self._before.get(side, states[0])
            whole = np.concatenate((before[None], states))
            for joint in np.flatnonzero((whole[1:] != whole[:-1]).any(axis=0)):
                lane = whole[:, joint]
                at = np.flatnonzero(lane[1:] != lane[:-1])
                changes: list[tuple[int | None, int]] = [(int(t), int(states[t, joint])) for t in at]
                if (side, int(joint)) not in self._open:
                    self._open.add((side, int(joint)))
                    changes.insert(0, (None, int(lane[0])))
                yield side, int(joint), changes
            self._before[side] = states[-1].copy()  # a view would keep the whole block


def _in_words(joint: str) -> str:
    """ELBOW_LEFT and ElbowLeft as ``elbow left``."""
    return re.sub(r"(?<=[a-z])(?=[A-Z])|_", " ", joint).lower()


def _text(picture: NDArray[np.uint8], words: str, x: int, y: int) -> None:
    letters = np.zeros_like(picture)
    cv2.putText(letters, words, (x, y), _FONT, _TEXT_SIZE, 255, 1, cv2.LINE_AA)
    np.maximum(picture, letters // (256 // _INKS), out=picture)


def _png(picture: NDArray[np.uint8]) -> bytes:
    """(height, width) places in the palette as a PNG file, a quarter of one without palette."""

    def part(kind: bytes, content: bytes) -> bytes:
        return (
            struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))
        )

    height, width = picture.shape
    header = struct.pack(">IIBBBBB", width, height, 8, 3, 0, 0, 0)  # 8 bits, with a palette
    # a row that is the one above again, as most are, is stored as its difference from it: filter 2
    same = (np.diff(picture, axis=0, prepend=np.uint8(255)) == 0).all(axis=1, keepdims=True)
    filtered = np.concatenate([np.where(same, 2, 0), np.where(same, 0, picture)], axis=1).astype(np.uint8)
    parts = (
        (b"IHDR", header),
        (b"PLTE", _PALETTE.tobytes()),
        (b"IDAT", zlib.compress(filtered.tobytes())),
        (b"IEND", b""),
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(part(kind, content) for kind, content in parts)
