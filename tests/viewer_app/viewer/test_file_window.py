"""Replays and comparisons are written first and then shown, so that no viewer can delay them."""

import lzma
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import psutil
import pytest
import rerun as rr
import rerun.blueprint as rrb

from recordings import Session
from recordings.appearance.coach_page import CoachPage
from recordings.data import layout
from recordings.file.rrd_file import damage_of
from recordings.file.session_writer import whole_recording
from tests.helpers.machine import need_viewer
from tests.helpers.recorded_pairs import write_pair
from tests.helpers.waiting import eventually
from viewer_app.addresses import LOOPBACK
from viewer_app.errors import UsageError
from viewer_app.viewer import file_window, window
from viewer_app.viewer.blueprint import SCENE
from viewer_app.viewer.hub import free_port
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
        return SimpleNamespace(poll=lambda: 0), 0  # a user has closed it


@pytest.fixture
def headless(monkeypatch):
    """Viewers without a screen instead of windows: their processes and ports."""
    need_viewer()
    started = []

    def start(arguments, stdin):
        started.append(window.start_viewer(["--headless", *arguments], stdin))
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
    def words(path):
        with whole_recording(path, BLUEPRINT) as stream:
            stream.log("/words", rr.TextDocument("S*"))

    with file_window.written_and_shown(save, words, force=False, window=window):
        pass


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
    def fail(path):
        path.touch()
        raise UsageError("…")

    with (
        pytest.raises(UsageError),
        file_window.written_and_shown(tmp_path / "s.rrd", fail, force=False, window=True),
    ):
        pass
    assert list(tmp_path.iterdir()) == []
    assert opened.read == []


def test_without_a_window_nothing_opens(opened, tmp_path):
    write(tmp_path / "s.rrd", window=False)
    write(None, window=False)
    assert opened.read == []


def test_a_viewer_that_is_interrupted_while_it_starts_is_gone(monkeypatch):
    """One without a window, of ``duplex doctor``, would run for ever."""
    sleeping = [sys.executable, "-c", "import time; time.sleep(60)"]
    process = subprocess.Popen(sleeping, start_new_session=True)

    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(window, "start", lambda *_: process)
    monkeypatch.setattr(window, "listens", interrupt)
    try:
        with pytest.raises(KeyboardInterrupt):
            window.start_viewer(["--headless"])
        assert process.poll() is not None
    finally:
        stop(process)


def test_a_viewer_shows_the_file_with_its_own_layout_after_the_file_is_gone(headless, monkeypatch):
    from rerun.experimental import ViewerClient

    monkeypatch.setattr(file_window, "_READS_WITHIN", 0.1)  # the file has no time to set
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

    def complaints():
        return [(view.name, report.summary) for view in viewer.get_state().views for report in view.reports]

    # a busy viewer may draw a plot once before it has the mappings of its blueprint
    assert eventually(lambda: not complaints(), 30.0), complaints()


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
    monkeypatch.setattr(file_window, "start_viewer", lambda *_: (process, free_port()))
    monkeypatch.setattr(file_window, "_READS_WITHIN", within)
    assert file_window.show(path, 1) is False


ROOT = Path(__file__).resolve().parents[3]
_STARTS_A_HUB = """
import sys
from viewer_app.viewer.hub import Hub
print(Hub.on_free_ports(web=False).start().pid, flush=True)
sys.stdin.read()
"""


def gone(pid):
    """Returns whether a process has ended, even if its exit code has not been read yet."""
    try:
        return psutil.Process(pid).status() == psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return True


@pytest.mark.parametrize("how", ["killed", "ended"])
def test_a_hub_does_not_outlive_the_program(how):
    with subprocess.Popen(
        [sys.executable, "-c", _STARTS_A_HUB], stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=ROOT
    ) as program:
        hub = int(program.stdout.readline())
        assert not gone(hub)
        if how == "killed":
            if sys.platform != "linux":
                pytest.skip("only Linux ends the children of a program that is killed")
            program.kill()
        else:
            program.stdin.close()
        program.wait()
        assert eventually(lambda: gone(hub))


@pytest.mark.skipif(sys.platform != "linux", reason="signals to a process group")
def test_nothing_survives_sigterm_while_a_page_is_served(tmp_path):
    """Neither the server nor the session, which has no name of its own."""
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    write_pair(tmp_path)
    files = (tmp_path / "a.csv", tmp_path / "b.csv")
    environment = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY")}
    command = [sys.executable, "-m", "viewer_app.cli", "fuse", *map(str, files), "--offset", "0", "--web"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    environment["TMPDIR"] = str(temporary)
    with subprocess.Popen(command, **pipes, cwd=ROOT, env=environment) as program:
        try:
            assert any(b"stays until Ctrl-C" in line for line in program.stdout)
            children = psutil.Process(program.pid).children(recursive=True)
            assert children
            assert list(temporary.iterdir())
            program.terminate()
            assert program.wait(30.0) in (0, 130)
        finally:
            program.kill()
    assert eventually(lambda: all(gone(child.pid) for child in children))
    assert not list(temporary.iterdir())
