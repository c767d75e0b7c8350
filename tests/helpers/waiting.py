"""Waits for other processes and threads. Only this module polls."""

import time


def eventually(holds, within=20.0, every=0.02):
    """Returns whether a condition becomes true within a time limit, as soon as it does."""
    deadline = time.monotonic() + within
    while time.monotonic() < deadline:
        if holds():
            return True
        time.sleep(every)
    return holds()
