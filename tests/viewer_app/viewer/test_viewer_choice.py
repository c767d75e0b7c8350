"""A session in a browser, and the addresses that can reach it."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from urllib.request import urlopen

import cv2
import numpy as np
import psutil
import pytest
from numpy.typing import NDArray
from rich.console import Console

from fusion.fuser import Fuser
from recordings.appearance.colors import SKELETON_COLORS
from tests.helpers.live_frames import frames, session
from tests.helpers.machine import need_browser, need_viewer
from tests.helpers.pictures import pixels_near
from tests.helpers.waiting import eventually
from viewer_app.errors import UsageError
from viewer_app.options.shared import ViewerOptions
from viewer_app.sinks.live_session import LiveSession
from viewer_app.viewer.rerun_process import Hub, start_viewer, stop
from viewer_app.viewer.viewer_choice import Viewing, announce, choose_viewing

_DRAWN_WITHIN = 60.0


@pytest.fixture
def served(fuser: Fuser) -> Iterator[LiveSession]:
    """A session that is served to browsers."""
    with session(fuser, None, Hub.on_free_ports(web=True)) as live:
        yield live


def listening(pid: int) -> set[str]:
    """The addresses that a process and its children listen on."""
    process = psutil.Process(pid)
    everyone = [process, *process.children(recursive=True)]
    return {c.laddr.ip for p in everyone for c in p.net_connections("inet") if c.status == psutil.CONN_LISTEN}


def test_hub_page_and_window_listen_on_loopback_only(served: LiveSession) -> None:
    assert served.viewer is not None
    assert listening(served.viewer.process.pid) == {"127.0.0.1"}
    own = {c.laddr.ip for c in psutil.Process().net_connections("inet") if c.status == psutil.CONN_LISTEN}
    assert own <= {"127.0.0.1"}


def test_a_viewer_that_we_start_listens_on_loopback_only() -> None:
    need_viewer()
    viewer, _ = start_viewer(["--headless"])
    try:
        assert listening(viewer.pid) == {"127.0.0.1"}
    finally:
        stop(viewer)


def test_an_address_that_is_asked_for_is_listened_on(fuser: Fuser) -> None:
    hub = Hub.on_free_ports(web=True, address="0.0.0.0")
    with session(fuser, None, hub) as live:
        assert live.viewer is not None
        assert listening(live.viewer.process.pid) == {"0.0.0.0"}


def test_usage_statistics_are_off(served: LiveSession) -> None:
    assert served.viewer is not None
    assert psutil.Process(served.viewer.process.pid).environ()["RERUN_ANALYTICS"] == "0"


def test_the_page_is_the_viewer_with_the_session(served: LiveSession) -> None:
    hub = served.viewer._hub
    assert hub is not None
    with urlopen(hub.page, timeout=5.0) as page:
        assert b"<canvas" in page.read()
    assert f"%3A{hub.port}%2Fproxy" in hub.page


def said(viewing: Viewing | None, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setattr("viewer_app.viewer.viewer_choice.has_display", lambda: False)
    out = io.StringIO()
    announce(viewing, Console(file=out, width=300))
    return out.getvalue()


def test_listening_to_others_is_warned_of(monkeypatch: pytest.MonkeyPatch) -> None:
    alone, open_to_all = (
        said(Viewing(hub=Hub.on_free_ports(web=True, address=address)), monkeypatch)
        for address in (None, "0.0.0.0")
    )
    assert "Warning" not in alone
    assert "http://127.0.0.1:" in alone
    assert "Warning" in open_to_all
    assert "video included" in open_to_all
    assert said(None, monkeypatch) == ""


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"listen": "0.0.0.0"}, "--listen 0.0.0.0 is the address of --web"),
        ({"web": True, "no_viewer": True}, "contradict"),
        ({"web": True, "listen": "192.0.2.1"}, "Cannot listen on '192.0.2.1'"),
        ({}, "There is no display"),
    ],
)
def test_contradicting_options_give_one_line(
    options: dict[str, object], words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("viewer_app.viewer.viewer_choice.why_no_window", lambda: "There is no display")
    with pytest.raises(UsageError, match=words):
        choose_viewing(ViewerOptions(**options), None, live=True)  # type: ignore[arg-type]


@contextmanager
def browser() -> Iterator[object]:
    """Debian's Chromium without a screen, drawing on the CPU."""
    playwright = pytest.importorskip("playwright.sync_api", reason="the dev extra has playwright")
    program = need_browser()
    with playwright.sync_playwright() as started:
        flags = (
            "--no-sandbox --use-gl=angle --use-angle=swiftshader --enable-unsafe-swiftshader "
            "--ignore-gpu-blocklist"
        )
        chromium = started.chromium.launch(executable_path=program, args=flags.split())
        try:
            yield chromium.new_context(viewport={"width": 900, "height": 600})
        finally:
            chromium.close()


def test_a_browser_sees_the_three_skeletons_and_a_later_visitor_the_history(
    served: LiveSession, fuser: Fuser
) -> None:
    hub = served.viewer._hub
    assert hub is not None
    for frame in frames(fuser, 60):
        served.write(frame)
    with browser() as chromium:
        for _ in range(2):
            page = chromium.new_page()  # type: ignore[attr-defined]
            page.goto(hub.page)

            def sees_skeletons(page: object = page) -> bool:
                shot = cv2.imdecode(np.frombuffer(page.screenshot(), np.uint8), cv2.IMREAD_COLOR)  # type: ignore[attr-defined]
                assert shot is not None
                picture: NDArray[np.uint8] = np.asarray(shot[..., ::-1])
                colors = (SKELETON_COLORS[key] for key in ("a", "b", "fused"))
                return all(pixels_near(picture, color) > 50 for color in colors)

            assert eventually(sees_skeletons, _DRAWN_WITHIN)
            page.close()
