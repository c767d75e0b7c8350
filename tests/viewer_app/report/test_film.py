"""The film of small colour images on the page of a session."""

import base64
import io
import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from devices.sensor import ColorCamera, ColorImage
from fusion.body import KINECT_V2
from fusion.intrinsics import Intrinsics
from fusion.rigid import RigidTransform
from recordings.data.images import Images, SessionImages
from recordings.quality.figures import report
from recordings.quality.without_truth import truth_free_figures
from tests.helpers.frame_pairs import frame_pairs
from tests.helpers.fused_runs import record_fused
from tests.helpers.screens import browser
from tests.helpers.two_views import calibration_of
from viewer_app.report.pages.film import film
from viewer_app.report.pages.review_page import review_page

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
def session(tmp_path_factory):
    path = tmp_path_factory.mktemp("film") / "s.rrd"
    session = record_fused(path, frame_pairs(KINECT_V2, 90), calibration_of(KINECT_V2))
    assert film(session) == {}
    return replace(session, images=Colored())


def test_the_film_has_small_images_at_their_moments_and_fits_into_a_page(session):
    found = film(session)
    assert set(found) == {"a", "b"}
    for side, images in found.items():
        frames = [int(np.argmin(np.abs(session.time - seconds))) for seconds, _ in images]
        every = [k for k in range(0, 90, 3) if side == "a" or k not in GAP]
        assert frames == [k for k in every if (side, k) != ("a", 0)]
        for frame, (_, jpeg) in zip(frames, images, strict=True):
            small = Image.open(io.BytesIO(base64.b64decode(jpeg)))
            assert small.size == (240, 135)
            assert np.mean(np.asarray(small)) == pytest.approx(frame + 60.0, abs=4.0)
    bytes_of_a_minute = len(json.dumps(found)) * 60.0 / session.time[-1]
    assert bytes_of_a_minute < 12e6  # a page of a minute has at most 15 MB, and all the rest has 1.5


def test_there_are_at_most_ten_images_a_second(session):
    faster = replace(session, rows=replace(session.rows, time_ns=session.rows.time_ns * 6 // 5))  # 25 Hz
    seconds = [at for at, _ in film(faster)["a"]]
    assert np.diff(seconds).min() > 0.099


def test_the_player_shows_the_image_of_its_moment_or_how_old_it_is(session, tmp_path):
    page = tmp_path / "s.html"
    figures = report(session) | {"without_truth": truth_free_figures(session)}
    page.write_text(review_page(session, figures), encoding="utf-8")
    assert '<script type="application/json" id="film">' in page.read_text(encoding="utf-8")
    found = film(session)
    with browser(1000, 700) as chromium:
        tab = chromium.new_page()
        wrong, asked = [], []
        tab.on("pageerror", lambda error: wrong.append(str(error)))
        tab.on("request", lambda request: asked.append(request.url))
        tab.goto(page.as_uri())
        tab.locator("#play:enabled").wait_for()
        for frame in (0, 15, 31, 45, 89):
            tab.locator("#moment").fill(f"{session.time[frame]:.6f}")
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
