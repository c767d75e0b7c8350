"""``duplex replay``, ``compare``, ``review``, ``export``, ``trim`` and ``info`` on one session."""

import json
import re
import shutil
from dataclasses import replace
from html import unescape
from pathlib import Path

import numpy as np
import pytest
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
from recordings.quality.figures import fusion_figures, report
from recordings.quality.per_second import SecondQuality
from recordings.session import Session
from tests.helpers.command_line import duplex, one_line
from tests.helpers.frame_pairs import frame_pairs
from tests.helpers.fused_runs import record_fused
from tests.helpers.machine import small_disk
from tests.helpers.motion_capture import write_c3d, write_trc
from tests.helpers.programs import python
from tests.helpers.recalibrated import record_recalibrated
from tests.helpers.recorded_pairs import write_json, write_ntu, write_recordings, write_view
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


def test_no_line_is_wrapped_where_no_terminal_reads_it(session, tmp_path, capsys):
    path = tmp_path / f"{'long' * 40}.rrd"
    assert duplex("trim", session, "--to", 1, "--save", path) == 0
    assert duplex("info", path) == 0
    assert duplex("review", path, "--no-viewer") == 0
    printed = capsys.readouterr().out.splitlines()
    assert f"Saved {path}: 31 of 90 frames." in printed
    assert any(line.split() == ["session", str(path)] for line in printed)
    verdict = next(line for line in printed if line.startswith("Verdict"))
    assert len(verdict) > 80 or verdict.endswith(".")


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

    report, saved = tmp_path / "r.json", tmp_path / "again.rrd"
    monkeypatch.setattr("viewer_app.viewer.viewer_choice.why_no_window", lambda: None)
    monkeypatch.setattr("viewer_app.viewer.file_window.start_viewer", no_window)
    assert duplex("replay", session, "--report", report, "--save", saved) == 2
    assert capsys.readouterr().err == "duplex: no driver\n"
    assert len(Session.open(saved)) == 90
    assert report.exists()
    assert duplex("compare", session, saved) == 2
    assert "S* is the same in every frame they share." in capsys.readouterr().out


def test_where_no_display_is_a_replay_and_a_comparison_say_so(session, monkeypatch, capsys):
    monkeypatch.setattr("viewer_app.viewer.viewer_choice.why_no_window", lambda: "There is no display")
    for command in (("replay", session), ("compare", session, session)):
        assert duplex(*command) == 0
        assert "There is no display; no window opens." in capsys.readouterr().out
        assert duplex(*command, "--no-viewer") == 0
        assert "no window" not in capsys.readouterr().out


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


def test_a_replay_with_other_settings_is_compared_with_the_first(session, tmp_path, capsys):
    other, compared = tmp_path / "equal.rrd", tmp_path / "compared.rrd"
    assert duplex("replay", session, "--no-viewer", "--method", "paper", "--save", other) == 0
    capsys.readouterr()
    assert duplex("compare", session, other, "--no-viewer", "--save", compared, "--worst", "2") == 0
    said = capsys.readouterr().out
    assert "method: duplex against paper" in said
    assert "90 frames in common" in said
    assert said.count(" differs by ") == 2  # at least a second apart, of three
    assert compared.stat().st_size > 10_000
    assert duplex("compare", session, other, "--no-viewer", "--worst", "0") == 0
    said = capsys.readouterr().out
    assert " differs by " not in said
    assert "the same in every frame" not in said
    assert duplex("compare", session, session, "--no-viewer") == 0
    assert "S* is the same in every frame" in capsys.readouterr().out


def test_the_window_of_a_comparison_opens_where_s_star_differs_most(session, tmp_path, monkeypatch):
    other, opened = tmp_path / "paper.rrd", []
    assert duplex("replay", session, "--no-viewer", "--method", "paper", "--save", other) == 0
    monkeypatch.setattr("viewer_app.viewer.viewer_choice.why_no_window", lambda: None)
    monkeypatch.setattr("viewer_app.viewer.file_window.show", lambda _, at_ns: opened.append(at_ns))
    for worst in ("0", "2"):
        assert duplex("compare", session, other, "--worst", worst) == 0
    one, two = Session.open(session), Session.open(other)
    apart = np.nanmax(np.linalg.norm(one.fused - two.fused, axis=2), axis=1, initial=0.0)
    assert opened == 2 * [one.time_ns[np.argmax(apart)]]
    assert duplex("compare", session, session) == 0
    assert opened[2:] == [0]


