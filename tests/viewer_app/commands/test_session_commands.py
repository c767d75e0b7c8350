"""``duplex fuse``, ``replay``, ``compare``, ``review``, ``export``, ``trim`` and ``info``."""

import errno
import json
import math
import re
import shutil
from dataclasses import replace
from html import unescape

import numpy as np
import pytest
import rerun as rr
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from fusion.body import KINECT_V2
from fusion.calibration.calibration import nominal_calibration
from fusion.fuser import Fuser
from recordings.calibration_file import calibration_to_json
from recordings.data import layout
from recordings.export import FILES
from recordings.file.session_writer import write_session
from recordings.gait import SIDES
from recordings.quality.figures import fusion_figures, report
from recordings.quality.per_second import SecondQuality
from recordings.session import Session
from tests.experiments import example_recordings
from tests.helpers.command_line import duplex, one_line
from tests.helpers.frame_pairs import frame_pairs
from tests.helpers.fused_runs import record_fused
from tests.helpers.machine import small_disk
from tests.helpers.motion_capture import write_c3d, write_trc
from tests.helpers.programs import python
from tests.helpers.recalibrated import record_recalibrated
from tests.helpers.recorded_pairs import write_json, write_ntu, write_recordings, write_view
from tests.helpers.sentences import check_sentences, printed
from tests.helpers.session_text import rows_of
from tests.helpers.two_views import A_FROM_B, calibration_of, moving
from viewer_app.commands.replay import verify
from viewer_app.errors import UsageError
from viewer_app.report.pages.good_part import good_seconds


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    pairs = frame_pairs(KINECT_V2, 90, gap=(30,), no_b=(20,), depth=True)
    path = tmp_path_factory.mktemp("recorded") / "s.rrd"
    return record_fused(path, pairs, calibration_of(KINECT_V2), depth_every=1).path


@pytest.fixture
def session(recorded, tmp_path):
    """A copy, which a test may change."""
    return shutil.copy(recorded, tmp_path / "recorded.rrd")


@pytest.fixture(scope="module")
def by_the_paper(recorded):
    """The same by another method, in a file whose name is markup."""
    path = recorded.with_name("<b>paper.rrd")
    assert duplex("replay", recorded, "--no-viewer", "--method", "paper", "--save", path) == 0
    return path


QUICKLY = "--no-viewer", "--offset", "0"
"""Without a search for the offset of the clocks."""
LARGE = {"pandas", "numba", "scipy.optimize", "scipy.signal", "matplotlib", "rerun", "cv2"}
PROGRAM = """
import atexit, sys
from viewer_app.cli import script
atexit.register(lambda: print(*sys.modules))
script()
"""


@pytest.mark.parametrize(
    ("command", "imported"),
    [
        ("--version", set()),
        ("info {session}", set()),
        ("export {session} --to {out}.csv", set()),
        ("trim {session} --to 1 --save {out}.rrd", {"numba", "rerun", "cv2"}),
        ("review {session} --no-viewer", set()),
    ],
)
def test_a_command_imports_the_large_packages_that_it_uses(command, imported, session, tmp_path):
    arguments = command.format(session=session, out=tmp_path / "out").split()
    said = python("-c", PROGRAM, *arguments)
    modules = set(said.stdout.splitlines()[-1].split())
    assert said.returncode == 0, said.stderr
    assert modules & LARGE == imported


def test_a_replay_is_verified_and_can_be_replayed_again(session, tmp_path, capsys):
    again = tmp_path / "again.rrd"
    report = tmp_path / "r.json"
    assert duplex("replay", session, "--verify", "--save", again, "--report", report) == 0
    assert "all 90 frames is the recorded one, bit for bit" in capsys.readouterr().out.replace("\n", " ")
    assert duplex("replay", again, "--verify") == 0
    one, two = Session.open(session), Session.open(again)
    np.testing.assert_array_equal(one.fused_checksums, two.fused_checksums)
    np.testing.assert_array_equal(dict(one.depth("b"))[60], dict(two.depth("b"))[60])
    figures = json.loads(report.read_text(encoding="utf-8"))
    assert figures["paired"] + sum(figures["alone"].values()) == 90
    assert figures["bone_error_mm"]["fused"]["max"] < 1e-3


