"""How the program ends and prints: Ctrl-C at any moment, sensors that still close, output nobody reads."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from devices.events import Event
from recordings.testing import simulated_session
from tests.helpers.command_line import duplex
from tests.helpers.programs import ROOT, python
from tests.helpers.session_text import rows_of
from tests.helpers.telling_demo import telling_demo, wait_for_frames
from viewer_app.running.interruption import CtrlC
from viewer_app.sinks.live_session import LiveSession
from viewer_app.sinks.session_file import SessionFile

PRESSED_DURING_IMPORT = """
import sys
from importlib.abc import MetaPathFinder

class CtrlC(MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name == {name!r}:
            raise KeyboardInterrupt

sys.meta_path.insert(0, CtrlC())
sys.argv = ["duplex", "info", "none.rrd"]
from viewer_app.cli import script
script()
"""


@pytest.mark.parametrize("name", ["cyclopts", "recordings.session"])
def test_ctrl_c_during_the_imports(name):
    ended = python("-c", PRESSED_DURING_IMPORT.format(name=name), timeout=60.0)
    assert (ended.returncode, ended.stderr) == (130, "duplex: stopped\n")


PRESSED_IN_A_CALLBACK = """
import ctypes, os, signal, sys, threading
from viewer_app import cli

def pressed():
    os.kill(os.getpid(), signal.SIGINT)
    sum(range(10))  # where Python sees it

def main():
    ctypes.CFUNCTYPE(None)(pressed)()
    threading.Event().wait()

cli.main = main
cli.script()
"""


@pytest.mark.parametrize("signals", ["SIGINT", "SIGTERM"])
def test_ctrl_c_in_a_callback_of_a_library_is_not_lost(signals):
    """ctypes prints the exceptions of callbacks, as of llvmlite's while kernels are compiled. A shell lets a
    command that it starts in the background ignore SIGINT."""
    if signals == "SIGTERM" and sys.platform == "win32":
        pytest.skip("Windows has no SIGTERM that can be caught")
    code = PRESSED_IN_A_CALLBACK.replace("SIGINT", signals)
    if signals != "SIGINT":
        code = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)\n" + code
    ended = python("-c", code, timeout=60.0)
    assert (ended.returncode, ended.stdout, ended.stderr) == (130, "", "")


LEAVES_A_SENSOR = """
import ctypes, os, signal, sys, threading
from devices.capture.sensor_thread import SensorThread
from devices.sensor import Sensor
from viewer_app import cli

class Closing(Sensor):
    name, waits_for = "000123", "its body tracker, which stops"

    def frames(self):
        return iter(())

    def __exit__(self, *exc_info):
        threading.Event().wait(float(sys.argv[1]))
        print("closed", flush=True)

libc = ctypes.CDLL(None)

def main():
    if float(sys.argv[1]) > 10.0:
        libc.__cxa_atexit(libc.abort, None, None)  # as libk4a ends at a regular exit
    SensorThread(Closing()).open().close(0.0)
    if sys.argv[3] == "pressed":
        threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGINT)).start()
    print("saved")
    sys.exit(int(sys.argv[4]))

