"""Chooses the body tracker, for recordings and for live sensors: one rule, and its reason in words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

from devices.azure.tracking.settings import TrackerSettings
from devices.blazepose.settings import BlazePoseSettings
from devices.sensor import DeviceError

WantedTracker = Literal["auto", "blazepose", "k4abt"]
"""What the user may ask for; auto is k4abt where it works, else blazepose."""


@dataclass(frozen=True)
class TrackerChoice:
    """The body tracker that runs."""

    name: Literal["blazepose", "k4abt"]  # ``k4abt``, Microsoft's, or ``blazepose``, the program's own
    reason: str  # why this one, in one clause
    asked: bool = False  # whether the user asked for this one
    k4abt: TrackerSettings = field(default_factory=TrackerSettings)  # settings of Microsoft's tracker
    blazepose: BlazePoseSettings = field(default_factory=BlazePoseSettings)  # settings of the program's own

    @property
    def full_name(self) -> str:
        """The name that a session records: with the network, where there are several."""
        return self.name if self.name == "k4abt" else f"blazepose {self.blazepose.network}"

    def for_images_of(self, others: Sequence[str]) -> TrackerChoice:
        """The choice where some images are not libk4a's, which only ``blazepose`` takes.

        Both sensors are tracked by one tracker, because two trackers report different bodies.

        Raises:
            DeviceError: k4abt was asked for.
        """
        if not others or self.name == "blazepose":
            return self
        if self.asked:
            raise DeviceError(f"{others[0]}: k4abt accepts images of libk4a only. Use `tracker=blazepose`.")
        return replace(
            self, name="blazepose", reason=f"k4abt does not accept the images of {' and '.join(others)}"
        )


def choose_tracker(
    wanted: WantedTracker = "auto",
    k4abt: TrackerSettings | None = None,
    blazepose: BlazePoseSettings | None = None,
    root: Path = Path("/"),
) -> TrackerChoice:
    """Chooses the tracker for images of libk4a, which both trackers take.

    A library named in the settings of k4abt asks for that tracker. See :meth:`TrackerChoice.for_images_of`
    for images of other sensors.
    """
    k4abt, blazepose = k4abt or TrackerSettings(), blazepose or BlazePoseSettings()
    if wanted != "auto":
        return TrackerChoice(wanted, "asked for with `tracker`", True, k4abt, blazepose)
    if k4abt.library is not None:
        return TrackerChoice("k4abt", "its library is named with `k4abt`", True, k4abt, blazepose)
    from devices.azure.checks import why_not_k4abt

    why_not = why_not_k4abt(k4abt, root)
    if why_not:
        return TrackerChoice("blazepose", why_not, False, k4abt, blazepose)
    return TrackerChoice("k4abt", "libk4abt is installed", False, k4abt, blazepose)
