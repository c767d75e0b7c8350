"""The body tracker that the options ask for, and its networks."""

from pathlib import Path

from rich.console import Console

from devices.azure.tracking.settings import TrackerSettings
from devices.blazepose.settings import BlazePoseSettings, NetworkName
from devices.capture.frame_decimation import FrameDecimation
from devices.input_file import check_recording
from devices.tracker_choice import TrackerChoice, choose_tracker
from viewer_app.errors import UsageError
from viewer_app.options.shared import TrackerOptions


def tracker_of(options: TrackerOptions) -> TrackerChoice:
    """The tracker that the options ask for.

    Raises:
        UsageError: Options of the program's own tracker for another one.
    """
    choice = choose_tracker(
        options.tracker,
        TrackerSettings(processing=options.processing, library=options.k4abt),
        BlazePoseSettings(
            network=options.tracker_network, models=options.tracker_model, person=options.person
        ),
    )
    if choice.name == "k4abt" and options.person != "middle":
        raise UsageError("--person needs the program's own tracker: add --tracker blazepose.")
    return choice


def announce_tracker(tracker: TrackerChoice, console: Console, *recordings: Path) -> None:
    """Says which tracker runs and why, and fetches its networks if they are missing.

    Raises:
        DeviceError: A recording is missing, of which its reader would say so later.
    """
    for path in recordings:
        check_recording(path)
    console.print(f"Body tracker: {tracker.full_name} ({tracker.reason}).", markup=False)
    if tracker.name == "blazepose":
        ensure_networks(tracker.blazepose, console)


def decimation_of(tracker: TrackerChoice | None, fps: float) -> FrameDecimation:
    """The frame decimation that two sensors with this tracker share.

    With the program's own tracker it also changes to the lighter network if a tracker stays too slow.
    """
    if tracker is None or tracker.name != "blazepose":
        return FrameDecimation(fps)
    from devices.blazepose.pace import TrackingPace

    return TrackingPace(fps, tracker.blazepose)


def ensure_networks(settings: BlazePoseSettings, console: Console) -> None:
    """Fetches the tracker's network files if they are missing in the user's cache folder.

    A folder that was named by the user is not written; opening the tracker reports what it lacks.
    """
    from devices.blazepose.networks.files import cache_folder, missing

    folder = cache_folder()
    if settings.models is None and missing(settings.network, folder):
        note = f"Fetching the body tracker's network once (BlazePose, Apache-2.0) into {folder}"
        console.print(note, markup=False, soft_wrap=True)
        fetch_networks(settings.network, folder, console)


def fetch_networks(network: NetworkName, folder: Path, console: Console) -> list[Path]:
    """Fetches the files of a network that a folder lacks or has damaged; returns them."""
    from devices.blazepose.networks.fetching import fetch

    with console.status("fetching a package of about 40 MB …"):
        return fetch(network, folder)
