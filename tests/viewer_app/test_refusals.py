"""What cannot be done is refused in one line with exit code 2, and changes no file."""

import shutil

import pytest

from fusion.body import KINECT_V1, KINECT_V2
from tests.helpers.command_line import parsed
from tests.helpers.frame_pairs import frame_pairs
from tests.helpers.fused_runs import record_fused
from tests.helpers.recorded_pairs import write_recordings, write_view
from tests.helpers.sentences import check_sentences, refusals
from tests.helpers.two_views import calibration_of, moving

__all__ = ["parsed"]  # a fixture


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A session and recordings, some of which cannot be fused."""
    _, b = write_recordings(tmp_path)
    pairs = frame_pairs(KINECT_V2, 90, gap=(30,), no_b=(20,))
    session = record_fused(tmp_path / "w.rrd", pairs, calibration_of(KINECT_V2)).path
    shutil.copy(session, tmp_path / "w.csv")
    (tmp_path / "bad.rrd").write_bytes(session.read_bytes()[:3000])
    (tmp_path / "cut.csv").write_text(b.read_text(encoding="utf-8")[:-30], encoding="utf-8")
    write_view(tmp_path / "later.csv", KINECT_V2, moving(KINECT_V2, 30), start_us=60_000_000)
    write_view(tmp_path / "v1.csv", KINECT_V1, moving(KINECT_V1, 30))
    (tmp_path / "junk.csv").write_text("no recording\n")
    (tmp_path / "bad.toml").write_text("[" * 5000)
    for name in ("taken.rrd", "taken.bvh"):
        (tmp_path / name).touch()
    monkeypatch.chdir(tmp_path)
    for variable in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(variable, raising=False)
    return tmp_path


def test_sentences_of_refusals(folder, capsys):
    check_sentences("refused", refusals(capsys, folder))


def test_sentences_of_usage(parsed, capsys, tmp_path):
    check_sentences("usage", refusals(capsys, tmp_path))
    assert not parsed
