"""Where a session goes while it is made: a viewer's window, a file, or both."""

from __future__ import annotations

import os
import platform
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from uuid import uuid4

import rerun as rr
import rerun.blueprint as rrb

from recordings import layout
from recordings.rewriting import check_whole
from viewer_app.errors import UsageError
from viewer_app.outputs import whole_file

_LOOPBACK = "127.0.0.1"
_VIEWER_STARTS_WITHIN = 20.0  # seconds
_FLUSH_WITHIN = 30.0


def has_display() -> bool:
    """Whether a window could open here."""
    if platform.system() == "Linux":
        return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
    return True


@contextmanager
def open_stream(save: Path | None, window: bool, blueprint: rrb.Blueprint) -> Iterator[rr.RecordingStream]:
    """A recording stream into a file, a new viewer window, both or neither.

    The file appears under its name only when the block ends well. The window stays open afterwards. It
    listens on this machine's loopback address only, and sends no usage statistics.

    Raises:
        UsageError: The viewer does not start, or the file cannot be written.
    """
    with ExitStack() as stack:
        sinks: list[rr.FileSink | rr.GrpcSink] = []
        partial = None if save is None else stack.enter_context(whole_file(save))
        if partial is not None:
            sinks.append(rr.FileSink(str(partial)))
        if window:
            sinks.append(rr.GrpcSink(_start_window()))
        stream = rr.RecordingStream(layout.APPLICATION_ID, recording_id=uuid4())
        if sinks:
            stream.set_sinks(*sinks, default_blueprint=blueprint)
        try:
            yield stream
            stream.flush(timeout_sec=_FLUSH_WITHIN)
        finally:
            stream.disconnect()
        if partial is not None:
            check_whole(partial)


def open_file(path: Path) -> None:
    """Opens a session in a new viewer window, which stays when this process ends.

    Raises:
        UsageError: The viewer does not start.
    """
    _start_window(str(path))


def _start_window(*files: str) -> str:
    """Starts a viewer of our own and returns the address to log to."""
    port = free_port()
    viewer = subprocess.Popen(
        [
            *(sys.executable, "-m", "rerun"),
            *("--bind", _LOOPBACK, "--port", str(port)),
            *("--memory-limit", "2GiB", *(files or ("--expect-data-soon",))),
        ],
        env={**os.environ, "RERUN_ANALYTICS": "0"},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    deadline = time.monotonic() + _VIEWER_STARTS_WITHIN
    while time.monotonic() < deadline and viewer.poll() is None:
        with socket.socket() as probe:
            probe.settimeout(0.5)
            if probe.connect_ex((_LOOPBACK, port)) == 0:
                return f"rerun+http://{_LOOPBACK}:{port}/proxy"
        time.sleep(0.05)
    viewer.kill()
    raise UsageError(
        "Rerun's viewer does not start on this display. Use --save FILE.rrd --no-viewer, and open the file "
        "with `rerun FILE.rrd` where there is one."
    )


def free_port() -> int:
    """A port of the loopback address that nothing listens on."""
    with socket.socket() as probe:
        probe.bind((_LOOPBACK, 0))
        return int(probe.getsockname()[1])
