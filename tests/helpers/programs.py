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


def python(*arguments, cwd=ROOT, timeout=600.0, **environment):
    """What a Python process of the project printed, and its exit code."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), **environment}
    command = [sys.executable, *map(str, arguments)]
    return subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, timeout=timeout)


class Program:
    """A running command."""

    def __init__(self, *arguments):
        self._process = subprocess.Popen(
            [sys.executable, "-u", "-m", "viewer_app.cli", *map(str, arguments)],
            cwd=ROOT,
            env={**os.environ, "PYTHONPATH": str(ROOT), "COLUMNS": "300"},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
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
        self._process.kill()
        self._process.wait(20.0)

    def end(self, within=60.0):
        """Sends Ctrl-C and returns the exit code."""
        self._process.send_signal(signal.SIGINT)
        code = self._process.wait(within)
        self._reader.join(10.0)
        return code

    def _read(self):
        for line in self._process.stdout:
            self._lines.append(line)


@contextmanager
def running(*arguments):
    """A running command, which is killed at the end of the block if it has not ended."""
    program = Program(*arguments)
    try:
        yield program
    finally:
        program.kill()
