"""Folders of small pairs of recordings, and sessions compared bit for bit."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fusion.body import KINECT_V2
from recordings.session import Session
from tests.helpers.skeleton_views import write_view
from tests.helpers.two_views import A_FROM_B, moving

FRAMES = 75
"""Long enough for a start-up pose of 1.5 s."""


def write_pair(folder: Path, a: str = "a.csv", b: str = "b.csv", seed: int = 0) -> Path:
    """Writes two views of a moving person, each with 10 mm of noise, into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(seed)
    truth = moving(KINECT_V2, FRAMES, seed)
    for name, view in ((a, truth), (b, A_FROM_B.inverse().apply(truth))):
        write_view(folder / name, KINECT_V2, view + rng.normal(0, 0.01, truth.shape))
    return folder


def assert_same_session(one: Path, other: Path) -> None:
    """Compares two sessions: every figure of every frame but the time that fusion took, in bits."""
    first, second = Session.open(one), Session.open(other)
    for (name, _, values), (_, _, others) in zip(first.rows.figures(), second.rows.figures(), strict=True):
        if name != "fuse_ms":
            assert values.tobytes() == others.tobytes(), name
    assert first.fused_checksums.tobytes() == second.fused_checksums.tobytes()
    assert first.events == second.events
    assert first.settings == second.settings
    assert len(first.calibrations) == len(second.calibrations)
