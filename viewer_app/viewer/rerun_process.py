"""Rerun's own program as child processes: a hub that viewers connect to, and a window.

A recording stream connected directly to a viewer stops permanently when the viewer hangs or ends. Therefore
the data goes through a pipe to a hub (``rerun --serve-grpc -``). The hub keeps a bounded history for viewers
that connect later, and can be abandoned at any time, because writing to a pipe need not block.

All processes listen on the loopback address unless told otherwise, and send no usage statistics.
"""

from __future__ import annotations

import atexit
import contextlib
import errno
import importlib.util
import os
import platform
import random
import re
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

import psutil

from viewer_app.addresses import LOOPBACK, reached_at
from viewer_app.errors import UsageError
from viewer_app.viewer.display import environment_of_window

_STARTS_WITHIN, _ENDS_WITHIN = 20.0, 1.0  # seconds
_HANGS_AFTER, _IDLE_SHARE = 5.0, 0.05  # seconds; of a processor
_REOPENED = 3  # times in a row
STARTS_TRIED = 6
"""Of a server, whose ports others may take meanwhile."""
_SERVER = "Rerun's server"
_HUB_MEMORY, _FILE_MEMORY = "512MiB", "75%"
_VIEWER_MEMORY = "2GiB"
_LOOKED_AFTER_EVERY = 0.5  # seconds
PAGE_PORT, DATA_PORT = 9090, 9876
"""The first ports to try for browsers; Rerun's own defaults."""
_PORTS_TRIED = 20


@dataclass
class Hub:
    """A server of one session, and its addresses.

    Whoever binds a port first has it. Until the hub listens for the first time, each start takes other ports
    if another program has taken them since, far enough apart for several that start at once; afterwards they
    stay.
    """

    port: int  # port of the data
    web_port: int | None = None  # port of the web viewer; None without one
    address: str = LOOPBACK  # the address that the hub is bound to
    listened: bool = False  # whether it ever listened
    starts: int = 0

    @staticmethod
    def on_free_ports(web: bool, address: str | None = None) -> Hub:
        """A hub that is not started yet; for browsers on the usual ports, or the next free ones."""
        host = address or LOOPBACK
        if not web:
            return Hub(free_port(host), None, host)
        return Hub(free_port(host, DATA_PORT), free_port(host, PAGE_PORT), host)

    @property
    def url(self) -> str:
        """What ``rerun --connect`` takes."""
        return f"rerun+http://{reached_at(self.address)}:{self.port}/proxy"

    @property
    def site(self) -> str:
        """Where the web viewer is."""
        return f"http://{reached_at(self.address)}:{self.web_port}"

    @property
    def page(self) -> str:
        """What a browser opens."""
        return f"{self.site}/?url={quote(self.url, safe=':/')}"

    def start(self, session: IO[bytes] | None = None) -> subprocess.Popen[bytes]:
        """Starts the hub, which listens once it has received data.

        Args:
            session: A file that it serves as a whole. None: it reads from its standard input, a pipe, and
                forgets the oldest data when its memory is full.
        """
        if not self.listened:
            apart = random.randrange(1, _PORTS_TRIED) if self.starts else 0
            self.port = free_port(self.address, self.port + apart)
            if self.web_port is not None:
                self.web_port = free_port(self.address, self.web_port + apart)
        self.starts += 1
        web = ["--serve-grpc"]
        if self.web_port is not None:
            # without the last, a browser may read the data only from a page of this machine
            web = ["--serve-web", "--web-viewer-port", str(self.web_port), "--cors-allow-origin", self.site]
        return _start(
            [
                *web,
                *("--bind", self.address, "--port", str(self.port)),
                *("--server-memory-limit", _HUB_MEMORY if session is None else _FILE_MEMORY, "-"),
            ],
            stdin=subprocess.PIPE if session is None else session,
            dies_with_us=True,
        )

    def serve(self, session: IO[bytes]) -> subprocess.Popen[bytes]:
        """Starts a hub for a file, and returns it once it listens.

        Raises:
            UsageError: None of several starts listens.
        """
        for _ in range(STARTS_TRIED):
            session.seek(0)
            process = self.start(session)
            if self.listens(process):
                return process
            stop(process)
        raise not_started()

    def listens(self, process: subprocess.Popen[bytes]) -> bool:
        """Waits until a started hub listens; False once it has ended, as where its ports are taken, or after
        20 s."""
        ports = {port for port in (self.port, self.web_port) if port is not None}
        self.listened |= (found := _listens(process, ports))
        return found


