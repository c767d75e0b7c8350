"""``duplex live`` on stand-ins for two Kinects and their body tracker: sessions, options and reports."""

import gc
import io
import sys
from unittest.mock import MagicMock

import numpy as np
import pytest
from rich.console import Console

from devices.blazepose.blazepose import BlazePose
from devices.capture.sensor_choice import ConnectedSensor
from devices.capture.sensor_thread import SensorThread
from devices.capture.stream_pairing import LivePairing
from fusion.body import AZURE_KINECT, BLAZEPOSE
from fusion.calibration.calibration import nominal_calibration
from fusion.fuser import Fuser
from fusion.setup import FusionSetup
from fusion.skeleton import Skeleton
from recordings.calibration_file import calibration_to_json
from recordings.file.rrd_file import read_columns
from recordings.session import Session
from tests.helpers.command_line import duplex
from tests.helpers.mkv_writer import write_mkv
from tests.helpers.orbbec import standin_values as values
from tests.helpers.orbbec.standin import Orbbec
from tests.helpers.sentences import check_sentences, refusals
from tests.helpers.session_text import rows_of
from tests.helpers.standin_pyk4a import JPEG, Device
from tests.helpers.two_views import moving
from viewer_app.options.sensing import LiveOptions
from viewer_app.running import runner
from viewer_app.sensors.local import two_connected_sensors
from viewer_app.sinks.live_session import LiveSession


@pytest.mark.usefixtures("kinects")
@pytest.mark.parametrize("command", ["live", "demo"])
def test_kernels_are_compiled_before_the_first_frame(command, monkeypatch):
    class WarmedUpError(Exception):
        pass

    monkeypatch.setattr(runner, "first_run", MagicMock(side_effect=WarmedUpError))
    monkeypatch.setattr(Fuser, "update", lambda *_: pytest.fail("a frame"))
    sensors = ("--kinect-a", "000123", "--kinect-b", "000456") if command == "live" else ()
    with pytest.raises(WarmedUpError):
        duplex(command, *sensors, "--no-viewer", "--seconds", 1)


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
    key = "/quality/unpaired", "Scalars:scalars"
    unpaired = read_columns(live.saved, {key}).values[key][1]
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


# --- Which sensors ``duplex live`` opens, how it pairs them, and what it refuses before it starts.


def _pairing_settings(monkeypatch, **options):
    """The arguments that ``two_connected_sensors`` passes to the pairing."""
    given = {}

    def pairing(interval_ns, **more):
        given.update(interval_ns=interval_ns, **more)
        return LivePairing(interval_ns, **more)

    monkeypatch.setattr("viewer_app.sensors.local.LivePairing", pairing)
    two_connected_sensors(LiveOptions(**options), Console())
    return given


@pytest.mark.usefixtures("kinects")
@pytest.mark.parametrize(("principal", "b_later_ns"), [("000456", 160_000), ("000123", -160_000)])
def test_b_captures_later_where_a_leads_and_earlier_where_it_follows(principal, b_later_ns, monkeypatch):
    # the cable leads from 000456 to 000123
    assert _pairing_settings(monkeypatch, principal=principal)["sync_delay_ns"] == b_later_ns


def test_a_realsense_captures_at_its_masters_pulse(monkeypatch):
    two = [
        ConnectedSensor(k, serial, False, False, sdk="realsense", tells_jacks=False)
        for k, serial in enumerate(("1001", "1002"))
    ]
    monkeypatch.setattr("devices.live.sensors.connected_sensors", lambda _: two)
    options = {"principal": "1001", "sync_master": "1002", "tracker": "blazepose"}
    assert _pairing_settings(monkeypatch, **options)["sync_delay_ns"] == 0


@pytest.mark.parametrize("fps", [5, 15, 30])
def test_pairing_has_the_interval_of_the_cameras(kinects, monkeypatch, fps):
    for device in kinects.devices:
        device.jacks = (False, False)
    given = _pairing_settings(monkeypatch, principal="000123", fps=fps)
    assert given == {"sync_delay_ns": None, "interval_ns": round(1e9 / fps)}


@pytest.mark.parametrize(("processing", "within_s"), [("gpu", 120.0), ("tensorrt", 900.0)])
@pytest.mark.usefixtures("kinects")
def test_tensorrt_has_time_to_build_its_engine(processing, within_s, monkeypatch, capsys):
    given = []

    def open_thread(thread):
        given.extend((thread._limits.open_s, thread.sensor.settings.start_s))
        return thread

    monkeypatch.setattr(SensorThread, "open", open_thread)
    options = LiveOptions(kinect_a="000123", kinect_b="000456", processing=processing, tracker="k4abt")
    with two_connected_sensors(options, Console()):
        assert given == [within_s] * 4
    assert ("TensorRT builds its engine, which" in capsys.readouterr().out) == (processing == "tensorrt")


@pytest.mark.parametrize(("answer", "principal"), [("1\n", "000123"), ("x\n\n000456\n", "000456")])
@pytest.mark.usefixtures("kinects")
def test_it_asks_which_is_which(standin, answer, principal, monkeypatch, capsys):
    terminal = io.StringIO(answer)
    terminal.isatty = lambda: True
    monkeypatch.setattr(sys, "stdin", terminal)
    assert duplex("live", "--k4abt", standin.path, "--no-viewer", "--seconds", 0.2) == 0
    said = capsys.readouterr().out
    assert f"Next time: --principal {principal}" in said
    assert f"Opening {principal} (A)" in said


