"""State of a sensor on its own thread."""

from __future__ import annotations

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
