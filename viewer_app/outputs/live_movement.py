"""Angles of each frame, and heel strikes and toe-offs soon after they happen, for live outputs."""

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from devices.events import Event
from fusion.body import Body
from fusion.movement.angles import angle_sigma, joint_angles
from recordings.appearance.floor import LEVEL_FLOOR
from recordings.gait.events import find_gait
from viewer_app.sinks.item_queue import QueuedFrame

_WINDOW_NS = 4_000_000_000  # in which steps are looked for
_EVERY_NS = 250_000_000
_CERTAIN_AFTER = 0.3  # seconds: the foot has begun to move the other way
_APART = 0.3  # seconds, between two events of one kind


class LiveMovement:
    """Follows the movement of one person.

    Attributes:
        floor: K_A ← floor of the newest frame that tells it.
    """

    def __init__(self, body: Body) -> None:
        self._body = body
        self.floor = LEVEL_FLOOR
        self._recent: deque[tuple[int, NDArray[np.float64]]] = deque()
        self._due_ns = _WINDOW_NS // 2
        self._told: dict[str, float] = {}

    def angles(self, frame: QueuedFrame) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(K,) degrees of the angles of a frame, and their standard deviations; NaN where unknown."""
        fused = frame.fused
        self.floor = frame.frame.floor or self.floor
        self._recent.append((frame.time_ns, fused.positions))
        while self._recent[0][0] < frame.time_ns - _WINDOW_NS:
            self._recent.popleft()
        sigma = np.full(len(self._body), np.nan) if fused.sigma is None else fused.sigma
        return (
            joint_angles(self._body, fused.positions, self._up),
            angle_sigma(self._body, fused.positions, sigma, self._up),
        )

    def new_events(self) -> list[Event]:
        """Events of the gait that are certain now and were not reported before, at their own times.

        Steps are looked for four times a second. The first ones of a walk are reported with the third.
        """
        newest_ns = self._recent[-1][0] if self._recent else 0
        if newest_ns < self._due_ns:
            return []
        self._due_ns = newest_ns + _EVERY_NS
        times, positions = (np.array(each) for each in zip(*self._recent, strict=True))
        new = []
        for seconds, name in find_gait(self._body, times, positions, self._up).events:
            certain = seconds < newest_ns * 1e-9 - _CERTAIN_AFTER
            if certain and seconds > self._told.get(name, -math.inf) + _APART:
                self._told[name] = seconds
                new.append(Event(name.replace("_", " "), topic="gait", time_ns=round(seconds * 1e9)))
        return new

    @property
    def _up(self) -> NDArray[np.float64]:
        return -self.floor.rotation[:, 1]
