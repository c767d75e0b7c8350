"""The page of ``duplex review``, in a real browser where there is one."""

import base64
import io
import json
import re
import zlib
from dataclasses import replace
from html import unescape
from html.parser import HTMLParser

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from devices.recorded.files import distinct_names
from devices.sensor import ColorCamera, ColorImage
from fusion.body import KINECT_V2
from fusion.intrinsics import Intrinsics
from fusion.rigid import RigidTransform
from recordings.appearance.colors import PREDICTED_COLOR
from recordings.appearance.floor import floor_under
from recordings.data.images import Images, SessionImages
from recordings.gait import Gait, Measured, Step, Turn
from recordings.quality.figures import report
from recordings.quality.limits import POSSIBLE
from recordings.quality.without_truth import truth_free_figures
from tests.helpers.command_line import duplex
from tests.helpers.footfalls import walking_session
from tests.helpers.frame_pairs import frame_pairs
from tests.helpers.fused_runs import record_fused
from tests.helpers.screens import browser
from tests.helpers.two_views import calibration_of
from viewer_app.report import motion as motion_module
from viewer_app.report.motion import _kept_frames, encoded_motion
from viewer_app.report.pages.film import film
from viewer_app.report.pages.review_page import recorded, review_page
from viewer_app.report.svg_plots import (
    _BAND_POINTS,
    _band,
    _columns_of_time,
    line_plot,
    skeleton_color,
    trust_map,
)
from viewer_app.report.walking import _in_words, _scatter, _summary, _told, movement_of
from viewer_app.report.words import in_percent

pytest.importorskip("matplotlib", reason="the page's plots need matplotlib")


def test_files_are_named_without_their_folders():
    assert distinct_names(*("ann/walk/a.csv", "ann/walk/b.csv")) == ("a.csv", "b.csv")
    assert distinct_names(*("C:\\ann\\left\\s.csv", "C:\\ann\\right\\s.csv")) == ("left/s.csv", "right/s.csv")
    assert distinct_names(*("1/rec.csv", "rec.csv")) == ("1/rec.csv", "rec.csv")
    assert distinct_names(*("Kinect 12", "Kinect 12")) == ("Kinect 12", "Kinect 12")


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "s.rrd"
    return record_fused(path, frame_pairs(KINECT_V2, 60, gap=(20, 21)), calibration_of(KINECT_V2))


@pytest.fixture(scope="module")
def page(session):
    path = session.path.with_name("report.html")
    assert duplex("review", session.path, "--no-viewer", "--html", path) == 0
    return path


def page_of(session):
    return review_page(session, report(session) | {"without_truth": truth_free_figures(session)})


def telling(session, **words):
    """The session with more that it tells about itself."""
    return replace(session, about={**session.about, "session": session.about["session"] | words})


PLOTS = [f"pages.review_page.{name}" for name in ("line_plot", "bar_plot", "trust_map")]


def titles_instead_of(plots, monkeypatch):
    """Leaves out plots, which take most of the time; returns a list that gets their first arguments."""
    titles = []
    for name in plots:
        monkeypatch.setattr(
            f"viewer_app.report.{name}", lambda title, *_, **__: titles.append(str(title)) or ""
        )
    return titles


@pytest.fixture
def titles(monkeypatch):
    return titles_instead_of([*PLOTS, "walking.line_plot", "walking.cycle_plot"], monkeypatch)


def test_the_page_has_the_gait_of_people_who_walk_and_of_no_others(page, tmp_path, monkeypatch):
    titles_instead_of(PLOTS, monkeypatch)
    walking = walking_session(tmp_path / "walk.rrd")
    text = page_of(walking)
    assert re.search(
        rf"{len(walking.gait.steps)} steps in {walking.gait.walking_seconds:.0f} s of walking, 1 walk; "
        r"cadence 104\.\d ± \d+\.\d steps/min, .* \(± standard error\); .*"  # a stride takes 1.15 s
        r"left out of 9 s of motion: \d s no three strikes in turn\.",
        text,
    )
    assert text.count("over the gait cycle") == 6
    assert re.search(r"<td>stance \(% of the cycle\)</td><td>6\d ± \d", text)
    for name in ("knee flexion", "shoulder abduction", "trunk"):
        assert re.search(f'aria-label="{name}, 1 σ about \\d+°, °, over time"', text)
    text = page.read_text(encoding="utf-8")
    assert "gait" not in text.lower()
    assert 'aria-label="knee flexion, 1 σ about ' in text


