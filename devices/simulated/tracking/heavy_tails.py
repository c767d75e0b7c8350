"""Heavy-tailed errors: small most of the time, very large at times, and correlated within a limb."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from devices.simulated.person.anatomy import Array
from devices.simulated.tracking.tracker_errors import JointGroups, TrackerErrors
from fusion.body import Body

_ERROR_SECONDS = 0.3  # correlation time of an error's direction
_SIZE_SECONDS = 1.0  # correlation time of its size: a hand passes in front of the trunk in about a second
_LARGEST = 1.2  # metres
_ARM = {"elbow", "wrist", "hand", "tip", "thumb"}
_LEG = {"knee", "ankle", "foot"}


class HeavyTails:
    """A log-normal size times a direction, both first-order autoregressive, one of each per limb.

    The error of a joint is ``tail · exp(tail_spread · h) · g``. Here h is a standard normal value and g a
    vector of three such values; both belong to the joint's limb (trunk, head, each arm, each leg). The length
    of the error is heavy-tailed: with a spread of 1.4, its 99th percentile is 30 times the median.

    Args:
        body: The body of the tracker.
        errors: Errors of the tracker, of which ``tail`` and ``tail_spread`` are used.
        frame_seconds: Frame interval.
        random: A separate generator; every frame draws the same number of values.
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
        """Returns (J, 3) the errors of the next frame, metres."""
        noise = self._random.standard_normal((len(self._h), 4))
        self._g = self._keep_error * self._g + np.sqrt(1.0 - self._keep_error**2) * noise[:, :3]
        self._h = self._keep_size * self._h + np.sqrt(1.0 - self._keep_size**2) * noise[:, 3]
        size = self._size * np.exp(self._spread * self._h[self._limb])
        errors: Array = np.clip(size[:, None] * self._g[self._limb], -_LARGEST, _LARGEST)
        return errors


def limbs(body: Body) -> NDArray[np.int64]:
    """Returns (J,) the limb of each joint: 0 trunk, 1 head, 2 and 3 arms, 4 and 5 legs, left before right."""
    found = []
    for name in body.joints:
        kind, right = JointGroups.group(name), "right" in name.lower()
        limb = 2 if kind in _ARM else 4 if kind in _LEG else 1 if kind in ("head", "face") else 0
        found.append(limb + (right and limb >= 2))
    return np.array(found, dtype=np.int64)
