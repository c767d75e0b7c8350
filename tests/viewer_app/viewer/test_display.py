"""A display that does not answer delays the start by a few seconds only."""

import socket
from contextlib import contextmanager, suppress

import pytest

from viewer_app.errors import UsageError
from viewer_app.options.shared import ViewerOptions
from viewer_app.viewer import display
from viewer_app.viewer.viewer_choice import choose_viewing

pytest.importorskip("Xlib", reason="python-xlib is installed on Linux only")


@pytest.fixture(autouse=True)
def _linux(monkeypatch):
    monkeypatch.setattr("platform.system", lambda: "Linux")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    display._answers.cache_clear()
    yield
    display._answers.cache_clear()


@contextmanager
def silent_x_server():
    """The name of a display that takes connections and never answers."""
    with socket.socket() as server:
        for number in range(4000, 4100):
            with suppress(OSError):
                server.bind(("127.0.0.1", 6000 + number))
                break
        server.listen()
        yield f"127.0.0.1:{number}.0"


def test_a_silent_display_counts_as_none_and_is_reported(monkeypatch):
    monkeypatch.setattr(display, "_ANSWERS_WITHIN", 0.2)
    with silent_x_server() as name:
        monkeypatch.setenv("DISPLAY", name)
        words = display.why_no_window()
        assert words is not None
        assert name in words
        assert "0.2 s" in words
        assert display.why_no_window() == words
        assert display._answers.cache_info().misses == 1, "there is no second wait"


def test_a_display_without_a_server_counts_as_none(monkeypatch):
    monkeypatch.setenv("DISPLAY", ":48731")
    assert not display.has_display()
    monkeypatch.delenv("DISPLAY")
    assert display.why_no_window() == "There is no display for the viewer's window"


def test_a_session_that_is_saved_goes_on_without_a_window(monkeypatch, tmp_path):
    monkeypatch.setenv("DISPLAY", ":48731")

    def chosen(save):
        return choose_viewing(ViewerOptions(), save, live=True)

    viewing = chosen(tmp_path)
    assert (viewing.window, viewing.hub) == (False, None)
    assert ":48731" in viewing.why_not
    with pytest.raises(UsageError, match=r":48731 .* does not answer .* --save FILE.rrd"):
        chosen(None)
