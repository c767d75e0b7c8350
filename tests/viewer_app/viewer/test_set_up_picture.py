"""The set-up as a viewer draws it on a small screen."""

import io

import numpy as np
import pytest
import rerun as rr
import rerun.blueprint as rrb
from PIL import Image

from fusion.body import KINECT_V2
from fusion.calibration.calibration import nominal_calibration
from fusion.setup import FusionSetup
from recordings.appearance.coach_page import CoachPage
from recordings.appearance.entity_styles import words_at
from recordings.appearance.state_card import LOOKS, State
from recordings.data import layout
from recordings.writing.recorder import Recorder
from tests.helpers.displays import x_server
from tests.helpers.pictures import contrast, headless_viewer, pixels_near, viewer_window
from tests.helpers.waiting import eventually
from viewer_app.viewer.blueprint import session_blueprint

SCREEN = (1366, 768)
PIXEL_MM, AWAY_MM = 0.2525, 3000.0  # such a screen of 15.6 inches


def arc_minutes(pixels):
    return 60.0 * np.degrees(np.arctan(pixels * PIXEL_MM / AWAY_MM))


def runs(there):
    """Begin and end of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], there.astype(int), [0]))))
    return edges.reshape(-1, 2)


@pytest.fixture(scope="module")
def picture():
    """The window with a red card whose step has capital letters only."""
    setup = FusionSetup(nominal_calibration(KINECT_V2))
    stream = rr.RecordingStream(layout.APPLICATION_ID)
    found = []
    with headless_viewer(size=SCREEN) as viewer:
        stream.connect_grpc(viewer.url)
        stream.send_blueprint(
            session_blueprint(setup, np.array([0.0, 0.0, 2.6]), "setup", live=True, card=True)
        )
        recorder = Recorder(stream, setup, ("a", "b"), points=True)
        recorder.coach(CoachPage("", card=(State.NOT_YET, "HTH")))
        stream.flush(timeout_sec=20.0)

        def drawn():
            found.append(np.asarray(Image.open(io.BytesIO(viewer.take_screenshot())).convert("RGB")))
            return pixels_near(found[-1], LOOKS[State.NOT_YET].ground) > 50_000

        assert eventually(drawn, 60.0)
        stream.disconnect()
    return found[-1]


def test_state_and_step_are_read_from_three_metres(picture):
    ground = np.abs(picture.astype(int) - LOOKS[State.NOT_YET].ground).max(axis=2) < 24
    rows, columns = (np.flatnonzero(ground.mean(axis=axis) > 0.1) for axis in (1, 0))
    card = picture[rows[0] : rows[-1], columns[0] : columns[-1]]
    white = (card > 200).all(axis=2)
    (word_top, word_end), (step_top, step_end) = runs(white.any(axis=1))
    # normal sight tells letters of 5'; ISO 9241-303 asks for 16' of what is read for long
    assert arc_minutes(word_end - word_top) > 16.0
    assert arc_minutes(step_end - step_top) > 10.0
    word = np.flatnonzero(white[:word_end].any(axis=0))
    assert word[-1] - word[0] > SCREEN[0] / 3


@pytest.mark.parametrize("theme", ["Dark", "Light"])
def test_words_in_the_scene_have_a_contrast_on_either_theme(theme, tmp_path, monkeypatch):
    (tmp_path / "rerun").mkdir()
    options = f'{{"rerun.version": "{rr.__version__}", "egui": "(options:(theme_preference:{theme}))"}}'
    (tmp_path / "rerun" / "app.ron").write_text(options)
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    scene = rrb.Spatial3DView(line_grid=False, eye_controls=rrb.EyeControls3D(position=(0, 0, -3)))
    found = []
    with x_server() as display:
        monkeypatch.setenv("DISPLAY", display)
        with viewer_window(size=(1200, 400)) as viewer:
            stream = rr.RecordingStream(layout.APPLICATION_ID)
            stream.connect_grpc(viewer.url)
            stream.send_blueprint(rrb.Blueprint(scene, collapse_panels=True, auto_views=False))
            stream.log("words", *words_at("HHHHHHHHHH", (0.0, 0.0, 0.0), layout.ROOT), static=True)
            stream.flush(timeout_sec=20.0)

            def drawn():
                picture = np.asarray(Image.open(io.BytesIO(viewer.take_screenshot())).convert("RGB"))
                middle = picture[150:300, 450:750].reshape(-1, 3)
                colors, counts = np.unique(middle, axis=0, return_counts=True)
                last, found[:] = found[:], [tuple(color) for color in colors[np.argsort(-counts)]]
                # of the view, of the words' ground, and of their edges
                themed = (np.mean(found[0]) > 128) == (theme == "Light")
                return themed and len(found) > 2 and found == last

            assert eventually(drawn, 60.0)
            stream.disconnect()
    _, ground, *edges = found
    assert max(contrast(each, ground) for each in edges) >= 4.5
