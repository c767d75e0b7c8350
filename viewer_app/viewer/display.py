"""Whether a window could open here: a display that is named, and that answers."""

from __future__ import annotations

import functools
import os
import platform
import re
import socket

_ANSWERS_WITHIN = 4.0  # seconds; over a slow ssh connection it takes one or two
_HELLO = b"l\0\x0b\0\0\0\0\0\0\0\0\0"
"""X11's connection setup, little-endian, version 11.0, without authorisation: a refusal is an answer too."""
_NAME = re.compile(r"^(?P<host>.*?)(?:/unix)?:(?P<number>\d+)(?:\.\d+)?$")


def has_display() -> bool:
    """Whether a window could open here."""
    return why_no_window() is None


def why_no_window() -> str | None:
    """What stands in the way of a window, in words; None where nothing does."""
    return None if os.environ.get("WAYLAND_DISPLAY") else why_no_x()


def why_no_x() -> str | None:
    """What stands in the way of X, which a sensor's depth engine needs under Wayland too; as above."""
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
    """Whether an X server speaks there. A program that opens a window on one that does not waits for ever."""
    parts = _NAME.match(name)
    if parts is None:  # of a kind not known here: let the viewer find out
        return True
    host, number = parts["host"], int(parts["number"])
    if host in ("", "unix"):
        path = f"/tmp/.X11-unix/X{number}"
        return any(_says_something(socket.AF_UNIX, at, within) for at in (path, f"\0{path}"))
    try:
        found = socket.getaddrinfo(host, 6000 + number, type=socket.SOCK_STREAM)
    except OSError:
        return False
    return any(_says_something(family, at, within / len(found)) for family, _, _, _, at in found)


def _says_something(family: int, at: object, within: float) -> bool:
    with socket.socket(family, socket.SOCK_STREAM) as server:
        server.settimeout(within)
        try:
            server.connect(at)  # type: ignore[arg-type]
            server.sendall(_HELLO)
            return bool(server.recv(1))
        except OSError:
            return False
