"""The line after saving that says how to view the session on this machine."""

from __future__ import annotations

import io
import shlex
import sys
from pathlib import Path

import pytest
from rich.console import Console

from viewer_app.report import terminal


@pytest.mark.parametrize(
    ("display", "command"),
    [(True, "duplex review a/long/folder/s.rrd"), (False, "duplex review a/long/folder/s.rrd --html")],
)
def test_the_next_step_is_one_line_that_works_without_a_display(
    display: bool, command: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(terminal, "has_display", lambda: display)
    monkeypatch.setattr("sys.argv", ["pytest"])
    monkeypatch.chdir(tmp_path)
    file = Path("a/long/folder/s.rrd")
    file.parent.mkdir(parents=True)
    file.write_bytes(bytes(122_400_000))
    out = io.StringIO()
    terminal.say_saved(Console(file=out, width=40), file)
    (line,) = out.getvalue().splitlines()
    assert f"{file}, 122 MB" in line
    assert command in line
    assert line.endswith(".html") is not display


@pytest.mark.skipif(sys.platform == "win32", reason="quotes of a POSIX shell")
def test_the_command_can_be_pasted_whatever_the_file_is_called(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(terminal, "has_display", lambda: True)
    monkeypatch.setattr("sys.argv", ["pytest"])
    file = tmp_path / "it's ö 空白.rrd"
    file.write_bytes(b"0")
    out = io.StringIO()
    terminal.say_saved(Console(file=out, width=40), file)
    *_, command = out.getvalue().partition("Look at it with: ")
    assert shlex.split(command) == ["duplex", "review", str(file)]
