"""``duplex live`` on stand-ins for two Kinects and their body tracker: sessions, options and reports."""

import gc
import io
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from unittest.mock import MagicMock

import numpy as np
import pytest
from rich.console import Console

from devices.azure.mkv import MkvRecording
from devices.azure.mkv_writer import MkvWriter
from devices.blazepose.blazepose import BlazePose
from devices.capture.sensor_choice import ConnectedSensor
from devices.capture.sensor_thread import SensorThread
from devices.capture.settings import CaptureSettings
from devices.capture.stream_pairing import LivePairing
from devices.recorded.files import recorded_at
from devices.sensor import SensorFrame
from devices.simulated.real_time import PacedSensor
from devices.tracker_choice import TrackerChoice
from fusion.body import AZURE_KINECT, BLAZEPOSE
from fusion.calibration.bone_lengths import bone_lengths_of
from fusion.calibration.calibration import nominal_calibration
from fusion.fuser import Fuser
from fusion.intrinsics import Intrinsics
from fusion.setup import FusionSetup
from fusion.skeleton import Skeleton
from recordings.calibration_file import calibration_to_json
from recordings.file.rrd_file import read_columns
from recordings.session import Session
from tests.helpers.command_line import duplex, one_line
from tests.helpers.machine import small_disk
from tests.helpers.mkv_writer import lens_of, write_mkv
from tests.helpers.orbbec import standin_values as values
from tests.helpers.orbbec.standin import Orbbec
from tests.helpers.realsense import LENS, numbered, plugged
from tests.helpers.realsense import record as record_bag
from tests.helpers.sentences import check_sentences, refusals
from tests.helpers.session_text import rows_of
from tests.helpers.standin_pyk4a import JPEG, Device
from tests.helpers.two_views import moving
from viewer_app.errors import UsageError
from viewer_app.options.sensing import LiveOptions
from viewer_app.running import runner
from viewer_app.running.runner import Runner
from viewer_app.sensors import local, raw_files
from viewer_app.sensors.local import two_connected_sensors, two_played_sensors
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


# --- ``duplex record``, ``--record`` and ``duplex live a.mkv b.mkv``, on stand-ins for two Kinects.


SENSORS = ("--kinect-a", "000123", "--kinect-b", "000456")


def read(path):
    with MkvRecording(path) as recording:
        frames = list(recording.frames())
    return recording, frames


@pytest.mark.parametrize("more", [(), ("--compress",), ("--color", "720P")])
def test_two_sensors_become_two_recordings(more, kinects, tmp_path, capsys):
    folder = tmp_path / "made" / "here"
    assert duplex("record", folder, *SENSORS, "--seconds", 1, *more) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "Sync cable: B leads" in said
    assert sorted(path.name for path in folder.iterdir()) == ["a.mkv", "b.mkv"]
    for name, serial, sync in (("a", "000123", "SUBORDINATE"), ("b", "000456", "MASTER")):
        recording, frames = read(folder / f"{name}.mkv")
        assert (recording.info.serial, recording.info.sync_mode) == (serial, sync)
        assert recording.info.intrinsics.cx == pytest.approx(332.0), "the sensor's own calibration"
        assert recording.warnings == []
        assert f"{name}.mkv: {len(frames)} frames" in said
        assert len(frames) >= 10
        # the stand-in's images name their capture
        numbers = [int(frame.depth[0, 0]) for frame in frames]
        assert numbers == [*range(numbers[0], numbers[0] + len(frames))]
        assert all((frame.ir == 900).all() and frame.host_ns for frame in frames)
    assert kinects.open_serials == []


@pytest.mark.usefixtures("kinects")
def test_a_disk_without_room_for_a_frame_is_the_only_reason_told(tmp_path, capsys):
    with small_disk(tmp_path / "small", 200) as disk:
        assert duplex("record", disk, *SENSORS, "--seconds", 2) == 2
        said = capsys.readouterr()
        assert "No space left on device" in said.err
        assert "no frame arrived" not in said.out


def test_realsenses_of_the_real_library_are_recorded(rs, tmp_path, capsys):
    with ThreadPoolExecutor() as pool:
        made = [
            pool.submit(
                record_bag, rs, tmp_path / f"{serial}.db3", numbered(90), serial=serial, pause_s=0.033
            )
            for serial in ("1001", "1002")
        ]
    with plugged(rs, *(one.result() for one in made)):
        assert duplex("record", tmp_path, "--principal", "1002", "--seconds", 1.5) == 0
    said = " ".join(capsys.readouterr().out.split())
    for name, serial in (("a", "1002"), ("b", "1001")):
        recording, frames = read(tmp_path / f"{name}.mkv")
        assert (recording.info.serial, recording.warnings) == (serial, [])
        assert recording.info.intrinsics == replace(LENS, distortion=(0.0,) * 8)
        assert f"{name}.mkv: {len(frames)} frames" in said
        numbers = [int(frame.depth[0, 0]) - 2001 for frame in frames]
        assert (np.diff(numbers) > 0).all()
        assert len(frames) > 25, "of 45; the library's playback leaves out some on a busy machine"
        assert "not saved" not in said
        assert [int(frame.ir[0, 0]) for frame in frames] == numbers


