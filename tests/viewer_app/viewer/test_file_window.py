"""Replays and comparisons are written first and then shown, so that no viewer can delay them."""

import lzma
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import rerun as rr
import rerun.blueprint as rrb

from recordings import Session, layout
from recordings.appearance.coach_page import CoachPage
from recordings.file.rrd_file import damage_of
from recordings.file.session_writer import whole_recording
from tests.helpers.machine import need_viewer
from tests.helpers.waiting import eventually
from viewer_app.addresses import LOOPBACK
from viewer_app.errors import UsageError
from viewer_app.viewer import file_window, rerun_process
from viewer_app.viewer.blueprint import SCENE
from viewer_app.viewer.rerun_process import stop

DATA = Path(__file__).parents[2] / "data"
BLUEPRINT = rrb.Blueprint(rrb.TextDocumentView(origin="/words", name="the only view"))


class Opened:
    """Replaces the viewer and records the files that it would show."""

    def __init__(self):
        self.read = []

    def __call__(self, arguments, stdin):
        assert "-" in arguments
        self.read.append(stdin.read())
        return None, 0


@pytest.fixture
def headless(monkeypatch):
    """Viewers without a screen instead of windows: their processes and ports."""
    need_viewer()
    started = []

    def start(arguments, stdin):
        started.append(rerun_process.start_viewer(["--headless", *arguments], stdin))
        return started[-1]

    monkeypatch.setattr(file_window, "start_viewer", start)
    yield started
    for process, _ in started:
        stop(process)


@pytest.fixture
def opened(monkeypatch):
    viewer = Opened()
    monkeypatch.setattr(file_window, "start_viewer", viewer)
    return viewer


def write(save, window):
    with file_window.written_and_shown(save, window) as path:
        if path is not None:
            with whole_recording(path, BLUEPRINT) as stream:
                stream.log("/words", rr.TextDocument("S*"))


def test_the_window_gets_the_whole_file_and_the_file_its_name(opened, tmp_path):
    save = tmp_path / "s.rrd"
    write(save, window=True)
    assert damage_of(save) is None
    assert opened.read == [save.read_bytes()]


def test_without_a_name_the_file_lives_for_the_window_only(opened, tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    write(None, window=True)
    (shown,) = opened.read
    assert list(tmp_path.iterdir()) == []
    again = tmp_path / "shown.rrd"
    again.write_bytes(shown)
    assert damage_of(again) is None


def test_a_failed_file_is_neither_kept_nor_shown(opened, tmp_path):
    def fail():
        with file_window.written_and_shown(tmp_path / "s.rrd", True):
            raise UsageError("…")

    with pytest.raises(UsageError):
        fail()
    assert list(tmp_path.iterdir()) == []
    assert opened.read == []


def test_without_a_window_nothing_opens(opened, tmp_path):
    write(tmp_path / "s.rrd", window=False)
    write(None, window=False)
    assert opened.read == []


def test_a_viewer_shows_the_file_with_its_own_layout_after_the_file_is_gone(headless):
    from rerun.experimental import ViewerClient

    write(None, window=True)
    ((_, port),) = headless
    viewer = ViewerClient.connect(f"rerun+http://{LOOPBACK}:{port}/proxy")
    assert eventually(lambda: [view.name for view in viewer.get_state().views] == ["the only view"], 30.0)


def test_a_session_of_version_0_1_is_shown_in_the_layout_of_today(headless, tmp_path):
    """No view complains that it lacks what older sessions do not have."""
    from rerun.experimental import ViewerClient

    old = tmp_path / "live.rrd"  # with depth images
    old.write_bytes(lzma.decompress((DATA / "version_0_1" / "live.rrd.xz").read_bytes()))
    session = Session.open(old)
    with file_window.in_this_layout(session, old, CoachPage("good")) as file:
        again = Session.open(file)
        assert again.fused.astype(np.float32).tobytes() == session.fused.astype(np.float32).tobytes()
        assert [event.text for event in again.events] == [event.text for event in session.events]
        assert sum(1 for _ in again.depth("a")) == sum(1 for _ in session.depth("a")) > 0
        assert file_window.show(file, 0)
    assert not file.exists()
    assert old.read_bytes() == lzma.decompress((DATA / "version_0_1" / "live.rrd.xz").read_bytes())
    ((_, port),) = headless
    viewer = ViewerClient.connect(f"rerun+http://{LOOPBACK}:{port}/proxy")
    assert eventually(lambda: any(view.name == SCENE for view in viewer.get_state().views), 30.0)
    assert eventually(lambda: not viewer.get_state().loading, 30.0)
    assert [(view.name, report.summary) for view in viewer.get_state().views for report in view.reports] == []


def test_the_time_cursor_of_a_new_window_stands_where_asked(headless, tmp_path):
    """Left alone, the viewer opens at the end of a file."""
    from rerun.experimental import ViewerClient

    path = tmp_path / "s.rrd"
    with whole_recording(path, BLUEPRINT) as stream:
        for second in range(9):
            stream.set_time(layout.TIME, duration=float(second))
            stream.log("/words", rr.TextDocument(f"{second} s"))
    assert file_window.show(path, 4_000_000_000)
    ((_, port),) = headless
    viewer = ViewerClient.connect(f"rerun+http://{LOOPBACK}:{port}/proxy")

    def cursor():
        return [(one.current_timeline, one.current_time) for one in viewer.get_state().recordings]

    assert eventually(lambda: cursor() == [(layout.TIME, 4_000_000_000)], 10.0), cursor()


@pytest.mark.parametrize(("exit_code", "within"), [(None, 0.2), (0, 3600.0)])
def test_a_window_that_takes_no_time_or_is_closed_is_given_up(exit_code, within, monkeypatch, tmp_path):
    path = tmp_path / "s.rrd"
    path.write_bytes(b"")
    process = SimpleNamespace(poll=lambda: exit_code)
    monkeypatch.setattr(file_window, "start_viewer", lambda *_: (process, rerun_process.free_port()))
    monkeypatch.setattr(file_window, "_READS_WITHIN", within)
    assert file_window.show(path, 1) is False
