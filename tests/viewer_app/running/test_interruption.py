"""Ctrl-C at any moment of a session, in its own process: it ends at once, and captured frames are saved."""

import os
import signal
import time

import pytest

from tests.helpers.session_text import rows_of
from tests.helpers.telling_demo import telling_demo, wait_for_frames
from viewer_app.running.interruption import CtrlC

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


@pytest.mark.parametrize(
    ("frames", "presses", "number", "options", "codes"),
    [
        (25, 8, signal.SIGINT, (), AFTER_ALL_WAS_SAVED),
        (5, 1, signal.SIGTERM, (), (0,)),
        (15, 1, signal.SIGINT, ("--seconds", "0.6"), AFTER_ALL_WAS_SAVED),  # while it saves
    ],
)
def test_captured_frames_are_saved(tmp_path, frames, presses, number, options, codes):
    saved = tmp_path / "demo.rrd"
    process = demo(saved, *options)
    wait_for_frames(process, frames)
    code, more, _ = ended(process, presses, number)
    assert code in codes
    assert [path.name for path in tmp_path.iterdir()] == ["demo.rrd"]
    assert rows_of(saved, "/fused/skeleton") == frames + more


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
