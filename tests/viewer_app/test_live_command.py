"""``duplex live`` and ``duplex doctor`` on stand-ins for two Kinects and their body tracker."""

from __future__ import annotations

import ctypes
import gc
import io
import json
import os
import signal
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from devices.azure import checks as device_doctor
from devices.azure import pyk4a_access
from devices.azure.tracking.body_tracker import BodyTracker
from devices.azure.usb import UsbKinect
from devices.live.sensor_thread import SensorThread
from devices.live.stream_pairing import LivePairing
from devices.pairing import Pairing
from fusion.body import AZURE_KINECT
from fusion.calibration.calibration import nominal_calibration
from fusion.fuser import Fuser
from fusion.setup import FuserSettings, FusionSetup
from recordings.calibration_file import calibration_to_json
from recordings.reading.rrd_file import read_columns
from recordings.session import Session
from tests.helpers.command_line import duplex
from tests.helpers.session_text import events_of, rows_of
from tests.helpers.standin_library import Standin
from tests.helpers.standin_pyk4a import JPEG, Bus, Device, make_module
from tests.helpers.usb_tree import furnish, plug_in
from viewer_app.commands import live as live_command
from viewer_app.live_sensors import two_kinects
from viewer_app.options.sensing import LiveOptions
from viewer_app.report.figures import FusionResult
from viewer_app.report.figures import report as report_of
from viewer_app.viewer import display

FRAME_S = 1 / 30


@pytest.fixture
def kinects(standin: Standin, monkeypatch: pytest.MonkeyPatch) -> Bus:
    """Two sensors on a sync cable, 000456 leading, at a real sensor's pace, tracked by the stand-in."""
    bus = Bus(ctypes.CDLL(str(standin.path)))
    bus.devices = [
        Device("000123", jacks=(True, False), paced=True),
        Device("000456", jacks=(False, True), paced=True),
    ]
    monkeypatch.setitem(sys.modules, "pyk4a", make_module(bus))

    def on_usb() -> list[UsbKinect]:
        return [UsbKinect(device.serial, Path("usb"), True, 5000) for device in bus.plugged()]

    monkeypatch.setattr(pyk4a_access, "usb_kinects", on_usb)
    Fuser(
        FusionSetup(nominal_calibration(AZURE_KINECT))
    ).warm_up()  # compiling takes longer than these sessions
    return bus


def live(standin: Standin, save: Path, *more: object, seconds: float = 1.0) -> int:
    return duplex(
        *("live", "--kinect-a", "000123", "--kinect-b", "000456", "--k4abt", standin.path),
        *("--no-viewer", "--save", save, "--seconds", seconds, *more),
    )


