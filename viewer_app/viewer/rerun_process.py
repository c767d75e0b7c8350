"""Rerun's own program as child processes: a hub that viewers connect to, and a window.

A recording stream connected directly to a viewer stops permanently when the viewer hangs or ends. Therefore
the data goes through a pipe to a hub (``rerun --serve-grpc -``). The hub keeps a bounded history for viewers
that connect later, and can be abandoned at any time, because writing to a pipe need not block.

All processes listen on the loopback address unless told otherwise, and send no usage statistics.
"""

from __future__ import annotations

import atexit
import contextlib
import importlib.util
import os
import platform
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO
from urllib.parse import quote

from viewer_app.addresses import LOOPBACK, reached_at
from viewer_app.errors import UsageError

_STARTS_WITHIN = 20.0  # seconds
_HUB_MEMORY = "512MiB"
_VIEWER_MEMORY = "2GiB"
_LOOKED_AFTER_EVERY = 0.5  # seconds


@dataclass(frozen=True)
class Hub:
    """The addresses of a hub.

    Attributes:
        port: Port of the data.
        web_port: Port of the web viewer; None without one.
        address: The address that the hub is bound to.
    """

    port: int
    web_port: int | None = None
    address: str = LOOPBACK

    @staticmethod
    def on_free_ports(web: bool, address: str | None = None) -> Hub:
        """A hub that is not started yet.

        Raises:
            UsageError: The address is none of this machine's.
        """
        host = address or LOOPBACK
        return Hub(free_port(host), free_port(host) if web else None, host)

    @property
    def reached_at(self) -> str:
        """The host name to reach it by, from this machine."""
        return reached_at(self.address)

    @property
    def url(self) -> str:
        """What ``rerun --connect`` takes."""
        return f"rerun+http://{self.reached_at}:{self.port}/proxy"

    @property
    def page(self) -> str:
        """What a browser opens."""
        return f"http://{self.reached_at}:{self.web_port}/?url={quote(self.url, safe='')}"

    def start(self) -> subprocess.Popen[bytes]:
        """Starts the hub. It reads a session from its standard input, and listens once it has received
        data."""
        web = ["--serve-grpc"]
        if self.web_port is not None:
            web = ["--serve-web", "--web-viewer-port", str(self.web_port)]
        return _start(
            [
                *web,
                *("--bind", self.address, "--port", str(self.port)),
                *("--server-memory-limit", _HUB_MEMORY, "-"),
            ],
            stdin=subprocess.PIPE,
            dies_with_us=True,
        )

    def wait_until_listening(self, process: subprocess.Popen[bytes]) -> None:
        """Waits until a started hub, which is receiving its session, listens.

        Raises:
            UsageError: It does not start.
        """
        for port in (self.port, self.web_port):
            if port is not None:
                _wait_for(process, self.reached_at.strip("[]"), port, "Rerun's server")


def start_window(hub: Hub, headless: bool = False) -> subprocess.Popen[bytes]:
    """Starts a viewer that shows what the hub has; `headless` is for tests.

    Raises:
        UsageError: It does not start.
    """
    arguments = ["--connect", hub.url, "--hide-welcome-screen", *(["--headless"] if headless else [])]
    return start_viewer(arguments)[0]


def start_window_on_pipe() -> subprocess.Popen[bytes]:
    """Starts a viewer of its own that takes a session from its standard input, and outlives us."""
    return _start([*_own(free_port()), "--expect-data-soon", "-"], stdin=subprocess.PIPE)


def start_viewer(
    arguments: Sequence[str], stdin: int | IO[bytes] = subprocess.DEVNULL
) -> tuple[subprocess.Popen[bytes], int]:
    """Starts a viewer that listens on a free port of the loopback address, and has a bounded memory.

    Args:
        arguments: What it shows, and how.
        stdin: What it reads where the arguments have ``-``.

    Returns:
        The process and its port.

    Raises:
        UsageError: It does not start.
    """
    port = free_port()
    viewer = _start([*_own(port), *arguments], stdin)
    _wait_for(viewer, LOOPBACK, port, "Rerun's viewer")
    return viewer, port


def stop(process: subprocess.Popen[bytes]) -> None:
    """Ends a process started by this module, even if it hangs. Ending it twice has no effect."""
    if process.stdin is not None:
        with contextlib.suppress(OSError):
            process.stdin.close()
    if process.poll() is None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL) if hasattr(os, "killpg") else process.kill()
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(timeout=1.0)


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


def free_port(address: str = LOOPBACK) -> int:
    """A port of the address that nothing listens on.

    Raises:
        UsageError: The address is none of this machine's.
    """
    try:
        family = socket.AF_INET6 if ":" in address else socket.AF_INET
        with socket.socket(family) as probe:
            probe.bind((address, 0))
            return int(probe.getsockname()[1])
    except OSError as error:
        raise UsageError(
            f"Cannot listen on {address!r}: {error.strerror or error}. Give an address of this machine, or "
            "0.0.0.0 for all."
        ) from None


_DIES_WITH_ITS_PARENT = """
import ctypes, os, signal, sys
ctypes.CDLL(None).prctl(1, signal.SIGKILL)
if os.getppid() != int(sys.argv[1]):
    sys.exit()
os.execv(sys.argv[2], sys.argv[2:])
"""
"""PR_SET_PDEATHSIG, kept over exec: the kernel ends the process when the thread that started it ends. Popen's
preexec_fn would do it without a second program, but may hang in a program with threads."""


def _start(
    arguments: Sequence[str], stdin: int | IO[bytes] = subprocess.DEVNULL, dies_with_us: bool = False
) -> subprocess.Popen[bytes]:
    command = [*rerun_program(), *arguments]
    if dies_with_us and platform.system() == "Linux":
        command = [sys.executable, "-I", "-S", "-c", _DIES_WITH_ITS_PARENT, str(os.getpid()), *command]
    process = subprocess.Popen(
        command,
        env={**os.environ, "RERUN_ANALYTICS": "0"},
        stdin=stdin,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,  # only this process gets Ctrl-C; it ends the child when everything is saved
        bufsize=0,
    )
    if dies_with_us:
        atexit.register(stop, process)  # on other systems, and where a thread outlives the interpreter
    return process


def _own(port: int) -> tuple[str, ...]:
    return "--bind", LOOPBACK, "--port", str(port), "--memory-limit", _VIEWER_MEMORY


def rerun_program() -> list[str]:
    """The binary of Rerun's viewer, if found, so that the child process is the viewer itself."""
    spec = importlib.util.find_spec("rerun_cli")
    for folder in (spec.submodule_search_locations or ()) if spec else ():
        for name in ("rerun", "rerun.exe"):
            if (program := Path(folder) / name).is_file():
                return [str(program)]
    return [sys.executable, "-m", "rerun"]


def _wait_for(process: subprocess.Popen[bytes], host: str, port: int, what: str) -> None:
    deadline = time.monotonic() + _STARTS_WITHIN
    while time.monotonic() < deadline and process.poll() is None:
        try:
            socket.create_connection((host, port), timeout=0.5).close()
            return
        except OSError:
            time.sleep(0.05)
    stop(process)
    raise UsageError(
        f"{what} does not start here. Use --save FILE.rrd --no-viewer, and open the file with "
        "`rerun FILE.rrd` where there is a display."
    )
