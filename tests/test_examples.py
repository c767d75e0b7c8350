"""Each file in ``examples/`` runs as it is, and so does each block of Python in the README."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from fusion import FuserSettings
from fusion.setup import Method
from recordings import Session, fuse
from tests.helpers.command_line import duplex
from tests.helpers.machine import need_networks
from tests.helpers.written_recordings import write_recordings

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = ROOT / "examples"
TESTED_ELSEWHERE = ("kinect_v2_on_another_pc.py",)  # tests/devices/network/test_kinect_v2_example.py


def run(folder: Path, *arguments: object) -> subprocess.CompletedProcess[str]:
    """Runs Python in a folder, as someone who has installed the program."""
    return subprocess.run(
        [sys.executable, *map(str, arguments)],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT), "MPLBACKEND": "Agg"},
        capture_output=True,
        text=True,
        check=False,
    )


def test_every_example_is_short_and_has_a_test() -> None:
    tests = Path(__file__).read_text(encoding="utf-8")
    for example in EXAMPLES.iterdir():
        assert f'"{example.name}"' in tests
        assert len(example.read_text(encoding="utf-8").splitlines()) <= 30


def test_two_recordings_are_fused(tmp_path: Path) -> None:
    write_recordings(tmp_path)
    done = run(tmp_path, EXAMPLES / "fuse_two_recordings.py", "a.csv", "b.csv", "walk.rrd")
    assert "70 frames of 25 joints" in done.stdout, done.stderr
    assert len(Session.open(tmp_path / "walk.rrd")) == 70


@pytest.mark.parametrize(
    ("name", "line"), [("frame_by_frame.py", "right wrist at ["), ("own_sensor.py", "head at [")]
)
def test_own_arrays_and_own_sensors_give_joints(name: str, line: str, tmp_path: Path) -> None:
    done = run(tmp_path, EXAMPLES / name)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count(line) > 100
    assert "nan" not in done.stdout


def test_any_depth_camera_gives_joints(tmp_path: Path) -> None:
    need_networks()
    done = run(tmp_path, EXAMPLES / "any_depth_camera.py")
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("head at [") > 100
    assert "nan" not in done.stdout.splitlines()[-1], "the person is found"


def test_a_session_is_read_in_a_notebook(tmp_path: Path) -> None:
    session = tmp_path / "demo.rrd"
    assert duplex("demo", "--seconds", "1", "--depth", "none", "--no-viewer", "--save", session) == 0
    paper = tmp_path / "paper.rrd"
    assert duplex("replay", session, "--method", "paper", "--no-viewer", "--save", paper) == 0
    done = run(tmp_path, EXAMPLES / "session_in_a_notebook.py")
    assert done.returncode == 0, done.stderr
    assert "the views differ by" in done.stdout
    assert (tmp_path / "wrist.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("method", "noise_m", "says"),
    [
        ("duplex", 0.01, "2 passed"),
        ("paper", 0.01, "S* differs by more than 0.01 mm"),
        ("duplex", 0.02, "different captures"),
    ],
)
def test_a_session_is_checked_in_a_test_of_ones_own(
    method: Method, noise_m: float, says: str, tmp_path: Path
) -> None:
    expected = fuse(*write_recordings(tmp_path), settings=FuserSettings(method=method))
    expected.save(tmp_path / "expected.rrd")
    write_recordings(tmp_path, noise_m)
    example = tmp_path / "test_fusion.py"
    example.write_bytes((EXAMPLES / "test_fusion.py").read_bytes())
    done = run(tmp_path, "-m", "pytest", "-q", "-p", "no:cacheprovider", example)
    assert says in done.stdout


def test_readmes_python_runs(tmp_path: Path) -> None:
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.DOTALL)
    assert blocks
    write_recordings(tmp_path)
    for block in blocks:
        done = run(tmp_path, "-c", block)
        assert done.returncode == 0, done.stderr
    assert len(Session.open(tmp_path / "walk.rrd")) == 70
