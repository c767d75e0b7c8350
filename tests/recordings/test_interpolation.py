"""S* between the frames of a session."""

import itertools
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion.body import BODIES, KINECT_V2
from fusion.calibration.bone_lengths import bone_lengths_of
from recordings.data.interpolation import positions_at, sigma_at
from recordings.errors import RecordingError
from tests.helpers.frame_pairs import frame_pairs
from tests.helpers.fused_runs import record_with_a_gap
from tests.helpers.recalibrated import record_recalibrated
from tests.helpers.two_views import calibration_of


@pytest.fixture(params=BODIES.values(), ids=str)
def session(request, tmp_path):
    return record_with_a_gap(tmp_path / "s.rrd", request.param)


def test_bones_beside_a_new_calibration_are_those_of_the_frame_before(tmp_path):
    first = calibration_of(KINECT_V2)
    longer = replace(first, bone_lengths=1.1 * first.bone_lengths)
    pairs = frame_pairs(KINECT_V2, 30)
    session = record_recalibrated(tmp_path / "s.rrd", pairs, [(0, first), (12, longer), (20, first)])
    rows, bones = session.rows, KINECT_V2.bone_joints
    times = np.linspace(0, rows.time_ns[-1], 200, endpoint=False).astype(np.int64)
    before = np.searchsorted(rows.time_ns, times, side="right") - 1
    lengths = bone_lengths_of(KINECT_V2, session.at(1e-9 * times))
    np.testing.assert_allclose(lengths[:, bones], rows.bone_lengths[before][:, bones], atol=1e-6)


def test_s_star_between_two_frames_keeps_its_bones_and_turns_evenly(session):
    rows, body = session.rows, session.body
    before = int(np.flatnonzero(np.isfinite(rows.fused).all(axis=(1, 2)))[3])
    first_ns, last_ns = rows.time_ns[before : before + 2]
    times = np.linspace(first_ns, last_ns, 5).astype(np.int64)
    found = session.at(1e-9 * times)
    np.testing.assert_array_equal(found[[0, -1]], rows.fused[[before, before + 1]])
    lengths = bone_lengths_of(body, found)[:, body.bone_joints]
    np.testing.assert_allclose(
        lengths, rows.bone_lengths[[before]][:, body.bone_joints].repeat(5, 0), atol=1e-6
    )
    joint = body.bone_joints[0]
    bones = found[:, joint] - found[:, body.parents[joint]]
    turned = [np.linalg.norm(np.cross(u, v)) for u, v in itertools.pairwise(bones)]
    np.testing.assert_allclose(turned, turned[0], rtol=0.02)
    outside = np.array([rows.time_ns[0] - 1, rows.time_ns[-1] + 1]).astype("timedelta64[ns]")
    assert np.isnan(session.at(outside)).all()
    assert np.isnan(session.at([np.nan, -0.1, session.time[-1] + 60.0])).all()
    moments = [*times.astype("timedelta64[ns]"), np.timedelta64("NaT")]
    np.testing.assert_array_equal(session.at(moments), [*found, np.full_like(found[0], np.nan)])


def test_times_that_cannot_be_meant_are_refused(session):
    with pytest.raises(RecordingError, match=r"got an array of \(2, 2\)"):
        session.at([[0, 1], [2, 3]])
    for wrong in ("1", None, ["1", "2"], True):
        with pytest.raises(RecordingError, match="Times are seconds since the first frame; got an array of"):
            session.sigma_at(wrong)
    for far in (session.time_ns, np.inf, -1e300, 10**9, np.timedelta64(3, "D")):
        with pytest.raises(RecordingError, match=r"s is days away from a session of .* np\.timedelta64"):
            session.at(far)


def test_bones_that_turn_round_between_frames_are_somewhere(session):
    """Half-way between opposite directions there is no direction."""
    fused = session.rows.fused[[30, 30]]
    root = session.body.root
    fused[1] = 2.0 * fused[1, root] - fused[1]
    rows = replace(session.rows[np.array([0, 1])], time_ns=np.array([0, 20_000_000]), fused=fused)
    assert np.isfinite(positions_at(rows, np.array([0, 5_000_000, 10_000_000, 15_000_000, 20_000_000]))).all()


def test_the_uncertainty_between_frames_covers_what_interpolation_misses(session):
    rows = session.rows
    every, few = np.arange(0, 24), np.arange(0, 24, 6)
    angle = 0.1 * every  # radians: one metre about a centre
    circle = np.stack([np.cos(angle), 0.0 * angle, np.sin(angle)], axis=-1)[:, None]
    chosen = rows[every]
    chosen = replace(
        chosen,
        time_ns=every * 33_333_333,
        fused=rows.fused[[30]] - rows.fused[30, rows.body.root] + circle,
        sigma=np.full_like(chosen.filled("sigma"), 0.001),
    )
    root, times = rows.body.root, chosen.time_ns[9:15]
    missed = np.linalg.norm(positions_at(chosen[few], times) - chosen.fused[9:15], axis=2)[:, root]
    np.testing.assert_allclose(sigma_at(chosen[few], times)[:, root], np.hypot(0.001, missed), rtol=0.1)
    np.testing.assert_allclose(sigma_at(chosen, chosen.time_ns), 0.001, rtol=1e-6)
    assert np.isnan(session.sigma_at([-1])).all()


@given(*[st.floats(0.001, 0.5)] * 2, st.floats(0.0, 1.0))
def test_between_two_frames_of_somebody_still_the_variance_goes_from_one_to_the_other(first, second, share):
    rows = still_rows()
    sigma = np.stack([np.full(rows.sigma.shape[1], each) for each in (first, second)])
    found = sigma_at(replace(rows, sigma=sigma), np.array([round(share * 20_000_000)]))
    np.testing.assert_allclose(found, np.sqrt((1.0 - share) * first**2 + share * second**2), rtol=1e-4)


@cache
def still_rows():
    with TemporaryDirectory() as folder:
        rows = record_with_a_gap(Path(folder) / "s.rrd", KINECT_V2).rows[np.array([30, 30])]
    return replace(rows, time_ns=np.array([0, 20_000_000]))
