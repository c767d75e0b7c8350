"""Every command in the documents is one that the program takes; tables of one's own become recordings."""

import re
import shlex
from dataclasses import fields
from io import StringIO

import numpy as np
import pandas
import pytest

from devices.skeletons.name_tables import points_of
from devices.skeletons.stated_format import AXES
from fusion import KINECT_V2
from fusion.body import BODIES
from recordings import Session, SessionArrays, fuse
from recordings.quality.figures import report
from tests.experiments import example_recordings
from tests.helpers.command_line import duplex, parsed
from tests.helpers.documents import ROOT, commands_of, documents, mentions_of, python_of
from tests.helpers.recorded_pairs import write_recordings, write_view
from tests.helpers.two_views import A_FROM_B, moving
from viewer_app.options.command_line import COMMANDS

__all__ = ["parsed"]  # a fixture

NAMES = [document.relative_to(ROOT).as_posix() for document in documents()]


@pytest.mark.parametrize("name", NAMES)
def test_every_command_is_understood(name, parsed, capsys):
    commands = list(commands_of(ROOT / name))
    refused = [command for command in commands if duplex(*shlex.split(command)[1:]) != 0]
    assert not refused, capsys.readouterr().err
    # --help ends before anything is carried out
    assert len(parsed) == sum("--help" not in command for command in commands)


def test_the_documents_have_commands():
    assert sum(len(list(commands_of(document))) for document in documents()) > 30


def test_commands_in_sentences_exist():
    known = {name for command in COMMANDS for name in (command, command.partition(" ")[0])}
    for document in documents():
        for mention in mentions_of(document):
            words = mention.split()
            assert {words[1], " ".join(words[1:3])} & known, f"{document.name}: {mention}"


EXTRAS = {
    "cluster": "--scheduler",
    "export": r"\.(c3d|glb)\b",
    "lsl": r"--lsl\b",
    "mocap": r"--motion \S+\.bvh",
    "ros": r"\.mcap\b",
    "zenoh": r"--zenoh\b|zenoh:",
}


@pytest.mark.parametrize("name", NAMES)
def test_a_page_names_the_extra_that_its_lines_need(name):
    """Their comments count: they promise it likewise."""
    text = (ROOT / name).read_text(encoding="utf-8")
    lines = "\n".join(re.findall(r"^```sh\n(.*?)^```", text, re.MULTILINE | re.DOTALL))
    needed = {extra for extra, pattern in EXTRAS.items() if re.search(pattern, lines)}
    assert {extra for extra in needed if not re.search(rf'\[[a-z,]*\b{extra}\b[a-z,]*\]"', text)} == set()


def test_options_are_accepted_by_the_commands_that_the_page_on_the_viewer_names():
    """A sentence that names none is about those of the sentence before."""
    page = (ROOT / "docs" / "viewer.md").read_text(encoding="utf-8").partition("\n## ")[0]
    found, commands = 0, []
    for sentence in re.split(r"\. |\n\n", page):
        spans = [span.removeprefix("duplex ") for span in re.findall("`([^`]*)`", sentence)]
        commands = [span for span in spans if span in COMMANDS] or commands
        for option in (span.split()[0] for span in spans if span.startswith("--")):
            for command in commands:
                accepted = {field.name.replace("_", "-") for field in fields(COMMANDS[command][0])}
                assert option[2:] in accepted, f"{command} {option}"
                found += 1
    assert found > 2


FILES = ROOT / "docs" / "files.md"
(FROM_ARRAYS,) = python_of(FILES)
AXES_ROWS = re.findall(
    r"^\| `(?P<name>\w+)` \| [^|]* \| `(?P<axes>[-xyz,]+)` \|$",
    FILES.read_text(encoding="utf-8"),
    re.MULTILINE,
)


@pytest.fixture
def own_tables(tmp_path, monkeypatch):
    """Writes ``mine_a.csv`` and ``mine_b.csv`` in the current folder; the session expected of them."""
    expected = fuse(*write_recordings(tmp_path))
    for sensor in "ab":
        file = tmp_path / f"{sensor}.csv"
        table = pandas.read_csv(file)
        people = {"person": table["body"], "part": table["joint"].str.lower()}
        places = {"X": -1000 * table["x"], "Y": -1000 * table["y"], "Z": 1000 * table["z"]}
        mine = pandas.DataFrame({"seconds": table["time_us"] * 1e-6, **people, **places, "confidence": 0.5})
        mine.to_csv(tmp_path / f"mine_{sensor}.csv", index=False)
        file.unlink()
    monkeypatch.chdir(tmp_path)
    return expected


