"""Tracker errors that the program was not fitted to: larger errors, and errors of another distribution.

They test whether a method that was developed on the simulator generalizes. ``duplex bench accuracy`` uses
them with ``--errors`` and ``--tracker-errors``.
"""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np

from devices.simulated.tracking.mirroring import Mirroring
from devices.simulated.tracking.tracker_errors import JointGroups, TrackerErrors

SIZES = frozenset(
    {"view_bias", "skin", "inferred_error", "outlier_size", "rescale", "jitter", "moving_jitter", "tail"}
)
"""Knobs for the size of an error; they are multiplied."""
SHARES = frozenset(
    {
        "unsure", "not_tracked", "mistracked", "snap", "stretch", "outliers", "mirroring", "swapped", "stale",
        "lost",
    }
)  # fmt: skip
"""Knobs for the frequency of an error; they are multiplied, up to LARGEST_SHARE.

A value that is already above LARGEST_SHARE stays unchanged.

Of ``mirroring`` it is ``back``.
"""
SHAPES = frozenset({
    "seen_share", "inferred_jitter", "jitter_memory", "rescale_seconds", "swap_seconds", "lost_seconds",
    "tail_spread",
})  # fmt: skip
"""Knobs for the form of an error; they are unchanged."""
LARGEST_SHARE = 0.95


def scaled(errors: TrackerErrors, factor: float) -> TrackerErrors:
    """Multiplies the size and frequency of all errors; durations and thresholds stay unchanged.

    Args:
        errors: Errors of a tracker.
        factor: The factor; 1 changes nothing.
    """
    larger: dict[str, Any] = {
        knob.name: _times(getattr(errors, knob.name), factor, share=knob.name in SHARES)
        for knob in fields(TrackerErrors)
        if knob.name in SIZES | SHARES
    }
    return replace(errors, **larger)


def heavy_tailed(errors: TrackerErrors) -> TrackerErrors:
    """Returns heavy-tailed errors: 1–2 cm at trunk and legs, at times half a metre at the hands.

    The sizes are those of one Kinect v2 against optical motion capture: 59 recordings of a seated person,
    with the constant offset of each joint removed. Median, 90 % and 99 % in mm, ranges over three exercises:
    spine base 13–24, 30–70, 51–97; head 12–31, 33–245, 69–273; knee 5–15, 16–33, 21–55; hands 18–38, 84–775,
    279–1139.
    Jitter of trunk and legs 0.2–0.6 mm, of hands 2.3 mm. Elbows and wrists are interpolated between shoulder
    and hand: an assumption. The errors of hidden joints, turned backs and lost persons stay unchanged.

    Args:
        errors: Errors of the tracker; errors of other kinds are kept.
    """
    return replace(
        errors,
        outliers=0.0,
        rescale=0.0,
        moving_jitter=0.0,
        jitter=JointGroups(
            spine=0.0003, head=0.0005, girdle=0.0003, elbow=0.0007, wrist=0.001, hand=0.0013, tip=0.0013,
            thumb=0.0013, knee=0.0003, ankle=0.0003, foot=0.0003, face=0.0005,
        ),
        tail=JointGroups(
            spine=0.012, head=0.012, girdle=0.012, elbow=0.012, wrist=0.015, hand=0.018, tip=0.018,
            thumb=0.018, knee=0.006, ankle=0.006, foot=0.006, face=0.012,
        ),
        tail_spread=JointGroups(
            spine=0.5, head=0.9, girdle=0.5, elbow=0.9, wrist=1.2, hand=1.4, tip=1.4,
            thumb=1.4, knee=0.5, ankle=0.5, foot=0.5, face=0.9,
        ),
    )  # fmt: skip


def _times(
    value: float | JointGroups | Mirroring, factor: float, *, share: bool
) -> float | JointGroups | Mirroring:
    if isinstance(value, Mirroring):
        return replace(value, back=_product(value.back, factor, share))
    if isinstance(value, JointGroups):
        return JointGroups(
            **{kind.name: _product(getattr(value, kind.name), factor, share) for kind in fields(JointGroups)}
        )
    return _product(value, factor, share)


def _product(value: float, factor: float, share: bool) -> float:
    return float(np.minimum(value * factor, max(LARGEST_SHARE, value))) if share else value * factor
