"""The doubt about a view's sides when its labels are known beforehand."""

from dataclasses import replace

import numpy as np
import pytest

from fusion.body import KINECT_V2
from fusion.calibration.calibration import Calibration
from fusion.facing.labels import Labels
from fusion.facing.model import LEGS, WHOLE
from fusion.fuser import Fuser
from fusion.setup import FuserSettings, FusionSetup
from fusion.skeleton import Skeleton, SkeletonPair
from tests.helpers.two_views import A_FROM_B, FRAME_NS, moving

SETUP = FusionSetup(
    Calibration(KINECT_V2, A_FROM_B, KINECT_V2.nominal_lengths, "known"), FuserSettings(hindsight="labels")
)


def walk(count):
    pairs = []
    for k, truth in enumerate(np.tile(moving(KINECT_V2, 1), (count, 1, 1))):
        a, b = (
            Skeleton.of(KINECT_V2, at, None, k * FRAME_NS) for at in (truth, A_FROM_B.inverse().apply(truth))
        )
        pairs.append(SkeletonPair(a, b, k * FRAME_NS))
    return pairs


def test_labels_are_stored_to_the_nearest_step():
    labels = Labels.with_sides([[WHOLE, 0], [5, 7]], [[0.0, 1.0], [0.2, 0.5019]])
    labels.heading[:] = (0.2, 0.0, -0.9)
    stored = labels.as_stored()
    np.testing.assert_array_equal(stored.codes, labels.codes)
    np.testing.assert_array_equal(stored.doubt * np.float32(255.0), [[0, 255], [51, 128]])
    np.testing.assert_array_equal(stored.heading, np.array([(205, 0, -922)] * 2, np.float32) / 1024)


def test_recorded_sides_without_doubt_give_a_live_run_again():
    """A replay of a live session knows the sides only; the filter finds the doubt again, to the bit."""
    pairs = walk(40)
    fuser, again = Fuser(SETUP), Fuser(SETUP)
    live = [fuser.update(pair) for pair in pairs]
    labels = Labels.with_sides([(frame.exchanged_a, frame.exchanged_b) for frame in live], np.nan)
    for k, (frame, pair) in enumerate(zip(live, pairs, strict=True)):
        replayed = again.update(pair, labels.rows(slice(k, k + 1)))
        assert (replayed.doubt_a, replayed.doubt_b) == (frame.doubt_a, frame.doubt_b)
        assert replayed.positions.tobytes() == frame.positions.tobytes()
    legs = again.update(replace(pairs[0], time_ns=40 * FRAME_NS), Labels.with_sides([(LEGS, 0)], np.nan))
    assert legs.exchanged_a == LEGS, "version 1.0 exchanged limbs alone"


def test_the_fused_frame_tells_code_and_doubt():
    fuser = Fuser(SETUP)
    labels = Labels.with_sides([(WHOLE, 0)], (0.0, 0.4))
    labels.heading[:] = (0.5, 0.0, 0.5)
    frame = fuser.update(walk(1)[0], labels)
    np.testing.assert_array_equal(frame.heading, labels.heading[0])
    assert (frame.exchanged_a, frame.exchanged_b) == (WHOLE, 0)
    assert (frame.doubt_a, frame.doubt_b) == (0.0, pytest.approx(0.4))


def test_a_view_with_doubtful_sides_pulls_the_limbs_less():
    """B's labels become wrong after a second: with certain labels its joints count, with doubt hardly.

    Both views repeat their first skeleton before, so that S* does not know better.
    """
    pairs = walk(40)
    wrong = list(pairs)
    for k, pair in enumerate(pairs[30:], 30):
        exchanged = Skeleton.of(KINECT_V2, pair.b.positions[KINECT_V2.mirror], None, pair.time_ns)
        wrong[k] = replace(pair, b=exchanged)
    off = []
    for doubt in (0.0, 1.0):
        fuser = Fuser(SETUP)
        labels = Labels.with_sides(np.zeros((40, 2)), [(0.0, doubt if k >= 30 else 0.0) for k in range(40)])
        frames = fuser.fuse_sequence(wrong, labels)
        right = Fuser(SETUP).fuse_sequence(pairs, Labels.with_sides(np.zeros((40, 2))))
        limbs = KINECT_V2.mirror != np.arange(len(KINECT_V2))
        apart = np.array([f.positions - r.positions for f, r in zip(frames, right, strict=True)])
        off.append(np.linalg.norm(apart[:, limbs], axis=2).mean())
    assert off[1] < 0.7 * off[0]
