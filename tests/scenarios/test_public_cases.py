"""Inputs that people who do this job reported, from ``../shared/cases``, with the right values."""

import re

import numpy as np
import pytest

from devices.simulated.kinect import simulated_pair
from fusion.body import BODIES
from recordings import Session, fuse
from recordings.quality.figures import report
from tests.helpers.command_line import duplex, one_line
from viewer_app.report.words import lead_lines


@pytest.fixture
def case(shared):
    """Finds both files of a case by its number."""

    def files(number):
        folders = sorted((shared / "cases").glob(f"{number:02}-*"))
        if not folders:
            pytest.skip(f"no case {number} in {shared / 'cases'}")
        return folders[0] / "a.csv", folders[0] / "b.csv"

    return files


def said(session):
    """All that a session tells of its files."""
    return "\n".join(event.text for event in session.events)


def pace(session):
    """What the summary says of S*."""
    return next(line.text for line in lead_lines(report(session)) if line.label == "S*")


def test_case_1_a_gap_of_minutes_in_the_middle(case):
    session, expected = fuse(*case(1)), fuse(*case(1), offset_ms=0)
    np.testing.assert_array_equal(session.fused, expected.fused)
    assert len(session) == 52
    assert pace(session) == "52 frames in 601.7 s, 30.0 per second between pauses."


def test_case_2_feet_that_were_never_seen_are_no_unit(case):
    session, expected = fuse(*case(2)), fuse(*case(2), unit="m")
    assert not [event for event in session.events if "read as" in event.text]
    np.testing.assert_array_equal(session.fused, expected.fused)
    pelvis = session.fused[:, session.body.root]
    assert np.linalg.norm(pelvis, axis=1).mean() == pytest.approx(2.57, abs=0.1)


def test_case_3_ticks_of_100_ns(case):
    session = fuse(*case(3))
    assert (session.time_ns[-1] - session.time_ns[0]) * 1e-9 == pytest.approx(59 / 30, abs=1e-3)
    assert session.frame_rate == 30.0
    assert "ticks of 100 ns, so that there are 30 frames per second" in said(session)


def test_case_4_two_people_whom_the_trackers_number_otherwise(case):
    session = fuse(*case(4))
    assert "The one followed is '1' of A and '2' of B" in said(session)
    assert report(session)["views_agree_mm"]["median"] < 50.0


@pytest.mark.parametrize("lines", [2, 3])
def test_case_5_a_program_that_logs_faster_than_its_tracker(tmp_path, lines):
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
    assert "did not follow the person" not in said(session)
    assert f"{100 - 100 / lines:.0f} % of the frames repeat the one before" in said(session)


def test_case_8_confidence_is_a_state(case, tmp_path):
    files = []
    for path in case(8):
        files.append(tmp_path / path.name)
        files[-1].write_text(path.read_text().replace("confidence", "state"))
    np.testing.assert_array_equal(fuse(*case(8)).fused, fuse(*files).fused)


@pytest.mark.parametrize("seed", [0, 2])
def test_case_9_frame_numbers_as_times_where_frames_were_lost(seed, tmp_path):
    a, b, _ = simulated_pair(motion="walk", seed=seed, body=BODIES["azure_kinect"], seconds=60.0)
    for name, sensor, lost in (("a.csv", a, ()), ("b.csv", b, (300, 700, 701, 1200))):
        kept = [frame for number, frame in enumerate(sensor.frames()) if number not in lost]
        with (tmp_path / name).open("w") as file:
            file.write("frame,joint,x,y,z,state\n")
            for number, frame in enumerate(kept):
                for person in frame.people.values():
                    rows = zip(person.body.joints, person.positions, person.states, strict=True)
                    file.writelines(
                        f"{number},{joint},{x:.4f},{y:.4f},{z:.4f},{state}\n"
                        for joint, (x, y, z), state in rows
                    )
    session = fuse(tmp_path / "a.csv", tmp_path / "b.csv")
    assert re.search(
        r"The clocks differ: .*changing in steps of [+\d, ]* ms, as when times are frame", said(session)
    )
    assert "A sensor was moved" not in said(session)


def test_case_10_times_that_lost_their_digits(case, capsys):
    assert duplex("fuse", *case(10), "--no-viewer") == 2
    assert "the times lost their digits: 800 rows have one time, such as 1.59379e+15" in one_line(capsys)


def test_case_6_a_sensor_on_its_side_is_where_it_looks(case, tmp_path):
    a, b = case(6)
    assert duplex("fuse", a, b, "--no-viewer", "--save", tmp_path / "s.rrd") == 0
    assert duplex("export", tmp_path / "s.rrd", "--to", tmp_path / "s.trc") == 0
    lines = [line.split("\t") for line in (tmp_path / "s.trc").read_text().splitlines()]
    pelvis = [float(cell) for cell in lines[6][2:5]]
    np.testing.assert_allclose(pelvis, (-2580.0, 911.0, 0.0), atol=10.0)  # +x towards the first sensor


def test_case_7_joints_that_were_never_seen_are_exported_as_gaps(case, tmp_path, capsys):
    a, b = case(7)
    session_file, trc, mot = (tmp_path / name for name in ("s.rrd", "s.trc", "s.mot"))
    assert duplex("fuse", a, b, "--no-viewer", "--save", session_file) == 0
    never = [joint for joint in Session.open(session_file).never_seen if "Knee" in joint]
    assert never == ["KneeLeft", "KneeRight"]
    capsys.readouterr()
    for file in (trc, mot):
        assert duplex("export", session_file, "--to", file) == 0
        assert "No sensor ever saw" in capsys.readouterr().out
    lines = [line.split("\t") for line in trc.read_text().splitlines()]
    knee = lines[3].index("KneeLeft")
    assert all(row[knee : knee + 3] == ["nan", "nan", "nan"] for row in lines[6:])
    head = lines[3].index("Head")
    assert not any("nan" in row[head : head + 3] for row in lines[6:])
    columns = mot.read_text().split("endheader\n")[1].splitlines()[0].split("\t")
    assert "knee_angle_l" not in columns
    assert "elbow_flex_l" in columns
