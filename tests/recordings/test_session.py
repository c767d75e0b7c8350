"""Sessions are read as they were written, and damage is reported."""

import doctest
from collections import Counter
from dataclasses import replace
from importlib.resources import files
from unittest import mock
from uuid import uuid4

import numpy as np
import pyarrow as pa
import pytest
import rerun as rr

import recordings.session
from devices.depth.rvl import encode_depth
from devices.events import Event
from devices.pairing import pair_views
from devices.people.recorded_people import RecordedPeople
from devices.simulated.kinect import PERSON, simulated_pair
from fusion.body import BODIES, KINECT_V1, KINECT_V2
from fusion.fuser import Fuser
from fusion.setup import FuserSettings, FusionSetup
from recordings import Session, fuse
from recordings.data import layout
from recordings.data.session_arrays import SessionFrame
from recordings.errors import RecordingError
from recordings.file.session_writer import write_session
from recordings.fusing.pairs import fuse_segments
from recordings.writing.checksums import event_checksum, fused_checksums
from recordings.writing.recorder import Recorder
from tests.helpers.damage import damaged, opened
from tests.helpers.frame_pairs import frame_pairs
from tests.helpers.fused_runs import record_fused
from tests.helpers.programs import python
from tests.helpers.recorded_pairs import write_recordings
from tests.helpers.two_views import calibration_of

FRAMES = 70


@pytest.fixture(params=BODIES.values(), ids=str)
def body(request):
    return request.param


def full_of_faults(body):
    return frame_pairs(body, FRAMES, gap=(7, 40, 41), only_a=(9, 10), no_b=(15,), jitter_ns=3_000_000)


def test_a_session_gives_back_what_the_sensors_said(body, fused_run):
    pairs = full_of_faults(body)
    session = fused_run(pairs, calibration_of(body))
    assert (len(session), session.damage, session.frames_lost) == (FRAMES, None, 0)
    for pair, again in zip(pairs, session.pairs(), strict=True):
        assert (again.b is None) == (pair.b is None)
        assert again.time_ns == pair.time_ns - pairs[0].time_ns
        assert again.skew_ns == pair.skew_ns
        for one, two in ((pair.skeletons.a, again.skeletons.a), (pair.skeletons.b, again.skeletons.b)):
            assert (one is None) == (two is None)
            if one is not None and two is not None:
                np.testing.assert_array_equal(one.positions, two.positions)
                np.testing.assert_array_equal(one.states, two.states)
                assert one.time_ns == two.time_ns


def test_blocks_and_single_frames_mix_in_any_order():
    setup = FusionSetup(calibration_of(KINECT_V1), FuserSettings("paper"))
    sensors = simulated_pair(motion="still", body=KINECT_V1, seconds=1.0)[:2]
    a, b = (RecordedPeople.of(KINECT_V1, sensor.frames()).view([PERSON]) for sensor in sensors)
    pairs = pair_views(KINECT_V1, a, b).pairs
    parts = [(setup, slice(first, first + 10)) for first in (0, 10, 20)]
    first, second, third = fuse_segments(parts, pairs, None)
    for frames in ([*first, second, *third], [first, *second, third], [*first, second, third]):
        session = Session.of([(setup, frames)])
        assert len(session) == 30
        assert (np.diff(session.time_ns) > 0).all()


@pytest.mark.parametrize(("every_a", "every_b"), [(1, 1), (2, 1), (1, 2)])
def test_the_frame_rate_is_that_of_the_faster_sensor_without_its_pauses(every_a, every_b, fused_run):
    no_a, no_b = ([k for k in range(60) if k % every] for every in (every_a, every_b))
    pairs = frame_pairs(KINECT_V2, 60, no_a=no_a, no_b=no_b, jitter_ns=2_000_000)
    calibration = calibration_of(KINECT_V2)
    assert fused_run(pairs[:25] + pairs[40:], calibration).frame_rate == 30.0


