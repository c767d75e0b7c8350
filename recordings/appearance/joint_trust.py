"""Pictures that explain S*: joints coloured by their source, a matrix of joint × time, lanes of states.

The question "Why did the right elbow follow B at 12.4 s?" is answered by the colour of the joint, by its row
in the matrix, and by the components stored with the joint.
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

_SHADES = 16  # finer shades are not visible; few colours compress well
_BINS = 150
_BIN_NS = 200_000_000
_PAGE_NS, _LOOK_BACK_NS = 15_000_000_000, 10_000_000_000
_TICK_S = 5  # divides both
_BIN_WIDTH, _ROW_HEIGHT, _NAMES_WIDTH, _TICKS_HEIGHT, _AXIS_HEIGHT = 5, 20, 180, 28, 52  # pixels
_BACKGROUND, _INK = (27, 27, 31), (214, 214, 220)
_INKS = 16  # between background and ink: smooth letters
_FAST, _SMALL = 1, 9  # zlib levels: _FAST takes a fifth of the time, _SMALL half the space
_FONT, _TEXT_SIZE = cv2.FONT_HERSHEY_SIMPLEX, 0.6


def _palette() -> NDArray[np.uint8]:
    """(_INKS + _SHADES + 2, 3) RGB: from background to ink, from B's colour over that of S* to A's, then the
    predicted colour."""

    def between(first: layout.Color, last: layout.Color, steps: int) -> NDArray[np.float64]:
        return np.linspace(np.array(first), np.array(last), steps)

    a, b, both = (layout.SKELETON_COLORS[key] for key in ("a", "b", "fused"))
    half = _SHADES // 2
    ramps = (
        between(_BACKGROUND, _INK, _INKS),
        between(b, both, half + 1)[:-1],
        between(both, a, half + 1),
        np.array([layout.PREDICTED_COLOR]),
    )
    return np.concatenate(ramps).astype(np.uint8)


_PALETTE = _palette()
_FROM_B, _FROM_A, _PREDICTED = _INKS, _INKS + _SHADES, _INKS + _SHADES + 1


def trust_colors(rows: SessionArrays) -> NDArray[np.uint8]:
    """(T, J, 3) RGB by the share of the views in the joint: A's colour, that of S* where both count alike, B's
    colour; grey where predicted."""
    return np.asarray(_PALETTE[_shades(rows)])


def _shades(rows: SessionArrays) -> NDArray[np.uint8]:
    """(T, J) the colours of :func:`trust_colors` as palette indices."""
    total = rows.weights_a + rows.weights_b
    share = np.where(total > 0.0, rows.weights_a / np.where(total > 0.0, total, 1.0), 0.0)
    return np.where(rows.predicted, _PREDICTED, _FROM_B + np.round(share * _SHADES)).astype(np.uint8)


@dataclass(eq=False)
class _Page:
    """One picture of the matrix: the frame at which it is first shown, and its content so far."""

    frame: int
    time_ns: int
    first: int  # bin
    cells: NDArray[np.uint8]  # (J, _BINS) palette indices

    def put(self, number: int, shades: NDArray[np.uint8]) -> None:
        self.cells[:, number - self.first] = shades


class TrustMatrix:
    """Shows which view each joint followed: one row per joint, half a minute per page, colours as in
    :func:`trust_colors`.

    A page is shown from its start until the next page starts. It covers some time before its start and after
    its end, so that the current moment is always inside the page. A page is logged at its first frame,
    although it is completed later.

    Args:
        body: The body that defines the joints.
        draft_ns: Interval between drawings of an incomplete page; a newer drawing replaces an older one.
            None: only complete pages are drawn.
        hasty: Whether to compress drafts fast rather than small.
    """

    def __init__(self, body: Body, draft_ns: int | None, hasty: bool = False) -> None:
        self._draft_ns, self._draft_level = draft_ns, _FAST if hasty else _SMALL
        self._body = body
        self._open: list[_Page] = []
        self._newest = -1  # page
        self._next_ns = 0

    def add(self, rows: SessionArrays) -> Iterator[tuple[int, int, bytes]]:
        """Adds frames in time order.

        Returns:
            (frame, time in ns, PNG file) of each page that is drawn.
        """
        for t, shades in enumerate(_shades(rows)):
            now = int(rows.time_ns[t])
            number = now // _BIN_NS
            before = self._open
            if self._draft_ns is not None and now >= self._next_ns:
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
        """Returns the incomplete pages in their present state."""
        yield from map(self._drawn, self._open)

    def _page(self, frame: int, now_ns: int, before: Sequence[_Page]) -> _Page:
        """Starts the page of a frame with the overlapping content of the pages `before`."""
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
    """The background of every page as a PNG file: joint names on the right, and a legend."""
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
    """Changes of tracking states; a joint that never changes gets no lane."""

    def __init__(self) -> None:
        self._before: dict[str, NDArray[np.uint8]] = {}
        self._open: set[tuple[str, int]] = set()

    def add(self, rows: SessionArrays) -> Iterator[tuple[str, int, list[tuple[int | None, int]]]]:
        """Adds frames in time order.

        Returns:
            (side, joint, changes) for each joint that changed; a change is (index in `rows`, state).
            The first change of a joint is preceded by its initial state, at index None.
        """
        for side, states in (("a", rows.states_a), ("b", rows.states_b)):
            before = self._before.get(side, states[0])
            whole = np.concatenate((before[None], states))
            for joint in np.flatnonzero((whole[1:] != whole[:-1]).any(axis=0)):
                lane = whole[:, joint]
                indices = np.flatnonzero(lane[1:] != lane[:-1])
                changes: list[tuple[int | None, int]] = [(int(t), int(states[t, joint])) for t in indices]
                if (side, int(joint)) not in self._open:
                    self._open.add((side, int(joint)))
                    changes.insert(0, (None, int(lane[0])))
                yield side, int(joint), changes
            self._before[side] = states[-1].copy()  # a view would keep the whole block in memory


def _in_words(joint: str) -> str:
    """ELBOW_LEFT and ElbowLeft as ``elbow left``."""
    return re.sub(r"(?<=[a-z])(?=[A-Z])|_", " ", joint).lower()


def _text(picture: NDArray[np.uint8], words: str, x: int, y: int) -> None:
    letters = np.zeros_like(picture)
    cv2.putText(letters, words, (x, y), _FONT, _TEXT_SIZE, 255, 1, cv2.LINE_AA)
    np.maximum(picture, letters // (256 // _INKS), out=picture)


def _png(picture: NDArray[np.uint8], level: int = _SMALL) -> bytes:
    """Encodes palette indices (height, width) as a PNG file with a palette: a quarter of the RGB size."""
    image = Image.fromarray(picture)
    image.putpalette(_PALETTE.tobytes())
    file = io.BytesIO()
    image.save(file, "PNG", compress_level=level)
    return file.getvalue()