def start_window(hub: Hub, headless: bool = False) -> subprocess.Popen[bytes]:
    """Starts a viewer that shows what the hub has; `headless` is for tests."""
    arguments = ["--connect", hub.url, "--hide-welcome-screen", *(["--headless"] if headless else [])]
    return start_viewer(arguments)[0]


def start_viewer(
    arguments: Sequence[str], stdin: int | IO[bytes] = subprocess.DEVNULL
) -> tuple[subprocess.Popen[bytes], int]:
    """Starts a viewer with a bounded memory that listens on a port of the loopback address; returns both.

    A viewer listens first, and then opens its window: it runs when it answers a request. A graphics driver
    may hang while it opens the window, so a viewer that neither answers nor computes is started once more.

    Raises:
        UsageError: It does not start, or it cannot open its window; with its own last words.
    """
    for last in (False, True):
        port = free_port()
        own = ["--bind", LOOPBACK, "--port", str(port), "--memory-limit", _VIEWER_MEMORY]
        viewer = _start([*own, *arguments], stdin)
        try:
            if not _listens(viewer, {port}):
                raise not_started("Rerun's viewer")
            hangs = _hangs(viewer, port)
        except BaseException:  # Ctrl-C, too: nobody would have the process
            stop(viewer)
            raise
        if not hangs or last:
            break
        stop(viewer)
        if not isinstance(stdin, int):
            stdin.seek(0)
    if viewer.poll():  # a user who closes the window at once ends it with 0
        raise not_started("Rerun's viewer", _last_words([*own, *(set(arguments) & {"--headless"})]))
    return viewer, port


def _hangs(viewer: subprocess.Popen[bytes], port: int) -> bool:
    """Waits until a viewer answers a request, has ended, takes long, or has not computed for five seconds;
    returns whether it is the last.
    """
    answered, runs = threading.Event(), []

    def ask() -> None:
        from rerun.experimental import ViewerClient

        # the interface is experimental: whatever fails in it must not end a viewer that runs
        with contextlib.suppress(Exception):
            ViewerClient.connect(f"rerun+http://{LOOPBACK}:{port}/proxy").get_state()
            runs.append(True)
        answered.set()

    threading.Thread(target=ask, name="viewer's first answer", daemon=True).start()
    began = worked = time.monotonic()
    spent = 0.0
    while viewer.poll() is None and time.monotonic() - began < _STARTS_WITHIN and not answered.wait(0.05):
        with contextlib.suppress(psutil.Error):
            used = sum(psutil.Process(viewer.pid).cpu_times()[:2])
            if used > spent + _IDLE_SHARE * (time.monotonic() - worked):
                spent, worked = used, time.monotonic()
        if time.monotonic() - worked > _HANGS_AFTER:
            return True
    if not runs:
        with contextlib.suppress(subprocess.TimeoutExpired):
            viewer.wait(_ENDS_WITHIN)  # one that cannot open its window answers with an error first
    return False


def _last_words(arguments: Sequence[str]) -> str:
    """Why a viewer ends at once, in its own words: it is started once more, with nothing to show."""
    with contextlib.suppress(subprocess.TimeoutExpired):
        said = subprocess.run(
            [*rerun_program(), *arguments],
            env={**environment_of_window(), "RERUN_ANALYTICS": "0", "RUST_LOG": "off"},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=_STARTS_WITHIN,
            check=False,
        ).stderr.decode(errors="replace")
        words = re.findall(r"^(?:Error: |thread .* panicked at )(.*)$", said, re.MULTILINE)
        return re.sub(r"os error at \S+ ", "", words[-1]).strip("'.") if words else ""
    return ""


def why_nothing_is_drawn() -> str:
    """Why no viewer can draw on this machine, as text; empty if one can. It starts one, without a window."""
    try:
        stop(start_viewer(["--headless"])[0])
    except UsageError as error:
        return str(error).partition(". Use ")[0]
    return ""


