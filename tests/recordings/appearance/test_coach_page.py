"""The advice fits on its page: of much advice, what is to be mended first is large."""

from __future__ import annotations

import pytest

from recordings import layout
from recordings.appearance.coach_page import CoachPage


@pytest.mark.parametrize(
    ("paragraphs", "levels"),
    [
        (1, ["## "]),
        (2, ["## "] * 2),
        (3, ["#### "] * 3),
        (5, ["#### ", "#### ", "", "", ""]),
    ],
)
def test_the_first_advice_is_the_largest(paragraphs: int, levels: list[str]) -> None:
    said = [f"**Fix:** advice {k}" for k in range(paragraphs)]
    shown = dict(CoachPage("\n\n".join(said)).entities())[layout.COACH]
    (text,) = shown.text.as_arrow_array().to_pylist()
    assert text.split("\n\n") == [level + each for level, each in zip(levels, said, strict=True)]
