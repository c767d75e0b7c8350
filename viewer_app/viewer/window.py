"""Viewers in a window: started, watched, and opened again after a crash."""

from __future__ import annotations

import contextlib
import re
import subprocess
import threading
import time
from collections.abc import Callable, Sequence
from typing import IO, TYPE_CHECKING

import numpy as np
import psutil

from recordings.data import layout
from viewer_app.addresses import LOOPBACK
from viewer_app.errors import UsageError
from viewer_app.viewer.display import environment_of_window
from viewer_app.viewer.hub import Hub, free_port
from viewer_app.viewer.rerun_process import STARTS_WITHIN, listens, not_started, rerun_program, start, stop

if TYPE_CHECKING:
    from rerun.experimental import ViewerClient

_ENDS_WITHIN, _ANSWERS_WITHIN = 1.0, 1.0  # seconds
_HANGS_AFTER, _IDLE_SHARE = 5.0, 0.05  # seconds; of a processor
_REOPENED = 3  # times in a row
_VIEWER = "Rerun's viewer"
_VIEWER_MEMORY = "2GiB"
_LOOKED_AFTER_EVERY, _ASKED_EVERY = 0.5, 0.1  # seconds


def start_window(hub: Hub, headless: bool = False) -> tuple[subprocess.Popen[bytes], int]:
    """Starts a viewer that shows what the hub has; `headless` is for tests. Returns its process and port."""
    arguments = ["--connect", hub.url, "--hide-welcome-screen", *(["--headless"] if headless else [])]
    return start_viewer(arguments)


def start_viewer(
    arguments: Sequence[str], stdin: int | IO[bytes] = subprocess.DEVNULL
) -> tuple[subprocess.Popen[bytes], int]:
    """Starts a viewer that listens on a loopback port, with bounded memory; returns its process and the port.

    A viewer listens first, and then opens its window: it runs when it answers a request. A graphics driver
    may hang while it opens the window, so a viewer that neither answers nor computes is started once more.

    Raises:
        UsageError: It does not start, or it cannot open its window; with its own last words.
    """
    for last in (False, True):
        port = free_port()
        own = ["--bind", LOOPBACK, "--port", str(port), "--memory-limit", _VIEWER_MEMORY]
        viewer = start([*own, *arguments], stdin)
        try:
            if not listens(viewer, {port}):
                raise not_started(_VIEWER)
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
        raise not_started(_VIEWER, _last_words([*own, *(set(arguments) & {"--headless"})]))
    return viewer, port


def _hangs(viewer: subprocess.Popen[bytes], port: int) -> bool:
    """Waits until a viewer answers a request, has ended, takes long, or has not computed for five seconds;
    returns whether it is the last.
    """
    answered, runs = threading.Event(), []

    def ask() -> None:
        # the interface is experimental: whatever fails in it must not end a viewer that runs
        with contextlib.suppress(Exception):
            _client(port).get_state()
            runs.append(True)
        answered.set()

    threading.Thread(target=ask, name="viewer's first answer", daemon=True).start()
    began = worked = time.monotonic()
    spent = 0.0
    while viewer.poll() is None and time.monotonic() - began < STARTS_WITHIN and not answered.wait(0.05):
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
            timeout=STARTS_WITHIN,
            check=False,
        ).stderr.decode(errors="replace")
        words = re.findall(r"^(?:Error: |thread .* panicked at )(.*)$", said, re.MULTILINE)
        return re.sub(r"os error at \S+ ", "", words[-1]).strip("'.") if words else ""
    return ""


def pause(viewer: subprocess.Popen[bytes], port: int, at_ns: int, within: float) -> bool:
    """Stops the time of a viewer, which draws all the time otherwise; returns whether it has read so far.

    Args:
        at_ns: Where to stop, nanoseconds since the first pair.
        within: Seconds to wait until it has read so far. One that has not reads the rest while it stands
            there; one that hangs is left after another second.
    """
    stands = threading.Event()

    def ask() -> None:
        deadline = time.monotonic() + within
        while viewer.poll() is None:
            late = time.monotonic() > deadline
            # The interface is experimental: whatever fails in it must not end a command that is done.
            with contextlib.suppress(Exception):
                client = _client(port)
                state = client.get_state()
                lines = [line for each in state.recordings for line in each.timelines]
                read = [line.end for line in lines if line.name == layout.TIME and line.end is not None]
                whole = not state.loading and max(read, default=-1) >= at_ns
                if whole or late:
                    client.set_time(layout.TIME, duration=np.timedelta64(at_ns, "ns"), play_state="paused")
                    if whole:
                        stands.set()
                    return
            if late:
                return
            time.sleep(_ASKED_EVERY)

    asking = threading.Thread(target=ask, name="viewer's time", daemon=True)  # a hung viewer never answers
    asking.start()
    asking.join(within + _ANSWERS_WITHIN)
    return stands.is_set()


def viewer_url(port: int) -> str:
    """Where a viewer of this machine takes data and orders."""
    return f"rerun+http://{LOOPBACK}:{port}/proxy"


def _client(port: int) -> ViewerClient:
    from rerun.experimental import ViewerClient

    return ViewerClient.connect(viewer_url(port))


def why_nothing_is_drawn() -> str:
    """Why no viewer can draw on this machine, as text; empty if one can. It starts one, without a window."""
    try:
        stop(start_viewer(["--headless"])[0])
    except UsageError as error:
        return str(error).partition(". Use ")[0]
    return ""


class ViewerWindow:
    """A viewer window that reopens after a crash, and stays closed when the user closes it.

    Attributes:
        port: Where the viewer listens, on the loopback interface.
        failure: Why it is not opened again; empty as long as it is.
    """

    def __init__(self, start: Callable[[], tuple[subprocess.Popen[bytes], int]]) -> None:
        self._start = start
        self._leaving = threading.Event()
        self.process, self.port = start()
        self.starts = 1
        self.closed, self.failure = False, ""
        self._thread = threading.Thread(target=self._look_after, name="viewer window", daemon=True)
        self._thread.start()

    def leave(self) -> None:
        """Stops the supervision. The window stays open with its content."""
        self._leaving.set()
        self._thread.join(timeout=1.0)

    def pause(self, at_ns: int, within: float) -> bool:
        """Stops its time; see :func:`pause`."""
        return pause(self.process, self.port, at_ns, within)

    def _look_after(self) -> None:
        failed = 0
        while not self._leaving.wait(_LOOKED_AFTER_EVERY):
            if self.process.poll() is None:
                continue
            if self.process.returncode == 0:
                self.closed = True
                return
            try:
                self.process, self.port = self._start()
                self.starts, failed = self.starts + 1, 0
            except UsageError as error:
                failed += 1
                if failed == _REOPENED:
                    self.failure = str(error)
                    return
                continue
            if self._leaving.is_set():
                stop(self.process)
