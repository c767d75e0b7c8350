"""Each file of ``examples/``, run as its first lines say."""

import io
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from devices.network.remote_sensor import RemoteSensor
from devices.network.zenoh_session import ZenohAddresses
from fusion.body import KINECT_V2
from recordings import Session
from tests.acceptance.conftest import copied
from tests.helpers.machine import need_networks
from tests.helpers.network import free_address
from tests.helpers.notebooks import code_cells, read_notebook, run_cells
from tests.helpers.programs import ROOT, typed

EXAMPLES = ROOT / "examples"
NOTEBOOK = EXAMPLES / "session_in_a_notebook.ipynb"
ELSEWHERE = {"test_fusion.py": "test_pytest_plugin.py"}


def test_every_example_is_short_and_runs_here():
    here = {path.name for path in EXAMPLES.iterdir() if path.is_file()} - ELSEWHERE.keys()
    assert here == {*JOINTS, "fuse_two_recordings.py", NOTEBOOK.name, "kinect_v2_on_another_pc.py"}
    for example in filter(Path.is_file, EXAMPLES.iterdir()):
        source = example.read_text(encoding="utf-8")
        if example.suffix == ".ipynb":
            source = "\n".join("".join(cell["source"]) for cell in code_cells(read_notebook(example)))
        assert len(source.splitlines()) <= 30


def run(name, folder, arguments="", **environment):
    with typed(f"python {EXAMPLES / name} {arguments}", folder, **environment) as program:
        assert program.code() == 0, program.said
    return program.said


def test_two_recordings_are_fused(walk, tmp_path, home):
    copied(walk, tmp_path)
    assert "827 frames of 25 joints" in run(
        "fuse_two_recordings.py", tmp_path, "a.csv b.csv walk.rrd", **home
    )
    assert len(Session.open(tmp_path / "walk.rrd")) == 827


JOINTS = {
    "frame_by_frame.py": "right wrist at [",
    "own_sensor.py": "head at [",
    "any_depth_camera.py": "head at [",
}


@pytest.mark.parametrize("name", JOINTS)
def test_own_arrays_sensors_and_cameras_give_joints(name, tmp_path, home):
    if name == "any_depth_camera.py":
        need_networks()
    said = run(name, tmp_path, **home)
    # of two live sensors, a busy machine leaves out frames
    assert said.count(JOINTS[name]) > (100 if name == "frame_by_frame.py" else 0)
    assert "nan" not in said.splitlines()[-1], "the person is found"


def test_a_session_is_read_in_a_notebook(tmp_path, monkeypatch, home):
    monkeypatch.chdir(tmp_path)
    notebook = read_notebook(NOTEBOOK)
    text = "".join(notebook["cells"][0]["source"])
    commands = [line for line in text.splitlines() if line.startswith("duplex ")]
    assert len(commands) == 2
    for command in commands:
        one_second = re.sub(r"--seconds 10\b", "--seconds 1", command)  # is enough
        with typed(one_second, tmp_path, **home) as program:
            assert program.code() == 0, program.said
    outputs = run_cells(notebook)
    assert "the views differ by 0.0" in outputs[0].printed
    assert [len(output.pictures) for output in outputs] == [0, 1, 1, 1]
    pixels = [np.asarray(Image.open(io.BytesIO(output.pictures[0]))) for output in outputs[1:]]
    assert all((picture.min(axis=2) < 200).mean() > 0.01 for picture in pixels), "each plot has lines"


def test_the_notebook_shows_small_pictures():
    shown = [len(cell["outputs"]) for cell in code_cells(read_notebook(NOTEBOOK))]
    assert shown == [1, 1, 1, 1]  # a text, and three plots
    assert NOTEBOOK.stat().st_size < 100_000


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


def test_a_kinect_v2_is_published_in_the_projects_axes(tmp_path, home):
    pytest.importorskip("zenoh", reason="eclipse-zenoh is not installed: pip install -e '.[zenoh]'")
    (tmp_path / "kinect_next.py").write_text(STAND_IN, encoding="utf-8")
    address = free_address()
    line = f"python {EXAMPLES / 'kinect_v2_on_another_pc.py'} lab/a {address}"
    addresses = ZenohAddresses(listen=(address,))
    with (
        typed(line, tmp_path, **home, PYTHONPATH=str(tmp_path)) as example,
        RemoteSensor("lab/a", addresses, appear_s=60.0) as far,
    ):
        assert far.body is KINECT_V2
        frame = next(iter(far.frames()))
    assert "Traceback" not in example.said
    (person,) = frame.people.values()
    assert list(frame.people) == ["72057594037"]
    expected = np.array([(-0.1, -0.2, 2.0 + k / 100) for k in range(25)], dtype=np.float32)
    assert np.array_equal(person.positions, expected)
    assert person.states.tolist() == [1] + [2] * 24
