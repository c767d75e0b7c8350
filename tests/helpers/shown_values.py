"""Figures that sessions show, by their place."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from recordings.session_arrays import SessionArrays
from recordings.writing.shown_figures import SHOWN_FIGURES


def shown_values(rows: SessionArrays, entity: str, component: str) -> NDArray[Any] | None:
    """(T, …) values of one derived figure; None where there are none."""
    return next(f for f in SHOWN_FIGURES if (f.entity, f.component) == (entity, component)).values(rows)