def test_motion_without_steps_is_told_in_seconds_with_the_reason():
    assert _summary(Gait((), {"not forwards": 4.2, "no three strikes in turn": 0.2})) == (
        "No steps; left out of 4 s of motion: 4 s not forwards."
    )
    assert _summary(Gait((), {"not forwards": 0.0, "no three strikes in turn": 1.5})) == ""


def test_turns_are_told_with_their_range_and_the_steps_in_them():
    gait = Gait(
        tuple(a_step(at) for at in (1.0, 2.0, 3.0)),
        turns=(Turn(1.5, 1.0, 0.1, 7.5, 0.1), Turn(4.0, 1.0, 0.1, -0.8, 0.1)),
    )
    assert "; 2 turns by 46° to 430° with 1 of the steps" in _summary(gait)
    assert "; 1 turn by 46° with 0 of the steps" in _summary(replace(gait, turns=gait.turns[1:]))


def a_step(strike):
    return Step("left", 0, strike, 0.02, strike - 0.4, 0.02, 0.5, 0.6, 0.02, 0.1, 0.6, 0.0)


def test_no_value_is_more_certain_than_it_is_rounded():
    assert _in_words(Measured(104.19, 0.07), 1) == "104.2 ± 0.1"
    assert _told(_scatter([0.5, 0.5002]), "mean", "sd", 2) == "0.50 ± 0.01"
    assert _told(_scatter([0.5, np.nan]), "mean", "sd", 2) == "0.50"


class _Ids(HTMLParser):
    def __init__(self):
        super().__init__()
        self.ids = []
        self.links = []
        self.scripts = 0

    def handle_starttag(self, tag, attrs):
        self.scripts += tag == "script"
        for name, value in attrs:
            if name == "id" and value:
                self.ids.append(value)
            if name in ("src", "href", "xlink:href") and value and not value.startswith(("#", "data:")):
                self.links.append(f"{tag} {value}")


def test_the_page_stands_alone(page):
    text = page.read_text(encoding="utf-8")
    found = _Ids()
    found.feed(text)
    assert found.links == []
    assert found.scripts == 1
    assert not re.search(r"fetch|import|XMLHttp|WebSocket|https?:", text[text.index("<script") :])
    assert len(found.ids) == len(set(found.ids))
    assert len(text) < 1_500_000
    assert not re.search(
        r"nan|None", re.sub(r"<svg.*?</svg>|<canvas.*?>|<p>None\.</p>", "", text, flags=re.S)
    )


def without(session, *joints):
    """The session in which these joints were never seen."""
    joints, views = [session.body.joint(joint) for joint in joints], {}
    for side in "ab":
        for name, nothing in (("states", 0), ("positions", np.nan)):
            views[f"{name}_{side}"] = values = getattr(session.rows, f"{name}_{side}").copy()
            values[:, joints] = nothing
    return replace(session, rows=replace(session.rows, **views))


