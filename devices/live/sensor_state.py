"""State and events of a sensor on its own thread."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class SensorState(Enum):
    """What a sensor is doing."""

    CLOSED = "closed"
    OPENING = "opening"
    RUNNING = "running"
    STALLED = "stalled"
    """Open, but without a frame for too long."""
    LOST = "lost"
    """Failed; it is reopened until it works again."""
    ENDED = "ended"
    """The source has reached its end."""


@dataclass(frozen=True)
class SensorEvent:
    """An event to report to the user.

    Attributes:
        sensor: The sensor's name.
        message: What happened, and the way out.
        at_s: When, on the thread's clock.
    """

    sensor: str
    message: str
    at_s: float
