"""Replays and comparisons are written first and then shown, so that no viewer can delay them."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import IO

import pytest
import rerun as rr
import rerun.blueprint as rrb

from recordings.reading.rrd_file import damage_of
from recordings.writing.session_writer import whole_recording
from tests.helpers.machine import need_viewer
from tests.helpers.waiting import eventually
from viewer_app.addresses import LOOPBACK
from viewer_app.errors import UsageError
from viewer_app.viewer import file_window, rerun_process
from viewer_app.viewer.rerun_process import stop

BLUEPRINT = rrb.Blueprint(rrb.TextDocumentView(origin="/words", name="the only view"))


class Opened:
    """Replaces the viewer and records the files that it would show."""

    def __init__(self) -> None:
        self.read: list[bytes] = []

    def __call__(self, arguments: Sequence[str], stdin: IO[bytes]) -> None:
        assert "-" in arguments
        self.read.append(stdin.read())


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> Opened:
    viewer = Opened()
    monkeypatch.setattr(file_window, "start_viewer", viewer)
    return viewer


def write(save: Path | None, window: bool) -> None:
    with file_window.written_and_shown(save, window) as path:
        if path is not None:
            with whole_recording(path, BLUEPRINT) as stream:
                stream.log("/words", rr.TextDocument("S*"))


def test_the_window_gets_the_whole_file_and_the_file_its_name(opened: Opened, tmp_path: Path) -> None:
    save = tmp_path / "s.rrd"
    write(save, window=True)
    assert damage_of(save) is None
    assert opened.read == [save.read_bytes()]


def test_without_a_name_the_file_lives_for_the_window_only(
    opened: Opened, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    write(None, window=True)
    (shown,) = opened.read
    assert list(tmp_path.iterdir()) == []
    again = tmp_path / "shown.rrd"
    again.write_bytes(shown)
    assert damage_of(again) is None


def test_a_failed_file_is_neither_kept_nor_shown(opened: Opened, tmp_path: Path) -> None:
    def fail() -> None:
        with file_window.written_and_shown(tmp_path / "s.rrd", True):
            raise UsageError("…")

    with pytest.raises(UsageError):
        fail()
    assert list(tmp_path.iterdir()) == []
    assert opened.read == []


def test_without_a_window_nothing_opens(opened: Opened, tmp_path: Path) -> None:
    write(tmp_path / "s.rrd", window=False)
    write(None, window=False)
    assert opened.read == []


def test_a_viewer_shows_the_file_with_its_own_layout_after_the_file_is_gone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from rerun.experimental import ViewerClient

    need_viewer()
    started: list[tuple[subprocess.Popen[bytes], int]] = []

    def headless(arguments: Sequence[str], stdin: IO[bytes]) -> None:
        started.append(rerun_process.start_viewer(["--headless", *arguments], stdin))

    monkeypatch.setattr(file_window, "start_viewer", headless)
    write(None, window=True)
    ((process, port),) = started
    try:
        viewer = ViewerClient.connect(f"rerun+http://{LOOPBACK}:{port}/proxy")
        assert eventually(lambda: [view.name for view in viewer.get_state().views] == ["the only view"], 30.0)
    finally:
        stop(process)