def test_recorded_settings_of_other_methods_do_not_stop_a_replay(session, tmp_path):
    """Version 1.0 accepted --h with every method, and ``duplex`` can replay a session of ``paper``."""
    recorded, path = Session.open(session), tmp_path / "h.rrd"
    replace(recorded, settings=replace(recorded.settings, h=0.9, weights="equal")).save(path)
    assert duplex("replay", path, "--verify") == 0
    assert duplex("replay", path, "--method", "duplex", "--h", 0.9, "--no-viewer") == 2


def test_where_no_window_opens_the_report_and_the_session_are_written(session, tmp_path, monkeypatch, capsys):
    def no_window(*_):
        raise UsageError("no driver")

    monkeypatch.setattr("viewer_app.viewer.viewer_choice.why_no_window", lambda: None)
    monkeypatch.setattr("viewer_app.viewer.file_window.start_viewer", no_window)
    fuse = "fuse", *write_recordings(tmp_path), "--offset", 0
    for line, frames in ((("replay", session), 90), (fuse, 70)):
        report, saved = tmp_path / f"{line[0]}.json", tmp_path / f"{line[0]}.rrd"
        assert duplex(*line, "--report", report, "--save", saved) == 2
        assert capsys.readouterr().err == "duplex: no driver\n"
        assert len(Session.open(saved)) == frames
        assert report.exists()
    assert duplex("compare", session, tmp_path / "replay.rrd") == 2
    assert "S* is the same in every frame they share." in capsys.readouterr().out


def test_outputs_of_a_replay_get_the_session_s_rate(tmp_path, monkeypatch, capsys):
    def opened(_plan, _setup, rate, *_):
        raise UsageError(f"{rate:g}")

    monkeypatch.setattr("viewer_app.outputs.opening.OutputPlan.opened", opened)
    pairs = frame_pairs(KINECT_V2, 60)[::2]
    session = record_fused(tmp_path / "half.rrd", pairs, calibration_of(KINECT_V2))
    assert duplex("replay", session.path, "--no-viewer", "--pace", "live", "--vmc", "39539") == 2
    assert capsys.readouterr().err == "duplex: 15\n"


def test_a_difference_is_exit_code_1_with_frame_and_joint(session, capsys, monkeypatch):
    true_setups = Session.setups

    def biased(self, *arguments):
        longer = self.calibration.bone_lengths.copy()
        longer[KINECT_V2.joint("WristLeft")] *= 1.001
        for setup, frames in true_setups(self, *arguments):
            yield replace(setup, calibration=replace(setup.calibration, bone_lengths=longer)), frames

    monkeypatch.setattr(Session, "setups", biased)
    assert duplex("replay", session, "--verify") == 1
    said = " ".join(capsys.readouterr().out.split())
    assert "S* differs from the recorded one in 89 of 90 frames, first at frame 0, joint" in said


@pytest.mark.parametrize("seen", [False, True])
def test_the_first_frame_that_differs_is_named_also_where_float32_does_not_show_it(seen, session, capsys):
    recorded = Session.open(session)
    ((setup, _),) = recorded.setups()
    fuser = Fuser(setup)
    fused = np.array([fuser.update(pair.skeletons).positions for pair in recorded.pairs()])
    wrist, knee = KINECT_V2.joint("WristLeft"), KINECT_V2.joint("KneeRight")
    fused[40, knee] += 0.01
    assert verify(Console(width=300), recorded, fused) is False
    assert "in 1 of 90 frames, first at frame 40, joint KneeRight, by 17.3 mm" in capsys.readouterr().out
    fused[12, wrist, 1] = 0.0 if seen else np.nextafter(fused[12, wrist, 1], 9.0)
    assert verify(Console(width=300), recorded, fused) is False
    said = capsys.readouterr().out
    assert "in 2 of 90 frames, first at frame 12, joint WristLeft, by" in said
    assert ("by less than the file's float32 shows" in said) is not seen
    assert "trimmed" not in said
    about = {**recorded.about, "session": {**recorded.about["session"], "first_frame": [7]}}
    fused[80:] += 1.0
    assert verify(Console(width=300), replace(recorded, about=about), fused) is False
    assert "trimmed at its beginning; frames before it also have an effect." in capsys.readouterr().out


