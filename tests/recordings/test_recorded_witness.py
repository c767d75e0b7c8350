"""A session holds the depth witness of each joint, so that a replay needs no images."""

from dataclasses import replace

import numpy as np

from devices.simulated.kinect import simulated_pair
from fusion.calibration.calibration import Calibration, calibrate
from fusion.calibration.start_up_pose import find_start_up_pose
from fusion.fuser import Fuser
from fusion.rigid import RigidTransform
from fusion.setup import FusionSetup
from recordings import Session
from recordings.data.session_arrays import SessionArrays
from recordings.fusing.pairs import fuse_one
from tests.helpers.demonstrations import pairs_of
from tests.helpers.frame_pairs import paired


def test_a_session_gives_the_witness_back_bit_for_bit_without_the_images(tmp_path):
    a, b, _ = simulated_pair(motion="arms", seconds=3.0, seed=1, depth="half")
    pairs = paired(a.frames(), b.frames()).pairs
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


def test_a_session_that_begins_with_one_sensor_keeps_the_witness_of_the_other():
    a, b, _ = simulated_pair(motion="still", seconds=0.5, depth="half")
    pairs = list(pairs_of(a, b))
    lengths = a.body.nominal_lengths
    fuser = Fuser(
        FusionSetup(Calibration(a.body, RigidTransform.of(np.eye(3), np.ones(3)), lengths, "known"))
    )
    alone = replace(pairs[0], b=None, skeletons=replace(pairs[0].skeletons, b=None))
    first, later = ([fuse_one(fuser, pair)] for pair in (alone, pairs[1]))
    begun = SessionArrays.stack(a.body, lengths, first)
    assert begun.witness_b is not None
    assert np.isnan(begun.witness_b).all()
    gone_on = SessionArrays.stack(a.body, lengths, later, like=begun)
    assert gone_on.witness_b is not None
    assert np.isfinite(gone_on.witness_b).any()
