"""The body tracker that the options ask for, said on the terminal."""

from __future__ import annotations

from rich.console import Console

from devices.azure.tracking.body_tracker import TrackerSettings
from devices.blazepose.settings import BlazePoseSettings
from devices.tracker_choice import TrackerChoice, choose_tracker
from viewer_app.options.shared import TrackerOptions
from viewer_app.tracker_networks import ensure_networks


def tracker_of(options: TrackerOptions, smoothing: float = 0.0) -> TrackerChoice:
    """The tracker of images of an Azure Kinect.

    Args:
        options: What was asked for.
        smoothing: Temporal smoothing of k4abt.
    """
    return choose_tracker(
        options.tracker,
        TrackerSettings(processing=options.processing, smoothing=smoothing, library=options.k4abt),
        BlazePoseSettings(network=options.tracker_network, models=options.tracker_model),
    )


def announce_tracker(tracker: TrackerChoice, console: Console) -> None:
    """Says which tracker runs and why, and fetches its networks if they are missing.

    Raises:
        DeviceError: The networks cannot be fetched.
    """
    console.print(f"Body tracker: {tracker.full_name} ({tracker.reason}).", highlight=False, markup=False)
    if tracker.name == "blazepose":
        ensure_networks(tracker.blazepose, console)
