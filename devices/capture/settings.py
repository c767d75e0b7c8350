"""Settings that live sensors of all vendors have."""

from dataclasses import dataclass
from typing import Literal

LASER_GAP_US = 160
"""How much later than the master a subordinate captures, so that their lasers do not blind each other."""


@dataclass(frozen=True)
class CaptureSettings:
    """How a live sensor runs."""

    depth_mode: str = "NFOV_UNBINNED"  # NFOV_UNBINNED (640 × 576) or WFOV_2X2BINNED (512 × 512)
    fps: Literal[5, 15, 30] = 30  # frames per second
    color: str | None = None  # colour resolution, such as ``720P``; None for no colour images
    sync: Literal["standalone", "master", "subordinate"] = "standalone"  # its place on the sync cable
    delay_us: int = LASER_GAP_US  # how much later than the master a subordinate captures
    timeout_ms: int = 500  # how long one wait for a frame may take
    stall_s: float = 5.0  # after how long without depth the stream counts as stalled
    start_s: float = 120.0  # the same for a subordinate's first frame, which waits until its master runs
