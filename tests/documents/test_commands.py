"""Every command in the documents is one that the program takes; tables of one's own become recordings."""

import re
import shlex

import numpy as np
import pandas
import pytest

from devices.skeletons.stated_format import AXES, StatedFormat
from fusion import KINECT_V2
from fusion.body import BODIES
from recordings import Session, fuse
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


START = ROOT / "docs" / "start.md"
(FROM_ARRAYS,) = python_of(START)
AXES_ROWS = re.findall(
    r"^\| `(?P<name>\w+)` \| [^|]* \| (?P<axes>−?[XYZ], −?[XYZ], −?[XYZ]) \|$",
    START.read_text(encoding="utf-8"),
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
    shown = {name: axes.replace("−", "-").replace(" ", "").lower() for name, axes in AXES_ROWS}
    assert shown == AXES


def test_the_table_of_names_is_one_of_the_program(tmp_path):
    (text,) = re.findall(r"```toml\n(.*?)```", START.read_text(encoding="utf-8"), re.DOTALL)
    (tmp_path / "mine.toml").write_text(text, encoding="utf-8")
    labels = ["LeftUpLeg", "crown", "chin"]
    points = StatedFormat(names=str(tmp_path / "mine.toml")).points("a.csv", labels)
    assert {points.body.joints[joint]: of for joint, of in points.groups.items()} == {
        points.body.joints[points.body.joint("hip left")]: [0],
        points.body.joints[points.body.joint("head")]: [1, 2],
    }


def test_the_names_of_the_joints_are_those_of_the_bodies():
    rows = re.findall(
        r"^\| `(\w+)` \((\d+)\) \| (.*) \+ _?L\w+ or _?R\w+ \|$", START.read_text("utf-8"), re.M | re.I
    )
    assert [name for name, *_ in rows] == list(BODIES)
    for name, count, text in rows:
        middle, _, sided = text.partition(", and ")
        mark = "_" if middle.isupper() else ""
        sides = ("LEFT", "RIGHT") if mark else ("Left", "Right")
        names = middle.split(", ") + [f"{n}{mark}{side}" for n in sided.split(", ") for side in sides]
        assert set(names) == set(BODIES[name].joints)
        assert len(names) == int(count)
