"""Every command in the documents is one that the program takes; those that need no sensor are run."""

import shlex

import pytest

from recordings import Session
from tests.helpers.command_line import duplex, parsed
from tests.helpers.documents import ROOT, commands_of, documents, mentions_of
from tests.helpers.recorded_pairs import write_recordings
from viewer_app.options.command_line import COMMANDS

__all__ = ["parsed"]  # a fixture

NAMES = [document.relative_to(ROOT).as_posix() for document in documents()]
RUN = ("demo", "fuse", "review", "info", "export", "trim", "replay", "compare")
"""Commands of the start page that are run; the others need sensors."""
WITH_VIEWER = ("demo", "fuse", "review", "replay", "compare")


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


def test_the_start_page_works_from_top_to_bottom(tmp_path, monkeypatch):
    write_recordings(tmp_path)
    monkeypatch.chdir(tmp_path)
    for command in commands_of(ROOT / "docs" / "start.md"):
        _, name, *rest = shlex.split(command)
        if name not in RUN:
            continue
        rest += ["--no-viewer"] if name in WITH_VIEWER else []
        rest += ["--seconds", "1", "--depth", "none"] if name == "demo" else []  # the last --seconds counts
        assert duplex(name, *rest) == 0, command
    assert len(Session.open(tmp_path / "walk.rrd")) == 70
    assert (tmp_path / "demo.html").stat().st_size > 10_000
    assert (tmp_path / "walk.bvh").exists()
