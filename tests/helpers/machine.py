"""What a test needs from the machine: a Vulkan driver, a display, a browser, a compiler, sensors' libraries.

A machine without one of them skips the test, with the reason and what helps. Two options
let ``.ci/run`` prove that such skips hide nothing: ``--list-machine-skips FILE`` writes the identifiers of
the tests that were skipped for such a reason, and ``--complete-machine`` makes each such skip a failure.
"""

import functools
import shutil
import subprocess
import tempfile
from collections import Counter
from contextlib import contextmanager
from pathlib import Path

import pytest

_LACKS = "this machine lacks"
_COMPILERS = ("cc", "gcc", "clang")
_BROWSERS = ("chromium", "chromium-browser", "google-chrome")
_complete = False


def lacks(what, remedy, *, required=True):
    """Skips the running test because the machine lacks something."""
    reason = f"{_LACKS} {what}; {remedy}"
    if _complete and required:
        pytest.fail(reason + " (--complete-machine allows no such skip)", pytrace=False)
    pytest.skip(reason)


def need_viewer():
    """Skips the running test where Rerun's viewer cannot draw without a screen."""
    if not _viewer_draws():
        lacks("a Vulkan driver for Rerun's viewer", "Debian: apt install mesa-vulkan-drivers libvulkan1")


def need_browser():
    """The path of a Chromium; skips the running test where there is none."""
    return _first_of(_BROWSERS) or lacks("a browser", "Debian: apt install chromium")


def need_compiler():
    """The path of a C compiler; skips the running test where there is none."""
    return _first_of(_COMPILERS) or lacks("a C compiler", "Debian: apt install gcc libc6-dev")


def need_program(name, *, package):
    """The path of a program; skips the running test where it is missing."""
    return shutil.which(name) or lacks(name, f"Debian: apt install {package}")


def need_networks(network="full"):
    """The folder of the body tracker's networks; skips the running test where they were not fetched."""
    from devices.blazepose.networks.files import cache_folder, missing

    folder = cache_folder()
    if missing(network, folder):
        what, remedy = (
            f"the body tracker's network {network}",
            f"run duplex tracker fetch --network {network}",
        )
        lacks(what, remedy, required=network == "full")
    return folder


def _first_of(programs):
    return next(filter(None, map(shutil.which, programs)), None)


@functools.cache
def _viewer_draws():
    """Whether a headless viewer gives a picture; without a usable driver it starts, listens, and dies."""
    from rerun.experimental import ViewerClient

    from viewer_app.addresses import LOOPBACK
    from viewer_app.errors import UsageError
    from viewer_app.viewer.rerun_process import stop
    from viewer_app.viewer.window import start_viewer

    try:
        process, port = start_viewer(["--headless"])
    except UsageError:
        return False
    try:
        with tempfile.TemporaryDirectory() as folder:
            picture = Path(folder) / "window.png"
            ViewerClient.connect(f"rerun+http://{LOOPBACK}:{port}/proxy").save_screenshot(str(picture))
            return picture.exists() and process.poll() is None
    except (ConnectionError, RuntimeError):
        return False
    finally:
        stop(process)


def pytest_addoption(parser):
    group = parser.getgroup("machine", "what the machine lacks")
    group.addoption(
        "--complete-machine",
        action="store_true",
        help="fail where a driver, browser, compiler or library is missing",
    )
    group.addoption(
        "--list-machine-skips", metavar="FILE", help="write the tests that a missing one of them skipped"
    )


def pytest_configure(config):
    global _complete
    _complete = config.getoption("--complete-machine")
    file = config.getoption("--list-machine-skips")
    if file is not None and not hasattr(config, "workerinput"):  # not in a worker of pytest-xdist
        config.pluginmanager.register(_SkipList(Path(file)))


def pytest_terminal_summary(terminalreporter):
    """Says why tests were skipped: a line for each reason."""
    reasons = Counter(
        report.longrepr[2].removeprefix("Skipped: ")
        for report in terminalreporter.getreports("skipped")
        if isinstance(report.longrepr, tuple)
    )
    if reasons:
        terminalreporter.section("skipped tests")
    for reason, count in sorted(reasons.items()):
        terminalreporter.line(f"{count} × {reason}")


class _SkipList:
    """Collects the tests that were skipped for the machine's sake; pytest reads them back as ``@FILE``."""

    def __init__(self, file):
        self._file = file
        self._tests = []

    def pytest_runtest_logreport(self, report):
        if report.skipped and isinstance(report.longrepr, tuple) and _LACKS in report.longrepr[2]:
            self._tests.append(report.nodeid)

    def pytest_sessionfinish(self):
        self._file.write_text("".join(f"{test}\n" for test in self._tests), encoding="utf-8")


@contextmanager
def small_disk(folder, kilobytes):
    """Makes an empty disk of some kilobytes; skips the running test where this user may not mount one."""
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={kilobytes}k", "tmpfs", str(folder)]
    if shutil.which("mount") is None or subprocess.run(mount, capture_output=True, check=False).returncode:
        lacks("the right to mount a small disk", "run the tests as root, in a container", required=False)
    try:
        yield folder
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)
