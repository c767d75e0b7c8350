"""How a session is shown: one of four ways, which a command chooses once.

| | a file: fuse, review | a running loop: live, demo |
|---|---|---|
| ``--no-viewer`` | :class:`NoViewer` | :class:`NoViewer` |
| ``--web`` | :class:`WebPage` | :class:`WebPage` |
| a display answers | :class:`FileWindow` | :class:`LiveWindow` |
| none does, but the session is saved | :class:`NoViewer`, why not | :class:`NoViewer`, why not |
"""

import shutil
import threading
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from viewer_app.errors import UsageError
from viewer_app.options.shared import WebOptions
from viewer_app.viewer.display import why_no_window
from viewer_app.viewer.hub import Hub
from viewer_app.viewer.rerun_process import rerun_program
from viewer_app.viewer.web_page import announce_page


@dataclass(frozen=True)
class Viewing:
    """A way to show a session: to viewers that others connect to the hub, if there is one."""

    hub: Hub | None = None

    def announce(self, console: Console) -> None:
        """Prints where the viewer is, and who else can see it."""

    def stay(self, console: Console, until: threading.Event | None = None) -> None:
        """Waits until Ctrl-C or the event, where visitors may still come."""


@dataclass(frozen=True)
class NoViewer(Viewing):
    """Nothing is shown; `why_not` says why although it was wanted."""

    why_not: str = ""

    def announce(self, console: Console) -> None:
        if self.why_not:
            console.print(f"{self.why_not}; the session is saved.", markup=False)


@dataclass(frozen=True)
class FileWindow(Viewing):
    """A window that shows a file, and outlives the program."""


@dataclass(frozen=True)
class LiveWindow(Viewing):
    """A window that shows what the hub has, and can be opened again; `headless` is for tests."""

    hub: Hub
    headless: bool = False

    def announce(self, console: Console) -> None:
        program = "rerun" if shutil.which("rerun") else " ".join(rerun_program())
        console.print(f"Reopen a closed viewer with: {program} --connect {self.hub.url}", soft_wrap=True)


@dataclass(frozen=True)
class WebPage(Viewing):
    """A page for browsers, one of which is opened where there is a display; `live`: of a running loop."""

    hub: Hub
    live: bool = False

    def announce(self, console: Console) -> None:
        announce_page(self.hub, console, self.live)

    def stay(self, console: Console, until: threading.Event | None = None) -> None:
        console.print("The page stays until Ctrl-C.")
        until = until or threading.Event()
        with suppress(KeyboardInterrupt):
            while not until.wait(1.0):  # on Windows Ctrl-C does not end a wait
                pass


def window_opens(no_viewer: bool, console: Console) -> bool:
    """Whether a command that prints its result opens a window, too; says why none can open."""
    why_not = None if no_viewer else why_no_window()
    if why_not is not None:
        console.print(f"{why_not}; no window opens.", markup=False)
    return not no_viewer and why_not is None


def choose_viewing(options: WebOptions, save: Path | None, *, live: bool, served: bool = False) -> Viewing:
    """The way that the options ask for.

    Args:
        live: Whether a loop runs at its own pace; then a window that is closed can be opened again.
        served: Whether an output listens on the address, too.

    Raises:
        UsageError: Options contradict each other, no window can open and nothing is saved, or the address is
            none of this machine's.
    """
    if options.listen is not None and not (options.web or served):
        also = ", --websocket and --lsl; give one of them." if live else "; give both."
        raise UsageError(f"--listen {options.listen} is the address of --web{also}")
    if options.no_viewer:
        if options.web:
            raise UsageError("--web and --no-viewer contradict each other.")
        return NoViewer()
    if options.web:
        return WebPage(Hub.on_free_ports(web=True, address=options.listen), live)
    why_not = why_no_window()
    if why_not is None:
        return LiveWindow(Hub.on_free_ports(web=False)) if live else FileWindow()
    if save is None:
        raise UsageError(
            f"{why_not}, and there is no --save. Use --save FILE.rrd to keep the session, --web to look at "
            "it in a browser, or --no-viewer for the summary alone."
        )
    return NoViewer(why_not=why_not)
