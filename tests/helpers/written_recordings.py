"""Two recordings of one person as files."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fusion import KINECT_V2
from tests.helpers.skeleton_views import write_view
from tests.helpers.two_views import A_FROM_B, moving


def write_recordings(folder: Path, noise_m: float = 0.01) -> tuple[Path, Path]:
    """Two noisy views of a person, ``a.csv`` and ``b.csv``."""
    rng = np.random.default_rng(0)
    truth = moving(KINECT_V2, 70)
    a = truth + rng.normal(0.0, noise_m, truth.shape)
    b = A_FROM_B.inverse().apply(truth) + rng.normal(0.0, noise_m, truth.shape)
    return write_view(folder / "a.csv", KINECT_V2, a), write_view(folder / "b.csv", KINECT_V2, b)
