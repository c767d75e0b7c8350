"""A mistake on the command line gives one line that names it, and exit code 2."""

from __future__ import annotations

import shlex
import tomllib
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.helpers.command_line import duplex, one_line
from tests.helpers.documents import ROOT
from viewer_app import cli
from viewer_app.options.command_line import COMMANDS
from viewer_app.options.usage import _options, mistake


@pytest.fixture
def parsed(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Options of the commands that were accepted; nothing is carried out."""
    seen: list[Any] = []
    stand_in = SimpleNamespace(import_module=lambda _: SimpleNamespace(run=seen.append))
    monkeypatch.setattr(cli, "importlib", stand_in)
    return seen


@pytest.mark.parametrize(
    ("command", "line"),
    [
        ("review w.rrd --evnt 2", "unknown option --evnt; did you mean --event? (duplex review --help)"),
        ("review w.rrd --event x", "--event must be a whole number; got 'x' (duplex review --help)"),
        ("review w.rrd --event=", "--event must be a whole number; got '' (duplex review --help)"),
        ("review w.rrd --event", "--event needs a whole number (duplex review --help)"),
        ("fuse a.csv b.csv --save", "--save needs a file name (duplex fuse --help)"),
        ("fuse a.csv b.csv --save --force", "--save needs a file name (duplex fuse --help)"),
        ("fuse a.csv", "missing argument B (duplex fuse --help)"),
        ("fuse a.csv b.csv c.csv", "one argument too many: 'c.csv' (duplex fuse --help)"),
        ("fuse a.csv b.csv --no-viewer=yes", "--no-viewer takes no value; got 'yes' (duplex fuse --help)"),
        (
            "fuse a.csv b.csv --method foo",
            "--method must be duplex, paper or published; got 'foo' (duplex fuse --help)",
        ),
        ("live --fps 31", "--fps must be 5, 15 or 30; got '31' (duplex live --help)"),
        (
            "trim w.rrd --frm 3 --save x.rrd",
            "unknown option --frm; did you mean --from? (duplex trim --help)",
        ),
        ("trim w.rrd", "missing option --save (duplex trim --help)"),
        (
            "bench speed --recording a.csv",
            "--recording needs 2 values, each a file name; got only 'a.csv' (duplex bench speed --help)",
        ),
        ("fus a.csv b.csv", "unknown command fus; did you mean fuse? (duplex --help)"),
        (
            "bench accurcy",
            "unknown command bench accurcy; did you mean bench accuracy? (duplex bench --help)",
        ),
        ("bench", "name a command of bench: accuracy, real, speed, outputs (duplex bench --help)"),
        ("--zzz", "unknown option --zzz; name a command first: demo, live, …"),
        ("xyz", "unknown command xyz; there are demo, live, …"),
        ("", "name a command: demo, live, …"),
    ],
)
def test_the_line_names_the_mistake(
    command: str, line: str, parsed: list[Any], capsys: pytest.CaptureFixture[str]
) -> None:
    assert duplex(*shlex.split(command)) == 2
    said = one_line(capsys).removeprefix("duplex: ").rstrip("\n")
    assert not parsed
    if line.endswith("…"):
        assert said.startswith(line.removesuffix("…"))
        assert said.endswith(" (duplex --help)")
    else:
        assert said == line


def test_a_long_value_is_shortened(capsys: pytest.CaptureFixture[str]) -> None:
    assert duplex("demo", "--seconds", "7x" * 400) == 2
    assert len(one_line(capsys)) < 200


def test_the_version_is_that_of_the_package(capsys: pytest.CaptureFixture[str]) -> None:
    assert duplex("--version") == 0
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert capsys.readouterr().out == f"duplex {project['version']}\n"


def test_every_option_of_the_help_is_known_to_the_explanation(capsys: pytest.CaptureFixture[str]) -> None:
    """An option that tyro accepts and the explanation does not know would be called unknown."""
    for name, (kind, _) in COMMANDS.items():
        assert duplex(*name.split(), "--help") == 0
        help_text = capsys.readouterr().out
        for option in _options(kind):
            assert option.positional or f"{option.name} " in help_text.replace("\n", " "), name


def test_the_overview_describes_each_command_in_its_first_paragraph(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert duplex("--help") == 0
    overview = capsys.readouterr().out
    assert duplex("batch", "--help") == 0
    page = capsys.readouterr().out
    for text in ("In FOLDER and its subfolders", "The exit code is"):
        assert text in page
        assert text not in overview


@pytest.mark.parametrize("command", COMMANDS)
def test_the_help_names_what_an_option_takes(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Not the Python type of an optional value, {None}|PATH."""
    assert duplex(*command.split(), "--help") == 0
    assert "{None}" not in capsys.readouterr().out


WORDS = (
    *("fuse", "demo", "bench", "speed", "tracker", "a.csv", "x", "-1", "", "--", "é", "-h2", "-5e3", "nan"),
    *("--save", "--save=", "--force", "--seconds", "--method", "duplex", "--recording", "--evnt", "--angles"),
)


@settings(
    max_examples=60,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(words=st.lists(st.sampled_from(WORDS), max_size=6))
def test_any_command_line_is_accepted_or_refused_in_one_line(
    words: list[str], parsed: list[Any], capsys: pytest.CaptureFixture[str]
) -> None:
    before = len(parsed)
    code = duplex(*words)
    said = capsys.readouterr().err
    if code == 0:
        assert (len(parsed), said) == (before + 1, "")
    else:
        assert code == 2
        assert said.startswith("duplex: ")
        assert said.count("\n") == 1


def test_a_mistake_that_only_tyro_sees_has_a_line_too() -> None:
    commands = {name: kind for name, (kind, _) in COMMANDS.items()}
    assert mistake(["fuse", "a.csv", "b.csv"], commands) == "the command cannot be read (duplex fuse --help)"
