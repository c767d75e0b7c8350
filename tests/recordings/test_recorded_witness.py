"""A session holds the depth witness of each joint, so that a replay needs no images."""

from pathlib import Path

import numpy as np

from devices.pairing import pair_recordings
from devices.simulated.kinect import PERSON, simulated_pair
from fusion.calibration.calibration import calibrate
from fusion.calibration.start_up_pose import find_start_up_pose
from fusion.fuser import Fuser
from fusion.setup import FusionSetup
from recordings import Session
from recordings.fusing.pairs import fuse_one


def test_a_session_gives_the_witness_back_bit_for_bit_without_the_images(tmp_path: Path) -> None:
    a, b, _ = simulated_pair(motion="arms", seconds=3.0, seed=1, depth="half")
    pairs = pair_recordings(list(a.frames()), list(b.frames()), PERSON, PERSON).pairs
    calibration = calibrate(a.body, *find_start_up_pose(a.body, [pair.skeletons for pair in pairs]))
    fuser = Fuser(FusionSetup(calibration))
    frames = [fuse_one(fuser, pair) for pair in pairs]
    session = Session.of([(fuser.setup, frames)], ("a", "b"))
    session.save(tmp_path / "s.rrd")
    again = list(Session.open(tmp_path / "s.rrd").pairs())
    seen = 0
    for before, after in zip(pairs, again, strict=True):
        for side in ("a", "b"):
            one, other = (getattr(pair.skeletons, side) for pair in (before, after))
            if one is None:
                continue
            np.testing.assert_array_equal(other.witness, one.witness)
            seen += int(np.isfinite(one.witness).any(axis=1).sum())
    assert seen > 60 * 20  # most joints of most frames
