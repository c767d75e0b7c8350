"""The page of ``duplex review``, in a real browser where there is one."""

import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from fusion.body import KINECT_V2
from recordings.testing import FusedRun, fused_run
from tests.helpers.command_line import duplex
from tests.helpers.frame_pairs import frame_pairs
from tests.helpers.machine import need_browser
from tests.helpers.two_views import calibration_of
from viewer_app.report.figures import report, truth_free_figures
from viewer_app.report.review_page import _without_folders, review_page
from viewer_app.report.svg_plots import _columns_of_time, _figure, _legend

__all__ = ["fused_run"]  # a fixture
pytest.importorskip("matplotlib", reason="the page's plots need matplotlib")


def test_files_are_named_without_their_folders() -> None:
    assert _without_folders(("ann/walk/a.csv", "ann/walk/b.csv")) == ("a.csv", "b.csv")
    assert _without_folders(("C:\\ann\\left\\s.csv", "C:\\ann\\right\\s.csv")) == (
        "left/s.csv",
        "right/s.csv",
    )
    assert _without_folders(("Kinect 12", "Kinect 12")) == ("Kinect 12", "Kinect 12")


def test_a_trust_map_s_columns_are_stretches_of_time() -> None:
    time = np.arange(1500) / 30.0
    time = time[(time < 10.0) | (time >= 40.0)]  # 30 s without a frame
    share = np.where(time < 20.0, 1.0, 0.0)[:, None]
    columns = _columns_of_time(time, share)[:, 0]
    edges = np.linspace(0.0, time[-1], len(columns) + 1)
    before, after = edges[1:] <= 9.9, edges[:-1] >= 40.0
    between = (edges[:-1] > 10.1) & (edges[1:] < 39.9)
    assert (columns[before] == 1.0).all()
    assert (columns[after] == 0.0).all()
    assert np.isnan(columns[between]).all()
    assert before.sum() + after.sum() + between.sum() > 0.98 * len(columns)
    assert np.isfinite(_columns_of_time(time[:9], share[:9])).all()  # fewer frames than columns


def test_a_legend_stands_above_its_plot() -> None:
    figure, axes = _figure(6.0, 2.4)
    axes.plot([0, 1], [0, 1], label="S_A")
    _legend(axes, 1)
    figure.draw_without_rendering()
    box = axes.get_legend().get_window_extent()
    assert box.y0 >= axes.get_window_extent().y1
    assert box.y1 <= figure.bbox.y1


@pytest.fixture
def page(fused_run: FusedRun, tmp_path: Path) -> Path:
    session = fused_run(frame_pairs(KINECT_V2, 60, gap=(20, 21)), calibration_of(KINECT_V2))
    path = tmp_path / "report.html"
    assert duplex("review", session.path, "--no-viewer", "--html", path) == 0
    return path


class _Ids(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.ids: list[str] = []
        self.links: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if name == "id" and value:
                self.ids.append(value)
            if name in ("src", "href", "xlink:href") and value and not value.startswith(("#", "data:")):
                self.links.append(f"{tag} {value}")


def test_the_page_stands_alone(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    found = _Ids()
    found.feed(text)
    assert found.links == []
    assert "<script" not in text
    assert len(found.ids) == len(set(found.ids))
    assert len(text) < 2_000_000
    assert not re.search(r"nan|None", re.sub(r"<svg.*?</svg>|<p>None\.</p>", "", text, flags=re.S))


def test_a_browser_shows_it_light_and_dark_without_network(page: Path) -> None:
    playwright = pytest.importorskip("playwright.sync_api", reason="no playwright")
    chromium = need_browser()
    with playwright.sync_playwright() as p:
        browser = p.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        try:
            colors = {}
            for scheme in ("light", "dark"):
                tab = browser.new_page(color_scheme=scheme, viewport={"width": 1200, "height": 900})
                asked: list[str] = []
                said: list[str] = []
                tab.on("request", lambda request, asked=asked: asked.append(request.url))
                tab.on("console", lambda message, said=said: said.append(message.text))
                tab.goto(page.as_uri())
                assert asked == [page.as_uri()]
                assert said == []
                headings = tab.locator("h2").all_inner_texts()
                assert {"All figures", "Bone lengths", "Jitter", "Trust per joint", "Timing"} <= set(headings)
                assert tab.locator("figure svg").count() == 13
                for box in (svg.bounding_box() for svg in tab.locator("figure svg").all()):
                    assert box["width"] > 300
                    assert box["height"] > 80
                assert tab.evaluate("document.documentElement.scrollWidth") <= 1200
                heights = [plot.bounding_box()["height"] for plot in tab.locator("figure svg").all()]
                assert max(heights) < 2.5 * min(heights)  # the trust map's two dozen rows
                event = tab.locator("table.words td").last
                assert event.evaluate("e => getComputedStyle(e).textAlign") == "left"
                phone = browser.new_page(color_scheme=scheme, viewport={"width": 390, "height": 800})
                phone.goto(page.as_uri())
                assert phone.evaluate("document.documentElement.scrollWidth") <= 390
                ink = tab.locator("figure svg text").first.evaluate("e => getComputedStyle(e).fill")
                ground = tab.evaluate("getComputedStyle(document.body).backgroundColor")
                colors[scheme] = (ink, ground)
                assert colors[scheme][0] == tab.evaluate("getComputedStyle(document.body).color")
            assert colors["light"][1] != colors["dark"][1]
            assert colors["light"][0] != colors["dark"][0]
        finally:
            browser.close()


def test_what_a_session_says_is_text_and_never_markup(fused_run: FusedRun) -> None:
    session = fused_run(frame_pairs(KINECT_V2, 30), calibration_of(KINECT_V2))
    session.about["settings"]["note"] = ["<script>alert(1)</script>"]
    hostile = replace(session.events[0], text="<img src=x onerror=alert(1)> & more")
    session = replace(session, events=(*session.events, hostile))
    text = review_page(session, report(session) | {"without_truth": truth_free_figures(session)})
    assert "Roughness" in text
    assert "<script" not in text
    assert "<img" not in text
    assert "&lt;img src=x onerror=alert(1)&gt; &amp; more" in text