PAPERS = [FuserSettings("published"), FuserSettings("paper", h=0.9), FuserSettings("paper", weights="equal")]


@pytest.mark.parametrize("settings", [FuserSettings(), FuserSettings(smoothing=0.2), *PAPERS], ids=str)
def test_fusing_a_session_again_gives_the_same_bits(settings, fused_run):
    session = fused_run(full_of_faults(KINECT_V2), calibration_of(KINECT_V2), settings)
    assert session.settings == settings
    ((setup, _),) = session.setups()
    fuser = Fuser(setup)
    again = [fuser.update(pair.skeletons) for pair in session.pairs()]
    fused = np.array([frame.positions for frame in again])
    np.testing.assert_array_equal(fused_checksums(fused), session.fused_checksums)
    np.testing.assert_array_equal([frame.stale_a for frame in again], session.rows.stale_a)
    np.testing.assert_array_equal([frame.a_from_b.translation for frame in again], session.rows.translation)


def test_the_checksum_of_s_notices_the_last_bit():
    fused = np.random.default_rng(0).normal(size=(3, 20, 3))
    nudged = fused.copy()
    nudged[1, 4, 2] = np.nextafter(nudged[1, 4, 2], 9.0)
    assert (fused_checksums(fused) == fused_checksums(nudged)).tolist() == [True, False, True]


def test_depth_comes_back_exactly_and_only_when_asked_for(fused_run):
    pairs = frame_pairs(KINECT_V1, 12, no_b=(4,), depth=True)
    session = fused_run(pairs, calibration_of(KINECT_V1), depth_every=2)
    images = dict(session.depth("b"))
    assert sorted(images) == [0, 2, 6, 8, 10]
    for frame, image in images.items():
        expected = pairs[frame].b
        np.testing.assert_array_equal(image, expected.depth)
    with_depth = list(session.pairs(depth=True))
    np.testing.assert_array_equal(with_depth[2].a.depth, dict(session.depth("a"))[2])
    assert with_depth[3].a.depth is None


def test_a_flipped_number_is_noticed_and_counted(tmp_path):
    whole = record_fused(tmp_path / "s.rrd", full_of_faults(KINECT_V1), calibration_of(KINECT_V1), block=10)
    data = bytearray(whole.path.read_bytes())
    needle = whole.rows.positions_a[33, 5].tobytes()  # stands as it is: it does not compress
    assert data.count(needle) == 1
    data[data.index(needle) + 2] ^= 1
    (tmp_path / "flipped.rrd").write_bytes(bytes(data))
    flipped = Session.open(tmp_path / "flipped.rrd")
    assert len(flipped) == 33
    assert flipped.frames_lost == FRAMES - 33
    assert flipped.damage is not None
    assert "frame 33" in flipped.damage


def test_files_that_are_no_sessions_are_named_in_one_line(tmp_path):
    (tmp_path / "text.rrd").write_text("hello, world\n", encoding="utf-8")
    (tmp_path / "empty.rrd").touch()
    stream = rr.RecordingStream("something_else")
    stream.save(tmp_path / "other.rrd")
    stream.log("x", rr.TextLog("y"))
    stream.disconnect()
    for name, words in (
        ("missing.rrd", "No session"),
        ("text.rrd", "does not begin like an .rrd"),
        ("empty.rrd", "not a session"),
        ("other.rrd", "not a session of duplex-kinects"),
        (".", "is a folder"),
    ):
        with pytest.raises(RecordingError, match=words) as error:
            Session.open(tmp_path / name)
        assert "\n" not in str(error.value)


def test_another_layout_says_which_version_wrote_it(monkeypatch, fused_run):
    readable = ", ".join(map(str, layout.READABLE_VERSIONS))
    older = min(layout.READABLE_VERSIONS) - 1
    monkeypatch.setattr(layout, "VERSION", older)
    monkeypatch.setattr(layout, "READABLE_VERSIONS", (older,))
    old = fused_run(frame_pairs(KINECT_V1, 3), calibration_of(KINECT_V1))
    monkeypatch.undo()
    with pytest.raises(
        RecordingError, match=rf"layout {older}, written by duplex-kinects .*reads layout {readable}"
    ):
        Session.open(old.path)


