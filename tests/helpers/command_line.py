"""Runs the program's commands in this process."""

from __future__ import annotations

import pytest

from viewer_app.cli import main


def duplex(*arguments: object) -> int:
    """Runs a command in this process and returns its exit code."""
    try:
        main([str(argument) for argument in arguments])
    except SystemExit as stop:
        return int(stop.code or 0)
    return 0


def one_line(capsys: pytest.CaptureFixture[str]) -> str:
    """Returns the one line of error that a command printed."""
    said = capsys.readouterr().err
    assert said.startswith("duplex: ")
    assert said.count("\n") == 1
    assert "Traceback" not in said
    return said
