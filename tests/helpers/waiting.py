"""Waits for other processes and threads. Only this module polls."""

import time
from collections.abc import Callable


def eventually(holds: Callable[[], bool], within: float = 20.0, every: float = 0.02) -> bool:
    """Returns whether a condition becomes true within a time limit, as soon as it does."""
    deadline = time.monotonic() + within
    while time.monotonic() < deadline:
        if holds():
            return True
        time.sleep(every)
    return holds()
