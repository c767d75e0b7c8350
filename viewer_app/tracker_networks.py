"""Fetches the networks of the program's own tracker, with a word and a progress bar."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn

if TYPE_CHECKING:
    from devices.blazepose.settings import BlazePoseSettings, NetworkName


def ensure_networks(settings: BlazePoseSettings, console: Console) -> None:
    """Fetches the tracker's network files if they are missing in the user's cache folder.

    A folder that was named by the user is not written; opening the tracker reports what it lacks.

    Raises:
        DeviceError: They cannot be fetched; one line with the way out.
    """
    from devices.blazepose.networks.files import cache_folder, missing

    folder = settings.models or cache_folder()
    if settings.models is not None or not missing(settings.network, folder):
        return
    console.print(
        f"Fetching the body tracker's network once (BlazePose, Apache-2.0) into {escape(str(folder))}",
        highlight=False,
        soft_wrap=True,
    )
    fetch_with_bar(settings.network, folder, console)


def fetch_with_bar(network: NetworkName, folder: Path, console: Console) -> list[Path]:
    """Fetches the files of a network that are missing in a folder, with a progress bar.

    Returns:
        The files that were fetched.

    Raises:
        DeviceError: They cannot be fetched; one line with the way out.
    """
    from devices.blazepose.networks.fetching import fetch

    with Progress(
        TextColumn("{task.description}"), BarColumn(), DownloadColumn(), console=console, transient=True
    ) as bar:
        task = bar.add_task("fetching the networks", total=None)
        return fetch(network, folder, lambda done, total: bar.update(task, completed=done, total=total))
