"""Checks whether a window can open: a display must be named and must answer.

A program that opens a window on an X server that does not answer waits for ever, and Rerun's viewer tries no
X server where a Wayland compositor is named that is gone. So each is asked first, with a time limit, for the
first bytes of its protocol: the answer to the set-up of a connection (X), a refusal included, and to the
request ``wl_display.sync`` (Wayland).
"""

import os
import platform
import re
import socket
import struct
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

_ANSWERS_WITHIN = 4.0  # seconds; over a slow ssh connection it takes one or two
_GIVES_UP_AFTER = 2.0 * _ANSWERS_WITHIN  # longer, so that silence is told from a refusal
_SILENCE_HOLDS = 10.0  # seconds in which a display that stayed silent is not asked again
_NO_DISPLAY = "There is no display for the viewer's window"
_X_NAME = re.compile(r"(?:(?:tcp|unix|inet6?)/)?(?P<host>[^/]*):(?P<number>[0-9]+)(?:\.[0-9]+)?")
_X_REPLIES = (b"\0", b"\1", b"\2")  # failed, success, authenticate
_COOKIE = b"MIT-MAGIC-COOKIE-1"
_WAYLAND_SYNC = struct.pack("=III", 1, 12 << 16, 2)  # object 1, opcode 0 and 12 bytes, the new object 2

_silent_since: dict[str, float] = {}


def has_display() -> bool:
    """Whether a window could open here."""
    return why_no_window() is None


def why_no_window() -> str | None:
    """Why no window can open, as text; None if one can."""
    if platform.system() != "Linux":
        return None
    no_wayland = _why_no_wayland()
    if no_wayland is None:
        return None
    no_x = why_no_x()
    return no_x if no_x is None or os.environ.get("DISPLAY") else no_wayland


def why_no_x() -> str | None:
    """Why X cannot be used, as text; None if it can. A sensor's depth engine needs X even under Wayland."""
    return _why_silent("DISPLAY", _asks_x) if platform.system() == "Linux" else None


def environment_of_window() -> dict[str, str]:
    """The environment for a program that opens a window: it names no Wayland display that does not answer."""
    environment = dict(os.environ)
    if platform.system() == "Linux" and _why_no_wayland() is not None:
        environment.pop("WAYLAND_DISPLAY", None)
    return environment


def _why_no_wayland() -> str | None:
    return _why_silent("WAYLAND_DISPLAY", _asks_wayland)


def _why_silent(variable: str, asks: Callable[[str], bool]) -> str | None:
    """Why the display that an environment variable names cannot be used; None if it answers in time."""
    name = os.environ.get(variable)
    if not name:
        return _NO_DISPLAY
    silence = f"The display {name} (environment variable {variable}) does not answer"
    in_time = f"{silence} within {_ANSWERS_WITHIN:g} s: no window opens"
    if time.monotonic() - _silent_since.get(name, -_SILENCE_HOLDS) < _SILENCE_HOLDS:
        return in_time
    answered = threading.Event()

    def ask() -> None:
        with suppress(OSError, ValueError, OverflowError):  # all that sockets raise for names of any kind
            if asks(name):
                answered.set()

    asking = threading.Thread(target=ask, daemon=True)  # the look-up of a host's name has no time limit
    asking.start()
    asking.join(_ANSWERS_WITHIN)
    if answered.is_set():
        return None
    if asking.is_alive():
        _silent_since[name] = time.monotonic()
        return in_time
    return f"{silence}: no window opens"


def _asks_x(name: str) -> bool:
    """Whether an X server answers; also for a kind of name not known here, which the viewer may know.

    Source: X Window System Protocol, version 11, section 8, "Connection Setup".
    """
    parts = _X_NAME.fullmatch(name)
    if parts is None:
        return True
    number = parts["number"]
    cookie = next(_cookies(number.encode()), b"")
    kind = _COOKIE if cookie else b""
    head = struct.pack("<BxHHHHxx", ord("l"), 11, 0, len(kind), len(cookie))  # "l": least significant first
    with _x_connection(parts["host"], int(number)) as server:
        server.sendall(head + b"".join(each + bytes(-len(each) % 4) for each in (kind, cookie)))
        return server.recv(1) in _X_REPLIES


def _x_connection(host: str, number: int) -> socket.socket:
    """Connects to a server on this machine, by its abstract or its usual socket, or by TCP."""
    if host in ("", "unix"):
        path = f"/tmp/.X11-unix/X{number}"
        for address in (f"\0{path}", path):
            with suppress(OSError):
                return _unix_connection(address)
    return socket.create_connection((host.strip("[]") or "localhost", 6000 + number), _GIVES_UP_AFTER)


def _unix_connection(path: str) -> socket.socket:
    if sys.platform == "win32":
        raise OSError("There are no displays with Unix sockets on Windows.")
    server = socket.socket(socket.AF_UNIX)
    try:
        server.settimeout(_GIVES_UP_AFTER)
        server.connect(path)
    except BaseException:
        server.close()
        raise
    return server


def _cookies(number: bytes) -> Iterator[bytes]:
    """The cookies for a display's number in the user's file of authorisations, first those of this machine.

    Without its cookie, ssh closes the connection without an answer. Source: Xau(3).
    """
    file = Path(os.environ.get("XAUTHORITY") or "~/.Xauthority")
    entries = []
    with suppress(OSError, struct.error, RuntimeError), file.expanduser().open("rb") as stream:

        def field() -> bytes:
            (length,) = struct.unpack(">H", stream.read(2))
            return stream.read(length)

        while stream.read(2):  # the family of the address
            entries.append((field(), field(), field(), field()))
    entries.sort(key=lambda entry: entry[0] != socket.gethostname().encode())
    return (cookie for _, of, kind, cookie in entries if kind == _COOKIE and of in (b"", number))


def _asks_wayland(name: str) -> bool:
    """Whether a Wayland compositor answers. Source: the protocol's core, interface ``wl_display``."""
    with _unix_connection(str(Path(os.environ.get("XDG_RUNTIME_DIR", "")) / name)) as compositor:
        compositor.sendall(_WAYLAND_SYNC)
        return compositor.recv(1) != b""
