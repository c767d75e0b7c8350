"""From the simulated world through sensors, pairing, calibration and fusion, back to the truth."""

from itertools import cycle

import numpy as np
import pytest

from devices.pairing import pair_recordings
from devices.simulated.kinect import PERSON, simulated_pair
from devices.simulated.rig import Rig
from devices.simulated.tracking.tracker import TrackerErrors
from fusion.body import BODIES
from fusion.calibration.calibration import calibrate
from fusion.calibration.start_up_pose import find_start_up_pose
from fusion.fuser import Fuser
from fusion.setup import FuserSettings, FusionSetup

TOLERANCE = 1e-5
"""0.01 mm. Positions leave the sensors as float32, exact to 2.4e-7 m at 4 m; R and the bone lengths are
fitted to those, and the longest chain of bones is 8."""


@pytest.mark.parametrize(("body", "motion"), [*zip(BODIES.values(), cycle(("badminton", "walk")))], ids=str)
def test_without_errors_fusion_is_the_truth(body, motion):
    rig = Rig(skew_seconds=0.0)
    a, b, truth = simulated_pair(motion=motion, body=body, seconds=8.0, errors=TrackerErrors(), rig=rig)
    pairs = [pair.skeletons for pair in pair_recordings([*a.frames()], [*b.frames()], PERSON, PERSON).pairs]
    chosen, how = find_start_up_pose(body, pairs)
    assert how.startswith("start-up pose")
    setup = FusionSetup(calibrate(body, chosen, how), FuserSettings(method="paper"))
    fused = [frame.positions for frame in Fuser(setup).fuse_sequence(pairs)]
    true = [truth.positions_at(pair.time_ns) for pair in pairs]
    assert np.linalg.norm(np.array(fused) - true, axis=2).max() < TOLERANCE
