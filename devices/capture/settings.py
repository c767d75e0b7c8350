"""Settings that live sensors of all vendors have."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

LASER_GAP_US = 160
"""How much later than the master a subordinate captures, so that their lasers do not blind each other."""


@dataclass(frozen=True)
class CaptureSettings:
    """How a live sensor runs.

    Attributes:
        depth_mode: NFOV_UNBINNED (640 × 576) or WFOV_2X2BINNED (512 × 512).
        fps: Frames per second.
        color: Colour resolution, such as ``720P``; None for no colour images.
        sync: Its place on the sync cable.
        delay_us: How much later than the master a subordinate captures.
        timeout_ms: How long one wait for a frame may take.
        stall_s: After how long without depth the stream counts as stalled.
        start_s: The same for a subordinate's first frame, which waits until its master runs.
    """

    depth_mode: str = "NFOV_UNBINNED"
    fps: Literal[5, 15, 30] = 30
    color: str | None = None
    sync: Literal["standalone", "master", "subordinate"] = "standalone"
    delay_us: int = LASER_GAP_US
    timeout_ms: int = 500
    stall_s: float = 5.0
    start_s: float = 120.0
