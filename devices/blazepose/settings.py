"""Settings of the body tracker."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

NetworkName = Literal["full", "lite"]
WantedPerson = Literal["middle", "nearest", "left", "right"]
"""Whom to follow of several people: by the place in the image, or the one nearest to the sensor."""


@dataclass(frozen=True)
class BlazePoseSettings:
    """How the body tracker runs."""

    network: NetworkName = "full"
    """The landmark network: ``full``, or ``lite``, which is faster and less accurate."""
    models: Path | None = None
    """Folder of the network files. None: the user's cache folder, into which the commands fetch missing
    files; in Python, :func:`devices.blazepose.networks.fetching.fetch` does."""
    threads: int = 1  # CPU threads of the networks
    person: WantedPerson = "middle"  # whom to follow of several people, until they are lost for a second
