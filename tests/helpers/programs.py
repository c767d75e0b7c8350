"""Runs ``duplex`` in separate processes and reads their output."""

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tests.helpers.waiting import eventually

ROOT = Path(__file__).resolve().parents[2]


class Program:
    """A running command."""

    def __init__(self, *arguments: object) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-u", "-m", "viewer_app.cli", *map(str, arguments)],
            cwd=ROOT,
            env={**os.environ, "PYTHONPATH": str(ROOT), "COLUMNS": "300"},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        self._lines: list[str] = []
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    @property
    def said(self) -> str:
        """Everything that it printed so far."""
        return "".join(self._lines)

    def says(self, words: str, within: float = 120.0) -> bool:
        """Returns whether it prints some words before it ends."""
        eventually(lambda: words in self.said or self._process.poll() is not None, within)
        if self._process.poll() is not None:
            self._reader.join(10.0)
        return words in self.said

    def kill(self) -> None:
        """Kills it without notice, like a power cut."""
        self._process.kill()
        self._process.wait(20.0)

    def end(self, within: float = 60.0) -> int:
        """Sends Ctrl-C and returns the exit code."""
        self._process.send_signal(signal.SIGINT)
        code = self._process.wait(within)
        self._reader.join(10.0)
        return code

    def _read(self) -> None:
        for line in self._process.stdout:
            self._lines.append(line)


@contextmanager
def running(*arguments: object) -> Iterator[Program]:
    """A running command, which is killed at the end of the block if it has not ended."""
    program = Program(*arguments)
    try:
        yield program
    finally:
        program.kill()
