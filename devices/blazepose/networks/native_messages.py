"""Keeps a native library's progress notes off the terminal."""

from __future__ import annotations

import os
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager

_one_at_a_time = threading.Lock()


@contextmanager
def without_notes(prefix: bytes = b"INFO:") -> Iterator[None]:
    """Drops lines that begin with a prefix from what native code writes to standard error meanwhile.

    The runtime of the networks has no setting for its notes. Other lines appear when the context ends.
    """
    with _one_at_a_time, tempfile.TemporaryFile() as caught:
        try:
            terminal = os.dup(2)
        except OSError:  # no standard error
            yield
            return
        os.dup2(caught.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(terminal, 2)
            caught.seek(0)
            kept = b"".join(line for line in caught if not line.startswith(prefix))
            if kept:
                os.write(terminal, kept)
            os.close(terminal)
