"""Options of the command that fetches the body tracker's networks."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal


@dataclass(frozen=True)
class TrackerFetchOptions:
    """Fetch the networks of the body tracker BlazePose once, from the Python package that carries them.

    The other commands do this by themselves when they need them. The networks are Google's, Apache-2.0.
    """

    network: Literal["full", "lite"] = "full"
    """full: the default. lite: faster and less accurate; it is fetched with npm."""
    tracker_model: Path | None = None
    """Folder to put the files into, such as one to copy to a machine without a package index; the user's
    cache folder if not given."""
