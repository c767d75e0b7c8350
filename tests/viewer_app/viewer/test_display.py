"""A display that does not answer delays the start by a few seconds only."""

from __future__ import annotations

import socket
import struct
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from viewer_app.errors import UsageError
from viewer_app.options.shared import ViewerOptions
from viewer_app.viewer import display
from viewer_app.viewer.viewer_choice import Viewing, choose_viewing

pytest.importorskip("Xlib", reason="python-xlib is installed on Linux only")


@pytest.fixture(autouse=True)
def _linux(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr("platform.system", lambda: "Linux")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    display._answers.cache_clear()
    yield
    display._answers.cache_clear()


@contextmanager
def x_server(answer: bytes | None) -> Iterator[str]:
    """The name of a display that answers every connection with these bytes; None: it never answers."""
    listening = None
    for number in range(4000, 4100):
        server = socket.socket()
        try:
            server.bind(("127.0.0.1", 6000 + number))
        except OSError:
            server.close()
            continue
        listening = server
        break
    listening.listen()
    held: list[socket.socket] = []

    def serve() -> None:
        while True:
            try:
                one, _ = listening.accept()
            except OSError:
                return
            held.append(one)
            if answer is not None and len(one.recv(12)) == 12:  # X11's connection setup without a cookie
                one.sendall(answer)

    threading.Thread(target=serve, daemon=True).start()
    try:
        yield f"127.0.0.1:{number}.0"
    finally:
        listening.shutdown(socket.SHUT_RDWR)
        listening.close()
        for one in held:
            one.close()


_WELCOME = struct.pack("<BxHHH 4I HHBB 6B 4x", 1, 11, 0, 8, 0, 0, 0, 0, 0, 65535, 0, 0, 0, 0, 32, 32, 8, 255)
"""An X server without a vendor, formats or screens."""
_REFUSAL = struct.pack("<BBHHH 8s", 0, 6, 11, 0, 2, b"not you")


@pytest.mark.parametrize("answer", [_WELCOME, _REFUSAL], ids=["welcome", "refused"])
def test_a_display_that_answers_counts_as_a_display(answer: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    with x_server(answer) as name:
        monkeypatch.setenv("DISPLAY", name)
        assert display.has_display()


def test_a_silent_display_counts_as_none_and_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(display, "_ANSWERS_WITHIN", 0.2)
    with x_server(None) as name:
        monkeypatch.setenv("DISPLAY", name)
        words = display.why_no_window()
        assert words is not None
        assert name in words
        assert "0.2 s" in words
        assert display.why_no_window() == words
        assert display._answers.cache_info().misses == 1, "there is no second wait"


def test_a_display_without_a_server_counts_as_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DISPLAY", ":48731")
    assert not display.has_display()
    monkeypatch.delenv("DISPLAY")
    assert display.why_no_window() == "There is no display for the viewer's window"


def test_a_session_that_is_saved_goes_on_without_a_window(
    monkeypatch: pytest.MonkeyPatch, tmp_path: object
) -> None:
    monkeypatch.setenv("DISPLAY", ":48731")

    def chosen(save: object) -> Viewing | None:
        return choose_viewing(ViewerOptions(), save, live=True)  # type: ignore[arg-type]

    viewing = chosen(tmp_path)
    assert (viewing.window, viewing.hub) == (False, None)
    assert ":48731" in viewing.why_not
    with pytest.raises(UsageError, match=r":48731 .* does not answer .* --save FILE.rrd"):
        chosen(None)
