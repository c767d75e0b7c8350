"""Tracker errors that the program was not fitted to: larger errors, and errors of another distribution.

They test whether a method that was developed on the simulator generalizes.
"""

from collections.abc import Mapping
from dataclasses import fields, replace

import numpy as np

from devices.simulated.tracking.mirroring import Mirroring
from devices.simulated.tracking.tracker_errors import TrackerErrors
from fusion.joint_kinds import by_joint, kind_of

SIZES = frozenset(
    {
        "view_bias", "skin", "lean", "bones", "inferred_error", "outlier_size", "rescale", "jitter",
        "moving_jitter",
    }
)  # fmt: skip
"""Knobs for the size of an error; they are multiplied."""
SHARES = frozenset(
    {
        "unsure", "not_tracked", "mistracked", "snap", "stretch", "outliers", "mirroring", "stale",
        "lost",
    }
)  # fmt: skip
"""Knobs for the frequency of an error; they are multiplied, up to LARGEST_SHARE.

A value that is already above LARGEST_SHARE stays unchanged.

Of ``mirroring`` it is ``back``.
"""
LARGEST_SHARE = 0.95


def scaled(errors, factor):
    """Multiplies the size and frequency of all errors; durations and thresholds stay unchanged.

    Args:
        errors: Errors of a tracker.
        factor: The factor; 1 changes nothing.
    """
    larger = {
        knob.name: _times(getattr(errors, knob.name), factor, share=knob.name in SHARES)
        for knob in fields(TrackerErrors)
        if knob.name in SIZES | SHARES
    }
    return replace(errors, **larger)


_TAIL = {
    "spine": 0.012, "head": 0.012, "girdle": 0.012, "elbow": 0.012, "wrist": 0.015, "hand": 0.018,
    "tip": 0.018, "thumb": 0.018,
    "knee": 0.006, "ankle": 0.006, "foot": 0.006, "face": 0.012,
}  # fmt: skip
"""Median size of heavy-tailed errors per axis, metres, by kind of joint."""
_SPREAD = {
    "spine": 0.5, "head": 0.9, "girdle": 0.5, "elbow": 0.9, "wrist": 1.2, "hand": 1.4, "tip": 1.4,
    "thumb": 1.4, "knee": 0.5, "ankle": 0.5,
    "foot": 0.5, "face": 0.9,
}  # fmt: skip
"""Standard deviation of the logarithm of their size. With 1.4, the 99th percentile is 30 times the median."""
_ERROR_SECONDS = 0.3  # correlation time of an error's direction
_SIZE_SECONDS = 1.0  # correlation time of its size: a hand passes in front of the trunk in about a second
_LARGEST = 1.2  # metres
_ARM = {"elbow", "wrist", "hand", "tip", "thumb"}
_LEG = {"knee", "ankle", "foot"}


def heavy_tails(body, frame_seconds, random):
    """Yields (J, 3) errors per frame, metres: a log-normal size times a direction, one of each per limb.

    The error of a joint is ``_TAIL · exp(_SPREAD · h) · g``. Here h is a standard normal value and g a vector
    of three such values, both first-order autoregressive. Both belong to the joint's limb (trunk, head, each
    arm, each leg).
    """
    size, spread, limb = by_joint(body, _TAIL), by_joint(body, _SPREAD), limbs(body)
    count = int(limb.max()) + 1
    g, h = random.standard_normal((count, 3)), random.standard_normal(count)
    keep_g, keep_h = (np.exp(-frame_seconds / seconds) for seconds in (_ERROR_SECONDS, _SIZE_SECONDS))
    while True:
        noise = random.standard_normal((count, 4))
        g = keep_g * g + np.sqrt(1.0 - keep_g**2) * noise[:, :3]
        h = keep_h * h + np.sqrt(1.0 - keep_h**2) * noise[:, 3]
        length = size * np.exp(spread * h[limb])
        yield np.clip(length[:, None] * g[limb], -_LARGEST, _LARGEST)


def limbs(body):
    """Returns (J,) the limb of each joint: 0 trunk, 1 head, 2 and 3 arms, 4 and 5 legs, left before right."""
    found = []
    for name in body.joints:
        kind, right = kind_of(name), "right" in name.lower()
        limb = 2 if kind in _ARM else 4 if kind in _LEG else 1 if kind in ("head", "face") else 0
        found.append(limb + (right and limb >= 2))
    return np.array(found, dtype=np.int64)


def heavy_tailed(errors):
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
        jitter={
            "spine": 0.0003, "head": 0.0005, "girdle": 0.0003, "elbow": 0.0007, "wrist": 0.001,
            "hand": 0.0013, "tip": 0.0013,
            "thumb": 0.0013, "knee": 0.0003, "ankle": 0.0003, "foot": 0.0003, "face": 0.0005,
        },
        added=heavy_tails,
    )  # fmt: skip


def _times(value, factor, *, share):
    if isinstance(value, Mirroring):
        return replace(value, back=_product(value.back, factor, share))
    if isinstance(value, Mapping):
        return {kind: _product(each, factor, share) for kind, each in value.items()}
    return _product(value, factor, share)


def _product(value, factor, share):
    return float(np.minimum(value * factor, max(LARGEST_SHARE, value))) if share else value * factor
