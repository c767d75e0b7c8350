"""Guards your own recordings: pytest test_fusion.py

Put this file beside your `a.csv` and `b.csv`. Make `expected.rrd` once, with the version that you trust:
`pytest --duplex-update test_fusion.py`
"""

from pathlib import Path

import numpy as np

from recordings import fuse
from recordings.testing import assert_sessions_match

FOLDER = Path(__file__).parent


def test_the_fused_skeleton_has_not_changed():
    session = fuse(FOLDER / "a.csv", FOLDER / "b.csv")
    assert_sessions_match(session, FOLDER / "expected.rrd", position_mm=0.01)


def test_bones_are_constant_and_joints_right(simulated_session):
    session = simulated_session("walk", seconds=4.0, seed=1)  # of two simulated sensors
    assert np.nanmax(session.quality.bone_error) < 1e-5  # metres
    off = np.linalg.norm(session.fused - session.truth, axis=2)
    assert np.nanmedian(off) < 0.04