def test_tables_in_other_units_and_axes_give_the_same_session(own_tables, tmp_path):
    """Of columns in other spellings."""
    assert (
        duplex("fuse", "mine_a.csv", "mine_b.csv", "--no-viewer", "--save", "walk.rrd", "--axes", "kinect")
        == 0
    )
    session = Session.open(tmp_path / "walk.rrd")
    np.testing.assert_array_equal(session.time_ns, own_tables.time_ns)
    # positions went through millimetres in text; float32 has 2e-7 m at 3 m, and fusion adds some
    np.testing.assert_allclose(session.fused, own_tables.fused, atol=1e-5)


def test_arrays_become_a_recording(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    positions, joints = moving(KINECT_V2, 70), KINECT_V2.joints
    exec(FROM_ARRAYS, {"positions": positions, "joints": joints, "seconds": np.arange(70) / 30})
    session = fuse("a.csv", write_view(tmp_path / "b.csv", KINECT_V2, A_FROM_B.inverse().apply(positions)))
    assert session.body is KINECT_V2
    np.testing.assert_allclose(session.skeleton_a.positions, positions, atol=1e-6)
    np.testing.assert_allclose(session.time_ns * 1e-9, np.arange(70) / 30, atol=1e-6)


def test_the_axes_are_those_of_the_option():
    assert dict(AXES_ROWS) == AXES


def test_the_table_of_names_is_one_of_the_program(tmp_path):
    (text,) = re.findall(r"```toml\n(.*?)```", FILES.read_text(encoding="utf-8"), re.DOTALL)
    (tmp_path / "mine.toml").write_text(text, encoding="utf-8")
    points, _ = points_of("a.csv", ["crown", "chin"], str(tmp_path / "mine.toml"))
    assert points.groups == {points.body.joint("head"): [0, 1]}


def test_the_names_of_the_joints_are_those_of_the_bodies():
    page = FILES.read_text("utf-8")
    (shared,) = re.findall(r"All have (.*?) \+ Left or Right", page, re.DOTALL)
    rows = re.findall(r"^- `(\w+)`: ([^;\n]*)(?:; (.*) \+ _?L\w+ or _?R\w+)?$", page, re.M)
    assert [name for name, *_ in rows] == list(BODIES)
    for name, middle, sided in rows:
        names = [*re.split(r",\s+", f"{shared}, {sided}".strip(", "))]
        both = [f"{each}{side}" for each in names for side in ("Left", "Right")]
        written = {each.replace("_", "").lower() for each in (*middle.split(", "), *both)}
        assert written == {joint.replace("_", "").lower() for joint in BODIES[name].joints}


def test_the_page_of_exports_has_every_key_of_a_report_and_of_arrays(tmp_path):
    page = (ROOT / "docs" / "exports.md").read_text("utf-8")
    _, _, tables = page.partition("## Arrays")
    arrays, _, figures = tables.partition("## Report")
    session = fuse(*write_recordings(tmp_path))
    (block,) = re.findall(r"```text\n(.*?)```", figures, re.DOTALL)
    always = block.partition("live only:")[0].replace(",\n", ", ")
    rows = re.findall(r"^(\w+(?:, \w+)*)  ", always, re.MULTILINE)
    written = report(session).keys() | {"gait"}  # which only the file has
    assert {name for row in rows for name in row.split(", ")} == written
    session.export(tmp_path / "s.npz")
    own = {each.name for each in fields(SessionArrays)}
    with np.load(tmp_path / "s.npz") as kept:
        assert {key for key in kept if f"`{key}`" not in arrays} <= own


def test_the_example_recordings_are_those_of_their_command():
    for name, text in example_recordings.recordings():
        kept, made = (pandas.read_csv(file) for file in (example_recordings.FOLDER / name, StringIO(text)))
        exact = ["time_us", "body", "joint", "state"]
        pandas.testing.assert_frame_equal(kept[exact], made[exact])
        # rounded to 1 mm, which another processor's last digit may turn
        np.testing.assert_allclose(kept[list("xyz")], made[list("xyz")], atol=1.1e-3)