def test_a_disk_with_room_for_less_than_a_minute_is_told_before(tmp_path, capsys):
    """Two sensors write 88 MB per second."""
    with small_disk(tmp_path / "small", 4_000_000) as disk:
        assert duplex("demo", "--no-viewer", "--seconds", 0.2, "--record", disk) == 0
        assert "Only 4096 MB are free" in capsys.readouterr().out


def test_a_slow_tracker_loses_no_recorded_frame(kinects, live, standin, tmp_path):
    standin.tracking_ms = 90  # it gets a third of the frames
    live("--record", tmp_path / "raw", "--compress", seconds=2.0)
    for name, device in zip("ab", kinects.devices, strict=True):
        path = tmp_path / "raw" / f"{name}.mkv"
        assert b"FFVH" in path.read_bytes()[:10_000]
        _, frames = read(path)
        assert len(frames) == device.captures, "every capture of the SDK"
        assert len(frames) > 1.5 * rows_of(live.saved, "/fused/skeleton")
    assert kinects.open_serials == []


@pytest.mark.usefixtures("kinects")
def test_recordings_give_the_same_s_as_live_did(live, standin, tmp_path):
    raw, calibration = tmp_path / "raw", tmp_path / "c.json"
    person = np.arange(32)[:, None] * (0.001, -0.01, 0.0)  # of the stand-in
    lengths = np.nan_to_num(bone_lengths_of(AZURE_KINECT, person))
    kept = replace(nominal_calibration(AZURE_KINECT), bone_lengths=lengths)
    calibration.write_text(calibration_to_json(kept), encoding="utf-8")
    live("--record", raw, "--calibrate", calibration, seconds=2.0)
    was = Session.open(live.saved)
    for library in ("libk4a.so", "libk4abt.so"):  # one library for both, as the loader sees it
        (tmp_path / library).symlink_to(standin.path)
    files, tracker = (raw / "a.mkv", raw / "b.mkv"), ("--k4abt", tmp_path / "libk4abt.so")
    given = (*tracker, "--no-viewer", "--calibrate", calibration, "--save")
    assert duplex("live", *files, *given, tmp_path / "l.rrd") == 0
    assert duplex("fuse", *files, *given, tmp_path / "f.rrd") == 0
    for name in "lf":
        now = Session.open(tmp_path / f"{name}.rrd")
        assert now.about["session"]["recorded"] == (recorded_at(files[0]),)
        assert now.tracker == was.tracker == "k4abt"
        for side in "ab":
            _, i, j = np.intersect1d(
                *(_column(each, f"clock_{side}") for each in (was, now)), return_indices=True
            )
            assert len(i) > 40, name
            views = _column(was, f"positions_{side}")[i], _column(now, f"positions_{side}")[j]
            np.testing.assert_allclose(*views, atol=1e-5, err_msg=name)
        # on a busy machine live loses frames, and S* of what follows is another
        same = _same_pairs(was, now)
        off = np.linalg.norm(was.fused[:same] - now.fused[:same], axis=2)
        # fuse knows later frames; live may find later that both clocks are one, which is 0.16 ms of skew
        skews = (_column(each, "skew_ns")[:same] for each in (was, now))
        whole = np.max if name == "l" and np.array_equal(*skews) else np.median
        assert same == 0 or whole(off) < 1e-4, name


def _column(session, name):
    return getattr(session.rows, name)


def _same_pairs(one, other):
    """How many pairs at the beginning of both sessions are of the same frames."""
    pairs = [
        list(zip(_column(each, "clock_a"), _column(each, "clock_b"), strict=True)) for each in (one, other)
    ]
    return next((k for k, (a, b) in enumerate(zip(*pairs, strict=False)) if a != b), min(map(len, pairs)))


