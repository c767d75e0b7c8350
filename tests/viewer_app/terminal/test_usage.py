"""A mistake on the command line gives one line that names it, and exit code 2."""

import re
import tomllib
from dataclasses import fields

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.helpers.command_line import duplex, one_line, parsed
from tests.helpers.documents import ROOT
from viewer_app.options.command_line import COMMANDS

__all__ = ["parsed"]  # a fixture


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
