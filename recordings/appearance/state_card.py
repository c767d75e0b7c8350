"""A picture, and tones, that say how far a set-up is, and what to do next.

A viewer draws a picture as large as its view. Its own text has one size.
"""

from collections.abc import Sequence
from enum import Enum
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from recordings.appearance.colors import Color

WIDTH, HEIGHT = 960, 276
"""Pixels of the picture."""
STEP_LINES = 2
"""How many lines a step takes at most."""
_WORD_SIZE, _STEP_SIZE, _LEAST_STEP_SIZE = 126, 58, 40
_EDGE, _SHAPE = 26, 98  # pixels
_STEP_TOP, _STEP_APART = 142, 64


class Look(NamedTuple):
    """Ground and ink of a state."""

    ground: Color
    ink: Color


class State(Enum):
    """How far a set-up is."""

    NOT_YET = "NOT YET"
    ALMOST = "ALMOST"
    READY = "READY"


LOOKS = {
    State.NOT_YET: Look((152, 20, 48), (255, 255, 255)),
    State.ALMOST: Look((240, 192, 24), (0, 0, 0)),
    State.READY: Look((0, 104, 78), (255, 255, 255)),
}
"""Red, amber and green, of different brightness."""
TONES: dict[str, Sequence[tuple[float, float]]] = {
    "not yet": ((440.0, 0.25),),
    "ready": ((523.0, 0.12), (659.0, 0.12), (784.0, 0.3)),
    "lost": ((392.0, 0.15), (0.0, 0.08), (392.0, 0.15), (0.0, 0.08), (392.0, 0.15)),
}
"""Of each sound, hertz and seconds one after another; 0 Hz is silence. A laptop plays little below 300 Hz."""


@lru_cache(maxsize=16)
def state_card(state: State, step: str) -> NDArray[np.uint8]:
    """The picture, (:data:`HEIGHT`, :data:`WIDTH`, 3) in RGB.

    Args:
        step: What to do next. A step that does not fit into two lines is drawn smaller.
    """
    look = LOOKS[state]
    picture = Image.new("RGB", (WIDTH, HEIGHT), look.ground)
    draw = ImageDraw.Draw(picture)
    _draw_shape(draw, state, look.ink)
    beside = (2 * _EDGE + _SHAPE, _EDGE + _SHAPE // 2)
    draw.text(beside, state.value, look.ink, _font(_WORD_SIZE), anchor="lm")
    font, lines = _fitted(step)
    for k, line in enumerate(lines):
        draw.text((_EDGE, _STEP_TOP + k * _STEP_APART), line, look.ink, font)
    return np.asarray(picture)


def fits(step: str) -> bool:
    """Whether a step is drawn at its full size."""
    return len(_wrapped(step, _font(_STEP_SIZE))) <= STEP_LINES


def _draw_shape(draw: ImageDraw.ImageDraw, state: State, ink: Color) -> None:
    """A cross, a triangle with a mark in it, or a tick."""
    left, top, right, bottom = _EDGE, _EDGE, _EDGE + _SHAPE, _EDGE + _SHAPE
    middle, thick = (left + right) // 2, 20
    if state is State.NOT_YET:
        draw.line((left, top, right, bottom), ink, thick)
        draw.line((left, bottom, right, top), ink, thick)
    elif state is State.ALMOST:
        draw.polygon(((middle, top), (right, bottom), (left, bottom)), ink)
        draw.line((middle, top + 32, middle, bottom - 26), LOOKS[state].ground, 11)
        draw.rectangle((middle - 6, bottom - 19, middle + 5, bottom - 9), LOOKS[state].ground)
    else:
        low = (left + _SHAPE * 0.38, bottom - 8)
        draw.line((left, top + _SHAPE * 0.52, *low, right, top + 6), ink, thick, joint="curve")


def _fitted(step: str) -> tuple[ImageFont.FreeTypeFont, list[str]]:
    for size in range(_STEP_SIZE, _LEAST_STEP_SIZE, -2):
        lines = _wrapped(step, _font(size))
        if len(lines) <= STEP_LINES:
            return _font(size), lines
    smallest = _font(_LEAST_STEP_SIZE)
    return smallest, _wrapped(step, smallest)[:STEP_LINES]


def _wrapped(text: str, font: ImageFont.FreeTypeFont) -> list[str]:
    lines = [""]
    for word in text.split():
        longer = f"{lines[-1]} {word}".lstrip()
        if font.getlength(longer) <= WIDTH - 2 * _EDGE or not lines[-1]:
            lines[-1] = longer
        else:
            lines.append(word)
    return lines


@lru_cache
def _font(size: int) -> ImageFont.FreeTypeFont:
    font = ImageFont.load_default(size)
    assert isinstance(font, ImageFont.FreeTypeFont)  # Pillow's wheels have FreeType
    return font