def test_a_replay_with_other_settings_is_compared_with_the_first(session, by_the_paper, tmp_path, capsys):
    compared = tmp_path / "compared.rrd"
    capsys.readouterr()
    assert duplex("compare", session, by_the_paper, "--no-viewer", "--save", compared, "--worst", "2") == 0
    said = capsys.readouterr().out
    assert "method: duplex against paper" in said
    assert "90 frames in common" in said
    assert said.count(" differs by ") == 2  # at least a second apart, of three
    assert compared.stat().st_size > 10_000
    assert duplex("compare", session, by_the_paper, "--no-viewer", "--worst", "0") == 0
    said = capsys.readouterr().out
    assert " differs by " not in said
    assert "the same in every frame" not in said
    assert duplex("compare", session, session, "--no-viewer") == 0
    assert "S* is the same in every frame" in capsys.readouterr().out


def test_the_window_of_a_comparison_opens_where_s_star_differs_most(session, by_the_paper, monkeypatch):
    opened = []
    monkeypatch.setattr("viewer_app.viewer.viewer_choice.why_no_window", lambda: None)
    monkeypatch.setattr("viewer_app.viewer.file_window.show", lambda _, at_ns: opened.append(at_ns))
    for worst in ("0", "2"):
        assert duplex("compare", session, by_the_paper, "--worst", worst) == 0
    one, two = Session.open(session), Session.open(by_the_paper)
    apart = np.nanmax(np.linalg.norm(one.fused - two.fused, axis=2), axis=1, initial=0.0)
    assert opened == 2 * [one.time_ns[np.argmax(apart)]]
    assert duplex("compare", session, session) == 0
    assert opened[2:] == [0]


def test_a_trimmed_session_is_a_session(session, tmp_path):
    part = tmp_path / "part.rrd"
    assert duplex("trim", session, "--from", "1.0", "--to", "2.0", "--save", part) == 0
    whole, cut = Session.open(session), Session.open(part)
    assert len(cut) == 30  # frame 30 is 10 ns before the second
    np.testing.assert_array_equal(cut.rows.fused, whole.rows.fused[31:61])
    assert rows_of(part, layout.COACH) == 1  # else the viewer shows "(empty)"
    assert duplex("replay", part, "--verify") == 0
    (event,) = cut.events
    assert (event.frame, event.time_ns, event.text) == (0, 0, "calibrated: known truth")


@pytest.mark.parametrize("good", [(0, 2), (0, 1, 2), ()])
@pytest.mark.parametrize("verb", ["trim", "export", "fuse"])
def test_only_the_good_seconds_are_taken_and_a_line_says_what_is_left_out(
    verb, good, session, tmp_path, capsys, monkeypatch
):
    saved, table = tmp_path / "good.rrd", tmp_path / "good.npz"
    fuse = "fuse", *write_recordings(tmp_path), *QUICKLY
    line = {
        "trim": ("trim", session, "--save", saved),
        "export": ("export", session, "--to", table),
        "fuse": (*fuse, "--save", saved, "--to", table),
    }[verb]
    if verb == "fuse":
        session = tmp_path / "whole.rrd"
        assert duplex(*fuse, "--save", session) == 0
    whole = Session.open(session)
    seconds = tuple(SecondQuality(float(k), "good" if k in good else "poor", "") for k in range(3))
    monkeypatch.setattr("recordings.quality.per_second.quality_per_second", lambda _: seconds)
    capsys.readouterr()
    assert duplex(*line, "--good") == (0 if good else 2)
    told, kept = capsys.readouterr(), np.isin(whole.time.astype(int), good)
    if not good:
        assert "No second of" in told.err
        assert not saved.exists()
        assert not table.exists()
        return
    written = [path for path in line if path in (saved, table)]
    for path in written:
        fused = Session.open(path).fused if path is saved else np.load(path)["fused"]
        np.testing.assert_allclose(fused, whole.fused[kept], atol=5e-7)
    left_out = f"Left out: {(~kept).sum()} of {len(whole)} frames, in seconds that are not good: 1–2 s."
    assert re.findall("Left out.*", told.out) == ([] if kept.all() else [left_out])


