"""Settings of Microsoft's body tracker."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from devices.sensor import Orientation


@dataclass(frozen=True)
class TrackerSettings:
    """How the body tracker runs."""

    processing: Literal["gpu", "cpu", "cuda", "tensorrt", "directml"] = "gpu"
    """Where the network runs. On a CPU it processes about one frame per second."""
    orientation: Orientation = 0  # of the sensor, whose frame stays its own
    library: Path | None = None  # file of libk4abt; found by the system if None
    timeout_s: float = 5.0
    """Longest time for one frame. The first frame may take ten times as long, because the network is
    loaded."""
