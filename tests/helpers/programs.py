"""Runs Python and ``duplex`` in separate processes and reads their output."""

import os
import signal
import subprocess
import sys
import threading
from contextlib import contextmanager
from pathlib import Path

from tests.helpers.waiting import eventually

ROOT = Path(__file__).resolve().parents[2]
_DUPLEX = (sys.executable, "-u", "-m", "viewer_app.cli")
_SHELL = ("bash", "-ec")


def python(*arguments, cwd=ROOT, timeout=600.0, **environment):
    """What a Python process of the project printed, and its exit code."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), **environment}
    command = [sys.executable, *map(str, arguments)]
    return subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, timeout=timeout)


class Program:
    """A running command of ``duplex``, or another command."""

    def __init__(self, *arguments, command=_DUPLEX, cwd=ROOT, **environment):
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "COLUMNS": "300", **environment}
        self._process = subprocess.Popen(
            [*command, *map(str, arguments)],
            cwd=cwd,
            env={name: value for name, value in environment.items() if value is not None},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,  # a group of processes, as a terminal makes one for a line
        )
        self._lines = []
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    @property
    def said(self):
        """Everything that it printed so far."""
        return "".join(self._lines)

    def says(self, words, within=120.0):
        """Returns whether it prints some words before it ends."""
        eventually(lambda: words in self.said or self._process.poll() is not None, within)
        if self._process.poll() is not None:
            self._reader.join(10.0)
        return words in self.said

    def kill(self):
        """Kills it without notice, like a power cut."""
        self._signal(signal.SIGKILL)
        self._process.wait(20.0)

    def end(self, within=60.0):
        """Sends Ctrl-C and returns the exit code."""
        self._signal(signal.SIGINT)
        return self.code(within)

    def code(self, within=600.0):
        """The exit code, once it has ended by itself."""
        code = self._process.wait(within)
        self._reader.join(10.0)
        return code

    def _signal(self, number):
        if self._process.poll() is None:
            os.killpg(self._process.pid, number)

    def _read(self):
        for line in self._process.stdout:
            self._lines.append(line)


@contextmanager
def running(*arguments, **how):
    """A running command, which is killed at the end of the block if it has not ended."""
    program = Program(*arguments, **how)
    try:
        yield program
    finally:
        program.kill()


def typed(line, folder, **environment):
    """A line that a user types in a folder, in the environment of this Python: see :func:`running`."""
    path = os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))
    how = {"PYTHONPATH": None, "PYTHONUNBUFFERED": "1", "PATH": path, **environment}
    return running(line, command=_SHELL, cwd=folder, **how)
