"""Chooses the viewer that a command opens, and announces it."""

import shutil
import subprocess
import sys
import threading
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO, cast

from rich.console import Console

from viewer_app.addresses import is_loopback
from viewer_app.errors import UsageError
from viewer_app.options.shared import WebOptions
from viewer_app.viewer.display import environment_of_window, has_display, why_no_window
from viewer_app.viewer.rerun_process import DATA_PORT, PAGE_PORT, Hub, rerun_program


@dataclass(frozen=True)
class Viewing:
    """How a running session is shown."""

    window: bool = False  # whether a window opens
    hub: Hub | None = None
    """The hub that viewers connect to; None: a window that shows a file, and outlives the program."""
    headless: bool = False  # whether the window renders off-screen, for tests
    why_not: str = ""  # why no viewer opens although one was requested

    @property
    def opens(self) -> bool:
        """Whether any viewer is to open."""
        return self.window or self.hub is not None


def choose_viewing(
    options: WebOptions, save: Path | None, *, live: bool, served: bool = False
) -> Viewing | None:
    """The viewer that the options ask for.

    Args:
        live: Whether a loop runs at its own pace; then a window that is closed can be opened again.
        served: Whether an output listens on the address, too.

    Returns:
        None if no viewer is wanted. If none can open, a value that states the reason.
    """
    if options.listen is not None and not (options.web or served):
        raise UsageError(f"--listen {options.listen} is the address of --web; give both.")
    if options.no_viewer:
        if options.web:
            raise UsageError("--web and --no-viewer contradict each other.")
        return None
    if options.web:
        return Viewing(hub=Hub.on_free_ports(web=True, address=options.listen))
    why_not = why_no_window()
    if why_not is None:
        return Viewing(window=True, hub=Hub.on_free_ports(web=False) if live else None)
    if save is None:
        raise UsageError(
            f"{why_not}, and there is no --save. Use --save FILE.rrd to keep the session, --web to look at "
            "it in a browser, or --no-viewer for the summary alone."
        )
    return Viewing(why_not=why_not)


def announce(viewing: Viewing | None, console: Console, live: bool = False) -> None:
    """Prints the address of the viewer, who else can see it, and, if it is live, how a slow browser shows;
    opens the browser if there is one."""
    if viewing is None:
        return
    if viewing.why_not:
        console.print(f"{viewing.why_not}; the session is saved.", markup=False)
    hub = viewing.hub
    if hub is None:
        return
    if hub.web_port is None:
        program = "rerun" if shutil.which("rerun") else " ".join(rerun_program())
        console.print(f"Reopen a closed viewer with: {program} --connect {hub.url}", soft_wrap=True)
        return
    for port, usual in ((hub.web_port, PAGE_PORT), (hub.port, DATA_PORT)):
        if port != usual:
            console.print(f"Port {usual} is taken: using {port}.")
    others = not is_loopback(hub.address)
    if others:
        console.print(
            f"[bold yellow]Warning[/]: listening on {hub.address}: whoever reaches this machine's ports "
            f"{hub.port} and {hub.web_port} sees the session, video included, without a password."
        )
    console.print(f"[bold]Viewer[/]: {hub.page}", soft_wrap=True)
    if others and console.is_terminal and console.encoding.startswith("utf"):
        import segno

        segno.make(hub.page).terminal(
            cast(TextIO, console.file), compact=True
        )  # for the camera of a phone or tablet
    if live:  # Rerun's server does not say how far a browser is behind
        console.print("Seconds of latency at its top: a slow browser shows the past. Try --depth none.")
    if has_display():
        _open_in_browser(hub.page)


def _open_in_browser(page: str) -> None:
    """Opens a page in the user's browser, from a process of its own.

    A browser that the standard library does not know, or one for the terminal, is waited for until it is
    closed; the latter is not tried where no terminal is named.
    """
    environment = environment_of_window()
    environment.pop("TERM", None)
    subprocess.Popen(
        [sys.executable, "-I", "-m", "webbrowser", page],
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )


def stay_for_visitors(
    viewing: Viewing | None, console: Console, until: threading.Event | None = None
) -> None:
    """Serves the web page until Ctrl-C or the event; returns at once without a page."""
    if viewing is None or viewing.hub is None or viewing.hub.web_port is None:
        return
    console.print("The page stays until Ctrl-C.")
    until = until or threading.Event()
    with suppress(KeyboardInterrupt):
        while not until.wait(1.0):  # on Windows Ctrl-C does not end a wait
            pass
