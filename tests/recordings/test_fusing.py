"""Long recordings: bounded memory, the same result in parts, and temporary files without a name."""

import errno
import gc
import os
import tempfile
import tracemalloc
from concurrent.futures import Future, wait
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from devices.capture.stream_pairing import LivePairing
from devices.depth.image_thinning import pair_without_images
from devices.events import Event, spells_of
from devices.frame_pairs import PERSON
from devices.pairing import pair_views
from devices.recorded.two_recordings import RecordingChoice, read_two
from devices.sensor import DeviceError
from devices.simulated.kinect import simulated_pair
from devices.skeletons.csv_files import reader
from devices.skeletons.csv_files.reader import read_csv
from fusion import plan
from fusion.body import AZURE_KINECT, KINECT_V1, KINECT_V2
from fusion.calibration.calibration import Calibration, nominal_calibration
from fusion.calibration.online import CalibrationLearner
from fusion.errors import FusionError
from fusion.fused_frame import FusedFrame
from fusion.fuser import Fuser
from fusion.intrinsics import Intrinsics
from fusion.pair_arrays import View
from fusion.plan import plan_recording
from fusion.rigid import RigidTransform
from fusion.setup import FuserSettings, FusionSetup
from fusion.skeleton import Skeleton, SkeletonPair, TrackingState
from fusion.support import large_arrays
from fusion.support.large_arrays import GrowingArray
from recordings import Session, fuse
from recordings.data import layout
from recordings.data.images import Images, SessionImages
from recordings.data.session_arrays import SessionArrays
from recordings.data.session_parts import PartOfImages
from recordings.file import session_reader
from recordings.file.session_writer import write_session
from recordings.fusing.live_surface import LiveSurface
from recordings.fusing.pairs import fuse_one, fuse_segments
from recordings.fusing.view_events import ViewEvents, watch
from recordings.live_fusion import LiveFusion
from recordings.quality.figures import report
from recordings.replaying import Agreement, Replay
from tests.helpers.command_line import duplex
from tests.helpers.demonstrations import pairs_of
from tests.helpers.frame_pairs import KnownSensors, frame_pairs
from tests.helpers.laws import BODY, HIDDEN, exchanged, hidden, walking
from tests.helpers.recalibrated import recorder_to
from tests.helpers.recorded_pairs import write_view
from tests.helpers.sentences import arguments, check_sentences
from tests.helpers.skeleton_files import read_found
from tests.helpers.two_clocks import SECOND_NS, run, shots
from tests.helpers.two_views import A_FROM_B, FRAME_NS, calibration_of, moving, standing
from viewer_app.report.events import event_in_words, list_events
from viewer_app.report.words import lead_lines


def write_walk(folder, frames):
    """Two noisy views of a person who moves."""
    folder.mkdir()
    truth, rng = moving(KINECT_V2, frames), np.random.default_rng(frames)
    a, b = (view + rng.normal(0.0, 0.005, truth.shape) for view in (truth, A_FROM_B.inverse().apply(truth)))
    return write_view(folder / "a.csv", KINECT_V2, a), write_view(folder / "b.csv", KINECT_V2, b)


def test_a_fused_recording_keeps_a_few_hundred_bytes_of_each_pair_in_memory(tmp_path, monkeypatch):
    """Positions of both views and of S* alone are 1,200 bytes; as one object each, pairs were 10 kB."""
    monkeypatch.setattr(large_arrays, "_LARGE", 2_000)  # bytes: one number per frame of 300 is larger
    held = {}
    fuse(*write_walk(tmp_path / "first", 100))  # what is held for the process
    for frames in (300, 600):
        files = write_walk(tmp_path / str(frames), frames)
        gc.collect()
        tracemalloc.start()
        session = fuse(*files)
        gc.collect()
        held[frames], _ = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert len(session) == frames
    assert (held[600] - held[300]) / 300 < 300.0


def test_a_saved_session_is_opened_in_parts(tmp_path, monkeypatch):
    """Its arrays are 2,000 bytes of each frame. The summary of a session that has ended opens it."""
    monkeypatch.setattr(large_arrays, "_LARGE", 4_000)  # bytes
    monkeypatch.setattr(session_reader, "parts", lambda count: large_arrays.parts(count, 100))
    short, most = fuse(*write_walk(tmp_path / "walk", 100)), {}
    for times in (6, 18):
        rows = SessionArrays.joined([short.rows] * times)
        number = np.arange(len(rows))
        replace(short, rows=replace(rows, frame=number, time_ns=number * 33_333_333)).save(tmp_path / "s.rrd")
        del rows
        gc.collect()
        tracemalloc.start()
        session = Session.open(tmp_path / "s.rrd")
        _, most[times] = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert session.damage is None
        np.testing.assert_array_equal(session.rows.fused[-100:], session.rows.fused[:100])
    assert (most[18] - most[6]) / 1200 < 600.0


