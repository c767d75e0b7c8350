"""The program as a person uses it, run in this process."""

from __future__ import annotations

import pytest

from viewer_app.cli import main


def duplex(*arguments: object) -> int:
    """The exit code of a command run in this process."""
    try:
        main([str(argument) for argument in arguments])
    except SystemExit as stop:
        return int(stop.code or 0)
    return 0


def one_line(capsys: pytest.CaptureFixture[str]) -> str:
    """The one line on stderr that says what is wrong."""
    said = capsys.readouterr().err
    assert said.startswith("duplex: ")
    assert said.count("\n") == 1
    assert "Traceback" not in said
    return said
