"""What is printed: names of parameters as flags, no control characters, and no error where nobody reads."""

import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any, TextIO, cast

_PARAMETER = re.compile(r"(?<![^\s(,;:\"'])`([a-z][a-z0-9_]*)(?:=([^`]*))?`(?![\w/\\-]|\.\w)")
"""Within the name of a file, something beside the backquotes tells that they are of it."""
_FLAGS = {"offset_ms": "offset"}
"""Flags that are named otherwise than the parameter."""
_CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069]")
"""Characters that move a terminal's cursor, change its state or the order of letters."""


def in_flags(text: str) -> str:
    """A text with ``--axes`` for `axes`, and ``--axes kinect`` for `axes=kinect`.

    The packages below name parameters in backquotes, because Python's users have no flags.
    """

    def flag(found: re.Match[str]) -> str:
        name, value = found.groups()
        return f"--{_FLAGS.get(name, name).replace('_', '-')}" + ("" if value is None else f" {value}")

    return _PARAMETER.sub(flag, text)


def printable(text: str) -> str:
    """A text with a question mark in a diamond for each control character but tab and line feed."""
    return _CONTROL.sub("\ufffd", text)


class Printed:
    """A standard stream that writes :func:`in_flags`, and after a failure nothing.

    Attributes:
        failure: Why not all of it was written: the reader is gone, or a disk is full.
    """

    def __init__(self, stream: TextIO) -> None:
        self.stream = stream
        self.failure: OSError | None = None

    def write(self, text: str) -> int:
        """Writes to the stream."""
        try:
            self.stream.write(in_flags(text))
        except OSError as failure:
            self._fail(failure)
        return len(text)

    def flush(self) -> None:
        """Flushes the stream."""
        try:
            self.stream.flush()
        except OSError as failure:
            self._fail(failure)

    def _fail(self, failure: OSError) -> None:
        self.failure = self.failure or failure
        with suppress(OSError, ValueError):  # the rest goes nowhere, also what the interpreter writes at exit
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self.stream.fileno())
            os.close(nowhere)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stream, name)


@contextmanager
def printing() -> Iterator[Printed]:
    """Makes the standard streams :class:`Printed` in the block; yields the standard output."""
    streams = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = (
        cast("TextIO", stream if isinstance(stream, Printed) else Printed(stream)) for stream in streams
    )
    try:
        yield cast("Printed", sys.stdout)
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        sys.stdout, sys.stderr = streams


def complain(text: str) -> None:
    """Prints a line to the standard error."""
    print(printable(text), file=sys.stderr)