def nobody_at_first(rows):
    half = len(rows) // 2
    feet = [row.split(",") for row in rows]
    scaled = [[*row[:3], *(f"{float(x) / 0.3048:.5f}" for x in row[3:6]), *row[6:]] for row in feet]
    return [",".join([*row[:3], "", "", "", *row[6:]]) for row in scaled[:half]] + [
        ",".join(row) for row in scaled[half:]
    ]


def nobody_as_minus_one_at_last(rows):
    end = 30 * len(KINECT_V2)
    return rows[:end] + [
        ",".join([*row.split(",")[:3], "-1", "-1", "-1", "not_tracked"]) for row in rows[end:]
    ]


def slow_at_last(rows):
    end = 37 * len(KINECT_V2)
    late = [row.split(",", 1) for row in rows[end:]]
    return rows[:end] + [
        f"{int(time) + 10_000_000 * (k // len(KINECT_V2) + 1)},{rest}" for k, (time, rest) in enumerate(late)
    ]


@pytest.mark.parametrize("change", [nobody_at_first, nobody_as_minus_one_at_last, slow_at_last, list])
@pytest.mark.parametrize("line_end", ["\n", "\r"])
def test_a_part_that_looks_wrong_by_itself_is_judged_by_the_whole(change, line_end, tmp_path):
    path, _ = write_walk(tmp_path / "walk", 40)
    header, *rows = path.read_text().splitlines()
    path.write_text(line_end.join([header, *change(rows)]) + line_end, newline="")
    whole, in_blocks = (read_found(path, read_csv(path, block=size)) for size in (-1, 5000))  # three frames
    assert in_blocks.warnings == whole.warnings
    for values, expected in zip(in_blocks.people.skeletons[:3], whole.people.skeletons[:3], strict=True):
        np.testing.assert_array_equal(values, expected)


def test_a_person_without_any_joint_is_said_in_one_line(tmp_path):
    a, b = write_walk(tmp_path / "walk", 120)
    header, *rows = a.read_text().splitlines()
    times = dict.fromkeys(row.split(",")[0] for row in rows)
    empty = [f"{time},9,{joint},,,,not_tracked" for time in times for joint in KINECT_V2.joints]
    stated = [f"{row},tracked" if row.count(",") == 5 else row for row in rows]
    a.write_text("\n".join([header if "state" in header else f"{header},state", *stated, *empty]) + "\n")
    with pytest.raises(DeviceError, match=r"a\.csv has no person '9'\. It has '0'"):
        fuse(a, b, person_a="9")


def test_a_plan_in_parts_is_that_of_the_whole(tmp_path, monkeypatch):
    files = write_walk(tmp_path / "walk", 600)
    pairs = read_two(*map(RecordingChoice, files)).pairing.pairs.skeletons
    settings = FuserSettings(hindsight="labels")
    whole = plan_recording(KINECT_V2, pairs, settings)
    monkeypatch.setattr(plan, "_LONG", 250)
    monkeypatch.setattr(plan, "_AROUND", 60)
    in_parts = plan_recording(KINECT_V2, pairs, settings)
    (first, _), (other, span) = whole.segments[0], in_parts.segments[0]
    assert span == slice(0, 600)
    # 200 pairs instead of 600: both are the truth within their deviation
    assert np.degrees(first.a_from_b.angle_to(other.a_from_b)) < 0.5
    np.testing.assert_array_equal(in_parts.labels.codes, whole.labels.codes)


