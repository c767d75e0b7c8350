"""The page of a session for browsers: its address, and who else can see it."""

import subprocess
import sys

from rich.console import Console

from viewer_app.addresses import is_loopback, print_code
from viewer_app.viewer.display import environment_of_window, has_display
from viewer_app.viewer.hub import DATA_PORT, PAGE_PORT, Hub


def announce_page(hub: Hub, console: Console, live: bool = False) -> None:
    """Prints the address of the page and who else can see it, and opens a browser where there is a display.

    Args:
        live: Whether a loop runs; then it says how a slow browser shows.
    """
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
    if others:
        print_code(hub.page, console)
    console.print(
        "Rerun's page requests a font and news from its makers' servers; it also works without a network."
    )
    if live:  # Rerun's server does not say how far a browser is behind
        console.print("If its top shows seconds of latency, the browser is too slow: try --depth none.")
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
