"""Names of parameters in messages, as the flags of the command line."""

import re
from typing import Any, TextIO

_PARAMETER = re.compile(r"`([a-z][a-z0-9_]*)(?:=([^`]*))?`")
_FLAGS = {"offset_ms": "offset"}
"""Flags that are named otherwise than the parameter."""


def in_flags(text: str) -> str:
    """A text with ``--axes`` for `axes`, and ``--axes kinect`` for `axes=kinect`.

    The packages below name parameters in backquotes, because Python's users have no flags.
    """

    def flag(found: re.Match[str]) -> str:
        name, value = found.groups()
        return f"--{_FLAGS.get(name, name).replace('_', '-')}" + ("" if value is None else f" {value}")

    return _PARAMETER.sub(flag, text)


class InFlags:
    """A text stream that writes :func:`in_flags`."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        """Writes to the stream."""
        return self._stream.write(in_flags(text))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)