def test_a_large_array_has_no_name_and_is_what_was_appended(tmp_path, monkeypatch):
    monkeypatch.setattr(large_arrays, "_LARGE", 100)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    rows = np.arange(120, dtype=np.float32).reshape(20, 2, 3)
    arrays = [GrowingArray() for _ in range(3)]
    for row in rows:
        arrays[0].append(np.broadcast_to(row, (1, 2, 3)))
        arrays[1].append(np.broadcast_to(row.astype(np.float64) + 0.5, (1, 2, 3)))
    arrays[2].append(rows[:2, 0])
    wholes = GrowingArray.wholes(arrays)
    for values, expected in zip(wholes, (rows, rows + 0.5, rows[:2, 0]), strict=True):
        np.testing.assert_array_equal(values, expected)
        assert not values.flags.writeable
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("side", [0, 1])
def test_a_clock_that_is_set_in_one_file_costs_no_partner(tmp_path, shared, side):
    """Whoever is who is asked only then: else the person is somebody else before it was set."""
    files = [shared / "real" / "kinect_v2_90deg_walk" / name for name in ("a.csv", "b.csv")]
    before = read_two(*map(RecordingChoice, files)).pairing.pairs.skeletons.frames
    header, *rows = files[side].read_text().splitlines()
    times, rest = zip(*(row.split(",", 1) for row in rows), strict=True)
    later = [int(us) + 8_000_000 * (int(us) >= 11_000_000) for us in times]
    files[side] = tmp_path / files[side].name
    told = "\n".join(f"{us},{cells}" for us, cells in zip(later, rest, strict=True))
    files[side].write_text(f"{header}\n{told}\n", encoding="utf-8")
    read = read_two(*map(RecordingChoice, files))
    np.testing.assert_array_equal(read.pairing.pairs.skeletons.frames, before)
    assert any("the clock jumped by 8.0" in line for line in read.warnings)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="counts descriptors as Linux and macOS number them")
def test_a_long_session_keeps_few_files_open(tmp_path, monkeypatch):
    monkeypatch.setattr(large_arrays, "_LARGE", 10_000)
    files = write_walk(tmp_path / "walk", 75)
    fuse(*files)
    sessions = [fuse(*files)]
    before = os.dup(0)  # the lowest number that is free
    os.close(before)
    sessions.append(fuse(*files))
    after = os.dup(0)
    os.close(after)
    assert after - before <= 3  # the session's and both views'
    assert len(sessions) == 2


def test_no_room_for_a_large_array_is_said_in_one_line(monkeypatch):
    class FullDisk:
        def write(self, _):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(large_arrays, "_LARGE", 100)
    monkeypatch.setattr(tempfile, "TemporaryFile", lambda **_: FullDisk())
    with pytest.raises(FusionError, match=r"No space left on device. .*TMPDIR"):
        GrowingArray().append(np.zeros(100))


def test_every_pass_shows_how_far_it_is(tmp_path, monkeypatch):
    monkeypatch.setattr(reader, "_BLOCK", 50_000)  # bytes: about 30 frames
    monkeypatch.setattr(plan, "_LONG", 60)
    files, shown = write_walk(tmp_path / "walk", 100), []

    def progress(blocks, what, total):
        seen = list(blocks)
        shown.append((what, len(seen) / total))
        return seen

    read = read_two(*map(RecordingChoice, files), progress=progress)
    settings = FuserSettings(hindsight="labels")
    plan_recording(KINECT_V2, read.pairing.pairs.skeletons, settings, progress=progress)
    write_session(fuse(*files), tmp_path / "s.rrd", block=30, progress=progress)
    passes = "finding left and right", "learning the registration", "finding left and right"
    assert [what for what, _ in shown] == ["reading a.csv", "reading b.csv", *passes, "writing"]
    assert [done for _, done in shown] == [1.0] * 6
    assert len(Session.open(tmp_path / "s.rrd")) == 100


