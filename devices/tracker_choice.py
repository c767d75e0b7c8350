"""Chooses the body tracker, for recordings and for live sensors: one rule, and its reason in words."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from devices.azure.tracking.availability import why_not_k4abt
from devices.azure.tracking.body_tracker import TrackerSettings
from devices.blazepose.settings import BlazePoseSettings

WantedTracker = Literal["auto", "blazepose", "k4abt"]
"""What the user may ask for; auto is k4abt where it works, else blazepose."""


@dataclass(frozen=True)
class TrackerChoice:
    """The body tracker that runs.

    Attributes:
        name: ``k4abt``, Microsoft's, or ``blazepose``, the program's own.
        reason: Why this one, in one clause.
        k4abt: Settings of Microsoft's tracker.
        blazepose: Settings of the program's own.
    """

    name: Literal["blazepose", "k4abt"]
    reason: str
    k4abt: TrackerSettings = field(default_factory=TrackerSettings)
    blazepose: BlazePoseSettings = field(default_factory=BlazePoseSettings)

    @property
    def full_name(self) -> str:
        """The name that a session records: with the network, where there are several."""
        return self.name if self.name == "k4abt" else f"blazepose {self.blazepose.network}"


def choose_tracker(
    wanted: WantedTracker = "auto",
    k4abt: TrackerSettings | None = None,
    blazepose: BlazePoseSettings | None = None,
    root: Path = Path("/"),
) -> TrackerChoice:
    """Chooses the tracker for images of an Azure Kinect, which both trackers take.

    Images of other sensors are tracked by ``blazepose`` only: libk4abt needs captures of libk4a.

    Args:
        wanted: What was asked for.
        k4abt: Settings of Microsoft's tracker; a library named there asks for that tracker.
        blazepose: Settings of the program's own.
        root: Root of the file system; tests inject their own.
    """
    k4abt, blazepose = k4abt or TrackerSettings(), blazepose or BlazePoseSettings()
    if wanted != "auto":
        return TrackerChoice(wanted, "asked for with --tracker", k4abt, blazepose)
    if k4abt.library is not None:
        return TrackerChoice("k4abt", "its library is named with --k4abt", k4abt, blazepose)
    why_not = why_not_k4abt(k4abt, root)
    if why_not:
        return TrackerChoice("blazepose", why_not, k4abt, blazepose)
    return TrackerChoice("k4abt", "libk4abt is installed", k4abt, blazepose)