@pytest.mark.usefixtures("kinects")
def test_sentences_of_live(tmp_path, monkeypatch, capsys):
    """Before any sensor opens."""
    monkeypatch.setattr(SensorThread, "open", lambda _: pytest.fail("it opens"))
    monkeypatch.setattr(sys, "stdin", io.StringIO(""))
    monkeypatch.chdir(tmp_path)
    for name in ("taken.rrd", "table.csv"):
        (tmp_path / name).touch()
    for side in "ab":
        write_mkv(tmp_path / f"{side}.mkv", 3)
    check_sentences("live", refusals(capsys, tmp_path))


# --- ``duplex live`` on Orbbec sensors, on Kinects v1, and on Azure Kinects with the program's own tracker.


A, B = "CL8H741005K", "CL8H7410123"
MODES = values.OBMultiDeviceSyncMode


@pytest.fixture
def own_tracker(monkeypatch):
    """A stand-in for the program's tracker, without networks. It finds a standing person in each image."""
    images = []
    standing = moving(BLAZEPOSE, 1)[0]

    def track(_self, image, depth, _camera, time_ns):
        assert image.shape[:2] == depth.shape
        images.append(image)
        return {"1": Skeleton.of(BLAZEPOSE, standing, time_ns=time_ns)}

    monkeypatch.setattr(BlazePose, "__enter__", lambda self: self)
    monkeypatch.setattr(BlazePose, "track", track)
    monkeypatch.setattr("viewer_app.sensors.tracker.ensure_networks", lambda *_: False)
    Fuser(FusionSetup(nominal_calibration(BLAZEPOSE))).warm_up()  # compiling takes longer than these sessions
    return images


@pytest.fixture
def bolts(orbbecs, own_tracker, monkeypatch):
    """Two Femto Bolts at a real sensor's pace, on a machine without pyk4a."""
    assert own_tracker == []
    monkeypatch.setitem(sys.modules, "pyk4a", None)
    orbbecs.devices = [Orbbec(A, paced=True), Orbbec(B, paced=True)]
    return orbbecs


def _live(*arguments, seconds=1.0):
    return duplex("live", "--kinect-a", A, "--kinect-b", B, "--no-viewer", "--seconds", seconds, *arguments)


def test_two_orbbec_sensors_become_a_session(bolts, tmp_path, capsys):
    saved = tmp_path / "live.rrd"
    assert _live("--save", saved) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "Body tracker: blazepose full (" in said
    assert "Saved" in said
    assert "software does not say whether a sync cable is in" in said
    session = Session.open(saved)
    assert (session.tracker, session.body) == ("blazepose full", BLAZEPOSE)
    assert session.sources == (A, B)
    assert 0 < len(session) <= 1 + min(device.given for device in bolts.devices)
    assert session.intrinsics_a.width == 320, "half of the depth image"
    assert rows_of(saved, "/kinect_a/depth") > 0
    assert bolts.open_serials == []
    assert [device.sync["mode"] for device in bolts.devices] == [MODES.STANDALONE] * 2
    assert duplex("info", saved) == 0
    assert "blazepose full" in capsys.readouterr().out


def test_the_named_master_leads(bolts, tmp_path):
    saved = tmp_path / "live.rrd"
    assert _live("--sync-master", A, "--save", saved) == 0
    assert bolts.started == [B, A], "the secondary first"
    assert [device.sync["mode"] for device in bolts.devices] == [MODES.PRIMARY, MODES.SECONDARY]
    assert len(Session.open(saved)) > 0


def test_impossible_options_give_one_line(bolts, capsys):
    for arguments, message in (
        (("--tracker", "k4abt"), f"{A}: k4abt accepts images of libk4a only"),
        (("--color", "3072P", "--fps", 15), "Orbbec's sensors have no colour 3072P"),
        (("--sync-master", "999"), "--sync-master 999 is neither of the two"),
    ):
        assert _live(*arguments, seconds=0.2) == 2
        said = capsys.readouterr().err
        assert message in said
        assert said.count("\n") == 1
    assert bolts.open_serials == []


def test_azure_kinects_are_tracked_by_our_tracker(bus, own_tracker, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyorbbecsdk", None)
    bus.devices = [Device("000123", paced=True), Device("000456", paced=True)]
    saved = tmp_path / "live.rrd"
    code = duplex(
        *("live", "--kinect-a", "000123", "--kinect-b", "000456", "--tracker", "blazepose"),
        *("--tracker-network", "lite", "--no-viewer", "--seconds", 1.0, "--save", saved),
    )
    assert code == 0
    session = Session.open(saved)
    assert (session.tracker, session.body) == ("blazepose lite", BLAZEPOSE)
    assert len(session) > 0
    assert {int(image[0, 0]) for image in own_tracker} == {900}, "the infrared images"


def _view_names(blueprint):
    def names(part):
        return {str(part.name)}.union(
            *(names(inner) for inner in getattr(part, "contents", ()) if hasattr(inner, "name"))
        )

    return names(blueprint.root_container)


@pytest.mark.parametrize(("depth", "shown"), [("half", True), ("none", False)])
def test_the_viewer_shows_the_infrared_that_our_tracker_works_on(bolts, depth, shown, monkeypatch):
    assert len(bolts.devices) == 2
    given = []

    class Watched(LiveSession):
        def __init__(self, setup, sources, blueprint, **more):
            given.append((blueprint, more["file_blueprint"]))
            super().__init__(setup, sources, blueprint, **more)

    monkeypatch.setattr("viewer_app.running.runner.LiveSession", Watched)
    assert _live("--depth", depth, seconds=0.5) == 0
    ((viewer, file),) = (tuple(map(_view_names, pair)) for pair in given)
    infrared = {"Kinect A, infrared", "Kinect B, infrared"}
    assert infrared <= viewer if shown else not infrared & viewer
    panes = {"Kinect A", "Kinect B"} if shown else {"Kinect A: its skeleton", "Kinect B: its skeleton"}
    assert panes <= file, "files hold no infrared"
    assert not infrared & file
