"""``duplex fuse`` at the command line: arguments, output and files."""

import errno
import json
import math
import re

import numpy as np
import pytest
import rerun as rr

from fusion.body import KINECT_V2
from recordings import Session
from recordings.gait import SIDES
from recordings.quality.per_second import SecondQuality
from tests.experiments import example_recordings
from tests.helpers.command_line import duplex, one_line
from tests.helpers.machine import small_disk
from tests.helpers.programs import python
from tests.helpers.recorded_pairs import write_recordings
from viewer_app.errors import UsageError

QUICKLY = "--no-viewer", "--offset", "0"
"""Without a search for the offset of the clocks."""


@pytest.fixture
def recordings(tmp_path):
    """Two views of a person, each with 10 mm of noise."""
    return write_recordings(tmp_path)


def figures_of(path):
    return json.loads(path.read_text(encoding="utf-8"))


def test_where_no_window_opens_the_report_is_written(recordings, tmp_path, monkeypatch):
    def no_window(*_):
        raise UsageError("no driver")

    report, saved = tmp_path / "r.json", tmp_path / "s.rrd"
    monkeypatch.setattr("viewer_app.viewer.viewer_choice.why_no_window", lambda: None)
    monkeypatch.setattr("viewer_app.viewer.file_window.start_viewer", no_window)
    assert duplex("fuse", *recordings, "--offset", "0", "--report", report, "--save", saved) == 2
    assert figures_of(report)["paired"] == len(Session.open(saved)) == 70


def test_two_recordings_become_a_session_a_report_and_a_summary(recordings, tmp_path, capsys):
    session, report = tmp_path / "s.rrd", tmp_path / "r.json"
    # the method duplex allows for trackers that show people too frontal, and these are exact
    options = "--method", "paper", "--no-viewer", "--save", session, "--report", report, "--verbose"
    assert duplex("fuse", *recordings, *options) == 0
    said = " ".join(capsys.readouterr().out.split())
    words = ("Frames 70 pairs", "start-up pose", "axes are 85° apart", "Largest bone error", "ms per frame")
    assert [each for each in words if each not in said] == []
    figures = figures_of(report)
    assert figures["paired"] == 70
    assert figures["dropped"] == {"a": 0, "b": 0}
    assert figures["bone_error_mm"]["fused"]["max"] < 1e-3
    assert set(figures["bones"]) == set(filter(None, KINECT_V2.bones))
    forearm = figures["bones"]["forearm_left"]
    assert set(forearm) == {"target_m", "length_from", "a", "b", "fused"}
    assert set(forearm["fused"]) == {"mean_m", "std_mm", "max_error_mm"}
    # each view's noise of 10 mm an axis disagrees by a Maxwell median of 1.538 · √2 · 10 mm
    assert figures["views_agree_mm"]["median"] == pytest.approx(21.7, rel=0.1)
    assert rr.chunk.RrdReader(session).store().schema() is not None
    assert {p.name for p in tmp_path.iterdir()} == {"a.csv", "b.csv", "s.rrd", "r.json"}


def test_the_report_has_the_gait_of_the_session(tmp_path):
    saved, report = tmp_path / "s.rrd", tmp_path / "r.json"
    walk = example_recordings.FOLDER / "a.csv", example_recordings.FOLDER / "b.csv"
    assert duplex("fuse", *walk, *QUICKLY, "--save", saved, "--report", report) == 0
    figures, gait = figures_of(report)["gait"], Session.open(saved).gait
    for side in SIDES:
        of_side, steps = figures[side], gait.of_side(side)
        assert of_side["steps"] == len(steps) > 1
        assert of_side["gait_cycles"] == len(gait.cycles(side))
        assert of_side["step_length_m"]["mean"] == pytest.approx(np.mean([step.length for step in steps]))
        stance, spread = gait.stance(side), of_side["stance_percent"]["sd"]
        if len(stance) > 1:
            assert spread == pytest.approx(100 * np.nanstd(stance, ddof=1), rel=1e-4, abs=1e-4)  # float32
        else:
            assert spread is None
    assert figures["cadence_per_minute"] == {
        name: pytest.approx(x, rel=1e-4) for name, x in gait.cadence._asdict().items()
    }
    assert figures["asymmetry_percent"].keys() == gait.asymmetry.keys()


def test_nobody_who_walks_is_said_in_the_report_too(recordings, tmp_path):
    report = tmp_path / "r.json"
    assert duplex("fuse", *recordings, *QUICKLY, "--report", report) == 0
    gait = figures_of(report)["gait"]
    assert gait["walks"] == gait["left"]["steps"] == 0
    assert gait["cadence_per_minute"] == gait["speed_m_per_s"] == {"value": None, "sigma": None}
    assert gait["right"]["step_length_m"] == {"mean": None, "sd": None}


@pytest.mark.parametrize("good", [(0,), (0, 2), (0, 1, 2), ()])
def test_only_the_good_seconds_are_saved_and_exported(good, recordings, tmp_path, monkeypatch, capsys):
    def judged(session):
        count = max(1, math.ceil(session.rows.time_ns[-1] * 1e-9 + 1 / 30))
        return tuple(SecondQuality(float(k), "good" if k in good else "poor", "") for k in range(count))

    whole, saved, table = tmp_path / "whole.rrd", tmp_path / "s.rrd", tmp_path / "s.npz"
    assert duplex("fuse", *recordings, *QUICKLY, "--save", whole) == 0
    monkeypatch.setattr("recordings.quality.per_second.quality_per_second", judged)
    capsys.readouterr()
    options = "--good", "--save", saved, "--to", table
    assert duplex("fuse", *recordings, *QUICKLY, *options) == (0 if good else 2)
    said = capsys.readouterr()
    if not good:
        assert "No second of the session in memory is good. It is " in said.err
        assert not saved.exists()
        return
    session = Session.open(whole)
    kept = session.good_frames
    assert ("Left out:" in said.out) == (not kept.all())
    for fused in (Session.open(saved).fused, np.load(table)["fused"]):
        np.testing.assert_allclose(fused, session.fused[kept], atol=5e-7)


