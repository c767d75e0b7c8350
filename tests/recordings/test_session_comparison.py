"""``duplex compare`` on fusions with known differences."""

from dataclasses import replace

import numpy as np
import pytest

from fusion.body import KINECT_V1
from fusion.setup import FuserSettings
from recordings.comparing.session_comparison import Comparison
from recordings.errors import RecordingError
from recordings.file.session_writer import write_session
from recordings.session import Session
from tests.helpers.frame_pairs import frame_pairs
from tests.helpers.two_views import calibration_of


@pytest.fixture
def session(fused_run):
    return fused_run(frame_pairs(KINECT_V1, 40), calibration_of(KINECT_V1))


def with_fused(session, fused):
    return replace(session, rows=replace(session.rows, fused=fused))


def test_a_limb_exchanged_with_its_mirror_image_is_swapped(session):
    left, right = KINECT_V1.joint("WristLeft"), KINECT_V1.joint("WristRight")
    fused = session.rows.fused.copy()
    fused[7:10, [left, right]] = fused[7:10, [right, left]]
    comparison = Comparison.of(session, with_fused(session, fused))
    expected = np.zeros(comparison.swapped.shape, dtype=bool)
    expected[7:10, [left, right]] = True
    np.testing.assert_array_equal(comparison.swapped, expected)


def test_differences_and_bone_deviations_are_those_put_in(session):
    hand = KINECT_V1.joint("HandLeft")
    fused = session.rows.fused.copy()
    along = fused[12, hand] - fused[12, KINECT_V1.parents[hand]]
    fused[12, hand] += 0.03 * along / np.linalg.norm(along)
    comparison = Comparison.of(session, with_fused(session, fused))
    apart = np.zeros(comparison.apart.shape)
    apart[12, hand] = 0.03
    np.testing.assert_allclose(comparison.apart, apart, atol=1e-12)
    # both ends of a bone are kept in float32: within 2⁻²³ m each, on each axis, at 4 m
    rounding = 2 * np.sqrt(3) * 2.0**-23
    assert np.nanmax(comparison.bone_deviation[0]) < rounding
    expected = np.zeros(len(KINECT_V1))
    expected[hand] = 0.03
    of_bones = KINECT_V1.bone_joints
    np.testing.assert_allclose(comparison.bone_deviation[1][of_bones], expected[of_bones], atol=rounding)
    assert comparison.worst(5) == [(12, hand)]
    assert comparison.worst(0) == []


def test_only_fusions_of_the_same_skeletons_are_compared(fused_run, tmp_path):
    calibration = calibration_of(KINECT_V1)
    one = fused_run(frame_pairs(KINECT_V1, 40), calibration)
    chance = fused_run(frame_pairs(KINECT_V1, 40, noise=0.03), calibration)  # the same times
    with pytest.raises(RecordingError, match="40 frames of the same time, but S_A or S_B of frame 0"):
        Comparison.of(one, chance)
    for name in ("clock_b", "positions_a", "positions_b", "states_a", "states_b"):
        other = getattr(one.rows, name).copy()
        other[23] += 1
        for pair in ((one, changed := replace(one, rows=replace(one.rows, **{name: other}))), (changed, one)):
            with pytest.raises(RecordingError, match="frame 23 differs from frame 23: not the same capture"):
                Comparison.of(*pair)
    again = fused_run(frame_pairs(KINECT_V1, 40), calibration, FuserSettings("paper", h=0.9))
    write_session(again.part(range(10, 30)), tmp_path / "part.rrd")
    part = Comparison.of(one, Session.open(tmp_path / "part.rrd"))
    assert part.first.frame.tolist() == list(range(10, 30))
    assert part.second.frame.tolist() == list(range(20))
