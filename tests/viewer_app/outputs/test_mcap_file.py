"""A recording of ROS 2 while the loop runs, read back by rosbags; times of capture since 1970."""

import errno
import shutil
import sys
import threading
from dataclasses import replace
from io import FileIO

import numpy as np
import pytest

from devices.events import Event
from fusion.body import KINECT_V2
from fusion.calibration.calibration import nominal_calibration
from fusion.setup import FusionSetup
from tests.helpers.command_line import duplex, one_line
from tests.helpers.frame_pairs import frame_pairs
from tests.helpers.fused_runs import record_fused
from tests.helpers.live_frames import frames
from tests.helpers.ros import OPTICAL, Frames, messages, nanoseconds, rosbags
from tests.helpers.two_views import calibration_of
from tests.helpers.waiting import eventually
from viewer_app.outputs import mcap_file
from viewer_app.outputs.mcap_file import McapOutput

COVARIANCES = "/humans/bodies/duplex/joint_covariances"


@pytest.fixture(autouse=True)
def installed():
    rosbags()


def topic(read, name):
    return [message for each, _, message in read if each == name]


def test_frames_covariances_and_events_are_those_of_the_loop(fuser, tmp_path):
    output, made = McapOutput(tmp_path / "s.mcap", fuser.setup, overwrite=False), frames(fuser, 40)
    output.event(Event("opened"))
    for frame in made:
        output.write(frame)
    output.event(Event("sensor B lost", "WARN"))
    output.recalibrated(fuser.setup)
    output.close()
    output.close()
    assert (output.counts.sent, output.failure) == (40, None)
    read = messages(tmp_path / "s.mcap")
    stamps = [nanoseconds(message.transforms[0].header.stamp) for message in topic(read, "/tf")]
    for frame, message, covariances in zip(made, topic(read, "/tf"), topic(read, COVARIANCES), strict=True):
        tree = Frames(message.transforms)
        at = OPTICAL @ frame.fused.positions[KINECT_V2.joint("WristLeft")]
        np.testing.assert_allclose(tree.pose("l_wrist_duplex", "sensor_a")[1], at, atol=1e-9)
        assert "sensor_b" in tree.names()
        turned = OPTICAL @ frame.fused.covariance @ OPTICAL.T
        np.testing.assert_allclose(covariances.data.reshape(turned.shape), turned, rtol=1e-6, atol=1e-12)
    said = [message.msg for message in topic(read, "/duplex/events")]
    assert said == ["opened", "sensor B lost", "calibration changed"]
    assert min(at for _, at, _ in read) == stamps[0]


def test_a_sensor_that_has_no_place_yet_has_no_frame(fuser, tmp_path):
    nominal = FusionSetup(nominal_calibration(KINECT_V2))
    output, (first, second) = McapOutput(tmp_path / "s.mcap", nominal, overwrite=False), frames(fuser, 2)
    output.write(first)
    output.recalibrated(fuser.setup)
    output.write(second)
    output.close()
    transforms = [Frames(message.transforms) for message in topic(messages(tmp_path / "s.mcap"), "/tf")]
    assert ["sensor_b" in tree.names() for tree in transforms] == [False, True]


@pytest.mark.parametrize("chunk", [1_000, 60_000, 4_000_000])
def test_what_a_killed_process_leaves_is_whole(fuser, tmp_path, monkeypatch, chunk):
    monkeypatch.setattr(mcap_file, "_EVERY_NS", 0)
    monkeypatch.setattr("recordings.export.ros._CHUNK", chunk)
    path, left = tmp_path / "s.mcap", tmp_path / "left.mcap"
    output = McapOutput(path, fuser.setup, overwrite=False)
    for number, frame in enumerate(frames(fuser, 12), start=1):
        output.write(frame)
        assert eventually(lambda number=number: output.counts.sent == number)
        shutil.copy(path, left)
        assert len(topic(messages(left), "/tf")) == number
    output.close()
    assert len(topic(messages(path), "/tf")) == 12


def test_a_full_disk_leaves_what_was_written_and_says_so(fuser, tmp_path, monkeypatch):
    monkeypatch.setattr(mcap_file, "_EVERY_NS", 0)

    full = threading.Event()

    class Full(FileIO):
        free = 40_000

        def write(self, block):
            if self.tell() + len(block) > self.free:
                full.set()
                super().write(block[: max(self.free - self.tell(), 0)])
                raise OSError(errno.ENOSPC, "No space left on device")
            return super().write(block)

    monkeypatch.setattr("devices.output_file.FileIO", Full)
    path = tmp_path / "s.mcap"
    output = McapOutput(path, fuser.setup, overwrite=False)
    for number, frame in enumerate(frames(fuser, 60), start=1):
        output.write(frame)
        eventually(lambda number=number: full.is_set() or output.counts.sent == number)
    output.close()
    assert output.failure == (
        f"{path} is not saved to its end: No space left on device. Everything before that can be read."
    )
    assert 5 < len(topic(messages(path), "/tf")) < 60


def test_the_command_records_and_replaces_nothing_unasked(tmp_path, capsys):
    path = tmp_path / "s.mcap"
    how = ("demo", "--seconds", 2, "--depth", "none", "--no-viewer", "--save", tmp_path / "s.rrd")
    assert duplex(*how, "--save-mcap", path) == 0
    assert f"ROS 2 recording {path}: frames sent" in " ".join(capsys.readouterr().out.split())
    sent = topic(messages(path), "/tf")
    assert 55 <= len(sent) <= 62
    before = path.read_bytes()
    assert duplex(*how[:-1], tmp_path / "t.rrd", "--save-mcap", path) == 2
    assert f"{path} exists already" in one_line(capsys)
    assert path.read_bytes() == before


def test_a_replay_has_the_times_of_its_session(tmp_path, capsys):
    session = record_fused(tmp_path / "s.rrd", frame_pairs(KINECT_V2, 10), calibration_of(KINECT_V2))
    about = {**session.about["session"], "recorded": ["2026-03-01T10:00:00.250+00:00"]}
    dated = replace(session, about={**session.about, "session": about})
    dated.save(tmp_path / "dated.rrd")
    for name, first_ns in (("s.rrd", 0), ("dated.rrd", 1_772_359_200_250_000_000)):
        path = tmp_path / name
        how = ("replay", path, "--pace", "live", "--no-viewer", "--save-mcap", path.with_suffix(".mcap"))
        assert duplex(*how) == 0
        stamps = [at for each, at, _ in messages(path.with_suffix(".mcap")) if each == "/tf"]
        assert stamps == (first_ns + session.time_ns).tolist()
    capsys.readouterr()


def test_a_failing_file_fails_the_command(tmp_path, monkeypatch, capsys):
    session = record_fused(tmp_path / "s.rrd", frame_pairs(KINECT_V2, 5), calibration_of(KINECT_V2))

    def append(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("devices.output_file.GrowingOutput.append", append)
    to = tmp_path / "t.mcap"
    assert duplex("replay", session.path, "--pace", "live", "--no-viewer", "--save-mcap", to) == 2
    assert f"{to} is not saved to its end" in capsys.readouterr().err
    assert not to.exists()


def test_a_missing_package_is_one_line(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "rosbags.typesys", None)
    assert duplex("demo", "--no-viewer", "--save-mcap", "s.mcap") == 2
    assert 'pip install "duplex-kinects[ros]"' in one_line(capsys)
