"""Ctrl-C at any moment of a session, from the outside: it ends at once, and what was captured is saved."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from session_text import rows_of

from viewer_app.ctrl_c import CtrlC

pytestmark = pytest.mark.skipif(not hasattr(os, "killpg"), reason="needs POSIX signals")

ENDS_WITHIN_S = 2.0
STARTS_WITHIN_S = 60.0  # the first run compiles the kernels
AFTER_ALL_WAS_SAVED = (0, 130, -signal.SIGINT)  # the last while Python itself shuts down
ROOT = Path(__file__).resolve().parent.parent


def demo(save: Path, *more: str) -> subprocess.Popen[str]:
    arguments = ["demo", "--no-viewer", "--depth", "none", "--save", str(save), *more]
    return subprocess.Popen(
        [sys.executable, "-u", "-m", "viewer_app.cli", *arguments],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def busy() -> float:
    """How many programs share a processor here: what takes 2 s alone takes so many times that beside them."""
    return max(1.0, os.getloadavg()[0] / (os.cpu_count() or 1))


def ended(process: subprocess.Popen[str], presses: int = 1, number: int = signal.SIGINT) -> tuple[int, str]:
    """Presses Ctrl-C; the exit code and what it said on stderr, both within the time it has."""
    begun = time.monotonic()
    for _ in range(presses):
        process.send_signal(number)
        time.sleep(0.02)
    try:
        _, said = process.communicate(timeout=30.0)
    finally:
        process.kill()
    assert time.monotonic() - begun < ENDS_WITHIN_S * busy()
    return process.returncode, said


def wait_for(process: subprocess.Popen[str], words: str) -> None:
    assert process.stdout is not None
    deadline = time.monotonic() + STARTS_WITHIN_S
    seen = ""
    while words not in seen:
        assert time.monotonic() < deadline
        line = process.stdout.readline()
        assert line, f"ended after {seen!r}: {process.communicate()[1]}"
        seen += line


@pytest.mark.parametrize("after_s", [0.0, 0.3, 1.0])
def test_ctrl_c_while_it_runs(tmp_path: Path, after_s: float) -> None:
    saved = tmp_path / "demo.rrd"
    process = demo(saved)
    wait_for(process, "A simulated person")
    time.sleep(after_s)
    code, said = ended(process)
    assert "Traceback" not in said
    if code == 130:  # before the sensors ran: there is nothing to save, and nothing is left behind
        assert after_s < 0.3
        assert said == "duplex: stopped\n"
        assert list(tmp_path.iterdir()) == []
        return
    assert code == 0
    if after_s < 0.3 and not saved.exists():  # before the first frame
        assert list(tmp_path.iterdir()) == []
        return
    assert [path.name for path in tmp_path.iterdir()] == ["demo.rrd"]
    # at least half of the frames since, for a machine that is busy with other things
    assert rows_of(saved, "/fused/skeleton") >= int(0.5 * 30 * max(after_s - 0.2, 0.0))


def test_pressing_it_again_and_again_loses_nothing(tmp_path: Path) -> None:
    saved = tmp_path / "demo.rrd"
    process = demo(saved)
    wait_for(process, "A simulated person")
    time.sleep(0.8)
    code, said = ended(process, presses=8)
    assert code in AFTER_ALL_WAS_SAVED
    assert "Traceback" not in said
    assert rows_of(saved, "/fused/skeleton") >= 9


def test_a_request_to_terminate_saves_too(tmp_path: Path) -> None:
    saved = tmp_path / "demo.rrd"
    process = demo(saved)
    wait_for(process, "A simulated person")
    time.sleep(0.8)
    assert ended(process, number=signal.SIGTERM)[0] == 0
    assert rows_of(saved, "/fused/skeleton") >= 9


@pytest.mark.parametrize("before_end_s", [0.2, 0.0])
def test_ctrl_c_while_it_saves(tmp_path: Path, before_end_s: float) -> None:
    saved = tmp_path / "demo.rrd"
    process = demo(saved, "--seconds", "0.6")
    wait_for(process, "A simulated person")
    time.sleep(0.7 - before_end_s)
    code, said = ended(process)
    assert code in AFTER_ALL_WAS_SAVED
    assert "Traceback" not in said
    assert rows_of(saved, "/fused/skeleton") >= 5


@pytest.mark.parametrize("after_s", [0.05, 0.4])
def test_ctrl_c_while_it_starts(tmp_path: Path, after_s: float) -> None:
    process = demo(tmp_path / "demo.rrd", "--seconds", "30")
    time.sleep(after_s)
    code, _ = ended(process)
    assert code in (130, 0, -signal.SIGINT, 1)  # 1: within Python's own start, before our first line
    assert not list(tmp_path.glob(".*partial*"))


def test_handlers_are_given_back() -> None:
    before = signal.getsignal(signal.SIGINT)
    pressed: list[int] = []
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
