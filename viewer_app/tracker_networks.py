"""Fetches the networks of the program's own tracker, with a word and a progress bar."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn

if TYPE_CHECKING:
    from devices.blazepose.settings import BlazePoseSettings


def ensure_networks(settings: BlazePoseSettings, console: Console) -> bool:
    """Fetches the tracker's network files if they are missing in the user's cache folder.

    A folder that was named by the user is not written; opening the tracker reports what it lacks.

    Returns:
        Whether files were fetched.

    Raises:
        DeviceError: They cannot be fetched; one line with the way out.
    """
    from devices.blazepose.networks.fetching import fetch
    from devices.blazepose.networks.files import cache_folder, missing

    folder = settings.models or cache_folder()
    if settings.models is not None or not missing(settings.network, folder):
        return False
    console.print(
        f"Fetching the body tracker's network once (BlazePose, Apache-2.0) into {escape(str(folder))}",
        highlight=False,
        soft_wrap=True,
    )
    with Progress(
        TextColumn("{task.description}"), BarColumn(), DownloadColumn(), console=console, transient=True
    ) as bar:
        task = bar.add_task("networks", total=None)
        fetch(settings.network, folder, lambda done, total: bar.update(task, completed=done, total=total))
    return True
