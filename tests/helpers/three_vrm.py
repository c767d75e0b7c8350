"""An avatar in a browser: pixiv's three-vrm, which draws VRM files and knows their humanoids.

``python -m tests.helpers.three_vrm`` installs it with npm under the user's cache folder; ``.ci/run`` does it.
"""

import subprocess
import threading
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from devices.cache import user_cache
from tests.helpers.machine import lacks, need_browser

PACKAGES = ("three@0.187.0", "@pixiv/three-vrm@3.5.5")
FOLDER = user_cache("three-vrm-3.5.5")
_MODULES = FOLDER / "node_modules"
_PAGE = Path(__file__).with_name("three_vrm.html")


@contextmanager
def avatar_page(vrm):
    """A browser page that shows an avatar; ``pose(bones)`` moves it as a receiver of VMC does.

    ``pose`` takes (name, position, rotation) in Unity's axes, and gives where the bones of the file are then.
    """
    playwright = pytest.importorskip("playwright.sync_api", reason="no playwright")
    chromium = need_browser()
    if not (_MODULES / "@pixiv").is_dir():
        lacks("three-vrm", "run python -m tests.helpers.three_vrm")
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(_Files, vrm))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    with playwright.sync_playwright() as p:
        browser = p.chromium.launch(
            executable_path=chromium, args=["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader"]
        )
        try:
            tab = browser.new_page(viewport={"width": 480, "height": 640})
            tab.on("pageerror", lambda error: pytest.fail(str(error)))
            tab.goto(f"http://127.0.0.1:{server.server_port}/")
            tab.wait_for_function("window.pose !== undefined", timeout=60_000)
            yield tab
        finally:
            browser.close()
            server.shutdown()
            server.server_close()


class _Files(SimpleHTTPRequestHandler):
    """The page, the avatar and the modules."""

    def __init__(self, vrm, *arguments, **named):
        self._vrm = vrm
        super().__init__(*arguments, **named)

    def translate_path(self, path):
        if path == "/":
            return str(_PAGE)
        return str(self._vrm if path == "/avatar.vrm" else _MODULES / path.removeprefix("/modules/"))

    def log_message(self, *_):
        pass


def install():
    """Installs it, unless it is there.

    Raises:
        OSError, subprocess.SubprocessError: There is no npm, or no network.
    """
    if not (_MODULES / "@pixiv").is_dir():
        FOLDER.mkdir(parents=True, exist_ok=True)
        # The output of npm is not shown: it may name a private package registry.
        command = ["npm", "install", "--prefix", str(FOLDER), "--ignore-scripts", "--no-audit", *PACKAGES]
        subprocess.run(command, check=True, capture_output=True, timeout=600.0)


if __name__ == "__main__":
    install()
