"""Rerun's own program as child processes, which send no usage statistics."""

from __future__ import annotations

import atexit
import contextlib
import importlib.util
import os
import platform
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import IO

import psutil

from viewer_app.errors import UsageError
from viewer_app.viewer.display import environment_of_window

STARTS_WITHIN = 20.0  # seconds

_DIES_WITH_ITS_PARENT = """
import ctypes, os, signal, sys
ctypes.CDLL(None).prctl(1, signal.SIGKILL)
if os.getppid() != int(sys.argv[1]):
    sys.exit()
os.execv(sys.argv[2], sys.argv[2:])
"""
"""PR_SET_PDEATHSIG, kept over exec: the kernel ends the process when the thread that started it ends. Popen's
preexec_fn would do it without a second program, but may hang in a program with threads."""


def start(
    arguments: Sequence[str], stdin: int | IO[bytes] = subprocess.DEVNULL, dies_with_us: bool = False
) -> subprocess.Popen[bytes]:
    """Starts Rerun's program; `dies_with_us`: it ends with this program, however that ends."""
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


def rerun_program() -> list[str]:
    """The binary of Rerun's viewer, if found, so that the child process is the viewer itself."""
    spec = importlib.util.find_spec("rerun_cli")
    for folder in (spec.submodule_search_locations or ()) if spec else ():
        for name in ("rerun", "rerun.exe"):
            if (program := Path(folder) / name).is_file():
                return [str(program)]
    return [sys.executable, "-m", "rerun"]


def listens(process: subprocess.Popen[bytes], ports: set[int]) -> bool:
    """Waits until a child process itself listens on the ports; another program that answers is not it."""
    deadline = time.monotonic() + STARTS_WITHIN
    while time.monotonic() < deadline and process.poll() is None:
        with contextlib.suppress(psutil.Error):
            parent = psutil.Process(process.pid)
            sockets = [c for p in (parent, *parent.children(True)) for c in p.net_connections("tcp")]
            if ports <= {each.laddr.port for each in sockets if each.status == psutil.CONN_LISTEN}:
                return True
        time.sleep(0.05)
    return False


def not_started(what: str, why: str = "") -> UsageError:
    """The error of a program of Rerun's that does not start."""
    return UsageError(
        f"{what} does not start here{f' ({why})' if why else ''}. Use --save FILE.rrd --no-viewer, and open "
        "the file with `rerun FILE.rrd` where there is a display."
    )
