"""Why S* is where it is, for eyes: joints coloured by their source, a matrix joint × time, state lanes.

"Why did the right elbow follow B at 12.4 s?" is answered by the joint's colour, by the row of the matrix, and
by the data that :func:`details` lays beside the joint.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from fusion.body import Body
from recordings import layout
from recordings.session_arrays import SessionArrays

_SHADES = 16  # more than an eye tells apart here; few colours compress well
_BINS = 150
_BIN_NS = 200_000_000
_PAGE_NS, _LOOK_BACK_NS = 15_000_000_000, 10_000_000_000
_TICK_S = 5  # divides both
_BIN_WIDTH, _ROW_HEIGHT, _NAMES_WIDTH, _TICKS_HEIGHT, _AXIS_HEIGHT = 5, 20, 180, 28, 52  # pixels
_BACKGROUND, _INK = (27, 27, 31), (214, 214, 220)
_INKS = 16  # between background and ink: smooth letters
_FAST, _SMALL = 1, 9  # of zlib: the one takes a fifth of the time, the other half the room
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


@dataclass(eq=False)
class _Page:
    """One picture of the matrix: the frame from which on it is shown, and what is in it so far."""

    frame: int
    time_ns: int
    first: int  # bin
    cells: NDArray[np.uint8]  # (J, _BINS) places in the palette

    def put(self, number: int, shades: NDArray[np.uint8]) -> None:
        self.cells[:, number - self.first] = shades


class TrustMatrix:
    """Whose view made each joint, a row a joint, coloured as in :func:`trust_colors`: half a minute a page.

    A page is shown from its own time on until the next one begins, and reaches from before the one to after
    the other: whatever moment is looked at stands within its page. It is logged at the frame that begins
    it, though complete only later.

    Args:
        body: Whose joints.
        draft_ns: How often pages that are not complete yet are drawn; newer drawings of a page replace older.
        hasty: Whether drafts are to be fast rather than small.
    """

    def __init__(self, body: Body, draft_ns: int, hasty: bool = False) -> None:
        self._draft_ns, self._draft_level = draft_ns, _FAST if hasty else _SMALL
        self._body = body
        self._open: list[_Page] = []
        self._newest = -1  # page
        self._next_ns = 0

    def add(self, rows: SessionArrays) -> Iterator[tuple[int, int, bytes]]:
        """Takes frames in time order.

        Returns:
            (frame, time in ns, PNG file) of a page whenever it is drawn.
        """
        for t, shades in enumerate(_shades(rows)):
            now = int(rows.time_ns[t])
            number = now // _BIN_NS
            before = self._open
            if now >= self._next_ns:
                self._next_ns = now - now % self._draft_ns + self._draft_ns
                for page in before[-1:]:
                    yield self._drawn(page, self._draft_level)
            whole = [page for page in before if number >= page.first + _BINS]
            yield from map(self._drawn, whole)
            self._open = [page for page in before if page not in whole]
            if now // _PAGE_NS > self._newest:
                self._newest = now // _PAGE_NS
                self._open.append(self._page(int(rows.frame[t]), now, before))
            for page in self._open:
                page.put(number, shades)

    def rest(self) -> Iterator[tuple[int, int, bytes]]:
        """The pages that are not complete, as they are."""
        yield from map(self._drawn, self._open)

    def _page(self, frame: int, now_ns: int, before: Sequence[_Page]) -> _Page:
        """Begins the page of a frame with what pages `before` have of its beginning."""
        first = max(0, now_ns // _PAGE_NS * _PAGE_NS - _LOOK_BACK_NS) // _BIN_NS
        page = _Page(frame, now_ns, first, np.zeros((len(self._body), _BINS), dtype=np.uint8))
        for old in before:
            shift = first - old.first
            if shift < _BINS:
                page.cells[:, : _BINS - shift] = old.cells[:, shift:]
        return page

    def _drawn(self, page: _Page, level: int = _SMALL) -> tuple[int, int, bytes]:
        cells = page.cells.repeat(_ROW_HEIGHT, axis=0).repeat(_BIN_WIDTH, axis=1)
        cells[_ROW_HEIGHT - 1 :: _ROW_HEIGHT] = 0  # a line between the joints
        picture = np.pad(cells, ((0, _TICKS_HEIGHT), (0, 0)))
        height, width = cells.shape[:2]
        axis = picture[height:]
        step = _BIN_WIDTH * (_TICK_S * 10**9 // _BIN_NS)
        for k, x in enumerate(range(0, width, step)):
            cv2.line(axis, (x, 0), (x, 5), _INKS - 1, 1)
            _text(axis, f"{page.first * _BIN_NS // 10**9 + k * _TICK_S} s", x + 4, 21)
        return page.frame, page.time_ns, _png(picture, level)


def matrix_frame(body: Body) -> bytes:
    """What lies beneath every page of the matrix: names on the right, and a legend; a PNG file."""
    height, width = len(body) * _ROW_HEIGHT, _BINS * _BIN_WIDTH
    picture = np.zeros((height + _AXIS_HEIGHT, width + _NAMES_WIDTH), dtype=np.uint8)
    for joint, name in enumerate(body.joints):
        _text(picture, _in_words(name), width + 8, (joint + 1) * _ROW_HEIGHT - 6)
    left = 0
    for words, shade in (
        ("from A", _FROM_A),
        ("from B", _FROM_B),
        ("predicted", _PREDICTED),
    ):
        picture[height + 33 : height + 48, left : left + 22] = shade
        _text(picture, words, left + 28, height + 47)
        left += 150
    return _png(picture)


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


def _png(picture: NDArray[np.uint8], level: int = _SMALL) -> bytes:
    """(height, width) places in the palette as a PNG file with a palette: a quarter of one in RGB."""
    image = Image.fromarray(picture)
    image.putpalette(_PALETTE.tobytes())
    file = io.BytesIO()
    image.save(file, "PNG", compress_level=level)
    return file.getvalue()
