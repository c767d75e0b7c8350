"""The good seconds of a session in words, and what they leave out."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from recordings.session import Session
from viewer_app.errors import UsageError
from viewer_app.flags import in_flags
from viewer_app.report.words import Line

MOST_STRETCHES = 6
"""Stretches of time that a line lists."""


def good_frames_of(session: Session, console: Console) -> NDArray[np.bool_]:
    """(T,) whether a frame is in a good second; prints what is left out.

    Raises:
        UsageError: No second is good.
    """
    good = session.good_frames
    if not good.any():
        why = in_flags(str(session.verdict))
        raise UsageError(f"No second of {session} is good. It is {why} Leave out --good to use all.")
    if not good.all():
        console.print(left_out(session), markup=False, soft_wrap=True)
    return good


def good_seconds(session: Session, most: int | None = None) -> Line:
    """How much of a session is good, and when; at most so many stretches."""
    spans = session.good_spans
    when = f": {_stretches(spans, most)}" if spans else ""
    total = sum(end - start for start, end in spans)
    return Line("Good", f"{total:.0f} of {session.time[-1]:.0f} s{when}.")


def left_out(session: Session) -> str:
    """What the good seconds leave out."""
    good, bounds = session.good_frames, np.ravel(session.good_spans)
    rest = np.concatenate(([0.0], bounds, [session.time[-1]])).reshape(-1, 2)
    when = _stretches([(start, end) for start, end in rest.tolist() if start < end], MOST_STRETCHES)
    return f"Left out: {len(good) - good.sum()} of {len(good)} frames, in seconds that are not good: {when}."


def _stretches(spans: Sequence[tuple[float, float]], most: int | None) -> str:
    listed = [f"{start:.0f}–{math.ceil(end)} s" for start, end in spans[:most]]
    more = [f"{len(spans) - len(listed)} more"] if len(spans) > len(listed) else []
    return ", ".join([*listed, *more])
