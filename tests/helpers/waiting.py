"""Waiting for another process or thread, which nobody announces: the one place in the tests that polls."""

from __future__ import annotations

import time
from collections.abc import Callable


def eventually(holds: Callable[[], bool], within: float = 20.0, every: float = 0.02) -> bool:
    """Whether something comes true within some seconds; returns as soon as it does."""
    deadline = time.monotonic() + within
    while time.monotonic() < deadline:
        if holds():
            return True
        time.sleep(every)
    return holds()
