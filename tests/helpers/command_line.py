"""Runs the program's commands in this process."""

from types import SimpleNamespace

import pytest

from viewer_app import cli


@pytest.fixture
def parsed(monkeypatch):
    """Options of the commands that were accepted; nothing is carried out."""
    seen = []
    stand_in = SimpleNamespace(import_module=lambda _: SimpleNamespace(run=seen.append))
    monkeypatch.setattr(cli, "importlib", stand_in)
    return seen


def duplex(*arguments):
    """Runs a command in this process and returns its exit code."""
    try:
        cli.main([str(argument) for argument in arguments])
    except SystemExit as stop:
        return int(stop.code or 0)
    return 0


def one_line(capsys):
    """Returns the one line of error that a command printed."""
    said = capsys.readouterr().err
    assert said.startswith("duplex: ")
    assert said.count("\n") == 1
    assert "Traceback" not in said
    return said