def test_two_sessions_are_on_one_page(session, by_the_paper, tmp_path, capsys):
    pytest.importorskip("matplotlib", reason="the page's plots need matplotlib")
    path = tmp_path / "c.html"
    capsys.readouterr()
    assert duplex("compare", session, by_the_paper, "--no-viewer", "--html", path) == 0
    said, page = " ".join(capsys.readouterr().out.split()), path.read_text(encoding="utf-8")
    assert f"Wrote {path}." in said
    assert "<b>paper" not in page
    text = unescape(page)
    for words in (session.name, by_the_paper.name, "method: duplex against paper"):
        assert words in text
    for line in re.findall(r"<p><strong>(.*?)</strong>: (.*?)</p>", text):
        assert " ".join(line) in said
    for when, words in re.findall(r"<td>([\d.]+) s</td><td>(frame .*?)</td>", text):
        assert f"{when} s {words}" in said
    for each in map(Session.open, (session, by_the_paper)):
        assert text.count(f"<td>{each.body.joints[5]}</td>") == 1
        assert unescape(good_seconds(each).text) in text
    assert text.count('<div class="quality"') == 2
    assert not re.search(r'(?:src|href)="(?!#|data:)', page)


def test_a_trim_keeps_each_calibration_s_event_once(tmp_path):
    first = calibration_of(KINECT_V2)
    second, third = replace(first, how="two"), replace(first, how="three")
    pairs = frame_pairs(KINECT_V2, 30)
    whole = record_recalibrated(tmp_path / "s.rrd", pairs, [(0, first), (10, second), (20, third)])
    write_session(whole.part(range(15, 28)), tmp_path / "part.rrd")
    texts = [event.text for event in Session.open(tmp_path / "part.rrd").events]
    assert texts == ["calibrated: two", "calibrated: three"]


def verdict(said):
    """The lines of a calibration's verdict."""
    words = ("frames the views differ by", "axes are")
    return [" ".join(line.split()) for line in said.split("\n") if any(w in line for w in words)]


@pytest.mark.usefixtures("without_plots")
def test_the_verdict_on_a_calibration_goes_with_the_session(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "300")
    saved = tmp_path / "s.rrd"
    report, html = tmp_path / "r.json", tmp_path / "r.html"
    fuse = ("fuse", *write_recordings(tmp_path), "--no-viewer", "--verbose")
    assert duplex(*fuse, "--save", saved, "--report", report) == 0
    said = verdict(capsys.readouterr().out)
    assert len(said) == 2
    again, part = tmp_path / "again.rrd", tmp_path / "part.rrd"
    replay = ("replay", saved, "--no-viewer", "--verbose", "--save", again)
    assert duplex(*replay, "--report", tmp_path / "again.json") == 0
    assert verdict(capsys.readouterr().out) == said
    one, two = (json.loads(p.read_text(encoding="utf-8")) for p in (report, tmp_path / "again.json"))
    assert one["calibration"] == two["calibration"]
    assert duplex("trim", again, "--from", "0.5", "--save", part) == 0
    capsys.readouterr()
    assert duplex("review", part, "--no-viewer", "--verbose", "--html", html) == 0
    assert verdict(capsys.readouterr().out) == said
    assert duplex("info", part) == 0
    assert [line.removeprefix("calibration ") for line in verdict(capsys.readouterr().out)] == said
    page = unescape(html.read_text(encoding="utf-8"))
    assert all(line in page for line in said)


