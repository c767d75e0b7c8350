"""What a body tracker tracks, and its report of one frame, which one error after another changes."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from devices.simulated.streams import Streams
from devices.simulated.tracking.scripted_faults import ScriptedFaults
from devices.simulated.tracking.tracker_errors import TrackerErrors
from fusion.body import Body
from fusion.intrinsics import Intrinsics
from fusion.support.types import Array


@dataclass(frozen=True)
class Tracked:
    """What a tracker tracks: the same in all frames."""

    body: Body
    errors: TrackerErrors
    intrinsics: Intrinsics  # of the camera: which joints cover each other
    frame_seconds: float
    streams: Streams
    script: ScriptedFaults | None = None
    rolled: Array = field(default_factory=lambda: np.eye(3))
    """(3, 3) from the sensor's frame to that of one that stands upright, as the tracker sees the person."""

    @cached_property
    def corners(self) -> list[int]:
        """Shoulder and hip of the left side, and of the right."""
        return [self.body.joint(n) for n in ("ShoulderLeft", "HipLeft", "ShoulderRight", "HipRight")]

    def rates(self, share: Array | float, seconds: float) -> tuple[Array, float]:
        """Returns the probabilities per frame that a spell starts and ends, from its share and length."""
        stop = min(1.0, self.frame_seconds / max(seconds, self.frame_seconds))
        share = np.minimum(np.asarray(share), 0.99)
        return np.asarray(stop * share / (1.0 - share)), stop


@dataclass(eq=False)
class Report:
    """One frame: the truth in the upright sensor's frame, metres, and what the tracker reports so far."""

    of: Tracked
    joints: Array  # (J, 3) the truth
    visible: Array  # (J,) visible share of each joint's surface
    time_ns: int
    at: Array  # (J, 3) positions reported
    states: NDArray[np.uint8]  # (J,) states reported
    hiding: Array  # (J,) 0: reported as seen … 1: reported as guessed
    lost: bool = False  # whether no person is reported

    @cached_property
    def left(self) -> Array:
        """(3,) towards the person's left, not normalised."""
        l1, l2, r1, r2 = self.joints[self.of.corners]
        return np.asarray((l1 - r1) + (l2 - r2))

    @cached_property
    def front(self) -> Array:
        """(3,) horizontal unit vector of the direction that the person faces."""
        front = np.array((self.left[2], 0.0, -self.left[0]))
        return np.asarray(front / max(float(np.linalg.norm(front)), 1e-9))

    @cached_property
    def angle(self) -> float:
        """From the direction to the sensor to the front, radians about the sensor's y axis."""
        x, _, z = -self.joints[self.of.body.root]
        return math.atan2(self.left[0] * x + self.left[2] * z, self.left[2] * x - self.left[0] * z)


class Error(Protocol):
    """One error of a tracker."""

    def apply(self, report: Report) -> None:
        """Changes the report of the next frame."""


class Wandering:
    """Values of unit variance that change from frame to frame, first-order autoregressive."""

    def __init__(self, shape: tuple[int, ...], memory: float, random: np.random.Generator) -> None:
        self._memory, self._random = memory, random
        self._values = random.standard_normal(shape)

    def next(self) -> Array:
        noise = self._random.standard_normal(self._values.shape)
        self._values = self._memory * self._values + np.sqrt(1.0 - self._memory**2) * noise
        return self._values
