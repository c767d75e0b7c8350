"""``duplex live`` on stand-ins for two Kinects."""

from __future__ import annotations

from pathlib import Path

from tests.helpers.command_line import duplex
from tests.helpers.standin_library import Standin


def live(standin: Standin, save: Path, *more: object, seconds: float = 1.0) -> int:
    """Records a session of so many seconds without a viewer; the exit code."""
    return duplex(
        *("live", "--kinect-a", "000123", "--kinect-b", "000456", "--k4abt", standin.path),
        *("--no-viewer", "--save", save, "--seconds", seconds, *more),
    )
