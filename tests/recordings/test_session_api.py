"""The attributes of a session that a notebook uses."""

import doctest
import subprocess
import sys
from importlib.resources import files

import numpy as np
import pytest

import recordings.session
from devices.depth.rvl import encode_depth
from fusion.body import KINECT_V1
from recordings import Session
from tests.helpers.frame_pairs import frame_pairs
from tests.helpers.fused_runs import record_fused
from tests.helpers.two_views import calibration_of

T, J = 12, len(KINECT_V1)


@pytest.fixture
def session(fused_run):
    return fused_run(
        frame_pairs(KINECT_V1, T, no_b=(4,), depth=True), calibration_of(KINECT_V1), depth_every=1
    )


def test_everything_over_time_has_a_name(session):
    rows = session.rows
    for values, shape, expected in (
        (session.time_ns, (T,), rows.time_ns),
        (session.skeleton_a.positions, (T, J, 3), rows.positions_a),
        (session.skeleton_b.positions, (T, J, 3), rows.positions_b),
        (session.skeleton_a.states, (T, J), rows.states_a),
        (session.skeleton_b.states, (T, J), rows.states_b),
        (session.skeleton_a.weights, (T, J), rows.weights_a),
        (session.skeleton_b.weights, (T, J), rows.weights_b),
        (session.skeleton_b.captured_ns, (T,), rows.clock_b),
        (session.skeleton_b.stale, (T,), rows.stale_b),
        (session.fused, (T, J, 3), rows.fused),
        (session.bone_lengths, (T, J), rows.bone_lengths),
        (session.rotation, (T, 3, 3), rows.rotation),
        (session.translation, (T, 3), rows.translation),
        (session.quality.bone_error, (T,), rows.bone_error),
        (session.quality.disagreement, (T,), rows.disagreement),
        (session.quality.skew_ns, (T,), rows.skew_ns),
        (session.quality.fuse_ms, (T,), rows.fuse_ms),
        (session.quality.iterations, (T,), rows.iterations),
        (session.quality.predicted, (T, J), rows.predicted),
    ):
        assert values.shape == shape
        np.testing.assert_array_equal(values, expected)


def test_a_session_counts_the_frames_of_each_sensor(session):
    pairing = session.pairing
    assert (len(pairing.pairs), pairing.frames_a, pairing.frames_b) == (T, T, T - 1)


def test_a_session_introduces_itself_in_a_line(session):
    assert repr(session) == f"<Session {session.path.name}: {T} frames, 0.4 s, kinect_v1>"


def test_the_example_runs(tmp_path, monkeypatch):
    pairs = frame_pairs(KINECT_V1, 120, depth=True)
    record_fused(tmp_path / "walk.rrd", pairs, calibration_of(KINECT_V1), depth_every=60)
    monkeypatch.chdir(tmp_path)
    attempted = doctest.testmod(recordings.session)
    assert attempted.attempted > 3
    assert attempted.failed == 0


def test_a_part_of_the_package_does_not_wait_for_sessions():
    program = "import sys, recordings; print('pyarrow' in sys.modules); recordings.Session"
    said = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert said.stdout == "False\n"
    with pytest.raises(AttributeError, match="Sessions"):
        recordings.Sessions  # noqa: B018


@pytest.mark.parametrize("package", ["fusion", "devices", "recordings", "viewer_app"])
def test_type_checkers_are_told_that_there_are_types(package):
    assert (files(package) / "py.typed").is_file()


def with_a_damaged_image(session, frame, damaged):
    data = bytearray(session.path.read_bytes())
    offset = data.find(encode_depth(dict(session.depth("a"))[frame])[200:260])
    assert offset > 0, "the image is not in the file as it is"
    data[offset + 20] ^= 1
    damaged.write_bytes(data)
    return Session.open(damaged)


def test_a_damaged_image_is_left_out_and_counted(session, tmp_path):
    damaged = with_a_damaged_image(session, 5, tmp_path / "damaged.rrd")
    assert damaged.damage is None  # every frame is there
    images = damaged.depth("a")
    assert [frame for frame, _ in images] == [0, 1, 2, 3, 4, 6, 7, 8, 9, 10, 11]
    assert images.damaged == 1
    assert images.count() == 11
    pairs = list(damaged.pairs(depth=True))
    assert pairs[5].a.depth is None
    assert damaged.depth("a", 6, 9).count() == 3


def test_images_are_read_no_further_than_asked(session, tmp_path):
    damaged = with_a_damaged_image(session, 10, tmp_path / "damaged.rrd")
    images = damaged.depth("a", 0, 8)
    assert images.count() == 8
    assert images.damaged == 0
