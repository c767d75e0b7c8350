"""``duplex demo`` as a process that prints a dot on stderr for each recorded frame."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

_PROGRAM = """
import sys
from viewer_app import cli
from viewer_app.sinks.live_session import LiveSession
record = LiveSession.write
def telling(session, frame):
    record(session, frame)
    sys.stderr.write(".")
    sys.stderr.flush()
LiveSession.write = telling
sys.argv[1:] = ["demo", "--no-viewer", "--save", *sys.argv[1:]]
cli.script()
"""


def telling_demo(save, *more):
    """Starts it."""
    command = [sys.executable, "-u", "-c", _PROGRAM, str(save), *more]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.Popen(
        command, cwd=ROOT, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )


def wait_for_frames(process, frames):
    """Waits until so many more frames have been recorded."""
    told = process.stderr.read(frames)
    assert told == b"." * frames, told + process.stderr.read()
