"""Screens without hardware, the windows of Rerun's viewer on them, and a browser without a screen."""

import contextlib
import io
import os
import re
import subprocess
import tempfile
from pathlib import Path

import numpy as np
import psutil
import pytest
from PIL import Image
from rerun.experimental import ViewerClient

from tests.helpers.displays import SIZE, titles, wayland_compositor, x_server
from tests.helpers.machine import need_browser, need_viewer
from viewer_app.addresses import LOOPBACK


class Screen:
    """A screen.

    Attributes:
        environment: The variables by which a program finds it.
        titles: A function that lists the titles of the windows that can be seen.
        photograph: A function that gives what the screen shows; None where only a window itself can tell.
    """

    def __init__(self, environment, titles, photograph=None):
        self.titles, self.photograph = titles, photograph
        # Rerun keeps what a user changed in the viewer in a folder of its own.
        self._state = tempfile.TemporaryDirectory()
        self.environment = {**environment, "XDG_DATA_HOME": self._state.name}

    def windows(self):
        """The viewers on this screen."""
        mine = f"XDG_DATA_HOME={self._state.name}".encode()
        found = []
        for process in psutil.process_iter(["cmdline"]):
            arguments = process.info["cmdline"] or []
            if "--hide-welcome-screen" in arguments:
                with contextlib.suppress(OSError, ValueError):
                    if mine in Path(f"/proc/{process.pid}/environ").read_bytes().split(b"\0"):
                        port = arguments[arguments.index("--port") + 1]
                        found.append(Window(process, f"rerun+http://{LOOPBACK}:{port}/proxy"))
        return found

    def close_windows(self):
        """Closes all windows, as a user does."""
        for window in self.windows():
            window.close()

    def close(self):
        """Closes everything on it."""
        self.close_windows()
        self._state.cleanup()


class Window:
    """A window of Rerun's viewer."""

    def __init__(self, process, url):
        self._process, self._url = process, url

    def state(self):
        """What it shows; None while it starts."""
        with contextlib.suppress(OSError, RuntimeError):
            return ViewerClient.connect(self._url).get_state()
        return None

    def picture(self, view=None):
        """Its picture as the viewer draws it, or that of a view, (height, width, 3) uint8.

        None while it starts, or has no view of this name.
        """
        with contextlib.suppress(OSError, RuntimeError):
            viewer = ViewerClient.connect(self._url)
            if view is None:
                return _pixels(viewer.take_screenshot())
            views = viewer.get_state().views
            for view_id in [each.view_id for each in views if each.visible and each.name == view]:
                return _pixels(viewer.take_screenshot(view_id))
        return None

    def close(self):
        """Ends it."""
        with contextlib.suppress(psutil.NoSuchProcess):
            self._process.kill()
            self._process.wait(10.0)


@contextlib.contextmanager
def x_screen():
    """A screen of X, without a graphics card; the test is skipped where there is none."""
    need_viewer()
    with x_server(
        "-noreset"
    ) as name:  # a desktop always has a client, after whose end a server would start again
        _put_pointer_aside(name)
        with contextlib.closing(Screen({"DISPLAY": name}, lambda: titles(name))) as screen:
            yield screen


@contextlib.contextmanager
def wayland_screen():
    """A screen of Wayland, without a graphics card; the test is skipped where there is none."""
    need_viewer()
    with (
        tempfile.TemporaryDirectory() as folder,
        wayland_compositor(Path(folder), "--use-pixman", "--no-config", "--debug") as name,
    ):
        environment = {"XDG_RUNTIME_DIR": folder, "WAYLAND_DISPLAY": name}

        def asked(*command):
            all_variables = {**os.environ, **environment}
            done = subprocess.run(command, cwd=folder, env=all_variables, capture_output=True, timeout=60.0)
            assert done.returncode == 0, done.stderr
            return done.stdout.decode()

        def titles_on_it():
            return re.findall(r"top-level window '(.*?)' of", asked("weston-debug", "scene-graph"))

        def photograph():
            asked("weston-screenshooter")
            (file,) = Path(folder).glob("wayland-screenshot-*.png")
            picture = _pixels(file.read_bytes())
            file.unlink()
            return picture

        with contextlib.closing(Screen(environment, titles_on_it, photograph)) as screen:
            yield screen


@contextlib.contextmanager
def browser(width=900, height=600, **how):
    """Debian's Chromium without a screen, drawing on the CPU; the test is skipped where there is none."""
    playwright = pytest.importorskip("playwright.sync_api", reason="the dev extra has playwright")
    program = need_browser()
    with playwright.sync_playwright() as started:
        flags = "--no-sandbox --use-gl=angle --use-angle=swiftshader --enable-unsafe-swiftshader"
        chromium = started.chromium.launch(
            executable_path=program, args=[*flags.split(), "--ignore-gpu-blocklist"]
        )
        try:
            context = chromium.new_context(viewport={"width": width, "height": height}, **how)
            context.set_default_timeout(120_000)  # milliseconds: it draws on the CPU
            yield context
        finally:
            chromium.close()


def shown_in(page):
    """The picture of a browser's page, (height, width, 3) uint8."""
    return _pixels(page.screenshot())


def _pixels(png):
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB"))


def _put_pointer_aside(name):
    """In the middle, where the server puts it, the viewer would describe what is below it."""
    from Xlib.display import Display

    display = Display(name)
    display.screen().root.warp_pointer(*SIZE)
    display.sync()
    display.close()
