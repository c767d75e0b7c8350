"""The end of the program: Ctrl-C while it starts, and sensors that still close."""

import os
import subprocess
import sys

import pytest

from tests.helpers.documents import ROOT

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


@pytest.mark.parametrize("name", ["cyclopts", "rerun"])
def test_ctrl_c_during_the_imports(name):
    ended = subprocess.run(
        [sys.executable, "-c", PRESSED_DURING_IMPORT.format(name=name)],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=60.0,
    )
    assert (ended.returncode, ended.stderr) == (130, "duplex: stopped\n")


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
    ended = subprocess.run(
        [sys.executable, "-c", LEAVES_A_SENSOR, *map(str, (closes_s, limit_s, pressed, code))],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=50.0,
    )
    assert (ended.returncode, ended.stdout.splitlines()[0]) == (code, "saved")
    assert "Waiting for 000123 (its body tracker, which stops) to close" in ended.stderr
    assert said in ended.stdout + ended.stderr