@pytest.mark.usefixtures("without_plots")
@pytest.mark.parametrize("lost", [0, 5])
def test_info_summary_and_page_say_what_is_lost_if_anything_is(session, lost, tmp_path, capsys, monkeypatch):
    found = replace(Session.open(session), damage="it was not ended", frames_lost=lost)
    monkeypatch.setattr(Session, "open", lambda _: found)
    page = tmp_path / "s.html"
    assert duplex("info", session) == 0
    told = [capsys.readouterr().out]
    assert duplex("review", session, "--no-viewer", "--html", page) == 0
    told += [capsys.readouterr().out, unescape(page.read_text(encoding="utf-8"))]
    for text in told:
        assert "it was not ended" + (f"; at least {lost} frames are lost" if lost else "") in text
        (line,) = (line for line in text.splitlines() if "not ended" in line)
        assert ("lost" in line) == (lost > 0)


def test_files_in_a_folder_of_opensim_are_replaced_all_with_force_only(session, tmp_path, capsys):
    folder = tmp_path / "opensim"
    assert duplex("export", session, "--to", folder) == 0
    assert "opensim: 90 frames" in capsys.readouterr().out
    assert sorted(path.name for path in folder.iterdir()) == sorted(FILES)
    sizes = {path.name: path.stat().st_size for path in folder.iterdir()}
    for file in folder.iterdir():
        file.write_text("mine")
    (folder / FILES[0]).unlink()
    assert duplex("export", session, "--to", folder) == 2
    assert f"{FILES[1]} exists already" in one_line(capsys)
    assert {path.read_text() for path in folder.iterdir()} == {"mine"}
    assert duplex("export", session, "--to", folder, "--force") == 0
    assert {path.name: path.stat().st_size for path in folder.iterdir()} == sizes
    (tmp_path / "file").touch()
    capsys.readouterr()
    assert duplex("export", session, "--to", tmp_path / "file") == 2
    assert "the name of a file" in one_line(capsys)


def test_a_demo_with_its_changing_calibrations_replays_bit_for_bit(tmp_path, capsys):
    saved, part, told = tmp_path / "demo.rrd", tmp_path / "part.rrd", tmp_path / "r.json"
    options = ("--no-viewer", "--seconds", "5.5", "--depth", "none", "--verbose")
    assert duplex("demo", *options, "--save", saved, "--report", told) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "At 4.4 s Kinect B exchanges left and right for a second; S* stays correct." in said
    assert "loses the left arm" not in said  # that comes later than the demo ends
    assert "Distance from the true joints" in said
    assert said.endswith("Next: --motion walk, --bad-setup, or your own sensors (duplex doctor).")
    assert {path.name for path in tmp_path.iterdir()} == {"demo.rrd", "r.json"}
    session = Session.open(saved)
    live, reviewed = json.loads(told.read_text(encoding="utf-8")), json.loads(json.dumps(report(session)))
    first = session.first_compared_frame
    same = fusion_figures(session.last_setup, session.rows, first).keys()  # of the whole session
    assert {name: live[name] for name in same} == {name: reviewed[name] for name in same}
    assert live["seconds"] > 4.5
    assert session.damage is None
    assert session.rows.truth is not None
    assert len(session.calibrations) > 1
    assert duplex("replay", saved, "--verify") == 0
    assert "bit for bit" in " ".join(capsys.readouterr().out.split())
    assert duplex("trim", saved, "--from", "2", "--save", part) == 0
    assert Session.open(part).calibrations[0][1].how == session.calibrations[-2][1].how
    assert duplex("replay", part, "--verify") == 0


