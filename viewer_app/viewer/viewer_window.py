"""A viewer window that is supervised while a session runs."""

from __future__ import annotations

import subprocess
import threading
from collections.abc import Callable

from viewer_app.errors import UsageError
from viewer_app.viewer.rerun_process import stop

_LOOKED_AFTER_EVERY = 0.5  # seconds


class ViewerWindow:
    """A viewer window that reopens after a crash, and stays closed when the user closes it."""

    def __init__(self, start: Callable[[], subprocess.Popen[bytes]]) -> None:
        self._start = start
        self._leaving = threading.Event()
        self.process = start()
        self.starts = 1
        self.closed = False
        self._thread = threading.Thread(target=self._look_after, name="viewer window", daemon=True)
        self._thread.start()

    def leave(self) -> None:
        """Stops the supervision. The window stays open with its content."""
        self._leaving.set()
        self._thread.join(timeout=1.0)

    def _look_after(self) -> None:
        while not self._leaving.wait(_LOOKED_AFTER_EVERY):
            if self.process.poll() is None:
                continue
            if self.process.returncode == 0:
                self.closed = True
                return
            try:
                self.process = self._start()
                self.starts += 1
            except UsageError:
                continue
            if self._leaving.is_set():
                stop(self.process)