def test_each_frame_is_judged_by_the_bone_lengths_it_was_fused_with(tmp_path):
    pairs, first = frame_pairs(KINECT_V1, 12), calibration_of(KINECT_V1)
    second = replace(first, bone_lengths=first.bone_lengths * 1.1)
    stream = rr.RecordingStream(layout.APPLICATION_ID, recording_id=uuid4())
    stream.save(tmp_path / "s.rrd")
    fusers = [Fuser(FusionSetup(first)), Fuser(FusionSetup(second))]
    recorder = Recorder(stream, fusers[0].setup, ("a", "b"))
    for fuser, own in zip(fusers, (pairs[:5], pairs[5:]), strict=True):
        if fuser is not fusers[0]:
            recorder.recalibrated(fuser.setup)
        recorder.record_all([SessionFrame(pair, fuser.update(pair.skeletons), 0) for pair in own])
    recorder.finish()
    stream.disconnect()
    session = Session.open(tmp_path / "s.rrd")
    np.testing.assert_array_equal(session.rows.bone_lengths[4], first.bone_lengths)
    np.testing.assert_array_equal(session.rows.bone_lengths[5], second.bone_lengths)
    # S* is kept in float32: at 4 m its ends are within half of 2⁻²² m on each axis
    assert session.rows.bone_error.max() < 2 * np.sqrt(3) * 2.0**-23
    trimmed = tmp_path / "t.rrd"
    write_session(session.part(range(3, 8)), trimmed)
    np.testing.assert_array_equal(Session.open(trimmed).rows.bone_lengths, session.rows.bone_lengths[3:8])


def test_a_session_opens_without_pandas(fused_run):
    path = fused_run(frame_pairs(KINECT_V1, 3), calibration_of(KINECT_V1)).path
    program = (
        "import sys; sys.modules['pandas'] = None; "
        "from recordings.session import Session; print(len(Session.open(sys.argv[1])))"
    )
    said = python("-c", program, path)
    assert said.stdout == "3\n", said.stderr


def test_an_event_moved_to_another_time_is_damage(tmp_path):
    path, moved = tmp_path / "s.rrd", tmp_path / "moved.rrd"
    fuser = Fuser(FusionSetup(calibration_of(KINECT_V1)))
    for file, at in ((path, (2, 5)), (moved, (1, 7))):
        with rr.RecordingStream("duplex_kinects") as stream:
            stream.set_sinks(rr.FileSink(str(file)))
            recorder = Recorder(stream, fuser.setup, ("a", "b"))
            pairs = frame_pairs(KINECT_V1, 3)
            recorder.record_all([SessionFrame(pair, fuser.update(pair.skeletons), 0) for pair in pairs])
            check = event_checksum(Event("lost").placed(2, 5))
            with mock.patch("recordings.writing.recorder.event_checksum", return_value=check):
                recorder.event(Event("lost").placed(*at), placed=True)
            recorder.finish()
    assert [event.text for event in Session.open(path).events] == ["lost"]
    session = Session.open(moved)
    assert (session.events, session.damage) == ((), "an event does not match its checksum")


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
    counts = session.frame_counts
    assert (len(session.recorded_pairs), counts["frames_a"], counts["frames_b"]) == (T, T, T - 1)


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
    said = python("-c", program)
    assert said.stdout == "False\n"
    with pytest.raises(AttributeError, match="Sessions"):
        recordings.Sessions  # noqa: B018


