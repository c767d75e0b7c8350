"""Settings of the body tracker."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

NetworkName = Literal["full", "lite"]


@dataclass(frozen=True)
class BlazePoseSettings:
    """How the body tracker runs."""

    network: NetworkName = "full"
    """The landmark network: ``full``, or ``lite``, which is faster and less accurate."""
    models: Path | None = None
    """Folder of the network files. None: the user's cache folder, into which the commands fetch missing
    files; in Python, :func:`devices.blazepose.networks.fetching.fetch` does."""
    threads: int = 1  # CPU threads of the networks
