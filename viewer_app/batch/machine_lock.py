"""A lock between the processes of one machine."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def one_process(lock: Path) -> Iterator[None]:
    """Lets one process at a time into the block; the operating system frees the lock of a process that ends.

    Args:
        lock: A file, created if missing. If it cannot be created, nothing is locked.
    """
    try:
        file = os.open(lock, os.O_RDWR | os.O_CREAT, 0o600)
    except OSError:
        yield
        return
    try:
        _lock(file)
        yield
    finally:
        os.close(file)


def _lock(file: int) -> None:
    if sys.platform == "win32":
        import msvcrt

        while True:
            try:
                msvcrt.locking(file, msvcrt.LK_LOCK, 1)
                return
            except OSError:
                continue  # it gives up after ten attempts, one per second
    else:
        import fcntl

        fcntl.flock(file, fcntl.LOCK_EX)
