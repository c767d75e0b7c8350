"""What the setup coach says at one moment, and what it draws into the scene for it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal

import rerun as rr

from recordings import layout

Point = tuple[float, float, float]
Meaning = Literal["do", "mend", "better"]

_COLORS: dict[Meaning, layout.Color] = {
    "do": (64, 168, 96),  # green: go there
    "mend": (220, 60, 60),  # red: something is wrong here
    "better": (226, 168, 60),  # amber: it could stand here
}
_LINE_RADIUS = rr.components.Radius.ui_points(2.0)


@dataclass(frozen=True)
class Mark:
    """Lines in the scene, and words beside the first of them.

    Attributes:
        lines: Polylines in K_A's frame, metres.
        words: A label; short.
        meaning: What its colour says.
    """

    lines: tuple[tuple[Point, ...], ...]
    words: str
    meaning: Meaning


@dataclass(frozen=True)
class CoachPage:
    """What to do next.

    Attributes:
        text: Markdown.
        marks: By where they belong, a name of :data:`layout.COACH_MARKS`; what is missing is not drawn.
    """

    text: str
    marks: tuple[tuple[str, Mark], ...] = ()

    def entities(self) -> Iterator[tuple[str, Any]]:
        """What to log where; a mark that is no longer there is logged as empty, which wipes it."""
        yield layout.COACH, rr.TextDocument(self.text, media_type=rr.MediaType.MARKDOWN)
        marks = dict(self.marks)
        for name in layout.COACH_MARKS:
            mark = marks.get(name)
            if mark is None:
                yield layout.coach_mark(name), rr.LineStrips3D([])
                continue
            yield (
                layout.coach_mark(name),
                rr.LineStrips3D(
                    mark.lines,
                    colors=_COLORS[mark.meaning],
                    radii=_LINE_RADIUS,
                    labels=[mark.words, *[""] * (len(mark.lines) - 1)],
                    show_labels=True,
                ),
            )
