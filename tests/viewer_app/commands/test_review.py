"""``duplex review`` lists the events and opens the viewer where something happened."""

from contextlib import nullcontext
from dataclasses import replace
from unittest.mock import MagicMock

import numpy as np
import pytest

from devices.events import Event
from fusion.body import KINECT_V2
from recordings.file.session_writer import write_session
from recordings.session import Session
from tests.helpers.command_line import duplex
from tests.helpers.frame_pairs import frame_pairs
from tests.helpers.fused_runs import record_fused
from tests.helpers.two_views import calibration_of
from viewer_app.viewer import file_window, viewer_choice
from viewer_app.viewer.blueprint import LAYOUTS, session_blueprint

EVENTS = (
    Event("calibrated: known", "INFO"),
    Event(
        "A reports left and right exchanged.", "INFO", "exchanged_a", "start", frame=15, time_ns=500_000_000
    ),
    Event("A sensor seems to have been moved.", "WARN").placed(30, 1_000_000_000),
    Event("A is right again.", "INFO", "exchanged_a", "end").placed(45, 1_500_000_000),
)


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    path = tmp_path_factory.mktemp("review") / "s.rrd"
    return record_fused(path, frame_pairs(KINECT_V2, 60), calibration_of(KINECT_V2))


@pytest.fixture
def path(session, tmp_path):
    write_session(replace(session, events=EVENTS), tmp_path / "s.rrd")
    return tmp_path / "s.rrd"


@pytest.fixture
def shown(monkeypatch):
    """Replaces the viewer."""
    viewer = MagicMock(return_value=True)
    monkeypatch.setattr(file_window, "show", viewer)
    monkeypatch.setattr(viewer_choice, "why_no_window", lambda: None)
    return viewer


@pytest.mark.parametrize(
    ("options", "at_ns", "words"),
    [
        ((), 1_000_000_000, "at 1.00 s, event 3"),
        (("--event", 2), 500_000_000, "at 0.50 s, event 2"),
        (("--at", 0.25), 250_000_000, "at 0.25 s"),
    ],
)
def test_the_viewer_opens_at_the_first_warning_or_as_asked(options, at_ns, words, path, shown, capsys):
    assert duplex("review", path, *options) == 0
    shown.assert_called_once_with(path, at_ns)
    said = capsys.readouterr().out
    assert f"The viewer opens {words}." in said
    assert "2  0.50 s  A reports left and right exchanged. It lasted 1.0 s." in said
    assert "3  1.00 s  Warning: A sensor seems to have been moved." in said


@pytest.mark.parametrize("layout", LAYOUTS)
def test_another_layout_is_opened_in_a_copy(layout, path, shown, monkeypatch):
    before, opened, drawn = path.read_bytes(), [], []
    shown.side_effect = lambda file, _: opened.append((file, Session.open(file))) or True
    made = lambda *given, **named: drawn.append(given[2]) or session_blueprint(*given, **named)  # noqa: E731
    monkeypatch.setattr("viewer_app.viewer.file_window.session_blueprint", made)
    assert duplex("review", path, "--layout", layout) == 0
    ((file, copy),) = opened
    assert drawn == [layout]
    assert file != path
    assert path.read_bytes() == before
    np.testing.assert_array_equal(copy.fused_checksums, Session.open(path).fused_checksums)


def test_without_a_display_it_says_where_a_viewer_would_open(path, shown, monkeypatch, capsys):
    monkeypatch.setattr(viewer_choice, "why_no_window", lambda: "There is no display")
    assert duplex("review", path, "--event", 2) == 0
    assert "There is no display; a viewer would open at 0.50 s, event 2." in capsys.readouterr().out
    shown.assert_not_called()


def test_a_browser_is_served_the_session(path, monkeypatch, capsys):
    served = []
    monkeypatch.setattr(file_window, "served", lambda *of: nullcontext(served.append(of)))
    monkeypatch.setattr(viewer_choice.WebPage, "stay", lambda *_: None)
    monkeypatch.setattr("viewer_app.viewer.web_page.has_display", lambda: False)
    assert duplex("review", path, "--web") == 0
    ((file, hub),) = served
    assert file == path
    said = capsys.readouterr().out
    assert f"Viewer: http://127.0.0.1:{hub.web_port}/?url=" in said
    assert "a window would open at 1.00 s, event 3." in said


def test_without_an_event_it_opens_at_the_beginning_and_says_so(session, shown, capsys):
    assert duplex("review", session.path) == 0
    shown.assert_called_once_with(session.path, 0)
    assert "opens at the beginning: no later event calls for a look" in capsys.readouterr().out
