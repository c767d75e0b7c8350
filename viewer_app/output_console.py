"""The console of a command."""

import sys
from collections.abc import Iterable

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment

from viewer_app.flags import printable

_UNLIMITED = 100_000  # columns


class _OutputConsole(Console):
    """A console whose texts have no control characters; its own, as of colours, stay."""

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        for text, style, control in super().render(renderable, options):
            yield Segment(text if control else printable(text), style, control)


def output_console() -> Console:
    """A console on the standard output. It wraps lines only for a terminal, not in a pipe or a log."""
    console = _OutputConsole(file=sys.stdout, highlight=False)
    if console.is_terminal:
        return console
    return _OutputConsole(file=sys.stdout, highlight=False, width=_UNLIMITED, soft_wrap=True)