def stop(process: subprocess.Popen[bytes]) -> None:
    """Ends a process started by this module, even if it hangs. Ending it twice has no effect."""
    if process.stdin is not None:
        with contextlib.suppress(OSError):
            process.stdin.close()
    if process.poll() is None:
        with contextlib.suppress(ProcessLookupError):
            if sys.platform == "win32":
                process.kill()
            else:
                os.killpg(process.pid, signal.SIGKILL)
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(timeout=1.0)


class ViewerWindow:
    """A viewer window that reopens after a crash, and stays closed when the user closes it.

    Attributes:
        failure: Why it is not opened again; empty as long as it is.
    """

    def __init__(self, start: Callable[[], subprocess.Popen[bytes]]) -> None:
        self._start = start
        self._leaving = threading.Event()
        self.process = start()
        self.starts = 1
        self.closed, self.failure = False, ""
        self._thread = threading.Thread(target=self._look_after, name="viewer window", daemon=True)
        self._thread.start()

    def leave(self) -> None:
        """Stops the supervision. The window stays open with its content."""
        self._leaving.set()
        self._thread.join(timeout=1.0)

    def _look_after(self) -> None:
        failed = 0
        while not self._leaving.wait(_LOOKED_AFTER_EVERY):
            if self.process.poll() is None:
                continue
            if self.process.returncode == 0:
                self.closed = True
                return
            try:
                self.process = self._start()
                self.starts, failed = self.starts + 1, 0
            except UsageError as error:
                failed += 1
                if failed == _REOPENED:
                    self.failure = str(error)
                    return
                continue
            if self._leaving.is_set():
                stop(self.process)


def free_port(address: str = LOOPBACK, first: int = 0) -> int:
    """A port of the address that nothing listens on: `first` or the next free one; 0: any.

    Raises:
        UsageError: The address is none of this machine's, or 20 ports are taken.
    """
    family = socket.AF_INET6 if ":" in address else socket.AF_INET
    for port in range(first, first + _PORTS_TRIED):
        try:
            with socket.socket(family) as probe:
                if os.name == "posix":  # else closed connections of the run before would hold the port
                    probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                probe.bind((address, port))
                return int(probe.getsockname()[1])
        except OSError as error:
            fault = error
            if error.errno not in (errno.EADDRINUSE, errno.EACCES):
                break
    raise UsageError(
        f"Cannot listen on {address!r}: {fault.strerror or fault}. Give an address of this machine, or "
        "0.0.0.0 for all."
    )


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
        env={**environment_of_window(), "RERUN_ANALYTICS": "0"},
        stdin=stdin,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,  # only this process gets Ctrl-C; it ends the child when everything is saved
        bufsize=0,
    )
    if dies_with_us:
        atexit.register(stop, process)  # on other systems, and where a thread outlives the interpreter
    return process


def rerun_program() -> list[str]:
    """The binary of Rerun's viewer, if found, so that the child process is the viewer itself."""
    spec = importlib.util.find_spec("rerun_cli")
    for folder in (spec.submodule_search_locations or ()) if spec else ():
        for name in ("rerun", "rerun.exe"):
            if (program := Path(folder) / name).is_file():
                return [str(program)]
    return [sys.executable, "-m", "rerun"]


def _listens(process: subprocess.Popen[bytes], ports: set[int]) -> bool:
    """Waits until a child process itself listens on the ports; another program that answers is not it."""
    deadline = time.monotonic() + _STARTS_WITHIN
    while time.monotonic() < deadline and process.poll() is None:
        with contextlib.suppress(psutil.Error):
            parent = psutil.Process(process.pid)
            sockets = [c for p in (parent, *parent.children(True)) for c in p.net_connections("tcp")]
            if ports <= {each.laddr.port for each in sockets if each.status == psutil.CONN_LISTEN}:
                return True
        time.sleep(0.05)
    return False


def not_started(what: str = _SERVER, why: str = "") -> UsageError:
    """The error of a program of Rerun's that does not start."""
    return UsageError(
        f"{what} does not start here{f' ({why})' if why else ''}. Use --save FILE.rrd --no-viewer, and open "
        "the file with `rerun FILE.rrd` where there is a display."
    )
