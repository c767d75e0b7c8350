"""Recordings of images become sessions: with skeletons, by a library's tracker, and by the program's own."""

import json
from dataclasses import replace

import numpy as np
import pytest

import recordings
from devices.azure.mkv import MkvRecording
from devices.azure.mkv_writer import MkvWriter
from devices.capture.settings import CaptureSettings
from devices.depth.camera import project
from devices.recorded.two_recordings import RecordingChoice, read_two
from devices.sensor import SensorFrame
from devices.simulated.kinect import movement, simulated_pair
from devices.simulated.rig import Rig
from devices.skeletons.file_sensor import SkeletonRecording
from fusion.body import AZURE_KINECT, BLAZEPOSE
from fusion.fuser import Fuser
from fusion.setup import FusionSetup
from recordings.calibration_file import calibration_to_json, read_calibration
from recordings.data import layout
from recordings.session import Session
from tests.helpers.command_line import duplex
from tests.helpers.live_frames import BODY, frames
from tests.helpers.machine import need_networks
from tests.helpers.mkv_writer import INTERVAL_US, depth_image, lens_of, write_mkv, write_simulated
from tests.helpers.recalibrated import recorder_to
from tests.helpers.recorded_pairs import write_view
from tests.helpers.session_text import events_of, rows_of
from tests.helpers.two_views import A_FROM_B, calibration_of, moving
from viewer_app.errors import UsageError
from viewer_app.options.shared import TrackerOptions
from viewer_app.sensors.tracker import tracker_of

# --- ``duplex fuse`` on Azure Kinect recordings, written by the tests in the real layout.


FRAMES = 60
START_US = 336_277
DELAY_US = 160


