"""The live demonstration, a saved session and the report page in a browser."""

import re

import pytest

from tests.acceptance.conftest import copied
from tests.helpers.pictures import shows_skeletons
from tests.helpers.programs import typed
from tests.helpers.screens import browser, shown_in
from tests.helpers.waiting import eventually

playwright = pytest.importorskip("playwright.sync_api", reason="the dev extra has playwright")
_DRAWN_WITHIN = 300.0


@pytest.fixture(scope="module")
def chromium():
    with browser(1000, 700) as found:
        yield found


@pytest.fixture
def tab(chromium):
    """A new tab that collects what goes wrong in it."""
    tab = chromium.new_page()
    tab.wrong = []
    tab.on("pageerror", lambda error: tab.wrong.append(str(error)))
    yield tab
    tab.close()


@pytest.fixture
def page_shows(tab, seen):
    """Opens the address that a program printed; waits until it shows the three skeletons."""

    def found(program):
        assert program.says("/proxy"), program.said
        (address,) = re.findall(r"Viewer: (http://\S+)", program.said)
        tab.goto(address)  # the server listens
        pictures = []

        def drawn():
            pictures.append(shown_in(tab))
            return shows_skeletons(pictures[-1])

        shown = eventually(drawn, _DRAWN_WITHIN, every=0.5)
        seen(pictures[-1])
        assert shown, "no skeletons in the page"

    return found


def test_the_running_demonstration_is_shown_to_a_browser_that_comes_later(page_shows, tmp_path, home):
    with typed("duplex demo --web --depth none", tmp_path, **home) as demonstration:
        page_shows(demonstration)
        assert demonstration.end() == 0, demonstration.said
    assert "Verdict" in demonstration.said


@pytest.fixture(scope="module")
def fused(tmp_path_factory, walk, home):
    """The folder of a saved session and its report page."""
    folder = copied(walk, tmp_path_factory.mktemp("fused"))
    line = "duplex fuse a.csv b.csv --save s.rrd --no-viewer && duplex review s.rrd --no-viewer --html r.html"
    with typed(line, folder, **home) as fusing:
        assert fusing.code() == 0, fusing.said
    return folder


def test_a_saved_session_is_shown(page_shows, fused, home):
    with typed("duplex review s.rrd --web", fused, **home) as review:
        page_shows(review)
        assert review.end() == 0, review.said


def test_the_report_page_plays_the_three_skeletons(tab, fused, seen):
    tab.goto((fused / "r.html").as_uri())
    tab.locator("#play:enabled").wait_for()
    tab.locator("#moment").fill("10")
    player = tab.locator("#person")
    seen(shown_in(tab))
    assert shows_skeletons(shown_in(player))
    verdict = tab.locator("body").inner_text()
    assert "usable" in verdict
    before = player.screenshot()
    tab.locator("#play").click()
    assert eventually(lambda: player.screenshot() != before)
    tab.locator("#play").click()  # a pause
    tab.locator("#moment").press("End")
    assert tab.locator("#clock").inner_text() == tab.locator("#moment").get_attribute("aria-valuetext")
    tab.locator("#play").click()
    assert tab.locator("#play").inner_text() == "Pause"
    assert float(tab.locator("#clock").inner_text().split()[0]) < 5.0, "it plays from the beginning"
    assert tab.wrong == []
