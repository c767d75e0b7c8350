"""The text and the drawings of the setup coach at one moment."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import rerun as rr

from recordings.appearance import entity_styles
from recordings.appearance.colors import MARK_COLORS
from recordings.appearance.state_card import State, state_card
from recordings.data import layout

Point = tuple[float, float, float]
Meaning = Literal["do", "mend", "better"]

_MANY = 3  # paragraphs
WORDS = {"spot": "stand here", "better_b": "better for B"}
"""Of marks: never others, see :func:`entity_styles.words_at`."""
_LINE_RADIUS = rr.components.Radius.ui_points(2.0)


@dataclass(frozen=True)
class Mark:
    """Lines in the scene, and where the words of :data:`WORDS` stand, if the mark has words."""

    lines: tuple[tuple[Point, ...], ...]  # polylines in K_A's frame, metres
    meaning: Meaning  # what the colour means
    words_at: Point | None = None


@dataclass(frozen=True)
class CoachPage:
    """The coach's advice at one moment."""

    text: str  # the advice in Markdown
    marks: tuple[tuple[str, Mark], ...] = ()
    """The marks by their name in :data:`layout.COACH_MARKS`. Missing marks are not drawn."""
    card: tuple[State, str] | None = None  # how far the set-up is, and the next step; None: it is no set-up
    from_start: bool = False  # whether the page holds from the first frame on, even if it is written later

    def entities(self, card: bool) -> Iterator[tuple[str, Sequence[Any]]]:
        """Pairs of entity and what to log. An absent mark is logged as empty, which clears it.

        Args:
            card: Whether to yield the picture of the state; else the text begins with it.
        """
        if card and self.card is not None:
            # not encoded: a viewer on a slow machine shows the last picture until it has decoded this one
            yield layout.COACH_CARD, [rr.Image(state_card(*self.card))]
        text = self.text
        if not card and self.card is not None:
            state, step = self.card
            text = f"## {state.value}: {step}\n\n{text}"
        yield layout.COACH, [rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN)]
        marks = dict(self.marks)
        for name in layout.COACH_MARKS:
            mark = marks.get(name)
            if mark is None:
                yield layout.coach_mark(name), [rr.LineStrips3D([])]
            else:
                color = MARK_COLORS[mark.meaning]
                yield layout.coach_mark(name), [rr.LineStrips3D(mark.lines, colors=color, radii=_LINE_RADIUS)]
            if name in WORDS:
                at = None if mark is None else mark.words_at
                words = (
                    entity_styles.words_at(WORDS[name], at, layout.ROOT)
                    if at
                    else [rr.Clear(recursive=False)]
                )
                yield layout.coach_words(name), words


def large(text: str) -> str:
    """Each paragraph as a heading, which the viewer draws larger: it is read from where the person stands.

    Three are smaller, so that they fit. Of more, only the first two are larger than plain text: what is said
    first is to be followed first.
    """
    paragraphs = [" ".join(part.split()) for part in text.split("\n\n") if part.strip()]
    level = "## " if len(paragraphs) < _MANY else "#### "
    large = len(paragraphs) if len(paragraphs) <= _MANY else _MANY - 1
    levels = [level] * large + [""] * (len(paragraphs) - large)
    return "\n\n".join(
        part if part.startswith(("#", "-")) else f"{level}{part}"
        for level, part in zip(levels, paragraphs, strict=True)
    )
