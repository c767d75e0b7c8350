"""What cannot be done is refused in one line with exit code 2, and changes no file."""

import ast
import re
import shutil
import tomllib
from dataclasses import fields
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from devices.output_file import Hidden, KeptError
from fusion.body import AZURE_KINECT, KINECT_V1, KINECT_V2
from fusion.calibration.calibration import nominal_calibration
from recordings.calibration_file import calibration_to_json
from tests.helpers.command_line import FLAGS, command_lines, duplex, one_line, parsed, words_of
from tests.helpers.documents import ROOT
from tests.helpers.frame_pairs import frame_pairs
from tests.helpers.fused_runs import record_fused
from tests.helpers.recorded_pairs import write_pair, write_recordings, write_view
from tests.helpers.sentences import check_sentences, refusals
from tests.helpers.two_views import calibration_of, moving
from viewer_app.errors import UsageError
from viewer_app.flags import in_flags
from viewer_app.options.command_line import COMMANDS
from viewer_app.options.command_line import parsed as plan_of
from viewer_app.options.needs import NEEDS, refuse_without_effect
from viewer_app.options.sensing import FuseOptions
from viewer_app.output_files import check_outputs, outputs_of_one_run, write_text

__all__ = ["parsed"]  # fixtures


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A session and recordings, some of which cannot be fused."""
    _, b = write_recordings(tmp_path)
    pairs = frame_pairs(KINECT_V2, 90, gap=(30,), no_b=(20,))
    session = record_fused(tmp_path / "w.rrd", pairs, calibration_of(KINECT_V2)).path
    shutil.copy(session, tmp_path / "w.csv")
    (tmp_path / "bad.rrd").write_bytes(session.read_bytes()[:3000])
    (tmp_path / "cut.csv").write_text(b.read_text(encoding="utf-8")[:-30], encoding="utf-8")
    write_view(tmp_path / "later.csv", KINECT_V2, moving(KINECT_V2, 30), start_us=60_000_000)
    write_view(tmp_path / "v1.csv", KINECT_V1, moving(KINECT_V1, 30))
    (tmp_path / "junk.csv").write_text("no recording\n")
    (tmp_path / "empty").mkdir()
    (tmp_path / "bad.toml").write_text("[" * 5000)
    for name in ("taken.rrd", "taken.bvh", "taken.zip"):
        (tmp_path / name).touch()
    for body in (AZURE_KINECT, KINECT_V2):
        text = calibration_to_json(nominal_calibration(body))
        (tmp_path / f"{body.name}.json").write_text(text)
    (tmp_path / "tail.json").write_text(text.replace('"forearm_left"', '"tail"'))
    (tmp_path / "cut.json").write_text(text[:100])
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_sentences_of_refusals(folder, capsys):
    check_sentences("refused", refusals(capsys, folder))


def test_sentences_of_usage(parsed, capsys, tmp_path):
    check_sentences("usage", refusals(capsys, tmp_path))
    assert not parsed


# --- A mistake on the command line gives one line that names it, and exit code 2.


def test_a_long_value_is_shortened(capsys):
    assert duplex("demo", "--seconds", "7x" * 400) == 2
    assert len(one_line(capsys)) < 300


def test_the_version_is_that_of_the_package(capsys):
    assert duplex("--version") == 0
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert capsys.readouterr().out == f"duplex {project['version']}\n"


def test_the_overview_describes_each_command_in_its_first_paragraph(capsys):
    assert duplex("--help") == 0
    overview = capsys.readouterr().out
    assert duplex("batch", "--help") == 0
    page = capsys.readouterr().out
    for text in ("In a folder and its subfolders", "The exit code is"):
        assert text in page
        assert text not in overview


@pytest.mark.parametrize("command", COMMANDS)
def test_the_help_describes_every_option(command, capsys):
    assert duplex(*command.split(), "--help") == 0
    page = capsys.readouterr().out
    kind, _ = COMMANDS[command]
    for field in fields(kind):
        renamed = {"start": "from", "end": "to"} if command == "trim" else {}
        assert f"--{renamed.get(field.name, field.name).replace('_', '-')} " in page
    assert "None" not in page


def test_the_help_has_the_options_of_experts_last(capsys):
    assert duplex("live", "--help") == 0
    titles = re.findall(r"╭─ (.+?) ─", capsys.readouterr().out)
    groups = ["Sensors", "Body tracker", "Method", "Viewer", "Outputs", "For experts"]
    assert titles == ["Arguments", "Options", *groups]


def test_options_of_several_values_may_be_given_twice(parsed):
    assert duplex("live", "--zenoh", "k", "--zenoh-listen", "tcp/a:1", "--zenoh-listen", "tcp/b:2") == 0
    assert parsed[0].zenoh_listen == ("tcp/a:1", "tcp/b:2")


WORDS = (
    *("fuse", "demo", "trim", "tracker", "fetch", "a.csv", "x", "-1", "", "--", "é", "-h2", "-5e3", "nan"),
    *("--save", "--save=", "--force", "--seconds", "--method", "duplex", "--worst", "--evnt"),
    "--zenoh-listen",
)


@given(words=st.lists(st.sampled_from(WORDS), max_size=6))
def test_any_command_line_is_accepted_or_refused_in_one_line(words, parsed, capsys):
    before = len(parsed)
    code = duplex(*words)
    said = capsys.readouterr().err
    if code == 0:
        assert (len(parsed), said) == (before + 1, "")
    else:
        assert code == 2
        assert said.startswith("duplex: ")
        assert said.count("\n") == 1


# --- What a command writes is not written by another process at the same time.


def test_of_two_processes_on_one_output_the_second_is_refused(tmp_path):
    path = tmp_path / "s.json"
    others = Hidden(path, shared=True)  # a lock is of one opening, so this is like another process's
    with (
        pytest.raises(UsageError, match=r"s\.json is being written by another process"),
        outputs_of_one_run(),
    ):
        check_outputs([path], [], force=True)
    others.remove()
    with outputs_of_one_run():
        check_outputs([path], [], force=True)
        check_outputs([path], [], force=True)  # the same run may ask again
        with pytest.raises(BlockingIOError):
            Hidden(path, shared=True)
    assert list(tmp_path.iterdir()) == []


def test_what_was_made_meanwhile_is_told_in_one_line(tmp_path):
    path = tmp_path / "s.json"
    path.write_text("theirs")
    with pytest.raises(KeptError, match=r"another program made it meanwhile.*s-2\.json"):
        write_text(path, "ours", force=False)
    assert path.read_text() == "theirs"
    write_text(path, "ours", force=True)
    assert path.read_text() == "ours"


def test_of_two_batches_on_one_folder_the_second_is_refused(tmp_path, capsys):
    write_pair(tmp_path / "in")
    out = tmp_path / "out"
    out.mkdir()
    first = Hidden(out / "summary.parquet", shared=True)
    unfinished = out / ".partial" / "in.host-1"
    unfinished.mkdir(parents=True)
    assert duplex("batch", tmp_path / "in", "--out", out) == 2
    assert "is being written by another process" in one_line(capsys)
    assert unfinished.is_dir(), "the first one's work is left alone"
    first.remove()


def test_a_folder_that_the_system_refuses_is_told_in_one_line(tmp_path, capsys):
    for path in (tmp_path / ("a" * 300), tmp_path / ("a" * 300) / "b.rrd", tmp_path / "new" / ("a" * 300)):
        assert duplex("demo", "--no-viewer", "--record", path) == 2
        assert one_line(capsys) == f"duplex: The folder {path} cannot be created: File name too long.\n"
    assert list(tmp_path.iterdir()) == []


def test_a_run_that_records_nothing_leaves_no_folder(tmp_path, capsys, monkeypatch):
    def stopped(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("viewer_app.running.runner.first_run", stopped)
    there = tmp_path / "there"
    there.mkdir()
    for folder in (tmp_path / "above" / "new", there):
        assert duplex("demo", "--no-viewer", "--record", folder) == 130
        assert capsys.readouterr().err == "duplex: stopped\n"
    assert list(tmp_path.iterdir()) == [there]


# --- No option is without effect and without a word.


def test_sentences_of_options():
    """Each option with a need, on a line that does not meet it and on one that does."""
    refused, accepted = set(), set()

    def told(case):
        try:
            options = plan_of(case.split())
        except UsageError as refusal:
            refused.add(str(refusal).split()[0])
            return str(refusal)
        accepted.update(word for word in case.split() if word.startswith("--"))
        return f"accepted: {type(options).__name__}"

    check_sentences("options", told)
    assert refused <= accepted


@given(command_lines(), st.randoms(use_true_random=False))
def test_an_option_changes_the_plan_or_is_refused_in_one_line(line, random):
    """Whatever else is stated, and in any order."""
    command, stated, chosen = line
    try:
        plan, refusal = plan_of(words_of(command, stated)), ""
    except UsageError as error:
        plan, refusal = None, str(error)
    if plan is None:
        assert "\n" not in refusal
        assert any(f"--{FLAGS.get(name, name).replace('_', '-')}" in refusal for name in stated)
        return
    usual = plan_of(words_of(command, {name: of for name, of in stated.items() if name not in chosen}))
    for name in chosen:
        given_, default = getattr(plan, name), getattr(usual, name)
        value = stated[name]
        said = given_[0] if isinstance(given_, tuple) else given_
        assert said is True if value is None else type(said)(value) == said
        assert (plan != usual) or given_ == default
    arguments, *options = re.split(" (?=--)", " ".join(words_of(command, stated)))
    random.shuffle(options)
    assert plan_of(" ".join([arguments, *options]).split()) == plan


def test_every_need_is_shown_in_both_ways():
    page = (Path(__file__).parents[1] / "data" / "sentences" / "options.txt").read_text(encoding="utf-8")
    for need in NEEDS:
        flags = [f"--{name.replace('_', '-')}" for name in need.options]
        assert any(f"{flag} {need.what}." in page for flag in flags), need


def test_a_batch_refuses_an_option_that_no_pair_has_a_use_for(tmp_path, capsys):
    given = {"tracker": "k4abt", "unit": "cm"}
    of_csv, of_mkv = (FuseOptions(a=Path(f"a.{end}"), b=Path(f"b.{end}"), **given) for end in ("csv", "mkv"))
    refuse_without_effect(of_csv, of_mkv)
    for alone, option in ((of_csv, "tracker"), (of_mkv, "unit")):
        with pytest.raises(UsageError, match=f"^--{option} needs "):
            refuse_without_effect(alone, alone)
    write_pair(tmp_path / "pairs")
    assert duplex("batch", tmp_path / "pairs", "--out", tmp_path / "out", "--tracker", "k4abt") == 2
    assert "--tracker needs a recording of images" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


# --- Messages name parameters, and the command line makes flags of them.


_COMMAND = re.compile(
    r"\b(duplex|pip|npm|k4arecorder|pytest)\b|\{COMMAND|without --no-deps|"  # as somebody types it
    r"^--[a-z-]+(=[a-z:]+)?$|^ --"  # an argument of a command that is run, or a part of one to type
)
words = st.text(st.characters(blacklist_characters="`"), max_size=30)
names = st.from_regex(r"[a-z][a-z0-9_]{0,12}", fullmatch=True)


@given(before=words, name=names.filter(lambda name: name != "offset_ms"), value=words, after=words)
def test_a_parameter_becomes_a_flag_of_the_same_length_and_nothing_else_changes(before, name, value, after):
    flag = f"--{name.replace('_', '-')}"
    assert in_flags(f"{before} `{name}` {after}") == f"{before} {flag} {after}"
    assert in_flags(f"{before} (`{name}={value}`, {after}") == f"{before} ({flag} {value}, {after}"
    for of_file in (f"x`{name}`.csv", f"a/`{name}`", f"`{name}`.csv", f"`{name}`/b.csv", f"`{name}`-2"):
        assert in_flags(f"{before} {of_file}: {after}") == f"{before} {of_file}: {after}"
    assert len(in_flags(f"`{name}`")) == len(f"`{name}`")
    assert in_flags(before + after) == before + after
    assert in_flags(f"`duplex {name}`") == f"`duplex {name}`"


@pytest.mark.parametrize("package", ["fusion", "devices", "recordings"])
def test_no_text_below_the_command_line_names_a_flag(package):
    """But in a command that somebody is to type, and among the arguments of one that is run."""
    named = []
    for module in (ROOT / package).rglob("*.py"):
        tree = ast.parse(module.read_text(encoding="utf-8"))
        documents = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}  # docstrings
        inner = {
            id(part) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in node.values
        }
        for node in ast.walk(tree):
            if id(node) in documents | inner or not isinstance(node, ast.JoinedStr | ast.Constant):
                continue
            text = ast.unparse(node)[2 if isinstance(node, ast.JoinedStr) else 1 : -1]
            if re.search(r"--[a-z]", text) and not _COMMAND.search(text):
                named.append(f"{module.name}: {text}")
    assert named == []
