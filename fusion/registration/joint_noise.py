"""Relative noise of body trackers by kind of joint."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from fusion.body import Body

# Name fragment → noise relative to the spine. The order matters: "handtip" precedes "hand".
# The values are rounded by hand; no command reproduces them: jitter of a still person and outlier rate
# of real Kinect v2 and published Azure recordings, compressed to a factor of four.
_KINDS = (
    ("handtip", 3.5),
    ("thumb", 4.0),
    ("hand", 2.5),
    ("wrist", 2.0),
    ("elbow", 1.5),
    ("spineshoulder", 1.0),
    ("shouldercenter", 1.0),
    ("hipcenter", 1.0),
    ("shoulder", 1.2),
    ("clavicle", 1.2),
    ("hip", 1.2),
    ("knee", 1.3),
    ("ankle", 1.6),
    ("foot", 2.5),
    ("heel", 2.5),
    ("head", 1.2),
    ("nose", 1.3),
    ("eye", 1.3),
    ("ear", 1.3),
)
_SPINE = 1.0

ARM, LEG = 1, 2
"""The limbs whose labels a tracker can exchange on their own; the bits of an exchange code."""


@lru_cache
def relative_noise(body: Body) -> NDArray[np.float64]:
    """(J,) standard deviation of a joint's frame-to-frame error, relative to the spine's."""
    return _fixed([_kind(name) for name in body.joints])


@lru_cache
def limbs(body: Body) -> NDArray[np.int64]:
    """(J,) ``ARM`` or ``LEG`` for joints that have a left and a right side, 0 for the midline.

    Hips belong to the legs; shoulders, clavicles, eyes and ears to the arms.
    """
    lower = ("hip", "knee", "ankle", "foot", "heel")
    return np.array(
        [
            0 if body.mirror[j] == j else LEG if any(part in _plain(name) for part in lower) else ARM
            for j, name in enumerate(body.joints)
        ],
        dtype=np.int64,
    )


def _fixed(values: list[float]) -> NDArray[np.float64]:
    array = np.array(values)
    array.flags.writeable = False  # all callers share it
    return array


def _kind(name: str) -> float:
    plain = _plain(name)
    return next((noise for part, noise in _KINDS if part in plain), _SPINE)


def _plain(name: str) -> str:
    return name.replace("_", "").lower()
