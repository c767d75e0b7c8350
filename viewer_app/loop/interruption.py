"""Ctrl-C as a wish to end, so that what was captured is saved whatever moment it comes at."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class CtrlC:
    """While it is entered, Ctrl-C and a request to terminate interrupt nothing: they are remembered.

    An exception in the middle of opening or saving would leave things half done. What waits long asks for it
    (:meth:`raising`), and the loop is told (:meth:`calls`). Outside the main thread, which alone gets
    signals, it does nothing.
    """

    def __init__(self) -> None:
        self._action: Callable[[], None] | None = None
        self._raises = self._pressed = False
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> CtrlC:
        if threading.current_thread() is threading.main_thread():
            self._before = {number: signal.signal(number, self._handle) for number in _SIGNALS}
        return self

    def __exit__(self, *exc_info: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    @contextmanager
    def raising(self) -> Iterator[None]:
        """Within the block a signal raises ``KeyboardInterrupt``, and so does one that came before."""
        self._raises = True
        try:
            self._raise_if_pressed()
            yield
        finally:
            self._raises = False

    def calls(self, action: Callable[[], None]) -> None:
        """From now on a signal calls `action`, however often it comes.

        Raises:
            KeyboardInterrupt: One came before.
        """
        self._action = action
        self._raise_if_pressed()

    def _raise_if_pressed(self) -> None:
        if self._pressed:
            raise KeyboardInterrupt

    def _handle(self, number: int, frame: FrameType | None) -> None:
        del number, frame
        self._pressed = True
        if self._action is not None:
            self._action()
            return
        if self._raises:
            raise KeyboardInterrupt