@pytest.mark.parametrize("never", [(), ("FootLeft", "HandRight")])
def test_the_motion_is_that_of_the_session_to_the_millimetre(session, never):
    session = without(session, *never)
    motion = encoded_motion(session, [])
    count, joints = motion["frames"], len(session.body.joints)
    data = zlib.decompress(base64.b64decode(motion["motion"]))
    seconds = np.frombuffer(data, "<f4", count)
    low, high = np.frombuffer(data, np.uint8, 18 * joints * count, 4 * count).astype(np.int64).reshape(2, -1)
    code = low + 256 * high
    steps = np.where(code % 2, -(code + 1) // 2, code // 2).reshape(3, joints, 3, count)
    found = (np.cumsum(steps, axis=-1) + 2**15) % 2**16 - 2**15
    floor = floor_under(session.rows)
    rows = np.searchsorted(session.time_ns * 1e-9, seconds - 1e-3)
    bits = np.unpackbits(
        np.frombuffer(data, np.uint8, offset=(4 + 18 * joints) * count), count=joints * count
    )
    uncertain = session.rows.predicted | (session.sigma > 0.15)
    np.testing.assert_array_equal(bits.reshape(joints, count).T, uncertain[rows])
    assert uncertain[rows].any()
    assert not uncertain[rows].all()
    assert np.diff(seconds[:-1]).min() > 1 / 16  # the last frame is always there
    assert seconds[-1] == pytest.approx(session.time_ns[-1] * 1e-9)
    for k, true in enumerate((session.rows.positions_a, session.rows.b_in_a, session.rows.seen)):
        positions = true[rows].astype(np.float64)
        seen = np.isfinite(positions)
        at = found[k].transpose(2, 0, 1)
        assert (at[~seen] == -32768).all()
        np.testing.assert_allclose(
            at[seen], 1e3 * floor.inverse().apply(positions)[seen], rtol=0.0, atol=0.5 + 1e-3
        )
    height = -found[2, session.body.joint("ankle left"), 1]
    assert np.median(height[height < 2**15]) == pytest.approx(80, abs=40)  # the floor is below the feet


def test_a_line_joins_values_of_every_other_frame_but_not_across_a_gap():
    time = np.arange(60) / 30
    values = np.where(np.arange(60) % 2, np.nan, 5.0)
    values[20:41] = np.nan
    drawn = line_plot("views differ", "mm", time, {"one": (values, "fused")})
    (path,) = re.findall(rf'<path d="([^"]*)"[^>]*stroke: {skeleton_color("fused")}', drawn)
    assert path.count("M ") == 2
    assert path.count("L ") == 9 + 8


@given(
    degrees=st.lists(st.floats(-90.0, 180.0) | st.just(np.nan), min_size=1, max_size=900),
    sigma=st.floats(0.1, 30.0),
)
def test_a_band_holds_every_value_and_its_deviation(degrees, sigma):
    values, time = np.array(degrees), np.arange(len(degrees)) / 30
    starts, lower, upper = _band(time, values, np.full(len(values), sigma))
    assert len(starts) <= _BAND_POINTS + 2 * np.isnan(values).sum()
    span = np.searchsorted(starts, time, side="right") - 1
    known = np.isfinite(values)
    assert (lower[span] <= values - sigma)[known].all()
    assert (upper[span] >= values + sigma)[known].all()
    np.testing.assert_array_equal(np.isnan(lower[span]), ~known)
    assert {*lower[np.isfinite(lower)]} <= {*(values - sigma)[known]}


@given(
    lasts=st.lists(st.integers(2, 400), min_size=1, max_size=6),
    pause=st.floats(0.35, 20.0),
    wide=st.booleans(),
)
def test_no_line_crosses_a_pause(lasts, pause, wide):
    """Also where only some of the values are drawn."""
    steps = [np.r_[pause, np.full(count - 1, 1 / 30)] for count in lasts]
    time = np.cumsum(np.concatenate(steps))
    zigzag = np.resize([0.0, 1.0], len(time))  # matplotlib would simplify a straight line
    drawn = line_plot("views differ", "mm", time, {"one": (zigzag, "fused")}, wide=wide)
    (path,) = re.findall(rf'<path d="([^"]*)"[^>]*stroke: {skeleton_color("fused")}', drawn)
    assert path.count("M ") == len(lasts)


@given(low=st.floats(0.01, 100.0), times=st.floats(1.0, 1e5))
def test_a_logarithmic_axis_has_plain_numbers_around_the_values(low, times):
    values = np.geomspace(low, low * times, 20)
    drawn = line_plot("fusion", "ms", np.arange(20.0), {"one": (values, "fused")}, logarithmic=True)
    labels = [float(text) for text in re.findall(r">([0-9.e+]+)</text>", drawn)][-2:]  # those of y come last
    assert "10^" not in drawn
    assert "tspan" not in drawn
    assert labels[0] < labels[1]
    assert values.max() <= labels[1] * 1.0001


def test_values_that_no_joint_reaches_are_marked_and_no_others(session, monkeypatch):
    calls = {}
    monkeypatch.setattr(
        "viewer_app.report.walking.line_plot", lambda title, *_, **named: calls.update({title: named}) or ""
    )
    for name in POSSIBLE:
        monkeypatch.setitem(POSSIBLE, name, (-360.0, 360.0))
    movement_of(session)
    assert not any("beyond" in title for title in calls)
    monkeypatch.setitem(POSSIBLE, "knee_flexion", (1000.0, 1001.0))
    movement_of(session)
    assert [title for title in calls if "beyond" in title] == [
        next(
            title
            for title in calls
            if title.startswith("knee flexion") and "×: beyond 1000 to 1001°" in title
        )
    ]
    time, values = np.arange(60) / 30, np.where(np.arange(60) < 5, 200.0, 30.0)
    for low, high, marked in ((-15.0, 165.0, 5), (-15.0, 210.0, 0), (50.0, 165.0, 60)):
        drawn = line_plot("knee", "°", time, {"left": (values, "left")}, beyond=(low, high))
        plain = line_plot("knee", "°", time, {"left": (values, "left")})
        assert drawn.count("<use") - plain.count("<use") == marked


def test_the_map_of_trust_is_grey_only_where_no_sensor_sees_the_joint():
    at = np.random.default_rng(0).random(900) > 0.3  # uneven frames: some columns of the map have none
    time, share = (np.arange(900) / 30)[at], np.full((900, 2), 0.5)[at]
    share[(time > 10.0) & (time < 11.0), 1] = np.nan
    unseen = np.isnan(_columns_of_time(time, share))
    assert not unseen[:, 0].any()
    np.testing.assert_array_equal(np.flatnonzero(unseen[:, 1]), np.arange(201, 220))  # 50 ms each
    images = re.findall(r"data:image/png;base64,([^\"]+)", trust_map(time, ("head", "neck"), share))
    drawn = cv2.imdecode(np.frombuffer(base64.b64decode(images[0]), np.uint8), cv2.IMREAD_COLOR)
    assert (drawn == PREDICTED_COLOR).all(axis=-1).mean() == pytest.approx(19 / 600 / 2, rel=0.2)


def test_a_long_session_keeps_more_frames_near_its_events():
    seconds = np.arange(0.0, 1200.0, 1 / 30)
    kept = seconds[_kept_frames(seconds, [300.0, 900.0], 2000)]
    assert len(kept) <= 2000
    for moment in (300.0, 900.0):
        assert np.diff(kept[np.abs(kept - moment) < 1.4]).max() < 0.07
    assert np.diff(kept).max() < 1.0  # and all of it can be seen


def test_a_page_stays_small_however_much_there_is_to_play(fused_run, monkeypatch):
    session = fused_run(frame_pairs(KINECT_V2, 200), calibration_of(KINECT_V2))
    monkeypatch.setattr(motion_module, "_MOST_BYTES", 6_000)
    motion = encoded_motion(session, [])
    assert 1_000 < len(motion["motion"]) <= 6_000


def test_joints_that_were_never_seen_are_marked(session, monkeypatch):
    names = []
    for plot in ("bar_plot", "trust_map"):
        drawn = lambda _, joints, __: names.append(joints) or ""  # noqa: E731
        monkeypatch.setattr(f"viewer_app.report.pages.review_page.{plot}", drawn)
    titles_instead_of([PLOTS[0], "walking.line_plot", "walking.cycle_plot"], monkeypatch)
    changed = without(session, "FootLeft")
    text = page_of(changed)
    assert "<strong>Never seen</strong>: left foot: S* guesses them" in text
    assert "as long as on the other side" in text
    assert [[name for name in each if "never" in name] for each in names] == [["FootLeft (never seen)"]] * 2


@pytest.mark.usefixtures("titles")
def test_an_event_of_the_list_leads_to_its_moment(fused_run, tmp_path):
    session = fused_run(frame_pairs(KINECT_V2, 90), calibration_of(KINECT_V2))
    events = [
        replace(session.events[0], time_ns=k * 100_000_000, frame=3 * k, text=f"n {k}") for k in range(25)
    ]
    session = replace(session, events=tuple(events))
    path = tmp_path / "page.html"
    path.write_text(page_of(session))
    with browser(1280, 900) as context:
        tab = context.new_page()
        errors = []
        tab.on("pageerror", lambda error: errors.append(str(error)))
        tab.goto(path.as_uri())
        tab.locator("#play:enabled").wait_for()
        picture = "document.getElementById('person').toDataURL()"
        rows = tab.locator("#events tbody tr")
        assert [row.split()[0] for row in rows.all_inner_texts()] == [str(k + 1) for k in range(25)]
        first = tab.evaluate(picture)
        tab.locator("#events button").nth(20).click()
        assert tab.locator("#clock").inner_text().startswith("2.00 of")
        assert "N 20" in tab.locator("#events tr[aria-current]").inner_text()
        assert tab.evaluate(picture) != first
        tab.locator("#moment").fill("1.0")
        assert tab.locator("#clock").inner_text().startswith("1.00 of")
        at_1 = tab.evaluate(picture)
        box = tab.locator("#person").bounding_box()
        tab.mouse.move(box["x"] + 200, box["y"] + 200)
        tab.mouse.down()
        tab.mouse.move(box["x"] + 300, box["y"] + 200)
        tab.mouse.up()
        assert tab.evaluate(picture) != at_1
        for label in tab.locator(".key input").all():
            label.uncheck()
        empty = tab.evaluate(picture)
        tab.locator(".key input").last.check()
        assert tab.evaluate(picture) != empty
        clock, why = tab.locator("#clock"), tab.locator("#why")
        box = tab.locator("#quality").bounding_box()
        tab.mouse.click(box["x"] + 0.75 * box["width"], box["y"] + 20)
        end = session.time_ns[-1] * 1e-9
        assert float(clock.inner_text().split()[0]) == pytest.approx(0.75 * end, abs=0.02)
        last = session.quality_per_second[int(0.75 * end)]
        assert why.inner_text().endswith(last.reason or last.word)
        tab.locator("#person").focus()
        moments = []
        for key in (".", ".", ",", "Home", ",", "End"):
            tab.keyboard.press(key)
            moments.append(float(clock.inner_text().split()[0]))
        on, twice, back, home, before, last = moments
        assert on == back < twice
        assert (home, before, last) == (0.0, 0.0, pytest.approx(end, abs=0.01))
        for key in ("+", "+", "l", "Home", " "):
            tab.keyboard.press(key)
        assert tab.locator("#speed").input_value() == "2"
        assert tab.locator("#loop").is_checked()
        assert tab.locator("#play").inner_text() == "Pause"
        tab.wait_for_function("+document.getElementById('clock').textContent.split(' ')[0] > 2.5")
        tab.wait_for_function("+document.getElementById('clock').textContent.split(' ')[0] < 1")  # again
        for key in (" ", "l", "End"):
            tab.keyboard.press(key)
        tab.locator("#play").click()
        tab.wait_for_function("document.getElementById('play').textContent === 'Play'")  # at the end
        assert tab.locator("#clock").inner_text() == f"{end:.2f} of {end:.2f} s"
        assert errors == []


@pytest.mark.usefixtures("titles")
def test_a_click_in_the_list_of_people_copies_the_options_that_follow_one(session, tmp_path):
    people = [(["1", "2"], [3.0, 0.5]), ([None, "a <b"], [0.1, 2.0]), (["3", None], [2.0, 0.0])]
    session = telling(session, people=[json.dumps([{"ids": i, "seconds": s} for i, s in people])])
    path = tmp_path / "page.html"
    path.write_text(page_of(session))
    options = ["--person-a 1 --person-b 2", "--person-b 'a <b'"]
    with browser(390) as context:
        context.grant_permissions(["clipboard-read", "clipboard-write"])
        tab = context.new_page()
        tab.goto(path.as_uri())
        rows = [row.split("\t") for row in tab.locator(".people tbody tr").all_inner_texts()]
        assert rows == [
            ["followed", "3.0 s", "0.5 s", options[0]],
            ["", "0.1 s", "2.0 s", options[1]],
            ["", "2.0 s", "–", "–"],  # one sensor alone sees them
        ]
        assert tab.evaluate("document.documentElement.scrollWidth") == 390
        for button, option in zip(tab.locator(".people button").all(), options, strict=True):
            button.click()
            tab.wait_for_function("document.querySelector('.people').innerText.includes('Copied')")
            assert tab.evaluate("navigator.clipboard.readText()") == option
            tab.wait_for_function("!document.querySelector('.people').innerText.includes('Copied')")


def test_the_page_shows_exchanged_sides_large_one_frame_rate_and_no_empty_plot(session, titles):
    rows = session.rows
    exchanged = np.zeros((len(rows), 2), dtype=np.int8)
    exchanged[:30, 1] = 3
    positions = rows.positions_b.copy()
    positions[:30] = positions[:30, session.body.mirror]  # S* corrects them
    plots = {}
    for name, skew in (("some", rows.skew_ns), ("none", np.zeros_like(rows.skew_ns))):
        changed = replace(
            session, rows=replace(rows, positions_b=positions, exchanged=exchanged, skew_ns=skew)
        )
        text = unescape(page_of(changed))
        plots[name] = "skew of B" in titles
        titles.clear()
    assert plots == {"some": True, "none": False}
    figures = report(changed)
    share = in_percent(figures["repaired"]["exchanged"]["b"])
    assert share == "40 %"  # 23 of the 58 frames with a person, who has no anatomy; then S* turns this doll
    assert f'<dt>Repaired</dt><dd class="figure">0 %, {share}</dd>' in text
    shown = text[: text.index("<script")]
    rates = set(re.findall(r"([\d.]+) (?:frames )?per second", shown))
    assert rates == {f"{figures['frames_per_second']:.1f}"}


@pytest.mark.usefixtures("titles")
def test_a_tile_says_its_figure_once_and_the_page_what_was_recorded(session):
    text = unescape(page_of(session))
    tiles = re.findall(r'<dt>(.*?)</dt><dd class="figure">(.*?)</dd>\n<dd[^>]*>(.*?)</dd>', text)
    assert len(tiles) >= 3
    for label, figure, beside in tiles:
        assert figure not in beside, label
        assert figure not in ("0 mm", "0 %", "0 %, 0 %"), label
    first = text[text.index("<h1>") : text.index("<dl")]
    for part in (f"{len(session)} frames", "body kinect_v2", "method duplex, revision", "file of 20"):
        assert part in first
    dated = telling(session, recorded=["2020-08-31T15:20:37.000000Z"])
    assert re.search(r"^recorded 2020-0[89]-.. ..:\d0; ", recorded(dated))
    assert "file of" not in recorded(dated)
    for said in ("0001-01-01T00:00:00+14:00", "9999-12-31T23:59:59-14:00", 5.0):
        assert "nothing says when" in recorded(telling(session, recorded=[said]))
    strip = re.findall(
        r'<i class="(\w+)" style="flex-grow: ([\d.]+)" data-at="([\d.]+)" title="(.*?)">', text
    )
    assert sum(float(lasts) for _, lasts, _, _ in strip) == pytest.approx(session.time[-1])
    of_second = {each.start: each for each in session.quality_per_second}
    for word, _, at, title in strip:
        assert of_second[float(at)].word == word
        assert f" s {word}" in title
        assert of_second[float(at)].reason in title


@pytest.mark.usefixtures("titles")
def test_what_a_session_says_is_text_and_never_markup(session):
    settings = session.about["settings"] | {"note": ["<script>alert(1)</script>"]}
    hostile = replace(session.events[0], text="<img src=x onerror=alert(1)> & more")
    about = {**session.about, "settings": settings}
    session = replace(session, events=(*session.events, hostile), about=about)
    text = page_of(session)
    assert "Roughness" in text
    assert text.count("<script") == 1
    assert "alert(1)</script" not in text
    assert "<img" not in text
    assert "&lt;img src=x onerror=alert(1)&gt; &amp; more" in text


# --- The film of small colour images on the page of a session.


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
def filmed(tmp_path_factory):
    path = tmp_path_factory.mktemp("film") / "s.rrd"
    session = record_fused(path, frame_pairs(KINECT_V2, 90), calibration_of(KINECT_V2))
    assert film(session) == {}
    return replace(session, images=Colored())


def test_the_film_has_small_images_at_their_moments_and_fits_into_a_page(filmed):
    found = film(filmed)
    assert set(found) == {"a", "b"}
    for side, images in found.items():
        frames = [int(np.argmin(np.abs(filmed.time - seconds))) for seconds, _ in images]
        every = [k for k in range(0, 90, 3) if side == "a" or k not in GAP]
        assert frames == [k for k in every if (side, k) != ("a", 0)]
        for frame, (_, jpeg) in zip(frames, images, strict=True):
            small = Image.open(io.BytesIO(base64.b64decode(jpeg)))
            assert small.size == (240, 135)
            assert np.mean(np.asarray(small)) == pytest.approx(frame + 60.0, abs=4.0)
    bytes_of_a_minute = len(json.dumps(found)) * 60.0 / filmed.time[-1]
    assert bytes_of_a_minute < 12e6  # a page of a minute has at most 15 MB, and all the rest has 1.5


def test_there_are_at_most_ten_images_a_second(filmed):
    faster = replace(filmed, rows=replace(filmed.rows, time_ns=filmed.rows.time_ns * 6 // 5))  # 25 Hz
    seconds = [at for at, _ in film(faster)["a"]]
    assert np.diff(seconds).min() > 0.099


def test_the_player_shows_the_image_of_its_moment_or_how_old_it_is(filmed, tmp_path):
    page = tmp_path / "s.html"
    page.write_text(page_of(filmed), encoding="utf-8")
    assert '<script type="application/json" id="film">' in page.read_text(encoding="utf-8")
    found = film(filmed)
    with browser(1000, 700) as chromium:
        tab = chromium.new_page()
        wrong, asked = [], []
        tab.on("pageerror", lambda error: wrong.append(str(error)))
        tab.on("request", lambda request: asked.append(request.url))
        tab.goto(page.as_uri())
        tab.locator("#play:enabled").wait_for()
        for frame in (0, 15, 31, 45, 89):
            tab.locator("#moment").fill(f"{filmed.time[frame]:.6f}")
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
