"""Inputs that people who do this job reported, from ``../shared/cases``, with the right values."""

import re
import runpy

import numpy as np
import pytest

from devices.sensor import DeviceError
from devices.simulated.kinect import simulated_pair
from devices.skeletons.file_sensor import SkeletonRecording
from fusion.body import BODIES
from recordings import Session, fuse
from recordings.quality.figures import report
from tests.helpers.command_line import duplex


@pytest.fixture
def case(shared, tmp_path, monkeypatch):
    """Finds both files of a case by its number; makes them where the case is a program."""

    def files(number):
        (folder,) = (shared / "cases").glob(f"{number:02}_*")
        if (folder / "make.py").is_file():
            monkeypatch.chdir(tmp_path)
            runpy.run_path(str(folder / "make.py"))
            folder = tmp_path
        return folder / "a.csv", folder / "b.csv"

    return files


def said(session):
    """All that a session tells of its files."""
    return "\n".join(event.text for event in session.events)


def apart_mm(session):
    return report(session)["views_agree_mm"]["median"]


def test_case_1_seated_in_kinect_axes(case):
    session = fuse(*case(1))
    assert said(session).count("read as the axes kinect") == 2
    body, at = session.body, np.nanmedian(session.fused, axis=0)
    assert at[body.joint("Head"), 1] < at[body.joint("HandLeft"), 1]
    left, right = (at[body.joint(f"Shoulder{side}"), 0] for side in ("Left", "Right"))
    assert left > right  # of a person who faces the sensor


def test_case_3_one_file_in_other_axes(case, tmp_path):
    files = case(3)
    session = fuse(*files)
    assert "b.csv: read as the axes kinect" in said(session)
    assert apart_mm(session) < 60.0
    stated = tmp_path / "s.rrd"
    for options in (("--axes-b", "kinect"), ("--orientation", "0,180")):
        assert duplex("fuse", *files, *options, "--no-viewer", "--save", stated, "--force") == 0
        np.testing.assert_allclose(Session.open(stated).fused, session.fused, atol=1e-6)  # float32


def test_case_4_a_clock_that_is_set_back(case):
    session = fuse(*case(4))
    assert "the clock went back by 1.012 s" in said(session)
    assert apart_mm(session) < 60.0


def test_case_6_a_clock_one_percent_fast(case):
    session = fuse(*case(6))
    (ppm,) = re.findall(r"growing by ([-+.\d]+) millionths of the time", said(session))
    assert float(ppm) == pytest.approx(-9_901, abs=2_200)  # 33 ms in the 15 s from the middle


def test_case_7_a_csv_of_nuitrack(case):
    session = fuse(*case(7))
    assert said(session).count("the names of nuitrack; the axes unity") == 2
    assert apart_mm(session) < 60.0


def test_case_8_positions_relative_to_the_person(case, capsys):
    with pytest.raises(DeviceError, match="relative to the person"):
        fuse(*case(8))
    assert duplex("info", case(8)[0]) == 2
    assert "duplex fuse" not in capsys.readouterr().out


def test_case_10_states_in_columns_of_joints(case):
    with SkeletonRecording(case(10)[0]) as recording:
        states = recording.people.skeletons.states
    assert set(np.unique(states).tolist()) == {0, 1, 2}
    assert said(fuse(*case(10))).count("read as the axes kinect") == 2


@pytest.mark.parametrize("lines", [2, 3])
def test_a_program_that_logs_faster_than_its_tracker(tmp_path, lines):
    """A walk, each frame logged ``lines`` times; as without repeated lines."""
    body = BODIES["kinect_v1"]
    a, b, _ = simulated_pair(motion="walk", seed=0, body=body, angle_deg=90.0, seconds=8.0)
    for sensor, name in ((a, "a.csv"), (b, "b.csv")):
        once, often = (["time_us,body,joint,x,y,z"] for _ in range(2))
        for frame in sensor.frames():
            for again in range(lines):
                rows = [
                    f"{frame.time_ns // 1000 + again * 33_333 // lines},1,{joint},{x:.4f},{y:.4f},{z:.4f}"
                    for person in frame.people.values()
                    for joint, (x, y, z) in zip(body.joints, person.positions, strict=True)
                    if np.isfinite(x)
                ]
                often += rows
                once += rows if again == 0 else []
        (tmp_path / name).write_text("\n".join(often) + "\n")
        (tmp_path / f"once_{name}").write_text("\n".join(once) + "\n")
    session = fuse(tmp_path / "a.csv", tmp_path / "b.csv")
    expected = fuse(tmp_path / "once_a.csv", tmp_path / "once_b.csv")
    np.testing.assert_array_equal(session.fused, expected.fused)
    assert f"{100 - 100 / lines:.0f} % of the frames repeat the one before" in said(session)