def test_two_sensors_become_a_session_and_a_summary(
    kinects: Bus, standin: Standin, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    saved = tmp_path / "live.rrd"
    assert live(standin, saved) == 0
    said = " ".join(capsys.readouterr().out.split())
    for words in ("Sync cable: B leads, A captures 160 µs later", "Paired", "Largest bone error", "Saved"):
        assert words in said
    captures = min(device.captures for device in kinects.devices)
    # the first and the last may lack the other sensor; a busy machine drops some
    assert 0.5 * captures <= rows_of(saved, "/fused/skeleton") <= captures + 2
    assert kinects.open_serials == []
    assert kinects.started == ["000123", "000456"], "the subordinate first"
    modes = [(config.wired_sync_mode, config.subordinate_delay_off_master_usec) for config in kinects.configs]
    assert modes == [(2, 160), (1, 0)]
    assert [path.name for path in tmp_path.iterdir()] == ["live.rrd"]


@pytest.mark.usefixtures("kinects")
def test_it_warms_up_before_the_first_frame(
    standin: Standin, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class WarmedUpError(Exception):
        pass

    def warm_up(*_: object) -> None:
        raise WarmedUpError

    monkeypatch.setattr(live_command, "warm_up", warm_up)
    monkeypatch.setattr(Fuser, "update", lambda *_: pytest.fail("a frame"))
    with pytest.raises(WarmedUpError):
        live(standin, tmp_path / "x.rrd")


def test_options_reach_the_sensors_and_the_tracker(kinects: Bus, standin: Standin, tmp_path: Path) -> None:
    options = ("--fps", 15, "--depth-mode", "WFOV_2X2BINNED", "--color", "1080P", "--processing", "cuda")
    for device in kinects.devices:
        device.interval_usec = 66_667
    assert live(standin, tmp_path / "s.rrd", *options, "--tracker-smoothing", 0.5, seconds=0.3) == 0
    module = sys.modules["pyk4a"]
    for config in kinects.configs:
        assert config.camera_fps == module.FPS.FPS_15
        assert config.depth_mode == module.DepthMode.WFOV_2X2BINNED
        assert config.color_resolution == module.ColorResolution.RES_1080P
    assert (standin.processing, standin.smoothing) == (2, 0.5)


@pytest.mark.parametrize(("depth", "shape"), [("none", None), ("half", (288, 320)), ("full", (576, 640))])
def test_as_much_depth_is_saved_as_asked_for(
    kinects: Bus, standin: Standin, tmp_path: Path, depth: str, shape: tuple[int, int] | None
) -> None:
    assert len(kinects.devices) == 2
    assert live(standin, tmp_path / "s.rrd", "--depth", depth, seconds=0.4) == 0
    session = Session.open(tmp_path / "s.rrd")
    assert {image.shape for side in "ab" for _, image in session.depth(side)} == ({shape} if shape else set())


def test_colour_and_depth_of_one_moment_are_in_the_session(
    kinects: Bus, standin: Standin, tmp_path: Path
) -> None:
    for device in kinects.devices:
        device.color = True
    saved, part, again = (tmp_path / name for name in ("s.rrd", "part.rrd", "again.rrd"))
    assert live(standin, saved, "--color", "720P") == 0
    session = Session.open(saved)
    for side in ("a", "b"):
        depths, colors = [frame for frame, _ in session.depth(side)], dict(session.color(side))
        assert len(colors) >= 5
        assert [*colors] == depths
        image = next(iter(colors.values()))
        assert image.jpeg == JPEG, "as the camera made it"
        assert image.camera.intrinsics.width == 1280
        assert image.camera.color_from_depth.translation.tolist() == [-0.032, 0.0, 0.004]
    assert duplex("trim", saved, "--from", 0.2, "--save", part) == 0
    trimmed = Session.open(part)
    assert 0 < len(dict(trimmed.color("a"))) == len(dict(trimmed.depth("a"))) < len(dict(session.color("a")))
    assert duplex("replay", saved, "--no-viewer", "--save", again) == 0
    assert [*dict(Session.open(again).color("b"))] == [*dict(session.color("b"))]


def test_colour_is_off_unless_asked_for(kinects: Bus, standin: Standin, tmp_path: Path) -> None:
    for device in kinects.devices:
        device.color = True
    assert live(standin, tmp_path / "s.rrd", seconds=0.4) == 0
    assert rows_of(tmp_path / "s.rrd", "/kinect_a/color") == 0


def test_skew_drift_and_drops_are_on_the_timeline(kinects: Bus, standin: Standin, tmp_path: Path) -> None:
    _, b = kinects.devices
    b.interval_usec = 40_000
    saved = tmp_path / "s.rrd"
    assert live(standin, saved, seconds=1.5) == 0
    assert np.ptp(Session.open(saved).rows.skew_ns) > 0
    for name in ("drift_ppm", "dropped", "unpaired"):
        assert rows_of(saved, f"/quality/{name}") >= 2, name
    counted = read_columns(saved, lambda entity: entity == "/quality/unpaired").values
    unpaired = counted["/quality/unpaired", "Scalars:scalars"][1]
    # one of six frames of A has no partner
    assert unpaired[-1, 0] >= rows_of(saved, "/fused/skeleton") // 6 - 2 > 0
    assert (np.diff(unpaired, axis=0) >= 0).all()


def _pairing_settings(monkeypatch: pytest.MonkeyPatch, **options: object) -> dict[str, object]:
    """What ``two_kinects`` makes the pairing with."""
    given: dict[str, object] = {}

    def pairing(interval_ns: int, **more: object) -> LivePairing:
        given.update(interval_ns=interval_ns, **more)
        return LivePairing(interval_ns, **more)  # type: ignore[arg-type]

    monkeypatch.setattr("viewer_app.live_sensors.LivePairing", pairing)
    two_kinects(LiveOptions(**options), Console())  # type: ignore[arg-type]
    return given


@pytest.mark.usefixtures("kinects")
@pytest.mark.parametrize(("principal", "b_later_ns"), [("000456", 160_000), ("000123", -160_000)])
def test_b_captures_later_where_a_leads_and_earlier_where_it_follows(
    principal: str, b_later_ns: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    # the cable leads from 000456 to 000123
    assert _pairing_settings(monkeypatch, principal=principal)["sync_delay_ns"] == b_later_ns


@pytest.mark.parametrize("fps", [5, 15, 30])
def test_pairing_has_the_interval_of_the_cameras(
    kinects: Bus, monkeypatch: pytest.MonkeyPatch, fps: int
) -> None:
    for device in kinects.devices:
        device.jacks = (False, False)
    given = _pairing_settings(monkeypatch, principal="000123", fps=fps)
    assert given == {"sync_delay_ns": None, "interval_ns": round(1e9 / fps)}


@pytest.mark.usefixtures("kinects")
def test_on_a_cpu_it_says_that_frames_are_few(capsys: pytest.CaptureFixture[str]) -> None:
    two_kinects(LiveOptions(principal="000123", processing="cpu"), Console())
    said = " ".join(capsys.readouterr().out.split())
    assert "about one frame per second" in said
    assert "duplex fuse a.mkv b.mkv" in said


@pytest.mark.parametrize(("processing", "within_s"), [("gpu", 120.0), ("tensorrt", 900.0)])
@pytest.mark.usefixtures("kinects")
def test_tensorrt_has_time_to_build_its_engine(
    processing: str, within_s: float, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    given: list[float] = []

    def open_thread(thread: SensorThread, within_s: float) -> SensorThread:
        given.extend((within_s, thread.sensor.settings.start_s))
        return thread

    monkeypatch.setattr(SensorThread, "open", open_thread)
    options = LiveOptions(kinect_a="000123", kinect_b="000456", processing=processing)
    with two_kinects(options, Console()):
        assert given == [within_s] * 4
    assert ("TensorRT builds its engine; minutes" in capsys.readouterr().out) == (processing == "tensorrt")


def test_frames_lost_before_a_slow_tracker_are_told(
    kinects: Bus, standin: Standin, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _, b = kinects.devices
    b.at[5] = lambda: setattr(b, "clock_usec", b.clock_usec + 40 * b.interval_usec)
    saved, report = tmp_path / "s.rrd", tmp_path / "report.json"
    assert live(standin, saved, "--report", report) == 0
    figures = json.loads(report.read_text(encoding="utf-8"))
    assert figures["streams"]["too_slow_for"]["b"] >= 40
    assert figures["dropped"]["b"] >= 40
    said = " ".join(capsys.readouterr().out.split())
    assert "frames of B dropped (too slow) 4" in said
    counted = read_columns(saved, lambda entity: entity == "/quality/dropped").values
    assert counted["/quality/dropped", "Scalars:scalars"][1][-1, 1] >= 40


def test_a_report_has_what_that_of_fuse_has(kinects: Bus, standin: Standin, tmp_path: Path) -> None:
    assert len(kinects.devices) == 2
    report = tmp_path / "report.json"
    assert live(standin, tmp_path / "s.rrd", "--report", report) == 0
    figures = json.loads(report.read_text(encoding="utf-8"))
    assert figures["frames"]["a"] >= figures["paired"] > 0
    assert figures["streams"]["clock_resets"] == 0
    rows = Session.open(tmp_path / "s.rrd").rows
    of_fuse = report_of(
        FusionResult(Pairing([], 0, 0, 0, 0), nominal_calibration(AZURE_KINECT), FuserSettings(), rows)
    )
    assert of_fuse.keys() <= figures.keys()
    assert live(standin, tmp_path / "t.rrd", "--report", report) == 2, "it exists already"


def test_without_a_cable_it_says_what_that_costs(
    kinects: Bus, standin: Standin, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for device in kinects.devices:
        device.jacks = (False, False)
    assert live(standin, tmp_path / "s.rrd", seconds=0.2) == 0
    assert "No sync cable" in capsys.readouterr().out
    assert {config.wired_sync_mode for config in kinects.configs} == {0}


@pytest.mark.parametrize(("answer", "principal"), [("1\n", "000123"), ("x\n\n000456\n", "000456")])
@pytest.mark.usefixtures("kinects")
def test_it_asks_which_is_which(
    standin: Standin,
    answer: str,
    principal: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    terminal = io.StringIO(answer)
    terminal.isatty = lambda: True  # type: ignore[method-assign]
    monkeypatch.setattr(sys, "stdin", terminal)
    assert duplex("live", "--k4abt", standin.path, "--no-viewer", "--seconds", 0.2) == 0
    said = capsys.readouterr().out
    assert f"Next time: --principal {principal}" in said
    assert f"Opening {principal} (A)" in said


@pytest.mark.usefixtures("kinects")
def test_without_a_terminal_it_says_what_to_choose_from(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO(""))
    assert duplex("live", "--no-viewer") == 2
    assert "--principal 000123 or --principal 000456" in capsys.readouterr().err


@pytest.mark.usefixtures("kinects")
def test_mistakes_are_one_line_before_any_sensor_opens(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    taken = tmp_path / "taken.rrd"
    taken.touch()
    for arguments, words in (
        ([], "no display"),
        (["--no-viewer", "--save", taken], "exists already"),
        (["--no-viewer", "--seconds", -1], "--seconds must be"),
        (["--no-viewer", "--calibrate", tmp_path / "none.json"], "neither auto nor an existing file"),
        (["--no-viewer", "--color", "3072P"], "Colour 3072P runs at 15 fps at most"),
        (["--no-viewer", "--smoothing", 3], "Smoothing is 0 to 1, not 3.0"),
        (["--no-viewer", "--kinect-a", "000999"], "No Kinect with serial 000999"),
        (["--no-viewer", "--principal", "000123", "--h", 2], "h must lie"),
    ):
        assert duplex("live", *arguments) == 2
        printed = capsys.readouterr()
        assert words in printed.err
        assert printed.err.count("\n") == 1
        assert "Opening" not in printed.out


def test_a_calibration_is_loaded_and_kept(kinects: Bus, standin: Standin, tmp_path: Path) -> None:
    assert len(kinects.devices) == 2
    before, after = tmp_path / "before.json", tmp_path / "after.json"
    before.write_text(calibration_to_json(nominal_calibration(AZURE_KINECT)), encoding="utf-8")
    options = ("--calibrate", before, "--save-calibration", after)
    assert live(standin, tmp_path / "s.rrd", *options, seconds=0.3) == 0
    text = after.read_text(encoding="utf-8")
    assert f"loaded from {before}" in text


def test_a_calibration_that_was_never_found_is_said_and_the_session_is_kept(
    kinects: Bus, standin: Standin, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # the stand-in's joints lie on a line, which does not allow a calibration
    assert len(kinects.devices) == 2
    saved, wanted = tmp_path / "s.rrd", tmp_path / "calibration.json"
    assert live(standin, saved, "--save-calibration", wanted, seconds=0.3) == 2
    assert "no calibration was found" in capsys.readouterr().err
    assert rows_of(saved, "/fused/skeleton") > 0
    assert not wanted.exists()


# ------------------------------------------------------------------ faults, through the whole program


def test_no_device(bus: Bus, capsys: pytest.CaptureFixture[str]) -> None:
    assert bus.devices == []
    assert duplex("live", "--no-viewer") == 2
    assert capsys.readouterr().err.startswith("duplex: No Kinect is connected. Plug in two")


def test_one_device(bus: Bus, capsys: pytest.CaptureFixture[str]) -> None:
    bus.devices = [Device("000456")]
    assert duplex("live", "--no-viewer") == 2
    assert "Only one Kinect is connected, 000456" in capsys.readouterr().err


def test_unplugged_mid_stream(
    kinects: Bus, standin: Standin, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    a, b = kinects.devices  # A is the subordinate: without its master no other gives frames
    a.at[15] = lambda: setattr(a, "plugged", False)
    saved = tmp_path / "s.rrd"
    assert live(standin, saved, seconds=1.6) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "Kinect 000123 was unplugged or lost its power" in said
    told = [text for text in events_of(saved) if "000123" in text]
    assert "unplugged" in told[0]
    assert "Going on without it" in told[0]
    # B gives frames to the end: some 48, of which 15 with A
    assert rows_of(saved, "/fused/skeleton") >= 0.6 * b.captures > 15
    assert kinects.open_serials == []


def test_unplugged_and_plugged_in_again(kinects: Bus, standin: Standin, tmp_path: Path) -> None:
    a, b = kinects.devices
    a.at[10] = lambda: setattr(a, "plugged", False)
    b.at[20] = lambda: setattr(a, "plugged", True)
    saved = tmp_path / "s.rrd"
    assert live(standin, saved, seconds=2.4) == 0  # a lost sensor is tried again every second
    told = [text for text in events_of(saved) if "000123" in text]
    assert ["unplugged" in told[0], "is back" in told[-1]] == [True, True]
    assert a.captures > 15
    assert kinects.failed_opens <= 2, "one that is not there is not opened"


def test_both_unplugged_end_when_asked(
    kinects: Bus, standin: Standin, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for device in kinects.devices:
        device.at[8] = lambda device=device: setattr(device, "plugged", False)
    saved = tmp_path / "s.rrd"
    assert live(standin, saved, seconds=0.8) == 0
    said = capsys.readouterr().out
    assert said.count("was unplugged") == 2, "said at once, though no frame comes"
    assert len([text for text in events_of(saved) if "unplugged" in text]) == 2
    assert rows_of(saved, "/fused/skeleton") >= 5


def test_stream_stalls(
    kinects: Bus, standin: Standin, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    a, b = kinects.devices
    b.at[10] = lambda: setattr(b, "silent", True)
    saved = tmp_path / "s.rrd"
    assert live(standin, saved, seconds=2.8) == 0
    assert "000456 stalls: no frame for 2 s" in " ".join(capsys.readouterr().out.split())
    assert any("stalls" in text for text in events_of(saved))
    assert rows_of(saved, "/fused/skeleton") >= 0.7 * a.captures > 10, "A goes on"


def test_tracker_crashes_to_an_error_code(kinects: Bus, standin: Standin, tmp_path: Path) -> None:
    a, _ = kinects.devices
    a.at[10] = lambda: setattr(standin, "pop_status", 1)
    a.at[12] = lambda: setattr(standin, "pop_status", 0)
    saved = tmp_path / "s.rrd"
    assert live(standin, saved, seconds=2.0) == 0
    told = events_of(saved)
    assert any("The body tracker failed (status 1)" in text for text in told)
    assert any("is back" in text for text in told)


def test_driver_raises_what_no_one_expects(
    kinects: Bus, standin: Standin, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def oddity() -> None:
        raise RuntimeError("driver oddity")

    kinects.devices[0].at[20] = oddity
    saved = tmp_path / "s.rrd"
    assert live(standin, saved, seconds=20.0) == 2
    said = capsys.readouterr().err
    assert said.startswith(
        "duplex: 000123 failed within its driver or this program (RuntimeError: driver oddity)"
    )
    assert said.count("\n") == 1
    assert rows_of(saved, "/fused/skeleton") >= 5
    assert kinects.open_serials == []
    gc.collect()  # the error's traceback holds the last capture


def test_tracker_hangs_at_close(
    kinects: Bus,
    standin: Standin,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert len(kinects.devices) == 2
    release, hung, close = threading.Event(), [], BodyTracker.close

    def hang(tracker: BodyTracker) -> None:
        if tracker._library is not None and not hung:  # the library of the sensor that closes first
            hung.append(tracker)
            release.wait(60.0)
        close(tracker)

    monkeypatch.setattr(BodyTracker, "close", hang)
    saved, report = tmp_path / "s.rrd", tmp_path / "report.json"
    assert live(standin, saved, "--report", report, seconds=0.5) == 0
    assert "does not close; it is left behind" in " ".join(capsys.readouterr().out.split())
    assert rows_of(saved, "/fused/skeleton") > 0
    release.set()
    for thread in threading.enumerate():
        if thread.name.startswith("sensor "):
            thread.join(60.0)
    assert kinects.open_serials == []


def test_one_sensor_5_fps_slower(
    kinects: Bus, standin: Standin, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    a, b = kinects.devices
    b.interval_usec = 40_000
    saved = tmp_path / "s.rrd"
    assert live(standin, saved, seconds=1.5) == 0
    said = capsys.readouterr().out
    # every frame of A is fused, five of six with B
    fused = rows_of(saved, "/fused/skeleton")
    assert fused >= 0.7 * a.captures
    pairs = int(said[said.index("Paired") :].split()[1])
    assert 0.6 <= pairs / fused < 1.0
    assert not any("000" in text for text in events_of(saved)), "no event of a sensor"


@pytest.mark.skipif(not hasattr(os, "kill"), reason="needs POSIX signals")
@pytest.mark.parametrize("capture", [0, 1, 12])
def test_ctrl_c_ends_it_and_everything_is_saved(
    kinects: Bus, standin: Standin, tmp_path: Path, capsys: pytest.CaptureFixture[str], capture: int
) -> None:
    a, _ = kinects.devices
    a.at[capture] = lambda: os.kill(os.getpid(), signal.SIGINT)
    saved = tmp_path / "s.rrd"
    code = live(standin, saved, seconds=20.0)
    assert kinects.open_serials == []
    if code == 130:  # it came while the second sensor was still being opened: nothing was captured
        assert capture < 12
        assert not saved.exists()
        return
    assert code == 0
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    said = capsys.readouterr().out
    if "no frame was received" in said:
        assert capture < 12
        assert not saved.exists()
        return
    assert "Saved" in said
    assert rows_of(saved, "/fused/skeleton") >= max(capture - 5, 1)


# ------------------------------------------------------------------ doctor


def test_the_doctor_of_a_bare_machine_fails(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "pyk4a", None)
    monkeypatch.setitem(sys.modules, "pyorbbecsdk", None)
    assert duplex("doctor", "--k4abt", tmp_path / "none.so") == 1
    said = capsys.readouterr().out.splitlines()
    assert said[0].startswith("✗ pyk4a and the Sensor SDK: ")
    assert any(line.startswith(f"✗ k4abt: No library at {tmp_path}") for line in said)
    assert any(line.startswith("✓ viewer: rerun 0.") for line in said)
    assert said[-1].startswith(
        "duplex live cannot start: pyk4a and the Sensor SDK or pyorbbecsdk2 (Orbbec's SDK v2), "
    )
    assert said[-1].count("pyorbbecsdk2") == 1, "one of the two is enough"
    assert "depth engine" not in said[-1], "which of them needs it is not known yet"
    assert ", k4abt, " in said[-1]
    assert all(line[:2] in ("✓ ", "✗ ", "– ") for line in said[:-1]), "one line each"


def test_the_doctor_says_0_where_live_starts(
    kinects: Bus,
    standin: Standin,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv("DISPLAY", ":77")
    furnish(tmp_path)
    for number, device in enumerate(kinects.devices):
        plug_in(tmp_path, device.serial, number=number)
    checks = device_doctor.device_checks
    monkeypatch.setattr(
        "viewer_app.commands.doctor.device_checks", lambda of, **more: checks(of, tmp_path, **more)
    )
    if sys.platform.startswith("linux"):
        monkeypatch.setenv("WAYLAND_DISPLAY", "wayland-0")  # windows use Wayland; the depth engine uses X
        assert duplex("doctor", "--k4abt", standin.path) == 1
        assert "cannot start: depth engine.\n" in capsys.readouterr().out
    monkeypatch.setattr(display, "_answers", lambda name, within: name == ":77" and within > 0.0)
    assert duplex("doctor", "--k4abt", standin.path) == 0
    said = capsys.readouterr().out
    assert "✓ two Kinects: 2 connected, 2 usable" in said
    assert "✓ sync cable: from 000456 to 000123" in said
    assert "never a real sensor" in said
    assert said.endswith("duplex live can start.\n")
    assert live(standin, tmp_path / "s.rrd", seconds=0.2) == 0
    kinects.devices.append(Device("000789"))
    assert duplex("doctor", "--k4abt", standin.path) == 1
    assert "cannot start: two Kinects.\n" in capsys.readouterr().out
    assert duplex("doctor", "--k4abt", standin.path, "--kinect-a", "000123", "--kinect-b", "000456") == 0
    kinects.devices.pop().plugged = False
    kinects.devices[0].jacks = (False, False)
    assert duplex("doctor", "--k4abt", standin.path) == 1
    assert "joins no sync out to a sync in" in capsys.readouterr().out
    assert live(standin, tmp_path / "t.rrd", seconds=0.2) == 2


# ------------------------------------------------------------------ what the real libraries do


@pytest.mark.parametrize("asked", [False, True])
def test_a_cable_makes_both_colour_cameras_run(
    kinects: Bus, standin: Standin, tmp_path: Path, asked: bool
) -> None:
    saved = tmp_path / "s.rrd"
    assert live(standin, saved, *(("--color", "1080P") if asked else ()), seconds=0.5) == 0
    module = sys.modules["pyk4a"]
    wanted = module.ColorResolution.RES_1080P if asked else module.ColorResolution.RES_720P
    assert {config.color_resolution for config in kinects.configs} == {wanted}
    assert {config.color_format for config in kinects.configs} == {module.ImageFormat.COLOR_MJPG}
    assert {config.synchronized_images_only for config in kinects.configs} == {False}
    assert (rows_of(saved, "/kinect_a/color") > 0) == asked


def test_old_firmware_is_told_where_there_is_a_cable(
    kinects: Bus,
    standin: Standin,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(pyk4a_access, "firmware_version", lambda _: (1, 6, 102))
    assert live(standin, tmp_path / "s.rrd", seconds=0.3) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert said.count("has firmware 1.6.102. Before 1.6.110 a subordinate cannot be started again") == 2
    for device in kinects.devices:
        device.jacks = (False, False)
    assert live(standin, tmp_path / "t.rrd", seconds=0.3) == 0
    assert "has firmware" not in capsys.readouterr().out


def test_a_slow_tracker_halves_the_rate_of_both_and_is_named(
    kinects: Bus, standin: Standin, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    standin.tracking_ms = 60
    saved = tmp_path / "s.rrd"
    assert live(standin, saved, seconds=2.5) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "frames per second. It is the tracker, not USB or light" in said
    assert any("It is the tracker" in text for text in events_of(saved))
    assert min(device.captures for device in kinects.devices) > 30, "the cameras go on at full rate"
    assert 0 < rows_of(saved, "/fused/skeleton") < 0.8 * kinects.devices[0].captures


ORBBEC = ("CL8H741005K", "CL8H7410123")


@pytest.fixture
def femtos(kinects: Bus) -> Bus:
    """Two Femto Bolts on a sync cable, which their wrapper does not tell."""
    for device, serial in zip(kinects.devices, ORBBEC, strict=True):
        device.serial, device.orbbec = serial, True
    return kinects


def test_of_orbbecs_sensors_the_master_is_named(
    femtos: Bus, standin: Standin, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ("live", "--principal", ORBBEC[0], "--k4abt", standin.path, "--no-viewer", "--seconds", 0.5)
    assert duplex(*arguments) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "Orbbec's wrapper does not say whether a cable is in the jacks" in said
    assert f"--sync-master {ORBBEC[0]} or {ORBBEC[1]}" in said
    assert {config.wired_sync_mode for config in femtos.configs} == {0}
    femtos.configs.clear()
    femtos.started.clear()
    saved = tmp_path / "s.rrd"
    assert duplex(*arguments, "--sync-master", ORBBEC[0], "--save", saved) == 0
    assert [config.wired_sync_mode for config in femtos.configs] == [2, 1]
    assert femtos.started == [ORBBEC[1], ORBBEC[0]]
    assert rows_of(saved, "/fused/skeleton") > 0
    capsys.readouterr()
    assert duplex(*arguments, "--sync-master", "000999") == 2
    assert "--sync-master 000999 is neither of the two Kinects" in capsys.readouterr().err


def test_a_busy_orbbec_is_called_busy(
    femtos: Bus, standin: Standin, capsys: pytest.CaptureFixture[str]
) -> None:
    femtos.devices[1].busy = True
    assert duplex("live", "--k4abt", standin.path, "--no-viewer", "--seconds", 0.2) == 2
    assert "it is busy or starting up" in capsys.readouterr().err


@pytest.mark.parametrize("arguments", [(), ("--sync-master", ORBBEC[0])])
def test_the_doctor_explains_orbbecs_jacks(
    femtos: Bus, standin: Standin, capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...]
) -> None:
    assert len(femtos.devices) == 2
    duplex("doctor", "--k4abt", standin.path, *arguments)
    said = " ".join(capsys.readouterr().out.split())
    assert f"Kinect {ORBBEC[0]}: sync jacks not known" in said
    if arguments:
        assert f"✓ sync cable: from {ORBBEC[0]} to {ORBBEC[1]} (as --sync-master says)" in said
    else:
        assert "– sync cable: not known. Orbbec's wrapper does not say" in said
