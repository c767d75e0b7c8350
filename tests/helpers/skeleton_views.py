"""Skeleton recordings: the real pairs' names, and files that tests write."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fusion.body import Body
from tests.helpers.two_views import FRAME_NS

REAL = ("stationary", "steps", "walk")
"""``real/kinect_v2_90deg_…`` in the folder of reference recordings."""


def write_view(path: Path, body: Body, positions: NDArray[np.float64], start_us: int = 0) -> Path:
    """Writes (T, J, 3) positions of one person as .csv, to the micrometre."""
    rows = ["time_us,body,joint,x,y,z,state"]
    for t, at in enumerate(positions):
        rows += [
            f"{start_us + t * FRAME_NS // 1000},0,{joint},{x:.6f},{y:.6f},{z:.6f},tracked"
            for joint, (x, y, z) in zip(body.joints, at, strict=True)
        ]
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")
    return path