def test_a_saved_session_knows_what_was_dropped(tmp_path):
    """The paper's methods fuse pairs only; B gives half as many frames as A."""
    a, b = write_walk(tmp_path / "walk", 150)
    header, *rows = b.read_text().splitlines()
    half = [row for k, row in enumerate(rows) if k // len(KINECT_V2) % 2 == 0]
    b.write_text("\n".join([header, *half]) + "\n")
    session = fuse(a, b, settings=FuserSettings("paper"))
    session.save(tmp_path / "s.rrd")
    opened = Session.open(tmp_path / "s.rrd")
    assert opened.dropped == session.dropped == (75, 0)
    assert opened.frame_counts["frames_a"] == 150


# --- The people of a session of recordings who are not followed.


FRAMES, FIRST, END = 60, 20, 45
"""The other person is seen from one frame to another."""


def two_files(folder, aside=(0.0, 0.0, 0.0)):
    """The recordings of two sensors, and the other person of each, (n, J, 3) metres; all of them aside."""
    paths, others = [], []
    for side in "ab":
        noise = np.random.default_rng(ord(side)).normal(0.0, 0.005, (FRAMES, 25, 3))
        seen = moving(KINECT_V2, FRAMES) + noise + aside
        other = seen + [1.5, 0.0, 0.5]
        path = folder / f"{side}.csv"
        rows = write_view(path, KINECT_V2, other).read_text().splitlines()[1 + 25 * FIRST : 1 + 25 * END]
        one = write_view(path, KINECT_V2, seen).read_text().splitlines()
        path.write_text("\n".join([*one, *(row.replace(",0,", ",1,", 1) for row in rows)]) + "\n")
        paths.append(path)
        others.append(other[FIRST:END])
    return paths, others


@pytest.fixture(scope="module")
def fused(tmp_path_factory):
    paths, others = two_files(tmp_path_factory.mktemp("two"))
    return fuse(*paths), others


def others_of(session, side):
    return dict(session.images.others(side, range(len(session))))


def test_the_others_are_those_of_the_files(fused):
    session, others = fused
    bones = KINECT_V2.bone_joints
    for side, seen in zip(layout.VIEWS, others, strict=True):
        drawn = others_of(session, side)
        assert list(drawn) == list(range(FIRST, END + 1))
        assert len(drawn.pop(END)) == 0  # the last one clears them
        ends, along = np.stack(list(drawn.values())).transpose(2, 0, 1, 3)
        np.testing.assert_allclose(ends, seen[:, bones], atol=1e-3)
        parents = seen[:, KINECT_V2.parent_indices[bones]]
        np.testing.assert_allclose(ends + along, parents, atol=1e-3)


def test_people_and_the_time_of_the_others_are_told(fused, tmp_path):
    session, _ = fused
    share = (END - FIRST) / FRAMES
    assert [person.ids for person in session.seen_people] == [("0", "0"), ("1", "1")]
    assert report(session)["others_seen"] == pytest.approx(share)
    lines = {line.label: line.text for line in lead_lines(report(session))}
    assert "others seen in 42 %" in lines["Frames"]
    part = tmp_path / "part.rrd"
    write_session(session.part(range(10, FRAMES)), part)
    assert Session.open(part).seen_people == session.seen_people  # those of the recordings
    assert report(Session.open(part))["others_seen"] == 0.0  # nobody counted


def test_whoever_is_chosen_by_id_is_not_among_the_others(tmp_path):
    paths, others = two_files(tmp_path)
    session = fuse(*paths, person_a="1", person_b="1")
    root = KINECT_V2.root
    followed = session.skeleton_a.positions[FIRST:END, root]
    np.testing.assert_allclose(followed, others[0][:, root], atol=1e-3)
    assert set(others_of(session, "a")) == set(range(FRAMES))


@pytest.mark.parametrize(("options", "ids"), [([], "0"), (["--follow", "middle"], "1")])
def test_the_command_follows_the_one_seen_longest_or_in_the_middle(options, ids, tmp_path):
    paths, _ = two_files(tmp_path, aside=(-1.5, 0.0, 0.0))
    saved = tmp_path / "s.rrd"
    assert duplex("fuse", *paths, *options, "--no-viewer", "--force", "--save", saved) == 0
    assert Session.open(saved).seen_people[0].ids == (ids, ids)


@pytest.mark.parametrize(("first", "end"), [(0, FRAMES), (10, 40), (30, FRAMES), (END, FRAMES), (50, FRAMES)])
def test_a_written_session_keeps_the_others(fused, tmp_path, first, end):
    session, _ = fused
    part, again = tmp_path / "part.rrd", tmp_path / "again.rrd"
    write_session(session.part(range(first, end)), part)
    write_session(Session.open(part), again)
    for side in layout.VIEWS:
        expected = {
            t - first: bones for t, bones in session.images.others(side, range(first, end)) if len(bones)
        }
        for path in (part, again):
            kept = {t: bones for t, bones in others_of(Session.open(path), side).items() if len(bones)}
            assert kept.keys() == expected.keys()
            for t, bones in kept.items():
                np.testing.assert_array_equal(bones, expected[t])


class OthersOf(SessionImages):
    """So many bones in each frame."""

    def __init__(self, counts):
        self.counts = counts

    def others(self, side, frames):
        del side
        shown = (k for k in frames if self.counts[k] or (k > frames.start and self.counts[k - 1]))
        every = [(k, np.zeros((self.counts[k], 2, 3), np.float32)) for k in shown]
        return Images(lambda: iter(every))


@given(st.lists(st.tuples(st.integers(0, 2), st.booleans()), min_size=1, max_size=25))
def test_a_part_with_gaps_shows_in_each_frame_whom_the_session_shows(frames):
    counts = [count for count, _ in frames]
    kept = np.array([k for k, (_, keeps) in enumerate(frames) if keeps], dtype=np.int64)
    items = list(PartOfImages(OthersOf(counts), kept).others("a", range(len(kept))))
    numbers = [number for number, _ in items]
    assert numbers == sorted(set(numbers))
    shown, newest = 0, {number: len(bones) for number, bones in items}
    for number, of in enumerate(kept.tolist()):
        shown = newest.get(number, shown)
        assert shown == counts[of]


def test_damaged_others_are_counted_where_a_session_is_written(fused, tmp_path):
    whole, damaged = tmp_path / "whole.rrd", tmp_path / "damaged.rrd"
    write_session(fused[0], whole)
    data = bytearray(whole.read_bytes())
    bones = others_of(Session.open(whole), "a")[FIRST + 3]
    at = data.find(bones[:4, 0].tobytes())
    assert at > 0, "the bones are not in the file as they are"
    data[at + 1] ^= 1
    damaged.write_bytes(data)
    assert write_session(Session.open(whole), tmp_path / "again.rrd") == 0
    assert write_session(Session.open(damaged), tmp_path / "part.rrd") == 1


def test_recordings_of_one_person_have_no_others(tmp_path):
    paths = [
        write_view(
            tmp_path / f"{side}.csv",
            KINECT_V2,
            moving(KINECT_V2, FRAMES) + np.random.default_rng(k).normal(0.0, 0.005, (FRAMES, 25, 3)),
        )
        for k, side in enumerate("ab")
    ]
    assert others_of(fuse(*paths), "a") == {}


# --- A session holds the depth witness of each joint, so that a replay needs no images.


@cache
def pairs_with_depth():
    a, b, _ = simulated_pair(motion="still", seconds=0.5, depth="half")
    return list(pairs_of(a, b))


@given(data=st.data())
def test_a_live_file_keeps_every_figure_whoever_comes_late(data):
    """A person or a sensor may come late; images are written before the frames, or there are none."""
    pairs = pairs_with_depth()
    comes = [data.draw(st.integers(0, len(pairs))) for _ in "abt"]
    sensor_late, images, later = (data.draw(st.booleans()) for _ in range(3))
    sizes = data.draw(st.lists(st.integers(1, 7), min_size=len(pairs)))
    body = pairs[0].skeletons.a.body
    fuser = Fuser(
        FusionSetup(
            Calibration(body, RigidTransform.of(np.eye(3), np.ones(3)), body.nominal_lengths, "known")
        )
    )
    frames = []
    for k, pair in enumerate(pairs):
        absent = dict.fromkeys((side for side, first in zip("ab", comes, strict=False) if k < first))
        given_ = replace(pair, skeletons=replace(pair.skeletons, **absent))
        if sensor_late and "b" in absent:
            given_ = replace(given_, b=None)
        frame = fuse_one(fuser, given_)
        frames.append(replace(frame, truth=frame.fused.positions if k >= comes[2] else None))
    with TemporaryDirectory() as folder:
        path = Path(folder) / "s.rrd"
        with recorder_to(path, fuser.setup, plots_later=later) as recorder:
            first = 0
            while first < len(frames):
                block = frames[first : first + sizes[first]]
                for k, frame in enumerate(block if images else [], first):
                    recorder.record_images(k, frame)
                recorder.record_all([replace(of, pair=pair_without_images(of.pair)) for of in block])
                first += len(block)
        session = Session.open(path)
    assert session.damage is None
    expected = Session.of([(fuser.setup, frames)])
    np.testing.assert_array_equal(session.fused_checksums, expected.fused_checksums)
    for name, _, values in session.rows.figures():
        in_memory = expected.rows.filled(name)
        if values.dtype == in_memory.dtype and name not in ("fused", "truth", "sigma", "fuse_ms"):  # rounded
            np.testing.assert_array_equal(values, in_memory, name)
    assert (session.truth is None) == (expected.truth is None)
    assert Agreement.of(session, Replay.of(session).fused().fused).kind == "bits"


# --- Events at a moment, spells with a start and an end, and limbs that a view reports at a wrong place.


LOST = Event("A is lost", "WARN", "A", "start", frame=2, time_ns=66_000_000)
TURNED = Event("B is mirrored", "INFO", "B", "start", frame=3, time_ns=99_000_000)
BACK = Event("A is back", "INFO", "A", "end", frame=5, time_ns=165_000_000)


def test_a_spell_is_read_back_as_it_was_written(fused_run, tmp_path):
    session = fused_run(frame_pairs(KINECT_V1, 8), calibration_of(KINECT_V1))
    events = (*session.events, LOST, TURNED, BACK)
    write_session(replace(session, events=events), tmp_path / "spells.rrd")
    read = Session.open(tmp_path / "spells.rrd")
    assert read.damage is None
    assert read.events == events
    lost, turned = read.spells
    assert (lost.start, lost.end) == (LOST, BACK)
    assert (turned.start, turned.end) == (TURNED, None)


def test_a_spell_that_starts_again_before_its_end_stays_one_spell():
    again = replace(LOST, frame=4)
    assert [(spell.start, spell.end) for spell in spells_of([LOST, again, BACK, BACK])] == [(LOST, BACK)]
    assert spells_of([BACK, Event("moment", "INFO")]) == []


def test_a_short_interruption_does_not_end_a_spell():
    soon, late = (replace(LOST, time_ns=BACK.time_ns + gap) for gap in (400_000_000, 600_000_000))
    ended = replace(BACK, time_ns=late.time_ns + 900_000_000)
    assert [(s.start, s.end) for s in spells_of([LOST, BACK, soon, ended])] == [(LOST, ended)]
    assert [(s.start, s.end) for s in spells_of([LOST, BACK, late, ended])] == [(LOST, BACK), (late, ended)]
    (listed,) = list_events([LOST, BACK, soon, ended])
    assert event_in_words(listed) == "Warning: A is lost. It lasted 1.6 s."
    (moment,) = list_events([LOST, replace(BACK, time_ns=LOST.time_ns + 33_000_000)])
    assert event_in_words(moment) == "Warning: A is lost. It lasted 33 ms."


ARM = [BODY.joint(f"{name}_LEFT") for name in ("ELBOW", "WRIST", "HAND")]


def told_of(
    wrong_frames, *, sensor="B", off=0.5, share=0.0, joints=3, state=TrackingState.TRACKED,
    exchanged=(0, 0), mirrored="", mirrored_frames=90, other_off=0.0, reset_at=90,
):  # fmt: skip
    """The events, with their frames, of a view whose left arm is wrong from frame 10 on."""
    views_of, truth = ViewEvents(BODY), standing(BODY)
    told = []
    for k in range(90):
        time_ns = (k if k < reset_at else k - 300) * FRAME_NS
        wrong = 10 <= k < 10 + wrong_frames
        shift, weights, states = np.zeros((len(BODY), 3)), np.full(len(BODY), 0.5), np.full(len(BODY), 2)
        if wrong:
            shift[ARM[:joints], 1], weights[ARM], states[ARM] = off, share, state
        views = {"A": truth.copy(), "B": truth.copy()}
        views[sensor] += shift
        views["B" if sensor == "A" else "A"][ARM, 1] += other_off
        if k < mirrored_frames:  # S* has the sides that these views exchange
            views |= {side: views[side][BODY.mirror] for side in mirrored}
        whole = np.full(len(BODY), TrackingState.TRACKED)
        pair = SkeletonPair(
            Skeleton.of(BODY, views["A"], states if sensor == "A" else whole, time_ns),
            Skeleton.of(BODY, A_FROM_B.inverse().apply(views["B"]), states if sensor == "B" else whole, 0),
            time_ns,
        )
        fused = FusedFrame(
            truth, np.zeros(len(BODY), bool), weights if sensor == "A" else 1.0 - weights,
            weights if sensor == "B" else 1.0 - weights, np.full(len(BODY), -1), A_FROM_B, 1, False, False,
            time_ns, exchanged_a=exchanged[0], exchanged_b=exchanged[1],
        )  # fmt: skip
        told += [(k, each) for each in views_of.observe(pair, fused)]
    return told


def test_sentences_of_view_events():
    """Each after the number of its frame, with topic and phase; 15 frames are just short of half a second."""

    def told(case):
        found = told_of(**arguments(case))
        return "\n".join(f"{k} {each.topic} {each.phase}: {each.text}" for k, each in found) or "-"

    check_sentences("view_events", told)


# --- R and t by the surface in live depth images: which moments are kept, and what they give.


CAMERA = Intrinsics(32, 24, 20.0, 20.0, 16.0, 12.0)
SECOND = 1_000_000_000


class Never:
    """Keeps what is submitted, and never runs it."""

    def __init__(self):
        self.submitted = []

    def submit(self, _, *arguments):
        self.submitted.append(arguments)
        return Future()


def learner():
    return CalibrationLearner(
        AZURE_KINECT, Calibration(AZURE_KINECT, A_FROM_B, AZURE_KINECT.nominal_lengths, "known")
    )


@given(data=st.data(), rate=st.integers(10, 60))
@settings(max_examples=10)
def test_a_moment_is_one_of_its_second_with_both_views_all_around(data, rate):
    pairs = frame_pairs(AZURE_KINECT, 6 * rate, depth=True)
    gone = data.draw(st.sets(st.integers(0, len(pairs) - 1), max_size=4))
    gone |= set(range(0, len(pairs), 2)) if data.draw(st.booleans()) else set()  # B at half the rate
    times = [round(k * SECOND / rate) for k in range(len(pairs))]
    for k, time_ns in enumerate(times):
        pair = replace(pairs[k], skeletons=replace(pairs[k].skeletons, time_ns=time_ns))
        pairs[k] = replace(pair, skeletons=replace(pair.skeletons, b=None)) if k in gone else pair
    executor = Never()
    surface, known = LiveSurface(AZURE_KINECT, (CAMERA, CAMERA), executor=executor), learner()
    for pair in pairs:
        assert surface.observe(pair, known) == []
    ((moments, _),) = executor.submitted  # the fit has not ended
    assert len(moments) == 4
    middles = [moment.pairs[3] for moment in moments]
    assert all(middles[k + 2].time_ns - middles[k].time_ns >= SECOND for k in range(2))
    for moment, middle in zip(moments, middles, strict=True):
        k = times.index(middle.time_ns)
        assert all(pair.a is not None and pair.b is not None for pair in moment.pairs)
        assert moment.images[0] is pairs[k].a.depth
        assert moment.images[1] is pairs[k].b.depth


def test_who_is_seen_from_two_sides_is_where_the_surface_is():
    """The trackers shift the joints along their rays; the images do not."""
    a, b, truth = simulated_pair(depth="half", seconds=10.0, seed=914, body=AZURE_KINECT, motion="walk")
    setup = FusionSetup(nominal_calibration(AZURE_KINECT), None, a.intrinsics, b.intrinsics)
    pairs = list(pairs_of(a, b))
    off, texts = [], []
    for cameras in ((None, None), (a.intrinsics, b.intrinsics)):
        fusion = LiveFusion(setup)
        for frame in fusion.frames(KnownSensors(pairs, cameras=cameras)):
            texts += [event.text for event in fusion.learn(frame)]
            if fusion._surface is not None and fusion._surface._fit is not None:
                wait([fusion._surface._fit[1]])
        found = fusion.setup.calibration.a_from_b
        there = truth.positions_at(np.array([pairs[-1].time_ns]))[0].mean(axis=0)
        off.append(np.linalg.norm(found.apply(truth.a_from_b.inverse().apply(there)) - there))
    assert sum("by the surface that both sensors see" in text for text in texts) >= 1
    assert off[1] < 0.7 * off[0]


def test_without_images_nothing_is_fitted():
    executor = Never()
    surface, known = LiveSurface(AZURE_KINECT, (CAMERA, CAMERA), executor=executor), learner()
    for pair in frame_pairs(AZURE_KINECT, 200):
        assert surface.observe(pair, known) == []
    assert executor.submitted == []


# --- A live run, and the same frames as a recording holds them, give the same pairs, S* and events.


BEGINS_S, STANDS_S, SECONDS = 2.0, 4.0, 8.0
"""From when on somebody is seen, and walks: the clocks are known to be one by then."""
SPELLS = st.lists(
    st.tuples(
        st.sampled_from("ab"), st.sampled_from(("nobody", "arm", "half", "exchanged", "elsewhere")),
        st.floats(0.0, SECONDS), st.floats(0.05, 2.0),
    ),
    max_size=4,
)  # fmt: skip
"""View, what is wrong in it, and from when on for how long, seconds."""


def seen(side, seconds, spells, random):
    """The skeleton of a view; None where it sees nobody."""
    if seconds < BEGINS_S:
        return None
    at = standing(BODY) if seconds < STANDS_S else walking(seconds - STANDS_S)[0]
    at = at + random.normal(0.0, 0.004, at.shape)
    skeleton = Skeleton.of(BODY, A_FROM_B.inverse().apply(at) if side == "b" else at)
    for _, what, *_ in (of for of in spells if of[0] == side and of[2] <= seconds < of[2] + of[3]):
        if what == "nobody":
            return None
        if what == "exchanged":
            skeleton = exchanged(skeleton)
        elif what == "elsewhere":
            positions = skeleton.positions.copy()
            positions[HIDDEN["arm"]] += np.float32(0.4)
            skeleton = Skeleton.of(BODY, positions)
        else:
            skeleton = hidden(skeleton, HIDDEN[what])
    return skeleton


def facts(pairs):
    """Of each pair: time since the first, skew, and the own times of its frames."""
    first_ns = pairs[0].time_ns
    return [(of.time_ns - first_ns, of.skew_ns, of.a and of.a.time_ns, of.b and of.b.time_ns) for of in pairs]


@given(
    fps=st.sampled_from((15, 30, 60)),
    lost=st.sampled_from((0.0, 0.1, 0.4)),
    late_ms=st.tuples(st.integers(0, 120), st.integers(0, 120)),
    phase=st.floats(-0.4, 0.4),
    clock_s=st.sampled_from((0, 1_000, -7)),
    spells=SPELLS,
    seed=st.integers(0, 999),
)
def test_the_frames_of_a_live_run_give_its_pairs_its_s_star_and_its_events(
    fps, lost, late_ms, phase, clock_s, spells, seed
):
    """On a cable, whose own times are of one clock; with the run's calibrations, and no later frames.

    What a file of skeletons with times does not hold: which frames came too late, what arrivals told of the
    clocks before they were known to be one, and how the calibrations were learned.
    """
    random = np.random.default_rng(seed)
    streams = []
    delay_ns = round(1e9 * phase / fps)
    for side, ms, phase_ns in zip("ab", late_ms, (0, delay_ns), strict=True):
        how = {"fps": fps, "phase_ns": phase_ns, "latency_ns": 20_000_000 + 1_000_000 * ms}
        made = []
        for shot in shots(side, SECONDS, clock_ns=clock_s * SECOND_NS, seed=seed, **how):
            if random.random() < lost:
                continue
            person = seen(side, 1e-9 * shot.true_ns - 5.0, spells, random)
            made.append(replace(shot, frame=replace(shot.frame, people={PERSON: person} if person else {})))
        streams.append(made)
    setup = FusionSetup(nominal_calibration(BODY), FuserSettings(hindsight="none"))
    fusion, live, setups, told = LiveFusion(setup), [], [], []
    for pair in run(LivePairing(round(1e9 / fps), sync_delay_ns=delay_ns), *streams):
        live.append(fusion.fuse(fusion.chosen(pair)))
        setups.append(fusion.setup)
        told += [(len(live) - 1, event.text) for event in fusion.learn(live[-1]) if event.topic]
    first = next(k for k, of in enumerate(live) if of.pair.skeletons.a or of.pair.skeletons.b)
    live, setups = live[first:], setups[first:]
    told = [(k - first, text) for k, text in told]
    views = []
    for side in "ab":
        given = [
            (frame, getattr(of.pair.skeletons, side)) for of in live if (frame := getattr(of.pair, side))
        ]
        none = np.full((len(BODY), 3), np.nan, np.float32), np.zeros(len(BODY), np.uint8)
        arrays = zip(*(none if of is None else (of.positions, of.states) for _, of in given), strict=True)
        times = np.array([frame.time_ns for frame, _ in given], dtype=np.int64)
        views.append(View(times, *map(np.stack, arrays)))
    pairs = pair_views(BODY, *views, every_frame=True).pairs
    assert facts(pairs) == facts([of.pair for of in live])
    begins = [k for k in range(len(live)) if k == 0 or setups[k] is not setups[k - 1]]
    ends = [*begins[1:], len(live)]
    segments = [(setups[k], slice(k, end)) for k, end in zip(begins, ends, strict=True)]
    events = []
    blocks = list(watch(BODY, fuse_segments(segments, pairs), int(pairs.skeletons.time_ns[0]), events))
    for name in ("positions", "sigma", "weights_a", "weights_b"):
        recorded = np.concatenate([getattr(block.fused, name) for block in blocks])
        np.testing.assert_array_equal(recorded, [getattr(of.fused, name) for of in live], name)
    assert [(event.frame, event.text) for event in events if event.topic] == told