def write_skeletons(path, start_us, place=None):
    """The person of a recording as .csv, exact, on the recording's clock."""
    truth = moving(AZURE_KINECT, FRAMES)
    return write_view(path, AZURE_KINECT, truth if place is None else place.apply(truth), start_us)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A master and a subordinate that captured 160 µs later, and their skeletons."""
    folder = tmp_path_factory.mktemp("mkv")
    b_us = START_US + DELAY_US
    return {
        "a": write_mkv(folder / "a.mkv", FRAMES, start_offset_ns=START_US * 1000, sync="MASTER"),
        "b": write_mkv(folder / "b.mkv", FRAMES, start_offset_ns=b_us * 1000),
        "skeletons_a": write_skeletons(folder / "a.csv", START_US),
        "skeletons_b": write_skeletons(folder / "b.csv", b_us, A_FROM_B.inverse()),
    }


def fuse(recorded, *more):
    return duplex(
        *("fuse", recorded["a"], recorded["b"], "--no-viewer"),
        *("--skeletons-a", recorded["skeletons_a"], "--skeletons-b", recorded["skeletons_b"], *more),
    )


@pytest.mark.parametrize(("given", "step"), [((), 1), (("--depth", "half"), 2), (("--depth", "none"), None)])
def test_recordings_with_skeletons_become_a_session_with_depth(recorded, given, step, tmp_path, capsys):
    saved = tmp_path / "s.rrd"
    assert fuse(recorded, "--save", saved, "--verbose", *given) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert f"{FRAMES} pairs of {FRAMES} (A) and {FRAMES} (B)" in said
    assert "axes are 85° apart" in said
    assert "clock" not in said, "one clock by the cable: nothing to warn of"
    session = Session.open(saved)
    assert session.damage is None
    with MkvRecording(recorded["a"]) as recording:
        assert session.about["session"]["recorded"] == (recording.info.recorded,)
    assert len(session) == FRAMES
    for side, camera in (("a", session.intrinsics_a), ("b", session.intrinsics_b)):
        images = list(session.depth(side))
        assert [frame for frame, _ in images] == ([] if step is None else [*range(FRAMES)])
        assert all((image == depth_image(frame)[::step, ::step]).all() for frame, image in images)
        assert all(image.shape == (camera.height, camera.width) for _, image in images)
    assert duplex("replay", saved, "--verify", "--no-viewer") == 0


@pytest.mark.parametrize("first", ["a", "b"])
def test_the_first_frame_was_captured_when_its_own_sensor_did(recorded, first, tmp_path):
    """The file of A says when that was recorded; frames of one sensor alone may begin, or be left out."""
    later, late_us = 10, START_US + 333_333
    truth = A_FROM_B.inverse().apply(moving(AZURE_KINECT, FRAMES))[later:]
    pair = {
        "a": recorded["a"],
        "b": write_mkv(tmp_path / "b.mkv", FRAMES - later, start_offset_ns=late_us * 1000),
        "skeletons_a": recorded["skeletons_a"],
        "skeletons_b": write_view(tmp_path / "b.csv", AZURE_KINECT, truth, late_us),
    }
    method = "paper"  # frames of A alone are left out
    if first == "b":
        pair = {key[:-1] + "ba"[key[-1] == "b"]: path for key, path in pair.items()}
        method = "duplex"
    saved = tmp_path / "s.rrd"
    assert fuse(pair, "--save", saved, "--depth", "none", "--method", method) == 0
    session = Session.open(saved)
    captured_ns = getattr(session, f"skeleton_{first}").captured_ns[0]
    since_a_ns = captured_ns - 1000 * (START_US if first == "a" else late_us)
    assert abs(since_a_ns) > 3e8
    assert session.first_unix_ns == pytest.approx(1e9 * session.recorded.timestamp() + since_a_ns, abs=2e6)


def test_a_cut_off_recording_gives_what_it_has_and_says_so(recorded, tmp_path, capsys):
    whole = recorded["b"].read_bytes()
    cut = tmp_path / "cut.mkv"
    cut.write_bytes(whole[: int(0.8 * len(whole))])
    saved = tmp_path / "s.rrd"
    assert fuse({**recorded, "b": cut}, "--save", saved) == 0
    assert "cut.mkv is cut off" in capsys.readouterr().out
    assert any("cut.mkv is cut off" in text for text in events_of(saved))
    assert rows_of(saved, "/fused/skeleton") == FRAMES  # A alone goes on
    assert 0 < Session.open(saved).frame_counts["alone_a"] < FRAMES - 40


def test_a_clock_that_the_master_did_not_set_is_reported(recorded, tmp_path, capsys):
    late_us = START_US + DELAY_US + 9_000
    b = write_mkv(tmp_path / "b.mkv", FRAMES, start_offset_ns=late_us * 1000)
    skeletons = write_skeletons(tmp_path / "b.csv", late_us, A_FROM_B.inverse())
    assert fuse({**recorded, "b": b, "skeletons_b": skeletons}) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "captured 0.16 ms apart by their cable, but their times lie 9.2 ms apart" in said


@pytest.mark.parametrize("arrivals", [True, False])
def test_the_motion_is_not_asked_for_what_arrivals_and_cable_tell(arrivals, tmp_path, monkeypatch):
    asked, choices, late = [], [], A_FROM_B.inverse()
    monkeypatch.setattr("devices.recorded.two_recordings.clock_by_motion", lambda *_: asked.append(True))
    for side, sync, delay_us, place in (("a", "master", 0, None), ("b", "subordinate", DELAY_US, late)):
        path, image = tmp_path / f"{side}.mkv", np.ones((288, 320), np.uint16)
        skeletons = write_skeletons(tmp_path / f"{side}.csv", START_US + delay_us, place)
        with SkeletonRecording(skeletons) as recording:
            times = [frame.time_ns for frame in recording.frames()]
        frames = [
            SensorFrame(t, depth=image, ir=image, host_ns=t + 10**13 if arrivals else None) for t in times
        ]
        given = CaptureSettings(sync=sync), lens_of("NFOV_2X2BINNED"), frames[0]
        with MkvWriter(path, side, *given) as writer:
            for frame in frames:
                writer.write(frame)
        choices.append(RecordingChoice(path, skeletons))
    read = read_two(*choices)
    assert len(read.pairing.pairs) == FRAMES
    assert read.clock is None
    assert asked == ([] if arrivals else [True])


def test_sensors_without_a_cable_have_no_common_clock(recorded, tmp_path, capsys):
    b = write_mkv(tmp_path / "b.mkv", FRAMES, start_offset_ns=(START_US + DELAY_US) * 1000, sync="STANDALONE")
    assert fuse({**recorded, "b": b}) == 0
    assert "without a common clock (master, standalone)" in " ".join(capsys.readouterr().out.split())


def test_the_body_tracker_runs_over_both_recordings(standin, tmp_path, capsys):
    for name, sync in (("a", "MASTER"), ("b", "SUBORDINATE")):
        write_mkv(tmp_path / f"{name}.mkv", 40, mode="NFOV_UNBINNED", sync=sync)
    for library in ("libk4a.so", "libk4abt.so"):  # one library for both, as the loader sees it
        (tmp_path / library).symlink_to(standin.path)
    saved = tmp_path / "s.rrd"
    code = duplex(
        *("fuse", tmp_path / "a.mkv", tmp_path / "b.mkv", "--no-viewer", "--save", saved),
        *("--k4abt", tmp_path / "libk4abt.so", "--calibrate", "seconds:5", "--verbose"),
    )
    assert code == 0
    assert "40 pairs of 40" in " ".join(capsys.readouterr().out.split())
    assert rows_of(saved, "/fused/skeleton") == 40


def test_the_surface_that_both_sensors_see_corrects_the_registration(tmp_path):
    """S* is where the person is; calibration, session and replay keep that. Somebody else is near."""
    sensors = simulated_pair(
        motion="walk",
        seed=9,
        seconds=6.5,
        depth="half",
        infrared=True,
        angle_deg=60.0,
        other=movement("still"),
    )
    truth, paths, skeletons = sensors[2], [], []
    for side, sensor, sync in zip("ab", sensors[:2], ("MASTER", "SUBORDINATE"), strict=True):
        frames = list(sensor.frames())
        images = [(frame.depth, frame.ir) for frame in frames]
        start_ns = 336_277_000 + 1000 * DELAY_US * (side == "b")
        given = {"sync": sync, "images": images, "lens": sensor.intrinsics, "serial": sensor.name}
        paths.append(write_mkv(tmp_path / f"{side}.mkv", len(frames), start_offset_ns=start_ns, **given))
        rows = []
        for name in frames[0].people:
            nobody = np.full((len(AZURE_KINECT), 3), np.nan)
            at = [frame.people[name].positions if name in frame.people else nobody for frame in frames]
            path = write_view(tmp_path / f"{side}.csv", AZURE_KINECT, at, start_ns // 1000, INTERVAL_US)
            head, *own = path.read_text().splitlines()
            rows += [row.replace(",0,", f",{name},", 1) for row in own if "nan" not in row]
        path.write_text("\n".join([head, *sorted(rows, key=lambda row: int(row.split(",")[0]))]) + "\n")
        skeletons.append(path)
    with_images = recordings.fuse(*paths, skeletons_a=skeletons[0], skeletons_b=skeletons[1], depth="none")
    without = recordings.fuse(*skeletons)
    person, off = truth.positions_at(0)[AZURE_KINECT.root], []
    for session in (with_images, without):
        there = session.calibration.a_from_b.apply(truth.a_from_b.inverse().apply(person))
        off.append(np.linalg.norm(there - person))
    assert off[0] < min(off[1], 0.01)
    assert "of the surface in" in with_images.calibration.how
    assert not without.calibration.depth_errors.any()
    errors = with_images.calibration.depth_errors
    assert (np.abs(errors) > 1e-4).all()

    saved, kept = tmp_path / "s.rrd", tmp_path / "c.json"
    with_images.save(saved)
    np.testing.assert_array_equal(Session.open(saved).calibration.depth_errors, errors)
    assert duplex("replay", saved, "--verify", "--no-viewer") == 0
    kept.write_text(calibration_to_json(with_images.calibration), encoding="utf-8")
    np.testing.assert_array_equal(read_calibration(kept).depth_errors, errors)
    kept.write_text(kept.read_text().replace("depth_errors_m", "depth_errors"), encoding="utf-8")
    assert not read_calibration(kept).depth_errors.any()  # as of an older version


# --- The program's own tracker, from images to S*, and its infrared images in the viewer but not in the file.


START_NS = 336_277_000
SECONDS = 1.7


@pytest.mark.parametrize("wanted", ["nearest", "left", "right", "middle"])
def test_the_option_names_the_person_to_follow(wanted):
    assert tracker_of(TrackerOptions(tracker="blazepose", person=wanted)).blazepose.person == wanted


def test_the_person_of_another_tracker_cannot_be_named():
    with pytest.raises(UsageError, match="add --tracker blazepose"):
        tracker_of(TrackerOptions(tracker="k4abt", person="left"))


def test_two_files_of_images_become_a_session_near_the_truth_that_replays_bit_for_bit(tmp_path, capsys):
    need_networks("full")
    rig = Rig(frame_seconds=INTERVAL_US * 1e-6, skew_seconds=160e-6)
    a, b, truth = simulated_pair(
        motion="arms", seed=41, body=BLAZEPOSE, seconds=SECONDS, depth="half", infrared=True, rig=rig
    )
    paths = (
        write_simulated(tmp_path / "a.mkv", a, START_NS, "MASTER"),
        write_simulated(tmp_path / "b.mkv", b, START_NS + 160_000, "SUBORDINATE"),
    )
    with MkvRecording(paths[0]) as written:  # the lens in the file is the simulator's
        points = np.array(((0.3, -0.4, 2.0), (-0.8, 0.9, 3.0)))
        np.testing.assert_allclose(
            project(written.intrinsics, points), project(a.intrinsics, points), atol=1e-6
        )
    saved = tmp_path / "s.rrd"
    assert duplex("fuse", *paths, "--no-viewer", "--tracker", "blazepose", "--save", saved, "--verbose") == 0
    said = " ".join(capsys.readouterr().out.split())
    frames = round(SECONDS / (INTERVAL_US * 1e-6))
    assert f"{frames} pairs of {frames} (A) and {frames} (B)" in said

    session = Session.open(saved)
    assert session.damage is None
    assert session.body is BLAZEPOSE
    assert len(session.fused) == frames
    assert len(list(session.depth("a"))) == frames
    off = np.linalg.norm(session.fused - truth.positions_at(np.arange(frames) * 1000 * INTERVAL_US), axis=2)
    # The goal for 90 % of the joints of one view; a wrong person, wall or side is farther off.
    assert np.nanpercentile(off, 90) < 0.090

    assert duplex("replay", saved, "--verify", "--no-viewer") == 0


def test_the_demo_runs_the_own_tracker_on_images_of_a_person(tmp_path, capsys):
    need_networks("full")
    saved = tmp_path / "s.rrd"
    arguments = ("--tracker", "blazepose", "--motion", "startup", "--seconds", "4", "--no-viewer")
    report = tmp_path / "r.json"
    assert duplex("demo", *arguments, "--save", saved, "--report", report, "--verbose") == 0
    said = capsys.readouterr().out
    assert "From images to S*" in said
    figures = json.loads(report.read_text())
    # Tracking alone takes milliseconds.
    assert 1.0 < figures["latency_ms"]["p50"] <= figures["latency_ms"]["p99"] <= figures["latency_ms"]["max"]
    assert "Distance from the true joints" in said
    session = Session.open(saved)
    assert session.body is BLAZEPOSE
    assert session.tracker == "blazepose full"
    # A busy machine gets fewer frames, but both sensors the same ones: pairs with both.
    assert np.isfinite(session.fused).all(axis=(1, 2)).sum() >= 3
    both = np.isfinite(session.skeleton_a.positions[:, 0, 0]) & np.isfinite(
        session.skeleton_b.positions[:, 0, 0]
    )
    assert both.mean() > 0.5
    assert rows_of(saved, "/kinect_a/depth") > 0
    assert rows_of(saved, "/kinect_a/depth/infrared") == 0


def with_infrared(frame):
    """The frame with infrared images of the size of its depth images."""
    pair = frame.pair
    light = np.linspace(10, 2000, pair.a.depth.size).reshape(pair.a.depth.shape).astype(np.uint16)
    return replace(frame, pair=replace(pair, a=replace(pair.a, ir=light), b=replace(pair.b, ir=light)))


def written(path, *, for_viewer):
    """Ten frames with depth and infrared, as a viewer gets them or as a file does."""
    setup = FusionSetup(calibration_of(BODY))
    with recorder_to(path, setup, depth_every=1, points=for_viewer) as recorder:
        for frame in frames(Fuser(setup), 10, depth=True):
            recorder.record_all([with_infrared(frame)])
    return path


def test_a_viewer_gets_infrared_and_a_file_does_not(tmp_path):
    shown = written(tmp_path / "shown.rrd", for_viewer=True)
    kept = written(tmp_path / "kept.rrd", for_viewer=False)
    for side in layout.VIEWS:
        assert rows_of(shown, layout.infrared(side)) == 10
        assert rows_of(kept, layout.infrared(side)) == 0
    session = Session.open(kept)
    assert session.damage is None
    assert len(list(session.depth("a"))) == 10
