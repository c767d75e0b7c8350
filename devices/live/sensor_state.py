"""What a sensor on its own thread is doing, and what is told of it."""

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
    """Failed; it is opened again and again until it comes back."""
    ENDED = "ended"
    """A source that ends, at its end."""


@dataclass(frozen=True)
class SensorEvent:
    """Something to tell the person at the screen.

    Attributes:
        sensor: The sensor's name.
        message: What happened, and the way out.
        at_s: When, on the thread's clock.
    """

    sensor: str
    message: str
    at_s: float
