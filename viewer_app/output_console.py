"""The console of a command."""

import sys
from typing import IO, cast

from rich.console import Console

from viewer_app.flags import InFlags

_UNLIMITED = 100_000  # columns


def output_console() -> Console:
    """A console on the standard output. It wraps lines only for a terminal, not in a pipe or a log."""
    out = cast("IO[str]", InFlags(sys.stdout))
    console = Console(file=out, highlight=False)
    if console.is_terminal:
        return console
    return Console(file=out, highlight=False, width=_UNLIMITED, soft_wrap=True)
