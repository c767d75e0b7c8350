"""Real displays without a screen: an X server (Xvfb) and a Wayland compositor (Weston)."""

import os
import re
import secrets
import subprocess
from contextlib import contextmanager

from tests.helpers.machine import need_program
from tests.helpers.waiting import eventually

SIZE = 1600, 1080
"""Width and height of the screens, pixels."""


@contextmanager
def x_server(*options):
    """The name of a real X server's display; the test is skipped where there is no Xvfb."""
    program = need_program("Xvfb", package="xvfb")
    ready, write = os.pipe()
    screen = "-screen", "0", "{}x{}x24".format(*SIZE)
    command = [program, "-displayfd", str(write), *screen, "-nolisten", "tcp", *options]
    process = subprocess.Popen(command, pass_fds=[write], stderr=subprocess.DEVNULL)
    os.close(write)
    try:
        with os.fdopen(ready) as number:
            yield f":{int(number.readline())}"  # the server writes it when it takes connections
    finally:
        process.terminate()
        process.wait()


def titles(display):
    """The titles of the windows on an X display, as a window manager would list them."""
    program = need_program("xwininfo", package="x11-utils")
    said = subprocess.run([program, "-display", display, "-root", "-tree"], capture_output=True, text=True)
    return re.findall(r'^ +0x\w+ "(.+)": \(', said.stdout, re.MULTILINE)


@contextmanager
def wayland_compositor(folder, *options):
    """The name of a real Wayland display, with its socket in a folder; the test is skipped without Weston."""
    program = need_program("weston", package="weston")
    folder.chmod(0o700)
    name = f"wayland-{secrets.token_hex(4)}"
    size = f"--width={SIZE[0]}", f"--height={SIZE[1]}"
    process = subprocess.Popen(
        [program, "--backend=headless-backend.so", f"--socket={name}", "--idle-time=0", *size, *options],
        env={**os.environ, "XDG_RUNTIME_DIR": str(folder)},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        assert eventually((folder / name).exists), "Weston does not start"
        yield name
    finally:
        process.terminate()
        process.wait()
