"""Each file in ``examples/`` runs as it is, and so does each block of Python in the README."""

import io
import os
import re
import runpy
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from devices.network.remote_sensor import RemoteSensor
from devices.network.zenoh_session import ZenohAddresses
from fusion.body import KINECT_V2
from recordings import Session, fuse
from tests.helpers.command_line import duplex
from tests.helpers.machine import need_networks
from tests.helpers.network import free_address
from tests.helpers.notebooks import code_cells, read_notebook, run_cells
from tests.helpers.programs import ROOT, python
from tests.helpers.recorded_pairs import write_recordings

EXAMPLES = ROOT / "examples"


@pytest.fixture
def printed(tmp_path, monkeypatch, capsys):
    """Runs an example in this process and in an empty folder; returns what it prints."""
    monkeypatch.chdir(tmp_path)

    def run_example(name, *arguments):
        monkeypatch.setattr(sys, "argv", [name, *arguments])
        runpy.run_path(str(EXAMPLES / name), run_name="__main__")
        return capsys.readouterr().out

    return run_example


def test_every_example_is_short_and_has_a_test():
    tests = Path(__file__).read_text(encoding="utf-8")
    for example in EXAMPLES.iterdir():
        assert f'"{example.name}"' in tests
        source = example.read_text(encoding="utf-8")
        if example.suffix == ".ipynb":
            source = "\n".join("".join(cell["source"]) for cell in code_cells(read_notebook(example)))
        assert len(source.splitlines()) <= 30


def test_two_recordings_are_fused(printed, tmp_path):
    write_recordings(tmp_path)
    assert "70 frames of 25 joints" in printed("fuse_two_recordings.py", "a.csv", "b.csv", "walk.rrd")
    assert len(Session.open(tmp_path / "walk.rrd")) == 70


@pytest.mark.parametrize(
    ("name", "line"), [("frame_by_frame.py", "right wrist at ["), ("own_sensor.py", "head at [")]
)
def test_own_arrays_and_own_sensors_give_joints(name, line, printed):
    said = printed(name)
    assert said.count(line) > 100
    assert "nan" not in said


def test_any_depth_camera_gives_joints(printed):
    need_networks()
    said = printed("any_depth_camera.py")
    assert said.count("head at [") > 100
    assert "nan" not in said.splitlines()[-1], "the person is found"


@pytest.fixture
def notebook():
    return read_notebook(EXAMPLES / "session_in_a_notebook.ipynb")


def test_a_session_is_read_in_a_notebook(notebook, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = "".join(notebook["cells"][0]["source"])
    commands = [line for line in text.splitlines() if line.startswith("duplex ")]
    assert len(commands) == 2
    for command in commands:
        _, *words = shlex.split(command)
        assert duplex(*(word if word != "10" else "1" for word in words)) == 0  # one second is enough
    outputs = run_cells(notebook)
    assert "the views differ by 0.0" in outputs[0].printed
    assert [len(output.pictures) for output in outputs] == [0, 1, 1, 1]
    pixels = [np.asarray(Image.open(io.BytesIO(output.pictures[0]))) for output in outputs[1:]]
    assert all((picture.min(axis=2) < 200).mean() > 0.01 for picture in pixels), "each plot has lines"


def test_the_notebook_shows_small_pictures(notebook):
    shown = [len(cell["outputs"]) for cell in code_cells(notebook)]
    assert shown == [1, 1, 1, 1]  # a text, and three plots
    assert (EXAMPLES / "session_in_a_notebook.ipynb").stat().st_size < 100_000


def test_a_session_is_checked_in_a_test_of_ones_own(tmp_path):
    fuse(*write_recordings(tmp_path)).save(tmp_path / "expected.rrd")
    example = tmp_path / "test_fusion.py"
    example.write_bytes((EXAMPLES / "test_fusion.py").read_bytes())
    said = python("-m", "pytest", "-q", "-p", "no:cacheprovider", example, cwd=tmp_path)
    assert "2 passed" in said.stdout


def test_readmes_python_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.DOTALL)
    assert blocks
    write_recordings(tmp_path)
    for block in blocks:
        exec(block, {})
    assert len(Session.open(tmp_path / "walk.rrd")) == 70


STAND_IN = '''
import enum, time
from types import SimpleNamespace as Some

class StreamType(enum.IntFlag):
    BODY = 32

class KinectSensor:
    """Two people, of whom one is tracked, in Microsoft's axes: x to the sensor's left, y up."""

    def __init__(self, streams):
        assert streams == StreamType.BODY

    def __enter__(self):
        return self

    def __exit__(self, *fault): ...

    def poll_frames(self):
        for tick in range(10_000):
            joints = [
                Some(position=Some(x=0.1, y=0.2, z=2.0 + k / 100), tracking_state=2 if k else 1)
                for k in range(25)
            ]
            yield Some(tracked_bodies=[Some(tracking_id=72057594037, joints=joints)], relative_time_ns=tick)
            time.sleep(1 / 30)
'''


def test_a_kinect_v2_is_published_in_the_projects_axes(tmp_path):
    pytest.importorskip("zenoh", reason="eclipse-zenoh is not installed: pip install -e '.[zenoh]'")
    (tmp_path / "kinect_next.py").write_text(STAND_IN, encoding="utf-8")
    address = free_address()
    example = subprocess.Popen(
        [sys.executable, EXAMPLES / "kinect_v2_on_another_pc.py", "lab/a", address],
        env={**os.environ, "PYTHONPATH": os.pathsep.join((str(ROOT), str(tmp_path)))},
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        with RemoteSensor("lab/a", ZenohAddresses(listen=(address,)), appear_s=60.0) as far:
            assert far.body is KINECT_V2
            frame = next(iter(far.frames()))
    finally:
        example.kill()
        _, said = example.communicate()
    assert "Traceback" not in said
    (person,) = frame.people.values()
    assert list(frame.people) == ["72057594037"]
    expected = np.array([(-0.1, -0.2, 2.0 + k / 100) for k in range(25)], dtype=np.float32)
    assert np.array_equal(person.positions, expected)
    assert person.states.tolist() == [1] + [2] * 24
