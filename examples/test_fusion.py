"""Guards your own recordings: pytest test_fusion.py

Put this file beside your `a.csv` and `b.csv`. Make `expected.rrd` once, with the version that you trust:
`duplex fuse a.csv b.csv --no-viewer --save expected.rrd`
"""

from pathlib import Path

import numpy as np

from recordings import fuse
from recordings.testing import assert_sessions_match

FOLDER = Path(__file__).parent


def test_the_fused_skeleton_has_not_changed():
    session = fuse(FOLDER / "a.csv", FOLDER / "b.csv")
    assert_sessions_match(session, FOLDER / "expected.rrd", position_mm=0.01)


def test_bones_are_constant_and_the_views_agree():
    session = fuse(FOLDER / "a.csv", FOLDER / "b.csv")
    assert np.nanmax(session.quality.bone_error) < 1e-5  # metres
    assert session.views_agree.median < 0.080
