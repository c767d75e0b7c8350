"""Long recordings: bounded memory, the same result in parts, and temporary files without a name."""

import errno
import gc
import os
import tempfile
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from devices.recorded.two_recordings import RecordingChoice, read_two
from devices.sensor import DeviceError
from devices.skeletons.border import checked
from devices.skeletons.csv_files import reader
from devices.skeletons.csv_files.reader import read_csv
from fusion import plan
from fusion.body import KINECT_V2
from fusion.errors import FusionError
from fusion.plan import plan_recording
from fusion.setup import FuserSettings
from fusion.support import large_arrays
from fusion.support.large_arrays import GrowingArray
from recordings import Session, fuse
from recordings.data.session_arrays import SessionArrays
from recordings.file import session_reader
from recordings.file.session_writer import write_session
from tests.helpers.recorded_pairs import write_view
from tests.helpers.two_views import A_FROM_B, moving


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
    for frames in (300, 900):
        files = write_walk(tmp_path / str(frames), frames)
        gc.collect()
        tracemalloc.start()
        session = fuse(*files)
        gc.collect()
        held[frames], _ = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert len(session) == frames
    assert (held[900] - held[300]) / 600 < 300.0


def test_a_saved_session_is_opened_in_parts(tmp_path, monkeypatch):
    """Its arrays are 2,000 bytes of each frame. The summary of a session that has ended opens it."""
    monkeypatch.setattr(large_arrays, "_LARGE", 4_000)  # bytes
    monkeypatch.setattr(session_reader, "parts", lambda count: large_arrays.parts(count, 100))
    short, most = fuse(*write_walk(tmp_path / "walk", 100)), {}
    for times in (6, 18):
        rows = SessionArrays.joined([short.rows] * times)
        number = np.arange(len(rows))
        checks = {
            name: np.concatenate([getattr(short, name)] * times)
            for name in ("fused_checksums", "joint_digests")
        }
        replace(short, rows=replace(rows, frame=number, time_ns=number * 33_333_333), **checks).save(
            tmp_path / "s.rrd"
        )
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
    whole, in_blocks = (checked(path, read_csv(path, block=size)) for size in (-1, 5000))  # three frames
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
    assert in_parts.labels is not None
    assert whole.labels is not None
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
