"""Checks whether a window can open: a display must be named and must answer.

A program that opens a window on an X server that does not answer waits for ever. So python-xlib connects
first, with a time limit.
"""

import contextlib
import functools
import io
import os
import platform
import threading

_ANSWERS_WITHIN = 4.0  # seconds; over a slow ssh connection it takes one or two


def has_display() -> bool:
    """Whether a window could open here."""
    return why_no_window() is None


def why_no_window() -> str | None:
    """Why no window can open, as text; None if one can."""
    return None if os.environ.get("WAYLAND_DISPLAY") else why_no_x()


def why_no_x() -> str | None:
    """Why X cannot be used, as text; None if it can. A sensor's depth engine needs X even under Wayland."""
    if platform.system() != "Linux":
        return None
    name = os.environ.get("DISPLAY")
    if not name:
        return "There is no display for the viewer's window"
    if not _answers(name, _ANSWERS_WITHIN):
        return (
            f"The display {name} (environment variable DISPLAY) does not answer within "
            f"{_ANSWERS_WITHIN:g} s: no window opens"
        )
    return None


@functools.lru_cache(maxsize=8)
def _answers(name: str, within: float) -> bool:
    """Whether an X server answers; without an answer a program that opens a window would block forever."""
    answered = threading.Event()
    asking = threading.Thread(target=_ask, args=(name, answered), daemon=True)
    with contextlib.redirect_stdout(io.StringIO()):  # python-xlib prints where it finds no authorisation
        asking.start()
        asking.join(within)  # python-xlib itself has no time limit
    return answered.is_set()


def _ask(name: str, answered: threading.Event) -> None:
    from Xlib.error import ConnectionClosedError, DisplayConnectionError, DisplayNameError
    from Xlib.protocol.display import Display

    try:
        Display(name).close()
    except DisplayNameError:  # a kind of name not known here: let the viewer find out
        pass
    except DisplayConnectionError as error:
        # A refusal, in the server's own bytes, is an answer: the viewer knows more kinds of authorisation.
        if not isinstance(error.msg, bytes):
            return
    except ConnectionClosedError:
        return
    answered.set()
