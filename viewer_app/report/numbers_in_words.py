"""Formats figures for people."""

from __future__ import annotations

import math

_MICROMETRE = 1e-3  # millimetres; what a file stores of S* is no more exact


def in_mm(value: float | None, unit: str = " mm") -> str:
    """Whole millimetres from 10 on, two digits below, 0 below a micrometre; a dash where there is none."""
    if value is None or not math.isfinite(value):
        return "–"
    if abs(value) < _MICROMETRE:
        return f"0{unit}"
    return f"{value:.0f}{unit}" if value >= 10.0 else f"{value:.2g}{unit}"


def in_percent(share: float | None) -> str:
    """A share as a percentage: whole from 10 % on, one digit below; a dash where there is none."""
    if share is None or not math.isfinite(share):
        return "–"
    percent = 100.0 * share
    if 0.0 < percent < 0.05:
        return "below 0.1 %"
    return f"{percent:.0f} %" if percent >= 10.0 or percent == 0.0 else f"{percent:.1f} %"


def in_bytes(size: int) -> str:
    """A file's size as kB, MB or GB of a thousand each, with two digits at least."""
    value, unit = size * 1e-3, "kB"
    for larger in ("MB", "GB"):
        if value >= 1000.0:
            value, unit = value * 1e-3, larger
    return f"{value:.0f} {unit}" if value >= 10.0 else f"{value:.1f} {unit}"
