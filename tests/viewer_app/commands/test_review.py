"""``duplex review`` lists the events and opens the viewer where something happened."""

import base64
import io
import json
from contextlib import nullcontext
from dataclasses import replace
from unittest.mock import MagicMock

import numpy as np
import pytest
from PIL import Image

from devices.events import Event
from devices.sensor import ColorCamera, ColorImage
from fusion.body import KINECT_V2
from fusion.intrinsics import Intrinsics
from fusion.rigid import RigidTransform
from recordings.data.images import Images, SessionImages
from recordings.file.session_writer import write_session
from recordings.quality.figures import report
from recordings.quality.without_truth import truth_free_figures
from recordings.session import Session
from tests.helpers.command_line import duplex
from tests.helpers.frame_pairs import frame_pairs
from tests.helpers.fused_runs import record_fused
from tests.helpers.screens import browser
from tests.helpers.two_views import calibration_of
from viewer_app.report.pages.film import film
from viewer_app.report.pages.review_page import review_page
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


# --- The film of small colour images on the page of a session.


pytest.importorskip("matplotlib", reason="the page's plots need matplotlib")
CAMERA = ColorCamera(Intrinsics(320, 180, 157.0, 157.0, 159.5, 89.5), RigidTransform.identity())
GAP = range(20, 60)
"""Frames in which B has no image."""


def picture(frame, side):
    """A JPEG whose grey is the frame's number, with noise of another size for each sensor."""
    noise = np.random.default_rng(frame).normal(frame + 60.0, 1.0 if side == "a" else 40.0, (180, 320, 3))
    out = io.BytesIO()
    Image.fromarray(np.clip(noise, 0, 255).astype(np.uint8)).save(out, "JPEG", quality=90)
    return out.getvalue()


class Colored(SessionImages):
    """Colour images of A in every frame, of B except in a gap; one is damaged."""

    def color(self, side, frames):
        def made():
            for frame in frames:
                if side == "a" or frame not in GAP:
                    jpeg = claiming(65_500, 65_500) if (frame, side) == (0, "a") else picture(frame, side)
                    yield frame, ColorImage(jpeg, CAMERA)

        return Images(made)


def claiming(width, height):
    """An image that says that it is of this size."""
    jpeg = bytearray(picture(0, "a"))
    at = jpeg.index(b"\xff\xc0") + 5
    jpeg[at : at + 4] = height.to_bytes(2) + width.to_bytes(2)
    return bytes(jpeg)


@pytest.fixture(scope="module")
def session_of_film(tmp_path_factory):
    path = tmp_path_factory.mktemp("film") / "s.rrd"
    session_of_film = record_fused(path, frame_pairs(KINECT_V2, 90), calibration_of(KINECT_V2))
    assert film(session_of_film) == {}
    return replace(session_of_film, images=Colored())


def test_the_film_has_small_images_at_their_moments_and_fits_into_a_page(session_of_film):
    found = film(session_of_film)
    assert set(found) == {"a", "b"}
    for side, images in found.items():
        frames = [int(np.argmin(np.abs(session_of_film.time - seconds))) for seconds, _ in images]
        every = [k for k in range(0, 90, 3) if side == "a" or k not in GAP]
        assert frames == [k for k in every if (side, k) != ("a", 0)]
        for frame, (_, jpeg) in zip(frames, images, strict=True):
            small = Image.open(io.BytesIO(base64.b64decode(jpeg)))
            assert small.size == (240, 135)
            assert np.mean(np.asarray(small)) == pytest.approx(frame + 60.0, abs=4.0)
    bytes_of_a_minute = len(json.dumps(found)) * 60.0 / session_of_film.time[-1]
    assert bytes_of_a_minute < 12e6  # a page of a minute has at most 15 MB, and all the rest has 1.5


def test_there_are_at_most_ten_images_a_second(session_of_film):
    faster = replace(
        session_of_film, rows=replace(session_of_film.rows, time_ns=session_of_film.rows.time_ns * 6 // 5)
    )  # 25 Hz
    seconds = [at for at, _ in film(faster)["a"]]
    assert np.diff(seconds).min() > 0.099


def test_the_player_shows_the_image_of_its_moment_or_how_old_it_is(session_of_film, tmp_path):
    page = tmp_path / "s.html"
    figures = report(session_of_film) | {"without_truth": truth_free_figures(session_of_film)}
    page.write_text(review_page(session_of_film, figures), encoding="utf-8")
    assert '<script type="application/json" id="film">' in page.read_text(encoding="utf-8")
    found = film(session_of_film)
    with browser(1000, 700) as chromium:
        tab = chromium.new_page()
        wrong, asked = [], []
        tab.on("pageerror", lambda error: wrong.append(str(error)))
        tab.on("request", lambda request: asked.append(request.url))
        tab.goto(page.as_uri())
        tab.locator("#play:enabled").wait_for()
        for frame in (0, 15, 31, 45, 89):
            tab.locator("#moment").fill(f"{session_of_film.time[frame]:.6f}")
            shown = float(tab.locator("#clock").inner_text().split()[0])
            for side, images in found.items():
                figure = tab.locator(f".film [data-side={side}]")
                seconds, jpeg = min(images, key=lambda each: abs(each[0] - shown))
                assert figure.locator("img").get_attribute("src").endswith(jpeg)
                late = abs(seconds - shown) > 0.25
                words = f"{abs(seconds - shown):.1f} s" if late else f"at {seconds:.2f} s"
                assert words in figure.inner_text()
                assert (figure.locator("img").get_attribute("class") == "late") == late
        assert wrong == []
        assert [url for url in asked if not url.startswith(("file:", "data:"))] == []
