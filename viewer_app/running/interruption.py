"""Ends a run by Ctrl-C or after some time, so that captured data is saved at any moment."""

from __future__ import annotations

import _thread
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

ENDING = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
"""Signals that end a command: Ctrl-C, ``docker stop`` and systemd, a closed terminal."""

_AGAIN_S = 0.05


def ends_as_ctrl_c() -> None:
    """Lets every signal of :data:`ENDING` end the program as Ctrl-C does, but none that ``nohup`` ignores."""
    for number in ENDING:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, signal.default_int_handler)
    sys.unraisablehook = _interrupt_again


def _interrupt_again(unraisable: sys.UnraisableHookArgs) -> None:
    """Raises Ctrl-C once more that came in a callback of a library, where it ended the callback only."""
    if isinstance(unraisable.exc_value, KeyboardInterrupt):
        heard = (number for number in ENDING if signal.getsignal(number) is not signal.SIG_IGN)
        # at once it would end this function only
        again = threading.Timer(_AGAIN_S, _interrupt_main_thread, (next(heard, signal.SIGINT),))
        again.daemon = True
        again.start()
    else:
        sys.__unraisablehook__(unraisable)


def _interrupt_main_thread(number: signal.Signals) -> None:
    if sys.platform == "win32":
        _thread.interrupt_main(number)
    else:  # unlike interrupt_main, a real signal ends what the main thread waits for
        signal.pthread_kill(threading.main_thread().ident or 0, number)


@contextmanager
def call_after(seconds: float | None, action: Callable[[], object]) -> Iterator[None]:
    """Calls `action` on another thread if the block takes longer than so many seconds; None: never."""
    if seconds is None:
        yield
        return
    timer = threading.Timer(seconds, action)
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


class CtrlC:
    """Context manager that records the signals of :data:`ENDING` instead of interrupting the program.

    An exception during opening or saving would leave them incomplete. A long wait enables the exception with
    :meth:`raising`; the loop registers a callback with :meth:`calls`. Only the main thread receives signals:
    on other threads the manager does nothing.
    """

    def __init__(self) -> None:
        self._action: Callable[[], None] | None = None
        self._raises = self._pressed = False
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> CtrlC:
        if threading.current_thread() is threading.main_thread():
            heard = (number for number in ENDING if signal.getsignal(number) is not signal.SIG_IGN)
            self._before = {number: signal.signal(number, self._handle) for number in heard}
        return self

    def __exit__(self, *exc_info: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    @contextmanager
    def raising(self) -> Iterator[None]:
        """Within the block a signal raises ``KeyboardInterrupt``; an earlier signal raises it at once."""
        self._raises = True
        try:
            self._raise_if_pressed()
            yield
        finally:
            self._raises = False

    def calls(self, action: Callable[[], None]) -> None:
        """Calls `action` at every signal from now on.

        Raises:
            KeyboardInterrupt: A signal arrived earlier.
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