@pytest.mark.parametrize(
    ("arrivals_s", "cable", "common"),
    [
        ((4000, 4001), True, "arrival"),
        ((4000, 9000), True, None),  # two runs
        ((4000, None), True, "capture"),
        ((None, None), True, "capture"),
        ((None, None), False, None),
    ],
)
def test_two_recordings_of_one_name_are_told_apart_and_start_by_a_common_clock(
    arrivals_s, cable, common, tmp_path, monkeypatch
):
    paths = []
    for side, sync, host_s in zip("lr", ("master", "subordinate"), arrivals_s, strict=True):
        (tmp_path / side).mkdir()
        paths.append(tmp_path / side / "output.mkv")
        image = np.ones((288, 320), np.uint16)
        host_ns = None if host_s is None else host_s * 10**9
        frame = SensorFrame(10**9, depth=image, ir=image, host_ns=host_ns)
        settings = CaptureSettings(sync=sync if cable else "standalone")
        with MkvWriter(paths[-1], side, settings, lens_of("NFOV_2X2BINNED"), frame) as writer:
            writer.write(frame)
    monkeypatch.setattr(local, "tracker_of", lambda _: TrackerChoice("blazepose", "a test"))
    played = two_played_sensors(LiveOptions(), paths, Console(quiet=True))
    a, b = (thread.sensor for thread in (played.a, played.b))
    assert [a.name, b.name] == ["l/output.mkv", "r/output.mkv"]
    assert a.key != b.key
    assert a.source._beat is b.source._beat
    assert a.source._beat.common == common


def test_recordings_are_played_at_their_own_rate(tmp_path, monkeypatch, capsys):
    """--fps is of sensors: outputs, the coach and --record take the rate of what is played."""

    def stop(runner, _stack):
        raise UsageError(f"{runner.sensors.rate}")

    paths, told = [tmp_path / "a.mkv", tmp_path / "b.mkv"], []
    for path in paths:
        frame = SensorFrame(10**9, depth=np.ones((288, 320), np.uint16), ir=np.ones((288, 320), np.uint16))
        with MkvWriter(path, path.stem, CaptureSettings(fps=15), lens_of("NFOV_2X2BINNED"), frame) as writer:
            writer.write(frame)
    monkeypatch.setattr(local, "tracker_of", lambda _: TrackerChoice("blazepose", "a test"))
    monkeypatch.setattr(raw_files.RawFiles, "attach", lambda _, sensors: told.append(sensors.rate))
    monkeypatch.setattr(Runner, "open_outputs", stop)
    assert duplex("live", *paths, "--no-viewer", "--record", tmp_path / "raw") == 2
    assert capsys.readouterr().err == "duplex: 15.0\n"
    assert told == [15.0]


def test_skeletons_that_were_saved_are_advised_where_there_is_an_option_for_them(tmp_path, capsys):
    paths = [write_mkv(tmp_path / f"{side}.mkv", 3) for side in "ab"]
    tracker = "--tracker", "k4abt", "--k4abt", tmp_path / "none.so"
    for command, advised in (("live", False), ("fuse", True)):
        assert duplex(command, *paths, *tracker, "--no-viewer") == 2
        assert ("saved before, with " in one_line(capsys)) is advised


def test_the_rate_of_what_is_played_is_that_of_its_file(rs, tmp_path):
    """With another one, every second moment would have no frames."""
    lens = Intrinsics(64, 48, 60.0, 60.0, 32.0, 24.0)
    paths = [
        record_bag(rs, tmp_path / name, numbered(4, lens, fps=15), lens=lens, fps=15)
        for name in ("a.db3", "b.db3")
    ]
    played = two_played_sensors(LiveOptions(tracker="blazepose"), paths, Console())
    assert played._decimation.period_ns == pytest.approx(1e9 / 15, abs=1)


def test_what_the_simulator_saw_is_recorded(monkeypatch, tmp_path):
    """On a busy machine it sees less: the first image of each sensor, at least."""
    seen = {}
    frames_of = PacedSensor.frames

    def noted(sensor):
        seen[sensor.name] = times = []
        for frame in frames_of(sensor):
            if frame.depth is not None:
                times.append(frame.time_ns // 1000 * 1000)  # a file has microseconds
            yield frame

    monkeypatch.setattr(PacedSensor, "frames", noted)
    begun = time.perf_counter_ns()
    options = ("--no-viewer", "--seconds", 2, "--record", tmp_path, "--save", tmp_path / "s.rrd")
    assert duplex("demo", *options, "--compress") == 0
    for name in ("a", "b"):
        recording, images = read(path := tmp_path / f"{name}.mkv")
        assert b"FFVH" in path.read_bytes()[:10_000]
        assert (recording.info.depth_mode, recording.warnings) == ("NFOV_2X2BINNED", [])
        assert [image.time_ns for image in images] == seen[f"simulated {name}"]
        assert all(begun < image.host_ns < time.perf_counter_ns() for image in images)
        assert images[0].depth.max() > 1000
        assert images[0].ir.max() > 20