@pytest.mark.parametrize(
    ("statement", "without"),
    [
        ("from recordings import Session", {"scipy.spatial", "scipy.interpolate", "pandas", "rerun", "cv2"}),
        ("from recordings import fuse", {"scipy.spatial", "scipy.interpolate", "pandas", "rerun", "cv2"}),
    ],
)
def test_reading_sessions_and_files_loads_no_vendor_and_no_large_package(statement, without):
    program = f"{statement}; import sys; print(*sys.modules)"
    loaded = python("-c", program).stdout.split()
    assert not without & set(loaded)
    vendors = {"orbbec", "realsense", "freenect", "freenect2", "simulated", "network", "live_sensors"}
    own = [name for name in loaded if name.startswith("devices.")]
    assert not [name for name in own if name.split(".")[1] in vendors]
    if statement.endswith("Session"):
        assert len(own) <= 12


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


@pytest.mark.parametrize("frame", [8, 10])
def test_images_are_read_no_further_than_asked(session, tmp_path, frame):
    damaged = with_a_damaged_image(session, frame, tmp_path / "damaged.rrd")
    images = damaged.depth("a", 0, 8)
    assert images.count() == 8
    assert images.damaged == 0


# --- A damaged session gives one line of error, or exactly the first frames; cut off, its events, too.


def test_random_damage_gives_the_beginning_or_one_line(tmp_path):
    pairs = frame_pairs(KINECT_V1, 24, gap=(7,), only_a=(9, 10), no_b=(15,), depth=True)
    whole = record_fused(tmp_path / "whole.rrd", pairs, calibration_of(KINECT_V1), depth_every=1, block=8)
    data, path = whole.path.read_bytes(), tmp_path / "damaged.rrd"
    outcomes = Counter()
    for seed in range(24):
        path.write_bytes(damaged(data, seed))
        session = opened(path, whole)
        known = "refused" if session is None else "whole" if len(session) == len(whole) else "beginning"
        outcomes[known] += 1
    assert outcomes["beginning"] > 0
    assert outcomes["refused"] < 12


_BLOCK = 10


@pytest.fixture(scope="module")
def told(tmp_path_factory):
    """A session with an event at every second frame."""
    session = fuse(*write_recordings(tmp_path_factory.mktemp("told")))
    events = [Event(f"event {k}").placed(k, int(session.time_ns[k])) for k in range(0, len(session), 2)]
    return replace(session, events=tuple(events))


def test_a_folder_in_which_no_file_can_be_created_is_an_error_of_the_system(told, tmp_path):
    """Rerun raises a RuntimeError, which nobody would expect."""
    with pytest.raises(OSError, match="No such file"):
        write_session(told, tmp_path / "missing" / "s.rrd")


def test_events_are_kept_up_to_the_cut(told, tmp_path):
    whole, cut = tmp_path / "s.rrd", tmp_path / "cut.rrd"
    write_session(told, whole, block=_BLOCK)
    data = whole.read_bytes()
    assert len(Session.open(whole).events) == len(told.events)
    lengths = set()
    for share in range(30, 100, 5):
        cut.write_bytes(data[: len(data) * share // 100])
        try:
            found = Session.open(cut)
        except RecordingError:
            continue  # not one whole frame
        lengths.add(len(found))
        kept = {event.frame for event in found.events}
        # what was written in one go, frames and events, may be torn apart: at most two blocks
        assert kept >= set(range(0, len(found) - 2 * _BLOCK, 2)), share
    assert len(lengths) >= 3, "the cuts fall between frames"


@pytest.mark.parametrize("moment", [{"sequence": 1}, {"duration": 1.0}, {"timestamp": 1.7e9}])
def test_a_recording_of_another_program_is_refused_whatever_its_frames_are(moment, tmp_path):
    stream = rr.RecordingStream("another")
    stream.save(tmp_path / "s.rrd")
    stream.set_time(layout.FRAME, **moment)
    stream.log(
        layout.FUSED_SKELETON, rr.Points3D([[0.0, 0.0, 0.0]]), rr.AnyValues(day=pa.array([1], pa.date32()))
    )
    stream.disconnect()
    with pytest.raises(RecordingError, match="not a session of duplex-kinects"):
        Session.open(tmp_path / "s.rrd")
