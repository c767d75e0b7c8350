"""Rerun's processes end with the program, however it ends."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import psutil
import pytest

from tests.helpers.waiting import eventually

ROOT = Path(__file__).resolve().parents[3]
_STARTS_A_HUB = """
import sys
from viewer_app.viewer.rerun_process import Hub
print(Hub.on_free_ports(web=False).start().pid, flush=True)
sys.stdin.read()
"""


def gone(pid):
    """Returns whether a process has ended, even if its exit code has not been read yet."""
    try:
        return psutil.Process(pid).status() == psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return True


@pytest.mark.parametrize("how", ["killed", "ended"])
def test_a_hub_does_not_outlive_the_program(how):
    with subprocess.Popen(
        [sys.executable, "-c", _STARTS_A_HUB], stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=ROOT
    ) as program:
        hub = int(program.stdout.readline())
        assert not gone(hub)
        if how == "killed":
            if sys.platform != "linux":
                pytest.skip("only Linux ends the children of a program that is killed")
            program.kill()
        else:
            program.stdin.close()
        program.wait()
        assert eventually(lambda: gone(hub))


@pytest.mark.skipif(sys.platform != "linux", reason="signals to a process group")
def test_nothing_survives_two_ctrl_c_while_a_page_is_served():
    arguments = ["-m", "viewer_app.cli", "demo", "--web", "--depth", "none", "--seconds", "60", "--quiet"]
    environment = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY")}
    with subprocess.Popen(
        [sys.executable, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        cwd=ROOT,
        env=environment,
    ) as program:
        served = next((line for line in program.stdout if b"Viewer" in line), b"")
        assert b"127.0.0.1" in served
        assert eventually(lambda: len(psutil.Process(program.pid).children(recursive=True)) > 0)
        children = psutil.Process(program.pid).children(recursive=True)
        program.send_signal(signal.SIGINT)
        program.send_signal(signal.SIGINT)
        try:
            # the second signal may arrive before or after the first is handled: repeat until the process ends
            assert eventually(lambda: _pressed(program), 30.0)
        finally:
            program.kill()
        assert eventually(lambda: all(gone(child.pid) for child in children))


def _pressed(program):
    if program.poll() is None:
        program.send_signal(signal.SIGINT)
    return program.poll() is not None