FULL = "trim.rrd", "s.bvh", "s.C3D", "s.csv", "s.glb", "s.parquet", "s.trc", "fuse.rrd"


@pytest.mark.parametrize("name", FULL)
def test_a_full_disk_ends_with_one_line_and_no_file(session, tmp_path, capsys, name):
    command = {
        "trim.rrd": ("trim", session, "--save"),
        "fuse.rrd": ("fuse", *write_recordings(tmp_path), *QUICKLY, "--save"),
    }.get(name, ("export", session, "--to"))
    assert duplex(*command, tmp_path / name) == 0
    whole = (tmp_path / name).stat().st_size / 1024
    for kilobytes in (4, *(int(share * whole) for share in (0.5, 0.8))):
        with small_disk(tmp_path / str(kilobytes), kilobytes) as disk:
            assert duplex(*command, disk / name) == 2
            assert list(disk.iterdir()) == []
        said = one_line(capsys).rstrip()
        assert f"{name} could not be written: " in said
        assert said.endswith((": No space left on device.", "; the disk may be full."))
    if name == "fuse.rrd":  # Rerun's log of the failure would be lines beside it
        with small_disk(tmp_path / "small", int(0.9 * whole)) as disk:
            done = python("-m", "viewer_app.cli", *command, disk / name, timeout=120.0)
        assert done.returncode == 2
        assert re.fullmatch(r"duplex: .*\.rrd could not be written: .*\n", done.stderr)


# --- Files damaged at random: each is read, or refused with one line and exit code 2; never a traceback.


FRAMES = 12
_ODD = (
    *("nan", "-1", "1e999", "9" * 400, "null", "[]", "{}", '""', "é", "\0", "0x1", ",", "\n", "true"),
    "1e-320",
)


WRITERS = {
    ".csv": lambda path, at: write_view(path, KINECT_V2, at),
    ".json": write_json,
    ".skeleton": write_ntu,
}


