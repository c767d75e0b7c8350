"""Fixtures of the program's tests."""

import pytest

from tests.helpers.live_frames import known_fuser


@pytest.fixture
def fuser():
    return known_fuser()


@pytest.fixture
def without_plots(monkeypatch):
    """Leaves out the plots of the page, which take most of the time."""
    for name in ("line_plot", "bar_plot", "trust_map"):
        monkeypatch.setattr(f"viewer_app.report.pages.review_page.{name}", lambda *_, **__: "")
    monkeypatch.setattr("viewer_app.report.walking.line_plot", lambda *_, **__: "")
