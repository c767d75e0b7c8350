"""Figures that are derived from the arrays of a session."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fusion.body import KINECT_V1
from fusion.fuser import Fuser
from fusion.setup import FusionSetup
from recordings.fusing.pairs import fuse_one
from recordings.session_arrays import SessionArrays
from tests.helpers.frame_pairs import frame_pairs
from tests.helpers.two_views import calibration_of


def test_disagreement_is_the_median_over_the_joints_that_both_see() -> None:
    fuser = Fuser(FusionSetup(calibration_of(KINECT_V1)))
    frames = [fuse_one(fuser, pair) for pair in frame_pairs(KINECT_V1, 30)]
    rows = SessionArrays.stack(KINECT_V1, KINECT_V1.nominal_lengths, frames)
    positions = rows.positions_a.copy()
    for t in range(len(rows)):
        positions[t, : t % (len(KINECT_V1) + 1)] = np.nan  # of 0 to all joints
    some = replace(rows, positions_a=positions)
    seen = [d[~np.isnan(d)] for d in some.view_difference]
    assert {len(d) for d in seen} >= {0, 1, 2, 3, 4}
    wanted = [np.median(d) if len(d) else np.nan for d in seen]
    np.testing.assert_array_equal(some.disagreement, wanted)
