"""Errors that are small most of the time and very large at times, alike in all joints of a limb."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from devices.simulated.person.anatomy import Array
from devices.simulated.tracking.tracker_errors import JointGroups, TrackerErrors
from fusion.body import Body

_ERROR_SECONDS = 0.3  # how long an error keeps its direction
_SIZE_SECONDS = 1.0  # how long it keeps its size: a hand passes before the trunk in about a second
_LARGEST = 1.2  # metres
_ARM = {"elbow", "wrist", "hand", "tip", "thumb"}
_LEG = {"knee", "ankle", "foot"}


class HeavyTails:
    """A log-normal size times a direction, both first-order autoregressive; one of each a limb.

    The error of a joint is ``tail · exp(tail_spread · h) · g``, with h a standard normal value and g a vector
    of three of the joint's limb: trunk, head, each arm and each leg. Its distance is heavy-tailed: with a
    spread of 1.4, the 99th percentile is 30 times the median.

    Args:
        body: Whose joints.
        errors: ``tail`` and ``tail_spread`` are used.
        frame_seconds: Between two frames.
        random: Its own generator; every frame draws the same number of values.
    """

    def __init__(
        self, body: Body, errors: TrackerErrors, frame_seconds: float, random: np.random.Generator
    ) -> None:
        self._size, self._spread = errors.tail.of(body), errors.tail_spread.of(body)
        self._limb = limbs(body)
        self._keep_error, self._keep_size = (
            float(np.exp(-frame_seconds / seconds)) for seconds in (_ERROR_SECONDS, _SIZE_SECONDS)
        )
        self._random = random
        count = int(self._limb.max()) + 1
        self._g, self._h = random.standard_normal((count, 3)), random.standard_normal(count)

    def next(self) -> Array:
        """(J, 3) the errors of the next frame, metres."""
        noise = self._random.standard_normal((len(self._h), 4))
        self._g = self._keep_error * self._g + np.sqrt(1.0 - self._keep_error**2) * noise[:, :3]
        self._h = self._keep_size * self._h + np.sqrt(1.0 - self._keep_size**2) * noise[:, 3]
        size = self._size * np.exp(self._spread * self._h[self._limb])
        errors: Array = np.clip(size[:, None] * self._g[self._limb], -_LARGEST, _LARGEST)
        return errors


def limbs(body: Body) -> NDArray[np.int64]:
    """(J,) the limb of each joint: 0 trunk, 1 head, 2 and 3 arms, 4 and 5 legs, left before right."""
    found = []
    for name in body.joints:
        kind, right = JointGroups.group(name), "right" in name.lower()
        limb = 2 if kind in _ARM else 4 if kind in _LEG else 1 if kind in ("head", "face") else 0
        found.append(limb + (right and limb >= 2))
    return np.array(found, dtype=np.int64)
