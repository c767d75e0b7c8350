"""``duplex record`` that is killed, and ``doctor --bundle``, in processes of their own, on the rig, too."""

import signal
import time
import zipfile

import numpy as np
import pytest

from devices.azure.mkv import MkvRecording
from fusion.body import AZURE_KINECT
from fusion.calibration.calibration import nominal_calibration
from recordings.calibration_file import calibration_to_json
from recordings.session import Session
from tests.helpers.command_line import duplex
from tests.helpers.rig import built_rig
from tests.scenarios import program

_UNTIL_S = 1.0  # before the kill: what the project promises


@pytest.mark.parametrize("after_s", [0.7, 1.33, 2.9])
def test_what_was_recorded_before_a_kill_is_fused(after_s, rig, standin, tmp_path):
    raw, run = tmp_path / "raw", tmp_path / "run"
    run.mkdir()
    command = ["record", str(raw), "--principal", "000001111111"]
    events = (("Recording to", {}), (after_s, signal.SIGKILL))
    done = program.run(command, run, {"a.jack": 2, "b.jack": 1}, events, rig)
    killed_ns = 1e9 * (time.perf_counter() - done.ended_s)
    assert done.code == -signal.SIGKILL
    counts = []
    for name in ("a.mkv", "b.mkv"):
        with MkvRecording(raw / name) as recording:
            frames = list(recording.frames())
        assert any("is cut off" in warning for warning in recording.warnings)
        # of a frame that was being written, its arrival may be missing
        assert killed_ns - max(frame.host_ns or 0 for frame in frames) < 1e9 * _UNTIL_S
        counts.append(len(frames))
    calibration = tmp_path / "c.json"
    calibration.write_text(calibration_to_json(nominal_calibration(AZURE_KINECT)), encoding="utf-8")
    fuse = ["fuse", str(raw / "a.mkv"), str(raw / "b.mkv"), "--no-viewer", "--save", str(tmp_path / "s.rrd")]
    if rig is not None:
        fuse += ["--k4abt", str(rig / "lib" / "libk4abt.so.1.1")]
        (tmp_path / "fuse").mkdir()
        done = program.run(fuse, tmp_path / "fuse", {}, (), rig)
        assert done.code == 0, done.said
    else:
        for library in ("libk4a.so", "libk4abt.so"):  # one library for both, as the loader sees it
            (tmp_path / library).symlink_to(standin.path)
        options = ("--k4abt", tmp_path / "libk4abt.so", "--calibrate", calibration)
        assert duplex(*fuse, *options) == 0
    rows = Session.open(tmp_path / "s.rrd").rows
    assert len(rows) >= max(counts)
    assert np.abs(rows.skew_ns).max() < 165_000, "the cable's 160 µs, though the rig's clocks are not one"


@pytest.mark.rig
def test_what_the_real_libk4a_logs_tells_no_serial_in_a_bundle(shared, tmp_path):
    path = tmp_path / "b.zip"
    done = program.run(["doctor", "--bundle", str(path), "--recording"], tmp_path, {}, (), built_rig(shared))
    assert done.code == 1, "no display"
    with zipfile.ZipFile(path) as file:
        members = {name: file.read(name) for name in file.namelist()}
    assert sorted(members) == ["a.mkv", "b.mkv", "doctor.json", "doctor.txt", "log.txt"]
    assert b"Serial Number found sensor-" in members["log.txt"]
    for content in members.values():
        for trace in (b"000001111111", b"000002222222", b"00000077-0000-", str(tmp_path).encode()):
            assert trace not in content
