"""The console of a command."""

from rich.console import Console

_UNLIMITED = 100_000  # columns


def output_console() -> Console:
    """A console on the standard output. It wraps lines only for a terminal, not in a pipe or a log."""
    console = Console(highlight=False)
    return console if console.is_terminal else Console(highlight=False, width=_UNLIMITED, soft_wrap=True)
