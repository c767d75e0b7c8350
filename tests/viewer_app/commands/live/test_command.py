"""``duplex live`` on stand-ins for two Kinects and their body tracker: sessions, options and reports."""

import gc
import sys
from unittest.mock import MagicMock

import numpy as np
import pytest

from fusion.body import AZURE_KINECT
from fusion.calibration.calibration import nominal_calibration
from fusion.fuser import Fuser
from recordings.calibration_file import calibration_to_json
from recordings.file.rrd_file import read_columns
from recordings.session import Session
from tests.helpers.command_line import duplex
from tests.helpers.session_text import rows_of
from tests.helpers.standin_pyk4a import JPEG
from viewer_app.commands import demo as demo_command
from viewer_app.commands import live as live_command


def test_two_sensors_become_a_session_and_a_summary(kinects, live, tmp_path):
    said = live("--verbose")
    for words in ("Sync cable: B leads, A captures on its pulses", "Paired", "Largest bone error", "Saved"):
        assert words in said
    captures = min(device.captures for device in kinects.devices)
    # the first and the last may lack the other sensor; a busy machine drops some
    assert 0.5 * captures <= rows_of(live.saved, "/fused/skeleton") <= captures + 2
    assert kinects.open_serials == []
    assert kinects.started == ["000123", "000456"], "the subordinate first"
    modes = [(config.wired_sync_mode, config.subordinate_delay_off_master_usec) for config in kinects.configs]
    assert modes == [(2, 160), (1, 0)]
    assert [path.name for path in tmp_path.iterdir()] == ["s.rrd"]


@pytest.mark.usefixtures("kinects")
@pytest.mark.parametrize("command", [live_command, demo_command])
def test_kernels_are_compiled_before_the_first_frame(command, monkeypatch):
    class WarmedUpError(Exception):
        pass

    monkeypatch.setattr(command, "warm_up", MagicMock(side_effect=WarmedUpError))
    monkeypatch.setattr(Fuser, "update", lambda *_: pytest.fail("a frame"))
    sensors = ("--kinect-a", "000123", "--kinect-b", "000456") if command is live_command else ()
    with pytest.raises(WarmedUpError):
        duplex(command.__name__.rpartition(".")[2], *sensors, "--no-viewer", "--seconds", 1)


def test_options_reach_the_sensors_and_the_tracker(kinects, live, standin):
    options = ("--fps", 15, "--depth-mode", "WFOV_2X2BINNED", "--color", "1080P", "--processing", "cuda")
    for device in kinects.devices:
        device.interval_usec = 66_667
    live(*options, seconds=0.3)
    module = sys.modules["pyk4a"]
    for config in kinects.configs:
        assert config.camera_fps == module.FPS.FPS_15
        assert config.depth_mode == module.DepthMode.WFOV_2X2BINNED
        assert config.color_resolution == module.ColorResolution.RES_1080P
    assert (standin.processing, standin.smoothing) == (2, 0.0)


@pytest.mark.parametrize(("depth", "shape"), [("none", None), ("half", (288, 320)), ("full", (576, 640))])
def test_as_much_depth_is_saved_as_asked_for(live, depth, shape):
    live("--depth", depth, seconds=0.4)
    session = Session.open(live.saved)
    assert {image.shape for side in "ab" for _, image in session.depth(side)} == ({shape} if shape else set())


def test_colour_and_depth_of_one_moment_are_in_the_session(kinects, live, tmp_path):
    for device in kinects.devices:
        device.color = True
    part, again = tmp_path / "part.rrd", tmp_path / "again.rrd"
    live("--color", "720P")
    session = Session.open(live.saved)
    for side in ("a", "b"):
        depths, colors = [frame for frame, _ in session.depth(side)], dict(session.color(side))
        assert len(colors) >= 5
        assert [*colors] == depths
        image = next(iter(colors.values()))
        assert image.jpeg == JPEG, "as the camera made it"
        assert image.camera.intrinsics.width == 1280
        assert image.camera.color_from_depth.translation.tolist() == [-0.032, 0.0, 0.004]
    assert duplex("trim", live.saved, "--from", 0.2, "--save", part) == 0
    trimmed = Session.open(part)
    assert 0 < len(dict(trimmed.color("a"))) == len(dict(trimmed.depth("a"))) < len(dict(session.color("a")))
    assert duplex("replay", live.saved, "--no-viewer", "--save", again) == 0
    assert [*dict(Session.open(again).color("b"))] == [*dict(session.color("b"))]


def test_skew_drift_and_drops_are_on_the_timeline(kinects, live):
    _, b = kinects.devices
    b.interval_usec = 40_000
    live(seconds=1.5)
    assert np.ptp(Session.open(live.saved).rows.skew_ns) > 0
    for name in ("drift_ppm", "dropped", "unpaired"):
        assert rows_of(live.saved, f"/quality/{name}") >= 2, name
    counted = read_columns(live.saved, lambda entity: entity == "/quality/unpaired").values
    unpaired = counted["/quality/unpaired", "Scalars:scalars"][1]
    # one of six frames of A has no partner
    assert unpaired[-1, 0] >= rows_of(live.saved, "/fused/skeleton") // 6 - 2 > 0
    assert (np.diff(unpaired, axis=0) >= 0).all()


def test_a_calibration_is_loaded_and_kept(live, tmp_path):
    before, after = tmp_path / "before.json", tmp_path / "after.json"
    before.write_text(calibration_to_json(nominal_calibration(AZURE_KINECT)), encoding="utf-8")
    options = ("--calibrate", before, "--save-calibration", after)
    live(*options, seconds=0.3)
    text = after.read_text(encoding="utf-8")
    assert f"loaded from {before}" in text


def test_a_missing_calibration_is_reported_and_the_session_is_kept(live, tmp_path):
    wanted = tmp_path / "calibration.json"
    assert "no calibration was found" in live("--save-calibration", wanted, seconds=0.3, codes=(2,))
    assert rows_of(live.saved, "/fused/skeleton") > 0
    assert not wanted.exists()


def test_driver_raises_what_no_one_expects(kinects, live):
    def oddity():
        raise RuntimeError("driver oddity")

    kinects.devices[0].at[20] = oddity
    said = live(seconds=20.0, codes=(2,))
    assert said.startswith(
        "duplex: 000123 failed within its driver or this program (RuntimeError: driver oddity)"
    )
    assert said.count("\n") == 1
    assert rows_of(live.saved, "/fused/skeleton") >= 5
    assert kinects.open_serials == []
    gc.collect()  # the error's traceback holds the last capture