def test_recordings_of_other_people_are_refused_and_can_be_forced(shared, tmp_path, capsys):
    a = shared / "real_more" / "kinect_v2_90deg_walk_18" / "a.csv"
    b = shared / "real_more" / "kinect_v2_90deg_walk_2" / "b.csv"
    assert duplex("fuse", a, b, "--no-viewer") == 2
    assert "a.csv and b.csv cannot be of one person at the same time" in one_line(capsys)
    report = tmp_path / "r.json"
    assert duplex("fuse", a, b, "--no-viewer", "--force", "--report", report) == 0
    assert figures_of(report)["verdict"]["word"] == "poor"


def test_a_calibration_of_other_places_is_named(shared, tmp_path, capsys):
    folder, calibration = shared / "real" / "kinect_v2_90deg_steps", tmp_path / "c.json"
    views = folder / "a.csv", folder / "b.csv"
    assert duplex("fuse", *views, "--no-viewer", "--save-calibration", calibration) == 0
    capsys.readouterr()
    assert duplex("fuse", *views[::-1], "--no-viewer", "--calibrate", calibration) == 2
    line = one_line(capsys)
    assert "The calibration does not fit b.csv and a.csv" in line
    assert "--force" in line


def test_a_session_tells_how_files_were_read_without_their_folders(recordings, tmp_path, capsys):
    header, *rows = recordings[0].read_text(encoding="utf-8").splitlines()
    x = header.split(",").index("x")
    cells = [row.split(",") for row in rows]
    places = ([str(1e3 * float(at)) for at in row[x : x + 3]] for row in cells)
    scaled = [",".join((*row[:x], *at, *row[x + 3 :])) for row, at in zip(cells, places, strict=True)]
    recordings[0].write_text("\n".join([header, *scaled, ""]), encoding="utf-8")
    saved = tmp_path / "s.rrd"
    assert duplex("fuse", *recordings, "--no-viewer", "--save", saved) == 0
    assert f"{recordings[0]}: read as millimetres" in capsys.readouterr().out
    texts = [event.text for event in Session.open(saved).events]
    assert any(text.startswith(f"{recordings[0].name}: read as") for text in texts)
    assert not any(str(tmp_path) in text for text in texts)


@pytest.mark.parametrize("beyond", [False, True])
def test_seconds_beyond_the_recordings_are_told(recordings, tmp_path, capsys, beyond):
    report = tmp_path / "r.json"
    assert duplex("fuse", *recordings, *QUICKLY, "--report", report) == 0
    figures = figures_of(report)
    asked = 999 if beyond else math.ceil(figures["seconds"])
    again = "--calibrate", f"seconds:{asked}", "--report", report, "--force"
    assert duplex("fuse", *recordings, *QUICKLY, *again) == 0
    which = f"all {figures['seconds']:.1f} s" if beyond else f"first {asked} s"
    assert figures_of(report)["calibration"]["how"] == f"{which}, {figures['paired']} frames"
    said = f"--calibrate seconds:999: the recordings are shorter; calibrating on {which}."
    assert (said in capsys.readouterr().out) == beyond


def test_a_calibration_can_be_kept_and_used_again(recordings, tmp_path):
    kept, first, again = tmp_path / "c.json", tmp_path / "1.json", tmp_path / "2.json"
    assert duplex("fuse", *recordings, *QUICKLY, "--save-calibration", kept, "--report", first) == 0
    more = ("--calibrate", kept, "--person-b", "0")
    assert duplex("fuse", *recordings, *QUICKLY, *more, "--report", again) == 0
    one, two = figures_of(first), figures_of(again)
    assert one["bones"] == two["bones"]
    assert two["calibration"]["how"].startswith("loaded from")


@pytest.mark.parametrize("share", [0.1, 0.9])
def test_a_full_disk_gives_one_line_and_leaves_no_file(share, recordings, tmp_path, capsys):
    command = ("fuse", *recordings, *QUICKLY, "--save")
    assert duplex(*command, tmp_path / "s.rrd") == 0
    whole = (tmp_path / "s.rrd").stat().st_size / 1024
    capsys.readouterr()
    with small_disk(tmp_path / "small", round(share * whole)) as disk:
        assert duplex(*command, disk / "s.rrd") == 2
        assert re.fullmatch(r"duplex: .*s\.rrd could not be written: .*\n", capsys.readouterr().err)
        assert list(disk.iterdir()) == []
        if share == 0.9:  # Rerun's log of the failure would be lines beside it
            done = python("-m", "viewer_app.cli", *command, disk / "s.rrd", timeout=120.0)
            assert done.returncode == 2
            assert re.fullmatch(r"duplex: .*s\.rrd could not be written: .*\n", done.stderr)
            assert list(disk.iterdir()) == []


def test_a_session_survives_an_export_that_fails(recordings, tmp_path, monkeypatch, capsys):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("recordings.export.tables.write_npz", full)
    saved, table = tmp_path / "s.rrd", tmp_path / "s.npz"
    assert duplex("fuse", *recordings, *QUICKLY, "--save", saved, "--to", table) == 2
    assert "No space left" in capsys.readouterr().err
    assert not table.exists()
    assert len(Session.open(saved)) > 0
