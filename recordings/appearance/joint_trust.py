"""Pictures that explain S*: joints coloured by their source, a matrix of joint × time, lanes of states.

The question "Why did the right elbow follow B at 12.4 s?" is answered by the colour of the joint, by its row
in the matrix, and by the components stored with the joint.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from fusion.body import Body
from recordings.appearance.colors import PREDICTED_COLOR, SKELETON_COLORS, Color
from recordings.session_arrays import SessionArrays

_SHADES = 16  # finer shades are not visible; few colours compress well
_BINS = 150
_BIN_NS = 200_000_000
_PAGE_NS, _LOOK_BACK_NS = 15_000_000_000, 10_000_000_000
_TICK_S = 5  # divides both
_BIN_WIDTH, _NAMES_WIDTH, _TICKS_HEIGHT, _AXIS_HEIGHT = 5, 170, 34, 76  # pixels
_MATRIX_HEIGHT = 400  # pixels, about: twice as wide as high, as is the place for it
_INK = (140, 140, 148)  # in contrast to the viewer's light and dark background, which shines through
_INKS = 16  # from transparent to opaque: smooth letters
_FAST, _SMALL = 1, 9  # zlib levels: _FAST takes a fifth of the time, _SMALL half the space
_TEXT_SIZE, _STROKE = 0.85, 2
_GROUPS = ("head", "left arm", "right arm", "trunk", "left leg", "right leg")
_HEAD, _ARM, _LEG = (
    ("neck", "head", "nose", "eye", "ear"),
    ("clavicle", "shoulder", "elbow", "wrist", "hand", "thumb"),
    ("hip", "knee", "ankle", "heel", "foot"),
)


def _palette() -> NDArray[np.uint8]:
    """(_INKS + _SHADES + 2, 3) RGB: the ink, from B's colour over that of S* to A's, then the
    predicted colour."""

    def between(first: Color, last: Color, steps: int) -> NDArray[np.float64]:
        return np.linspace(np.array(first), np.array(last), steps)

    a, b, both = (SKELETON_COLORS[key] for key in ("a", "b", "fused"))
    half = _SHADES // 2
    ramps = (
        between(_INK, _INK, _INKS),
        between(b, both, half + 1)[:-1],
        between(both, a, half + 1),
        np.array([PREDICTED_COLOR]),
    )
    return np.concatenate(ramps).astype(np.uint8)


_PALETTE = _palette()
_ALPHA = np.append(np.linspace(0, 255, _INKS).astype(np.uint8), np.full(len(_PALETTE) - _INKS, 255, np.uint8))
_FROM_B, _FROM_A, _PREDICTED = _INKS, _INKS + _SHADES, _INKS + _SHADES + 1


def trust_colors(rows: SessionArrays) -> NDArray[np.uint8]:
    """(T, J, 3) RGB by the share of the views in the joint: the colours of A, of S* where both count alike,
    and of B; grey where predicted."""
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
    """Shows which view each joint followed: one row per joint, by limb, half a minute per page, colours as in
    :func:`trust_colors`.

    A page is shown from its start until the next page starts. It covers some time before its start and after
    its end, so that the current moment is always inside the page. A page is logged at its first frame,
    although it is completed later.

    Args:
        body: The body that defines the joints.
        draft_ns: Interval between drawings of an incomplete page; a newer drawing replaces an older one.
            None: only complete pages are drawn.
    """

    def __init__(self, body: Body, draft_ns: int | None) -> None:
        self._draft_ns = draft_ns
        self._body = body
        self._rows = _Rows.of(body)
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
                    yield self._drawn(page, _FAST)
            whole = [page for page in before if number >= page.first + _BINS]
            yield from map(self._drawn, whole)
            self._open = [page for page in before if page not in whole]
            if now // _PAGE_NS > self._newest:
                self._newest = now // _PAGE_NS
                self._open.append(self._page(int(rows.frame[t]), now, before))
            for page in self._open:
                page.put(number, shades)

    def blank(self) -> tuple[int, int, bytes]:
        """Returns an empty page for the time before the first frame."""
        return self._drawn(self._page(0, 0, ()), _FAST)

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
        cells = page.cells[self._rows.joints].repeat(_BIN_WIDTH, axis=1)
        picture = np.pad(cells.repeat(self._rows.height, axis=0), ((0, _TICKS_HEIGHT), (0, 0)))
        height, width = len(cells) * self._rows.height, cells.shape[1]
        picture[self._rows.height - 1 : height : self._rows.height] = 0  # a line between the joints
        for _, first, _ in self._rows.groups:
            picture[max(0, first - 2) : first + 1] = 0
        axis = picture[height:]
        step = _BIN_WIDTH * (_TICK_S * 10**9 // _BIN_NS)
        for k, x in enumerate(range(0, width, step)):
            axis[:8, x : x + 2] = _INKS - 1
            _text(axis, f"{page.first * _BIN_NS // 10**9 + k * _TICK_S} s", x + 6, 29)
        return page.frame, page.time_ns, _png(picture, level)


@dataclass(frozen=True, eq=False)
class _Rows:
    """The rows of the matrix.

    Attributes:
        joints: (J,) the joint of each row, by limb.
        height: Pixels of a row.
        groups: (name, first, last) pixel row of each limb.
    """

    joints: NDArray[np.int64]
    height: int
    groups: list[tuple[str, int, int]]

    @staticmethod
    def of(body: Body) -> _Rows:
        limbs = np.array([_GROUPS.index(_limb(name)) for name in body.joints])
        height = round(_MATRIX_HEIGHT / len(body))
        ends = np.cumsum([np.count_nonzero(limbs == k) for k in range(len(_GROUPS))]) * height
        begins = [0, *ends[:-1].tolist()]
        return _Rows(
            np.argsort(limbs, kind="stable"),
            height,
            [(name, begin, end) for name, begin, end in zip(_GROUPS, begins, ends.tolist(), strict=True)],
        )


def matrix_frame(body: Body) -> bytes:
    """What lies beneath every page, as a PNG file: the names of the limbs on the right, and a legend."""
    rows = _Rows.of(body)
    height, width = len(body) * rows.height, _BINS * _BIN_WIDTH
    picture = np.zeros((height + _AXIS_HEIGHT, width + _NAMES_WIDTH), dtype=np.uint8)
    for name, first, last in rows.groups:
        _text(picture, name, width + 10, (first + last) // 2 + 8)
    left = 0
    for words, shade in (
        ("from A", _FROM_A),
        ("from B", _FROM_B),
        ("from both", (_FROM_A + _FROM_B) // 2),
        ("predicted", _PREDICTED),
    ):
        picture[height + 46 : height + 66, left : left + 28] = shade
        _text(picture, words, left + 36, height + 65)
        left += 60 + 17 * len(words)
    return _png(picture)


def _limb(joint: str) -> str:
    """The group of a joint."""
    name = joint.lower()
    side = "left" if "left" in name else "right"
    if any(part in name for part in _ARM) and side in name:
        return f"{side} arm"
    if any(part in name for part in _LEG) and side in name:
        return f"{side} leg"
    return "head" if any(part in name for part in _HEAD) else "trunk"


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


def _text(picture: NDArray[np.uint8], words: str, x: int, y: int) -> None:
    letters = np.zeros_like(picture)
    cv2.putText(letters, words, (x, y), cv2.FONT_HERSHEY_SIMPLEX, _TEXT_SIZE, 255, _STROKE, cv2.LINE_AA)
    np.maximum(picture, letters // (256 // _INKS), out=picture)


def _png(picture: NDArray[np.uint8], level: int = _SMALL) -> bytes:
    """Encodes palette indices (height, width) as a PNG file with a palette: a quarter of the RGB size."""
    image = Image.fromarray(picture)
    image.putpalette(_PALETTE.tobytes())
    file = io.BytesIO()
    image.save(file, "PNG", compress_level=level, transparency=_ALPHA.tobytes())
    return file.getvalue()
