"""The packages' public names: found without side effects, and enough for what the documentation shows."""

import ast
import importlib
import time
from pathlib import Path

import numpy as np
import pytest

import devices
import fusion
import recordings
from devices import Sensor, SensorFrame
from fusion import KINECT_V2, FusionSetup, Skeleton
from fusion.errors import BodyError
from recordings import RecordingError, Session, fuse, fuse_live
from tests.helpers.programs import python
from tests.helpers.recorded_pairs import write_recordings
from tests.helpers.two_views import FRAME_NS, calibration_of, moving, pair_of

PACKAGES = (fusion, devices, recordings)


@pytest.mark.parametrize("package", PACKAGES, ids=lambda package: package.__name__)
def test_every_public_name_is_there_and_documented(package):
    tree = ast.parse(Path(package.__file__).read_text())
    homes = {
        alias.name: node.module
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.level == 0
        for alias in node.names
        if alias.asname is not None
    }
    assert set(package.__all__) == set(homes)
    for name, home in homes.items():
        found = getattr(package, name)
        assert found is getattr(importlib.import_module(home), name)
        assert name in dir(package)
        assert name.isupper() or found.__doc__
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        _ = package.nonsense


def test_importing_changes_no_file_and_no_environment():
    program = """
import os, sys
before = dict(os.environ)
import pathlib
deleted = []
pathlib.Path.unlink = lambda self, *_, **__: deleted.append(self)
import fusion, devices, recordings
assert "numba" not in sys.modules
for package in (fusion, devices, recordings):
    for name in package.__all__:
        getattr(package, name)
import fusion.paper.method, devices.depth.rvl, devices.simulated.imaging.rendering
print(dict(os.environ) == before, deleted)
"""
    said = python("-c", program)
    assert said.stdout == "True []\n", said.stderr


def test_three_lines_fuse_two_files_in_memory(tmp_path, capsys):
    session = fuse(*write_recordings(tmp_path))
    assert session.fused.shape == (70, len(KINECT_V2), 3)
    assert session.path is None
    assert {path.name for path in tmp_path.iterdir()} == {"a.csv", "b.csv"}
    assert capsys.readouterr() == ("", "")
    session.save(tmp_path / "s.rrd")
    read = Session.open(tmp_path / "s.rrd")
    assert read.damage is None
    np.testing.assert_array_equal(read.fused_checksums, session.fused_checksums)
    np.testing.assert_array_equal(read.rows.positions_b, session.rows.positions_b)
    assert read.events == session.events
    assert read.about["settings"].keys() == session.about["settings"].keys()


class Made(Sensor):
    """A sensor of one's own."""

    body = KINECT_V2

    def __init__(self, name, views):
        self.name, self.views = name, views

    def frames(self):
        for skeleton in self.views:
            yield SensorFrame(skeleton.time_ns, {"1": skeleton})


def test_a_live_session_is_kept_on_request_and_saved(tmp_path):
    views = [pair_of(KINECT_V2, at, t * FRAME_NS) for t, at in enumerate(moving(KINECT_V2, 8))]
    setup = FusionSetup(calibration_of(KINECT_V2))
    made = [Made(name, [getattr(pair, name) for pair in views]) for name in "ab"]
    running = fuse_live(made[0], made[1], setup, keep=True)
    with pytest.raises(RecordingError, match="no frame yet"):
        _ = running.setup
    frames = list(running)
    running.session.save(tmp_path / "own.rrd")
    session = Session.open(tmp_path / "own.rrd")
    fused = [frame.fused.positions for frame in frames]
    assert np.array_equal(session.fused, np.asarray(fused, dtype=np.float32))  # as it is stored
    assert session.sources == ("a", "b")
    assert running.setup is setup
    with pytest.raises(RecordingError, match="keep=True"):
        _ = fuse_live(made[0], made[1], setup).session
    for _ in range(10):  # it learns beside the frames, which may all have passed on a busy machine
        learning = fuse_live(made[0], made[1], keep=True)
        list(learning)
        if changes := [frame for frame, _ in learning.session.calibrations][1:]:
            break
    assert changes, "it calibrates on any pose, for the time being"
    assert [event.frame for event in learning.session.events if "calibrated" in event.text] == changes


class Paced(Made):
    """One that gives frames no faster than they are taken."""

    def frames(self):
        for frame in super().frames():
            time.sleep(0.005)
            yield frame


def test_what_a_sensor_of_ones_own_does_wrong_is_in_its_session():
    views = [pair_of(KINECT_V2, at, t * FRAME_NS) for t, at in enumerate(moving(KINECT_V2, 60))]
    a = Paced("a", [pair.a for pair in views])
    wrong = [Skeleton.of(KINECT_V2, 1000 * pair.b.positions, None, pair.b.time_ns) for pair in views]
    running = fuse_live(a, Paced("b", wrong), FusionSetup(calibration_of(KINECT_V2)), keep=True)
    list(running)
    told = [event.text for event in running.session.events if "its skeletons have no joint" in event.text]
    assert [text.partition(":")[0] for text in told] == ["b"]


@pytest.mark.parametrize("body", [None, "kinect_v2"])
def test_a_sensor_without_a_body_is_named(body):
    b = Made("mine", [])
    b.body = body
    with pytest.raises(BodyError, match=r"^mine has no body"):
        next(fuse_live(Made("a", []), b))
