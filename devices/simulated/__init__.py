"""Two simulated Kinects in front of one person whose joints are known exactly."""

from pathlib import Path

from fusion.compiling.kernel_cache import drop_stale_kernels

drop_stale_kernels(Path(__file__).parent)