cli.main, cli._CLOSING_S = main, float(sys.argv[2])
cli.script()
"""


@pytest.mark.skipif(sys.platform != "linux", reason="needs the C library's list of exit functions")
@pytest.mark.parametrize(
    ("closes_s", "limit_s", "pressed", "said", "code"),
    [(0.5, 60.0, "", "closed", 130), (60.0, 0.2, "", "did not close", 0), (60.0, 60.0, "pressed", "", 130)],
)
def test_a_sensor_that_closes_is_waited_for_and_changes_no_code(closes_s, limit_s, pressed, said, code):
    ended = python("-c", LEAVES_A_SENSOR, closes_s, limit_s, pressed, code, timeout=50.0)
    assert (ended.returncode, ended.stdout.splitlines()[0]) == (code, "saved")
    assert "Waiting for 000123 (its body tracker, which stops) to close" in ended.stderr
    assert said in ended.stdout + ended.stderr


pytestmark = pytest.mark.skipif(not hasattr(os, "killpg"), reason="needs POSIX signals")

HANGS_S = 120.0  # on an idle machine it ends within 2 s; a program that hangs never ends
AFTER_ALL_WAS_SAVED = (0, 130, -signal.SIGINT)  # the last while Python itself shuts down


def demo(save, *more):
    return telling_demo(save, "--depth", "none", *more)


def ended(process, presses=1, number=signal.SIGINT):
    """Presses Ctrl-C; returns the exit code, the number of reported frames, and the other output."""
    for _ in range(presses):
        process.send_signal(number)
        time.sleep(0.02)  # between two presses of a person in a hurry
    try:
        _, said = process.communicate(timeout=HANGS_S)
    finally:
        process.kill()
    assert b"Traceback" not in said
    words = said.lstrip(b".")
    return process.returncode, len(said) - len(words), words.decode()


def test_the_suite_hears_ctrl_c_also_in_the_background():
    """A shell without job control starts background jobs with SIGINT ignored."""
    ignored = "import signal, subprocess, sys; signal.signal(signal.SIGINT, signal.SIG_IGN);"
    shown = "import signal; print(signal.getsignal(signal.SIGINT) is signal.default_int_handler)"
    inner = f"subprocess.run([sys.executable, '-c', {shown!r}])"
    ended = python("-c", f"{ignored} import tests.conftest; {inner}")
    assert (ended.returncode, ended.stdout) == (0, "True\n")


def test_ctrl_c_before_the_first_frame(tmp_path):
    process = demo(tmp_path / "demo.rrd")
    while b"A simulated person" not in process.stdout.readline():
        assert process.poll() is None
    code, frames, said = ended(process)
    if code == 130:  # before the sensors ran: nothing to save, no file remains
        assert (frames, said) == (0, "duplex: stopped\n")
    else:
        assert code == 0
    assert [path.name for path in tmp_path.iterdir()] == (["demo.rrd"] if frames else [])


def test_captured_frames_are_saved_however_often_ctrl_c_is_pressed(tmp_path):
    saved = tmp_path / "demo.rrd"
    process = demo(saved)
    wait_for_frames(process, 25)
    code, more, _ = ended(process, presses=8)
    assert code in AFTER_ALL_WAS_SAVED
    assert [path.name for path in tmp_path.iterdir()] == ["demo.rrd"]
    assert rows_of(saved, "/fused/skeleton") == 25 + more


@pytest.mark.parametrize(
    ("number", "when", "seconds", "codes"),
    [
        (signal.SIGTERM, "capturing", 60.0, (0,)),
        (signal.SIGHUP, "capturing", 60.0, (0,)),  # a closed terminal, or a lost ssh
        (signal.SIGINT, "saving", 0.6, (0, 130)),
    ],
)
def test_captured_frames_are_saved(tmp_path, monkeypatch, number, when, seconds, codes):
    """The signal is raised in the test's own process while the first frames are captured, or saved."""
    saved, written, pressed = tmp_path / "demo.rrd", [], []
    write, finish = LiveSession.write, SessionFile.finish

    def press():
        pressed.append(when)
        signal.raise_signal(number)

    def telling(session, frame):
        write(session, frame)
        written.append(frame)
        if when == "capturing" and len(written) == 5:
            press()

    def finishing(file):
        if when == "saving":
            press()
        finish(file)

    monkeypatch.setattr(LiveSession, "write", telling)
    monkeypatch.setattr(SessionFile, "finish", finishing)
    options = "--seconds", seconds, "--depth", "none", "--no-viewer", "--save", saved
    before = signal.signal(number, signal.SIG_DFL)  # nohup may run the tests
    try:
        assert duplex("demo", *options) in codes
    finally:
        signal.signal(number, before)
    assert pressed == [when]
    assert len(written) < 300  # it ended before its time
    assert [path.name for path in tmp_path.iterdir()] == ["demo.rrd"]
    assert rows_of(saved, "/fused/skeleton") == len(written) > 0


def test_handlers_are_given_back():
    before = signal.getsignal(signal.SIGINT)
    pressed = []
    with CtrlC() as ctrl_c, pytest.raises(KeyboardInterrupt), ctrl_c.raising():
        signal.raise_signal(signal.SIGINT)
    with CtrlC() as ctrl_c:
        signal.raise_signal(signal.SIGINT)  # remembered
        with pytest.raises(KeyboardInterrupt):
            ctrl_c.calls(lambda: None)
    with CtrlC() as ctrl_c:
        ctrl_c.calls(lambda: pressed.append(1))
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGTERM)
    assert pressed == [1, 1]
    assert signal.getsignal(signal.SIGINT) is before


# --- Output that nobody reads, that has no room, or that would act on a terminal.


HOSTILE = "\x1b]0;owned\x07\x9b2J\u202e"

in_a_shell = pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a shell and /dev/full")


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    path = tmp_path_factory.mktemp("saved") / "s.rrd"
    simulated_session(seconds=1.0).save(path)
    return path


@in_a_shell
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


@in_a_shell
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


@in_a_shell
def test_a_closed_standard_input_is_an_empty_one():
    """``duplex doctor --bundle`` asks it whether it is a terminal."""
    code = "import sys; from viewer_app import cli;"
    code += "cli.main = lambda: print(repr(sys.stdin.read())); cli.script()"
    line = ["sh", "-c", '"$0" -c "$1" <&-', sys.executable, code]
    ended = subprocess.run(line, capture_output=True, text=True)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "''\n", "")
