"""Settings of the body tracker."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

NetworkName = Literal["full", "lite"]


@dataclass(frozen=True)
class BlazePoseSettings:
    """How the body tracker runs.

    Attributes:
        network: The landmark network: ``full``, or ``lite``, which is faster and less accurate.
        models: Folder of the network files. None: the user's cache folder, into which the commands fetch
            missing files; in Python, :func:`devices.blazepose.networks.fetching.fetch` does.
        threads: CPU threads of the networks.
    """

    network: NetworkName = "full"
    models: Path | None = None
    threads: int = 1
