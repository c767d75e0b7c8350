"""Compilation before a run, with a line that says how far it is."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from rich.console import Console
from rich.live import Live
from rich.text import Text

from fusion.compiling.first_run import FirstRun, Progress
from fusion.compiling.kernels import WarmUp

_LINE_CHANGES_EVERY = 0.5  # seconds


@contextmanager
def first_run(console: Console, shares: Sequence[Sequence[WarmUp]]) -> Iterator[FirstRun]:
    """Compiles kernels in other processes meanwhile, and says how far they are: in a line that changes, or in
    lines where the output is no terminal."""
    if not console.is_terminal:
        with FirstRun(*shares, tell=lambda progress: console.print(str(progress))) as running:
            yield running
        return
    with Live(console=console, auto_refresh=False, transient=True) as line:

        def tell(progress: Progress) -> None:
            line.update(Text(str(progress), no_wrap=True, overflow="ellipsis"), refresh=True)

        with FirstRun(*shares, tell=tell, every=_LINE_CHANGES_EVERY) as running:
            yield running


def warm_up(console: Console, shares: Sequence[Sequence[WarmUp]], load: bool = True) -> None:
    """Compiles kernels, or loads them where `load` is true, and tells how far it is."""
    with first_run(console, shares) as running:
        running.finish(load)
