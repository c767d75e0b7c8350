"""Formats figures for people."""

from __future__ import annotations

import math


def in_mm(value: float | None, unit: str = " mm") -> str:
    """Whole millimetres from 10 on, two digits below; a dash where there is none."""
    if value is None or not math.isfinite(value):
        return "–"
    return f"{value:.0f}{unit}" if value >= 10.0 else f"{value:.2g}{unit}"
