"""``duplex demo``, ``fuse`` and ``review`` in a real window, on X and on Wayland."""

import re
import shutil

import pytest

from recordings.appearance.state_card import LOOKS, State
from recordings.data import layout
from tests.acceptance.conftest import copied
from tests.helpers.displays import SIZE
from tests.helpers.pictures import pixels_near, shows_body, shows_skeletons
from tests.helpers.programs import ROOT, typed
from tests.helpers.screens import wayland_screen
from tests.helpers.waiting import eventually
from viewer_app.viewer.blueprint import SCENE

_DRAWN_WITHIN = 300.0


@pytest.fixture(scope="module")
def wayland():
    with wayland_screen() as screen:
        yield screen


@pytest.fixture
def screen(request):
    """A screen of X or of Wayland. Recordings and sessions are shown on X by the lines of README."""
    screen = request.getfixturevalue(getattr(request, "param", "wayland"))
    yield screen
    screen.close_windows()


@pytest.fixture
def shows(screen, seen):
    """Waits until the one window of a screen shows the three skeletons; returns what it shows."""

    def found(program):
        assert eventually(lambda: "Rerun" in screen.titles(), _DRAWN_WITHIN, every=0.5), program.said
        (window,) = screen.windows()
        pictures = []

        def drawn():
            pictures[:] = window.picture(), window.picture(SCENE)
            return shows_skeletons(pictures[0]) and shows_body(pictures[1])

        shown = eventually(drawn, _DRAWN_WITHIN, every=0.5)
        seen(pictures[0])
        seen(pictures[1], "-scene")
        assert shown, "no skeletons in the window"
        height, width, _ = pictures[0].shape
        assert width >= SIZE[0] // 2
        assert height >= SIZE[1] // 2
        if screen.photograph is not None:
            photograph = screen.photograph()
            seen(photograph, "-screen")
            assert shows_skeletons(photograph), "no skeletons on the screen"
        return window.state()

    return found


@pytest.mark.parametrize("screen", ["desk", "wayland"], indirect=True)
def test_the_demonstration_is_shown_while_it_runs(screen, shows, home):
    """As README begins: until Ctrl-C, and the window stays."""
    with typed("make demo", ROOT, **screen.environment, **home) as demonstration:
        shows(demonstration)
        demonstration.end()
        assert "Verdict" in demonstration.said, demonstration.said
    assert "Traceback" not in demonstration.said
    assert screen.titles().count("Rerun") == 1


def test_a_bad_set_up_is_told_while_the_sensors_are_placed(screen, seen, tmp_path, home):
    line = "duplex demo --bad-setup --seconds 300"
    pictures = []

    def told():
        pictures[:] = [window.picture() for window in screen.windows()]
        red = LOOKS[State.NOT_YET].ground
        return any(each is not None and pixels_near(each, red) > 0.05 * each.size / 3 for each in pictures)

    with typed(line, tmp_path, **screen.environment, **home) as demonstration:
        assert eventually(told, _DRAWN_WITHIN, every=0.5), demonstration.said
        seen(pictures[0], "-setup")
        assert demonstration.says("Move B away from A, round you, to 90°."), demonstration.said


@pytest.fixture(scope="module")
def session(tmp_path_factory, walk, home):
    """The real walk, fused without a screen."""
    folder = copied(walk, tmp_path_factory.mktemp("fused"))
    with typed("duplex fuse a.csv b.csv --save s.rrd", folder, **home) as fused:
        assert fused.code() == 0, fused.said
    return folder / "s.rrd"


def test_a_session_is_shown_at_the_event_that_matters(screen, shows, session, tmp_path, home):
    shutil.copy(session, tmp_path)
    with typed("duplex review s.rrd", tmp_path, **screen.environment, **home) as review:
        assert review.code() == 0, review.said
    (seconds,) = re.findall(r"The viewer opens at ([\d.]+) s, event \d+\.", review.said)
    (recording,) = shows(review).recordings
    assert recording.current_timeline == layout.TIME
    assert recording.current_time == pytest.approx(1e9 * float(seconds), abs=0.5e7)