@st.composite
def damage(draw):
    """Damages a file in one to three places: a cut, a flipped bit, lost, doubled or replaced bytes."""
    kind = st.sampled_from(("cut", "flip", "lose", "double", "odd"))
    place, length = st.floats(0, 1, exclude_max=True), st.integers(1, 200)
    wound = st.tuples(kind, place, length, st.sampled_from(_ODD))
    wounds = draw(st.lists(wound, min_size=1, max_size=3))

    def apply(data):
        for kind, place, length, odd in wounds:
            offset = int(place * len(data))
            before, there, after = data[:offset], data[offset : offset + length], data[offset + length :]
            if kind == "cut":
                data = before
            elif kind == "flip" and there:
                data = before + bytes([there[0] ^ (1 << length % 8)]) + there[1:] + after
            elif kind == "lose":
                data = before + after
            elif kind == "double":
                data = before + there + there + after
            elif kind == "odd":
                data = before + odd.encode() + there[length // 20 :] + after
        return data

    return apply


def _must_be_fused_or_refused(capsys, *arguments):
    code = duplex("fuse", *arguments, "--no-viewer")  # a traceback is an exception here
    said = capsys.readouterr().err
    if code == 0:
        assert said == ""
    else:
        assert code == 2
        assert said.startswith("duplex: ")
        assert said.endswith("\n")
        assert said.count("\n") == 1
        assert len(said) < 800, "one line that can be read"
    return code


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A's and B's recording in every format."""
    folder = tmp_path_factory.mktemp("whole")
    offset = moving(KINECT_V2, FRAMES)
    seen_by_b = A_FROM_B.inverse().apply(offset)
    return {
        ending: (write(folder / f"a{ending}", offset), write(folder / f"b{ending}", seen_by_b))
        for ending, write in WRITERS.items()
    }


@pytest.mark.parametrize("ending", WRITERS)
@given(wound=damage())
def test_damaged_skeletons_are_fused_or_refused(whole, tmp_path, capsys, ending, wound):
    a, b = whole[ending]
    damaged = tmp_path / f"damaged{ending}"
    damaged.write_bytes(wound(b.read_bytes()))
    _must_be_fused_or_refused(capsys, a, damaged)


@given(wound=damage())
def test_damaged_calibrations_are_used_or_refused(whole, tmp_path, capsys, wound):
    calibration = tmp_path / "calibration.json"
    calibration.write_bytes(wound(calibration_to_json(nominal_calibration(KINECT_V2)).encode()))
    _must_be_fused_or_refused(capsys, *whole[".csv"], "--calibrate", calibration)


# --- What commands print of sessions, of recordings and of motion capture.


@pytest.fixture
def folder(session, tmp_path, monkeypatch):
    """Sessions, one of them cut off and one of two people, recordings and motion capture."""
    session.rename(tmp_path / "w.rrd")
    (tmp_path / "[red]w.rrd").write_bytes((tmp_path / "w.rrd").read_bytes()[:-50])
    first = replace(calibration_of(KINECT_V2), bone_lengths=KINECT_V2.nominal_lengths)
    other = replace(first, bone_lengths=0.8 * first.bone_lengths, person=1)
    record_recalibrated(tmp_path / "two.rrd", frame_pairs(KINECT_V2, 30), [(0, first), (12, other)])
    write_recording(tmp_path / "a.csv")
    text = (tmp_path / "a.csv").read_text()
    (tmp_path / "no_joints.csv").write_text(text.replace("joint", "bone_of", 1))
    (tmp_path / "a.txt").write_text("a\n")
    points = np.random.default_rng(0).normal(0.0, 800.0, (50, 2, 3))
    points[:, 1] = np.nan
    for write in (write_c3d, write_trc):
        write(tmp_path / f"t.{write.__name__[-3:]}", ("LASI", "RASI"), np.arange(50) / 120.0, points)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("viewer_app.viewer.viewer_choice.why_no_window", lambda: "There is no display")
    return tmp_path


def write_recording(path):
    """Of millimetres, feet that were never seen, a column that is ignored, and a pause of two seconds."""
    positions = 1e3 * (moving(KINECT_V2, 40) + np.random.default_rng(0).normal(0.0, 0.005, (40, 25, 3)))
    positions[:, [KINECT_V2.joint(f"Foot{side}") for side in ("Left", "Right")]] = 0.0
    header, *rows = write_view(path, KINECT_V2, positions).read_text().splitlines()
    cells = [row.split(",") for row in rows]
    late = [[str(int(row[0]) + 2_000_000 * (k >= 500)), *row[1:]] for k, row in enumerate(cells)]
    path.write_text("\n".join([f"{header},remark", *(f"{','.join(row)},none" for row in late)]) + "\n")


@pytest.mark.usefixtures("folder", "without_plots")
def test_sentences_that_commands_print(capsys):
    check_sentences("printed", printed(capsys))


def test_what_is_in_a_recording_of_images(shared, capsys):
    assert duplex("info", shared / "azure" / "recording.mkv") == 0
    said = capsys.readouterr().out
    for words in ("NFOV_UNBINNED, standalone", "2020-08-31T15:20:37.000000Z", "5 frames per second, as the"):
        assert words in said


# --- ``duplex fuse`` at the command line: arguments, output and files.


@pytest.fixture
def recordings(tmp_path):
    """Two views of a person, each with 10 mm of noise."""
    return write_recordings(tmp_path)


def figures_of(path):
    return json.loads(path.read_text(encoding="utf-8"))


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


def test_a_session_survives_an_export_that_fails(recordings, tmp_path, monkeypatch, capsys):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("recordings.export.tables.write_npz", full)
    saved, table = tmp_path / "s.rrd", tmp_path / "s.npz"
    assert duplex("fuse", *recordings, *QUICKLY, "--save", saved, "--to", table) == 2
    assert "No space left" in capsys.readouterr().err
    assert not table.exists()
    assert len(Session.open(saved)) > 0
