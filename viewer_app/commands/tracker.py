"""``duplex tracker fetch``: fetches the networks of the program's own tracker."""

from rich.markup import escape

from devices.blazepose.networks.fetching import LICENCE, NOTICE
from devices.blazepose.networks.files import cache_folder
from viewer_app.options.sensing import TrackerFetchOptions
from viewer_app.output_console import output_console
from viewer_app.sensors.tracker import fetch_networks


def run(options: TrackerFetchOptions) -> None:
    """Runs the command."""
    console = output_console()
    folder = options.tracker_model or cache_folder()
    fetched = fetch_networks(options.network, folder, console)
    where = escape(str(folder))
    if not fetched:
        console.print(
            f"The network {options.network} is in {where} already, and complete.",
            soft_wrap=True,
        )
        return
    for path in fetched:
        console.print(f"{path.name:28s} {path.stat().st_size / 1e6:6.1f} MB", markup=False)
    console.print(f"In {where}. Apache License 2.0: see {LICENCE} and {NOTICE} there.", soft_wrap=True)
