"""Runs ``duplex`` in a process of its own on the rig or on the stand-in, to its very end.

Processes are forked from a server that has imported the program and loaded its kernels, where the system can.
"""

import ctypes
import os
import re
import signal
import sys
import time
from dataclasses import dataclass, field
from importlib import import_module
from multiprocessing import get_all_start_methods, get_context
from pathlib import Path

from tests.scenarios import standin_rig
from viewer_app.cli import script

_LIMIT_S = 300.0  # only a program that hangs reaches it
Action = dict[str, object] | int
"""New values of the configuration, or a signal."""


@dataclass
class Run:
    """A run of the program.

    Attributes:
        code: Exit code; negative: the signal that ended it.
        said: What it printed.
        ended_s: Seconds from the last signal to the end.
    """

    code: int
    said: str
    ended_s: float
    folder: Path = field(default=Path())


def main(arguments, folder, rig):
    """The process: ends as the interpreter does, with its exit functions and destructors."""
    with (folder / "out.txt").open("wb", 0) as out:
        os.dup2(out.fileno(), 1)
        os.dup2(out.fileno(), 2)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    sys.stdout, sys.stderr = (open(number, "w", buffering=1, closefd=False) for number in (1, 2))  # noqa: SIM115
    signal.signal(signal.SIGINT, signal.default_int_handler)
    os.environ.update(RIG_DIR=str(folder), COLUMNS="400", K4A_ENABLE_LOG_TO_STDOUT="0")
    sys.argv = ["duplex", *arguments]
    standin = None
    if rig is None:
        standin = standin_rig.install(folder)
    else:
        sys.path.insert(0, str(rig / "site"))
    code = 0
    try:
        script()
    except SystemExit as end:
        code = end.code
    sys.stdout.flush()
    if standin is not None and standin.bus.open_serials:
        os.kill(os.getpid(), signal.SIGSEGV)  # as libk4a's destructor does
    ctypes.pythonapi.Py_Exit(ctypes.c_int(code if isinstance(code, int) else bool(code)))


def run(arguments, folder, conf, events, rig):
    """Runs the program to its end.

    Args:
        arguments: Of ``duplex``.
        folder: Of the run: its configuration and output.
        conf: The configuration at the start.
        events: What happens, each so many seconds after the one before, or when a line matches.
        rig: Where the rig is built; None for the stand-in.
    """
    method = "forkserver" if "forkserver" in get_all_start_methods() else "spawn"
    context = get_context(method)
    if method == "forkserver":
        context.set_forkserver_preload(["tests.scenarios.preloaded"])
        if rig is not None and os.environ.get("LD_LIBRARY_PATH") != str(rig / "lib"):
            os.environ["LD_LIBRARY_PATH"] = str(rig / "lib")  # read where a process starts: the server
            import_module("multiprocessing.forkserver")._forkserver._stop()
    for file in [] if rig is None else (rig / "bus").iterdir():
        (folder / file.name).symlink_to(file)
    conf = {"a.jack": 0, "b.jack": 0, "t0": time.monotonic() + 1.0, **conf}
    _write(folder, conf)
    (folder / "out.txt").touch()
    process = context.Process(target=main, args=(arguments, folder, rig))
    process.start()
    begun = since = time.monotonic()
    todo = list(events)
    while process.is_alive() and time.monotonic() - begun < _LIMIT_S:
        time.sleep(0.01)
        if not todo:
            continue
        when, action = todo[0]
        if re.search(when, _said(folder)) if isinstance(when, str) else time.monotonic() - since >= when:
            todo.pop(0)
            since = time.monotonic()
            if isinstance(action, int):
                os.kill(process.pid or 0, action)
            else:
                conf |= action
                _write(folder, conf)
    ended_s = time.monotonic() - since
    hung = process.is_alive()
    if hung:
        process.kill()
    process.join()
    assert not hung, f"still runs after {_LIMIT_S:g} s: {_said(folder)}"
    assert not todo, f"never: {todo[0]}, but {_said(folder)}"
    return Run(process.exitcode or 0, _said(folder), ended_s, folder)


def _said(folder):
    return (folder / "out.txt").read_text(encoding="utf-8", errors="replace")


def _write(folder, conf):
    unfinished = folder / "rig.conf.new"
    unfinished.write_text("".join(f"{key}={value}\n" for key, value in conf.items()))
    unfinished.rename(folder / "rig.conf")