@pytest.mark.usefixtures("without_plots")
def test_names_with_brackets_are_printed_as_they_are(session, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "300")
    name = "[/bold]a[red].rrd"
    path = Path(name)
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(session.read_bytes()[:-50])  # reported as cut off, with its name
    out = path.with_suffix("")
    for command in (
        ("info", path),
        ("replay", path, "--no-viewer", "--save", f"{out}_2.rrd", "--report", f"{out}.json"),
        ("review", path, "--no-viewer", "--html", f"{out}.html"),
        ("compare", path, path, "--no-viewer", "--save", f"{out}_3.rrd"),
        ("export", path, "--to", f"{out}.csv"),
        ("trim", path, "--to", "1", "--save", f"{out}_4.rrd"),
    ):
        assert duplex(*command) == 0
        said = capsys.readouterr().out
        assert name in said
        assert all(str(part) in said for part in command[3:] if str(part).endswith(("_2.rrd", ".html")))


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


@pytest.mark.parametrize("command", [("trim", "--save", "good.rrd"), ("export", "--to", "good.npz")])
def test_only_the_good_seconds_are_taken_and_a_line_says_what_is_left_out(
    command, session, tmp_path, capsys, monkeypatch
):
    whole, (verb, option, name) = Session.open(session), command
    frames = len(whole)
    for good in (np.arange(frames) // 30 != 1, np.full(frames, True), np.full(frames, False)):
        path = tmp_path / name
        path.unlink(missing_ok=True)
        seconds = tuple(SecondQuality(float(k), "good" if good[30 * k + 5] else "poor", "") for k in range(3))
        monkeypatch.setattr("recordings.quality.per_second.quality_per_second", lambda _, each=seconds: each)
        assert duplex(verb, session, "--good", option, path) == (0 if good.any() else 2)
        told = capsys.readouterr()
        if not good.any():
            assert "No second of" in told.err
            assert not path.exists()
            continue
        kept = Session.open(session).good_frames
        fused = Session.open(path).fused if verb == "trim" else np.load(path)["fused"]
        np.testing.assert_allclose(fused, whole.fused[kept], atol=2e-7)
        left_out = f"Left out: {frames - kept.sum()} of {frames} frames, in seconds that are not good: 1–2 s."
        assert (left_out in told.out) == (not good.all())


def test_two_sessions_are_on_one_page(session, tmp_path, capsys):
    pytest.importorskip("matplotlib", reason="the page's plots need matplotlib")
    other, path = tmp_path / "<b>other.rrd", tmp_path / "c.html"
    assert duplex("replay", session, "--method", "paper", "--no-viewer", "--save", other) == 0
    capsys.readouterr()
    assert duplex("compare", session, other, "--no-viewer", "--html", path) == 0
    said, page = " ".join(capsys.readouterr().out.split()), path.read_text(encoding="utf-8")
    assert f"Wrote {path}." in said
    assert "<b>other" not in page
    text = unescape(page)
    for words in (session.name, other.name, "method: duplex against paper"):
        assert words in text
    for line in re.findall(r"<p><strong>(.*?)</strong>: (.*?)</p>", text):
        assert " ".join(line) in said
    for when, words in re.findall(r"<td>([\d.]+) s</td><td>(frame .*?)</td>", text):
        assert f"{when} s {words}" in said
    for each in map(Session.open, (session, other)):
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


def test_info_says_what_is_in_it_and_what_is_missing(session, tmp_path, capsys):
    assert duplex("info", session) == 0
    said = capsys.readouterr().out
    for words in ("kinect_v2, 25 joints", "90 in", "A 90, B 89", "85° apart", "whole"):
        assert words in said
    assert "Calibrated: known truth" in said
    assert all(reason in said for reason in Session.open(session).verdict.reasons)
    cut = tmp_path / "cut.rrd"
    cut.write_bytes(session.read_bytes()[:-50])
    assert duplex("info", cut) == 0
    assert "cut off" in capsys.readouterr().out


@pytest.mark.parametrize("person", [0, 1])
def test_info_says_from_when_several_people_are_there(person, tmp_path, capsys):
    first = replace(calibration_of(KINECT_V2), bone_lengths=KINECT_V2.nominal_lengths)
    other = replace(first, bone_lengths=0.8 * first.bone_lengths, person=person)
    path = tmp_path / "s.rrd"
    record_recalibrated(path, frame_pairs(KINECT_V2, 30), [(0, first), (12, other)])
    assert duplex("info", path) == 0
    assert ("1.75 m from 0.0 s, 1.40 m from 0.4 s" in capsys.readouterr().out) is bool(person)


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


@pytest.mark.parametrize("ending", ["rrd", "bvh", "C3D", "csv", "glb", "parquet", "trc"])
def test_a_full_disk_ends_with_one_line_and_no_file(session, tmp_path, capsys, ending):
    name = f"s.{ending}"
    command = ("trim", session, "--save") if ending == "rrd" else ("export", session, "--to")
    assert duplex(*command, tmp_path / name) == 0
    whole = (tmp_path / name).stat().st_size / 1024
    for kilobytes in (4, *(int(share * whole) for share in (0.5, 0.8))):
        with small_disk(tmp_path / str(kilobytes), kilobytes) as disk:
            assert duplex(*command, disk / name) == 2
            assert list(disk.iterdir()) == []
        said = one_line(capsys).rstrip()
        assert f"{name} could not be written: " in said
        assert said.endswith((": No space left on device.", "; the disk may be full."))


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


# --- ``duplex info`` of recordings and of motion capture; of sessions see test_session_commands.


FEET = [KINECT_V2.joint(f"Foot{side}") for side in ("Left", "Right")]


def told(capsys, *arguments):
    """The rows that were printed, by name, and the code and errors."""
    code = duplex("info", *arguments)
    printed = capsys.readouterr()
    rows = (line.strip().partition("  ") for line in printed.out.splitlines())
    return {name: value.strip() for name, _, value in rows}, code, printed.err


@pytest.fixture
def recording(tmp_path):
    """Of millimetres, feet that were never seen, a column that is ignored, and a pause of two seconds."""
    positions = 1e3 * (moving(KINECT_V2, 40) + np.random.default_rng(0).normal(0.0, 0.005, (40, 25, 3)))
    positions[:, FEET] = 0.0
    path = write_view(tmp_path / "a.csv", KINECT_V2, positions)
    header, *rows = path.read_text().splitlines()
    cells = [row.split(",") for row in rows]
    late = [[str(int(row[0]) + 2_000_000 * (k >= 500)), *row[1:]] for k, row in enumerate(cells)]
    path.write_text("\n".join([f"{header},remark", *(f"{','.join(row)},none" for row in late)]) + "\n")
    return path


def test_what_is_in_a_recording_of_skeletons(recording, capsys):
    rows, code, _ = told(capsys, recording)
    assert code == 0
    assert rows["joints"] == "23 of 25 of kinect_v2"
    assert rows["never seen"] == "FootLeft, FootRight"
    assert rows["people"] == "'0' in 40 frames"
    assert rows["frames"] == "40 in 3.30 s, 30.0 per second"
    assert rows["gaps"] == "1, of 2.03 s at 0.63 s"
    assert rows["unit"].startswith("millimetres; the person is 2.6")
    assert rows["ignored"] == "columns remark"
    assert "read as millimetres" in rows["note"]
    assert rows["likely unit"].startswith("mm 0.0, ")
    assert rows["fuse it"] == f"duplex fuse {recording} OTHER.csv --unit-a mm --save s.rrd"
    rows, code, _ = told(capsys, recording, "--unit", "mm")
    assert "note" not in rows
    assert rows["fuse it"].endswith("--unit-a mm --save s.rrd")


def test_a_recording_that_cannot_be_read_is_described_and_says_why(recording, capsys):
    recording.write_text(recording.read_text().replace("joint", "bone_of", 1))
    rows, code, errors = told(capsys, recording)
    assert code == 2
    assert rows["begins with"] == ascii(recording.read_text()[:60])
    assert rows["format"].endswith("it cannot be read")
    assert "no column joint" in errors
    other = recording.with_suffix(".txt")
    other.write_text("a\n")
    rows, code, errors = told(capsys, other)
    assert (code, rows["file"]) == (2, "a.txt, 0 kB")
    assert ".txt is not a format that can be read" in errors


@pytest.mark.parametrize("write", [write_c3d, write_trc])
def test_what_is_in_motion_capture(tmp_path, capsys, write):
    path = tmp_path / {"write_c3d": "t.c3d", "write_trc": "t.trc"}[write.__name__]
    points = np.random.default_rng(0).normal(0.0, 800.0, (50, 2, 3))
    points[:, 1] = np.nan
    rows, code, _ = told(capsys, write(path, ("LASI", "RASI"), np.arange(50) / 120.0, points))
    assert code == 0
    assert rows["points"] == "2: LASI, RASI"
    assert rows["never seen"] == "RASI"
    assert rows["frames"] == "50 in 0.41 s, 120.0 per second"
    assert rows["compare it"] == f"duplex compare s.rrd {path}"


def test_what_is_in_a_recording_of_images(shared, capsys):
    rows, code, _ = told(capsys, shared / "azure" / "recording.mkv")
    assert code == 0
    assert rows["sensor"].endswith("NFOV_UNBINNED, standalone")
    assert rows["recorded"] == "2020-08-31T15:20:37.000000Z"
    assert "5 frames per second, as the file states" in rows["duration"]
