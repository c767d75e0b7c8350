"""Output that nobody reads, that has no room, or that would act on a terminal."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from recordings.testing import simulated_session
from tests.helpers.command_line import duplex
from tests.helpers.programs import ROOT

HOSTILE = "\x1b]0;owned\x07\x9b2J\u202e"

pytestmark = pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a shell and /dev/full")


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    path = tmp_path_factory.mktemp("saved") / "s.rrd"
    simulated_session(seconds=1.0).save(path)
    return path


@pytest.mark.parametrize(
    ("streams", "code", "said"),
    [
        (">&-", 0, ""),
        (">&- 2>&-", 0, ""),
        (">/dev/full", 2, "duplex: the output could not be printed completely: No space left on device.\n"),
        (">/dev/full 2>/dev/full", 2, ""),
        ("| true", 1, ""),
    ],
)
def test_a_command_does_its_work_without_a_terminal(saved, tmp_path, streams, code, said):
    page = tmp_path / "s.csv"
    line = f'"{sys.executable}" -m viewer_app.cli export "{saved}" --to "{page}" {streams}'
    ended = subprocess.run(
        ["bash", "-c", f"set -o pipefail; {line}"], cwd=ROOT, capture_output=True, text=True, timeout=300.0
    )
    assert ended.stderr == said
    assert ended.returncode in ({0, code} if "|" in streams else {code})
    assert page.read_text().count("\n") > 100


def test_an_ignored_hangup_stays_ignored():
    ignored = f"trap '' HUP; exec '{sys.executable}' -c"
    program = (
        "import os, signal; from viewer_app import cli;"
        "cli.main = lambda: (os.kill(os.getpid(), signal.SIGHUP), print('goes on'));"
        "cli.script()"
    )
    for shell, expected in ((ignored, (0, "goes on\n")), (f"exec '{sys.executable}' -c", (130, ""))):
        ended = subprocess.run(
            ["bash", "-c", f'{shell} "{program}"'],
            cwd=ROOT, capture_output=True, text=True, timeout=60.0,
            preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_DFL),  # nohup may run the tests
        )  # fmt: skip
        assert (ended.returncode, ended.stdout) == expected


@pytest.mark.parametrize("given", [("info", HOSTILE), ("info", f"--{HOSTILE}=1"), (HOSTILE,)])
def test_control_characters_of_the_command_line_are_not_printed(given, capsys):
    assert duplex(*given) == 2
    check(capsys.readouterr())


def test_control_characters_of_a_session_are_not_printed(tmp_path, capsys):
    from dataclasses import replace

    from devices.events import Event

    session = simulated_session(seconds=1.0)
    hostile = replace(
        session,
        sources=(f"{HOSTILE}a", f"{HOSTILE}b"),
        events=[*session.events, Event(f"{HOSTILE} [red]", "WARN", 3)],
    )
    path = tmp_path / f"{HOSTILE[:8]}.rrd"
    hostile.save(path)
    for command in ("info", "review"):
        assert duplex(command, path, *(["--no-viewer", "--verbose"] if command == "review" else [])) == 0
        check(capsys.readouterr())


def check(printed):
    text = printed.out + printed.err
    assert "\ufffd" in text or r"\x1b" in text
    assert not set(text) & set("\x1b\x07\x9b\u202e")


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs a POSIX shell")
def test_a_closed_standard_input_is_an_empty_one():
    """``duplex doctor --bundle`` asks it whether it is a terminal."""
    code = "import sys; from viewer_app import cli;"
    code += "cli.main = lambda: print(repr(sys.stdin.read())); cli.script()"
    line = ["sh", "-c", '"$0" -c "$1" <&-', sys.executable, code]
    ended = subprocess.run(line, capture_output=True, text=True)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "''\n", "")
