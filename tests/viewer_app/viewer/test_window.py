"""Windows on a real X server that open, and that cannot."""

import os
import signal
import sys

import pytest

from tests.helpers.displays import titles, x_server
from tests.helpers.live_frames import frames, known_fuser, numbers_in, session
from tests.helpers.machine import need_viewer
from tests.helpers.waiting import eventually
from viewer_app.errors import UsageError
from viewer_app.viewer import window as window_module
from viewer_app.viewer.hub import Hub
from viewer_app.viewer.rerun_process import stop
from viewer_app.viewer.window import ViewerWindow, start_viewer

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="X is a display of Linux")


@pytest.fixture
def screen(monkeypatch):
    """A real X server, as the display of this process."""
    need_viewer()
    with x_server() as name:
        monkeypatch.setenv("DISPLAY", name)
        yield name


def without_driver(monkeypatch):
    monkeypatch.setenv("VK_DRIVER_FILES", os.devnull)


def test_a_window_that_is_started_is_on_the_screen_and_opens_again(screen):
    window = ViewerWindow(lambda: start_viewer([]))
    try:
        assert titles(screen) == ["Rerun"]
        os.kill(window.process.pid, signal.SIGKILL)
        assert eventually(lambda: window.starts == 2)
        assert titles(screen) == ["Rerun"]
        assert window.failure == ""
    finally:
        window.leave()
        stop(window.process)


def test_a_viewer_that_hangs_while_it_opens_is_started_once_more(screen, monkeypatch):
    """As graphics drivers make it: it listens, and neither answers nor computes."""
    listens, hung = window_module.listens, []

    def listens_and_hangs(process, ports):
        found = listens(process, ports)
        if not hung:
            hung.append(process)
            os.kill(process.pid, signal.SIGSTOP)
        return found

    monkeypatch.setattr(window_module, "listens", listens_and_hangs)
    monkeypatch.setattr(window_module, "_HANGS_AFTER", 1.0)
    viewer, _ = start_viewer([])
    try:
        assert hung[0].poll() is not None
        assert viewer.poll() is None
        assert titles(screen) == ["Rerun"]
    finally:
        stop(viewer)


@pytest.mark.usefixtures("screen")
def test_a_viewer_that_cannot_draw_says_why(monkeypatch):
    without_driver(monkeypatch)
    with pytest.raises(UsageError, match=r"viewer does not start here \(.*graphics driver.*\)\. Use --save"):
        start_viewer([])


@pytest.mark.usefixtures("screen")
def test_a_window_that_does_not_open_again_is_given_up(monkeypatch):
    window = ViewerWindow(lambda: start_viewer([]))
    without_driver(monkeypatch)
    os.kill(window.process.pid, signal.SIGKILL)
    assert eventually(lambda: window.failure, 60.0)
    assert "graphics driver" in window.failure
    assert window.starts == 1


@pytest.mark.usefixtures("screen")
def test_a_session_is_saved_where_no_window_opens(monkeypatch, tmp_path):
    without_driver(monkeypatch)
    fuser, hub = known_fuser(), Hub.on_free_ports(web=False)
    with session(fuser, tmp_path / "s.rrd", hub, window=True, headless=False) as live:
        assert "graphics driver" in live.viewer.window_failure
        for frame in frames(fuser, 5):
            live.write(frame)
        live.finish()
        live.save()
    assert numbers_in(tmp_path / "s.rrd") == list(range(5))
    with pytest.raises(UsageError, match="graphics driver"), session(fuser, None, hub, True, headless=False):
        pass
