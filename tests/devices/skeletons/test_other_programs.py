"""Files of other programs: their units of time, their axes, their names of the joints."""

import json
import re

import numpy as np
import pandas
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from devices.sensor import DeviceError
from devices.skeletons.file_sensor import SkeletonRecording
from devices.skeletons.name_tables import READY_MADE, fitting_table, name_table
from devices.skeletons.stated_format import UNSTATED, StatedFormat
from devices.skeletons.times import TIME_COLUMNS, find_time_unit
from fusion.body import AZURE_KINECT, BODIES, KINECT_V1, KINECT_V2
from recordings import Session, fuse
from tests.helpers.command_line import duplex, one_line
from tests.helpers.recorded_pairs import assert_same_session, write_recordings, write_view
from tests.helpers.two_views import moving
from viewer_app.batch.worker import fuse_job

FRAMES = 40
UNITY = np.diag([1, -1, 1])
"""From its axes to the sensor's, as its documentation has them."""


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    noise = np.random.default_rng(0).normal(0.0, 0.005, (FRAMES, len(KINECT_V2), 3))
    return write_view(tmp_path_factory.mktemp("good") / "a.csv", KINECT_V2, moving(KINECT_V2, FRAMES) + noise)


def read_csv(path, stated=UNSTATED):
    with SkeletonRecording(path, stated) as recording:
        return recording.content


def changed(path, made, change):
    """Writes a recording with its table changed."""
    change(pandas.read_csv(path)).to_csv(made, index=False)
    return made


def turned(path, made, sensor_from):
    """Writes a recording in other axes."""

    def change(table):
        return table.assign(**dict(zip("xyz", np.linalg.solve(sensor_from, table[[*"xyz"]].T), strict=True)))

    return changed(path, made, change)


@pytest.mark.parametrize("interval", [300e-6, 0.001, 0.4, 1e9])
def test_an_interval_of_no_body_tracker_is_refused(interval):
    with pytest.raises(DeviceError, match="unit of time_us is unclear; in no unit is its usual interval"):
        find_time_unit("a.csv", "time_us", interval * np.arange(FRAMES))


UNITS_US = {"ns": 1e-3, "us": 1.0, "ms": 1e3, "s": 1e6, "ticks": 0.1, "60 MHz": 1 / 60, "1/8 ms": 125.0}


@given(
    unit_rate=st.tuples(st.sampled_from(list(UNITS_US)), st.sampled_from([15.0, 30.0, 60.0, 90.0]))
    | st.tuples(st.sampled_from(["ns", "us", "ms", "s"]), st.floats(5.0, 120.0)),
    column=st.sampled_from(list(TIME_COLUMNS)),
    start=st.floats(0.0, 1e5),
)
def test_a_rate_is_found_or_told(unit_rate, column, start):
    """By the column's unit or by another one: the true rate, or a line."""
    unit, rate = unit_rate
    assume(column != "time_ticks" or unit == "ticks")  # 5 per second in microseconds are 50 in ticks
    times = (start + np.arange(20) / rate) * 1e6 / UNITS_US[unit]
    try:
        us, clock, told = find_time_unit("a.csv", column, times)
    except DeviceError:
        return
    assert clock or told or us == pytest.approx(UNITS_US[unit])
    if column == "time" and rate in (15.0, 30.0):
        assert us == pytest.approx(UNITS_US[unit])


@given(
    milliseconds=st.permutations([32] * 26 + [34] * 16 + [35] * 8 + [66] * 3 + [500]),
    unit=st.sampled_from(["ticks", "60 MHz"]),
)
def test_stamps_in_whole_milliseconds_tell_their_unit(milliseconds, unit):
    """Kinect v2: most often 32 ms from frame to frame, which is 31 per second by the median."""
    us, clock, _ = find_time_unit("a.csv", "time_us", np.cumsum(milliseconds) * 1e3 / UNITS_US[unit])
    assert us == pytest.approx(UNITS_US[unit])
    assert clock


NAMES = """
[joints]
SpineBase = "Hips"
Head = ["crown", "chin"]
HandLeft = [["palm_l"], ["LeftHand"]]
"""
THEIRS = {"SpineBase": "Hips", "HandLeft": "LeftHand"}


def renamed(table):
    """Other names for two joints, two points for the head, and a point that is no joint."""
    head = table[table["joint"] == "Head"]
    up = head.assign(joint="Crown", y=head["y"] - 0.1)
    down = head.assign(joint="Chin", y=head["y"] + 0.1)
    ring = head.assign(joint="ring finger")
    rest = table[table["joint"] != "Head"].assign(joint=table["joint"].replace(THEIRS))
    return pandas.concat([rest, up, down, ring]).sort_values("time_us", kind="stable")


@pytest.fixture(scope="module")
def own_pair(tmp_path_factory):
    """A pair in seconds, Unity's axes and other names, and the session expected of it."""
    tmp_path = tmp_path_factory.mktemp("own")
    folder = tmp_path / "mine"
    folder.mkdir()
    expected = fuse(*write_recordings(tmp_path))
    for side in "ab":
        made = turned(tmp_path / f"{side}.csv", folder / f"{side}.csv", UNITY)
        table = renamed(pandas.read_csv(made))
        table.assign(time_us=table["time_us"] * 1e-6).rename(columns={"time_us": "time"}).to_csv(
            made, index=False
        )
    return folder, expected


def fused_here(jobs, _):
    """Instead of in other processes."""
    yield from map(fuse_job, jobs)


def test_files_of_another_program_are_fused_and_replayed(own_pair, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("viewer_app.batch.processes.run_in_processes", fused_here)
    folder, expected = own_pair
    a, b, names = folder / "a.csv", folder / "b.csv", tmp_path / "names.toml"
    names.write_text(NAMES, encoding="utf-8")
    stated = ["--axes", "x,-y,z", "--names", names]
    save = tmp_path / "s.rrd"
    assert duplex("fuse", a, b, "--no-viewer", *stated, "--save", save) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert said.count("time in seconds, so that there are 30 frames per second") == 2
    assert said.count("these points are no joints: ring finger.") == 2
    session = Session.open(save)
    np.testing.assert_allclose(session.fused, expected.fused, atol=1e-4)
    recorded = {"Head": [["crown", "chin"]], "SpineBase": [["Hips"]], "HandLeft": [["palm_l"], ["LeftHand"]]}
    assert json.loads(session.about["session"]["joint_names"][0]) == recorded
    assert duplex("replay", save, "--verify") == 0
    assert duplex("replay", save, "--no-viewer", "--save", tmp_path / "again.rrd") == 0
    assert Session.open(tmp_path / "again.rrd").about["session"]["axes"] == ("x,-y,z",)
    out = tmp_path / "out"
    for axes, code in (("x,-y,z", 0), ("x,-y,z", 0), ("unity", 2)):
        assert duplex("batch", folder, "--out", out, "--axes", axes, "--names", names) == code
    assert "was fused with another --axes" in one_line(capsys)
    assert_same_session(out / "mine" / "mine.rrd", save)
    names.write_text(NAMES.replace("chin", "crown"), encoding="utf-8")
    assert duplex("batch", folder, "--out", out, *stated) == 2
    assert "was fused with another --names" in one_line(capsys)


def test_a_ready_made_table_without_a_fitting_point_is_refused(tmp_path, good):
    path = changed(good, tmp_path / "a.csv", lambda table: table.assign(joint="p" + table["joint"]))
    with pytest.raises(DeviceError, match="by mixamo none of its points is a joint: pSpineBase, "):
        read_csv(path, StatedFormat(names="mixamo"))


@pytest.mark.parametrize(
    "stated", [StatedFormat(axes="unity"), StatedFormat(names="mixamo")], ids=["axes", "names"]
)
@pytest.mark.parametrize("suffix", [".json", ".skeleton"])
def test_formats_with_axes_and_names_of_their_own_take_none(tmp_path, suffix, stated):
    path = tmp_path / f"a{suffix}"
    path.write_text("{}", encoding="utf-8")
    with pytest.raises(DeviceError, match=r"is for \.csv files"), SkeletonRecording(path, stated):
        pass


PLUG_IN_GAIT = """
    LFHD RFHD LBHD RBHD C7 T10 CLAV STRN LSHO LELB LWRA LWRB LFIN RSHO RELB RWRA RWRB RFIN
    LASI RASI LPSI RPSI LTHI LKNE LTIB LANK LHEE LTOE RTHI RKNE RTIB RANK RHEE RTOE
""".split()  # noqa: SIM905
GAIT2392 = """
    Sternum R.Acromium L.Acromium Top.Head R.ASIS L.ASIS V.Sacral R.Thigh.Upper R.Knee.Lat R.Knee.Med
    R.Ankle.Lat R.Ankle.Med R.Heel R.Toe.Tip L.Thigh.Upper L.Knee.Lat L.Knee.Med L.Ankle.Lat L.Ankle.Med
    L.Heel L.Toe.Tip
""".split()  # noqa: SIM905
MIXAMO = """
    Hips Spine Spine1 Spine2 Neck Head LeftShoulder LeftArm LeftForeArm LeftHand RightArm RightForeArm
    RightHand LeftUpLeg LeftLeg LeftFoot LeftToeBase RightUpLeg RightLeg RightFoot RightToeBase
""".split()  # noqa: SIM905


@pytest.mark.parametrize(
    ("table", "labels", "joints"),
    [
        ("plug-in-gait", [f"Subject:{name}" for name in PLUG_IN_GAIT], {"WRIST_LEFT": ["LWRA", "LWRB"]}),
        ("plug-in-gait", [*PLUG_IN_GAIT, "LFEO"], {"KNEE_LEFT": ["LFEO"], "KNEE_RIGHT": ["RKNE"]}),
        ("gait2392", [name.lower() for name in GAIT2392], {"KNEE_LEFT": ["L.Knee.Lat", "L.Knee.Med"]}),
        ("mixamo", [f"mixamorig:{name}" for name in MIXAMO], {"SHOULDER_LEFT": ["LeftArm"]}),
        ("mixamo", [f"mixamorig{name}" for name in MIXAMO], {"SHOULDER_LEFT": ["mixamorigLeftArm"]}),
        ("mixamo", [f"mixamorig1_{name}" for name in MIXAMO], {"HEAD": ["mixamorig1_Head"]}),
        ("bodies", KINECT_V2.joints, {"PELVIS": ["SpineBase"], "ELBOW_LEFT": ["ElbowLeft"]}),
    ],
)
def test_the_table_of_a_file_is_found_by_its_labels(table, labels, joints):
    found = fitting_table(AZURE_KINECT, labels)
    assert found.name == table
    points = found.points_of(AZURE_KINECT, labels)
    for joint, names in joints.items():
        short = [labels[k].rpartition(":")[2].lower() for k in points[AZURE_KINECT.joint(joint)]]
        assert short == [name.lower() for name in names]
    lateral = {"hip", "knee", "ankle", "shoulder"}
    assert {f"{part} {side}" for part in lateral for side in ("left", "right")} <= {
        AZURE_KINECT.joints[j].lower().replace("_", " ") for j in points
    }


@pytest.mark.parametrize("table", READY_MADE)
@pytest.mark.parametrize("body", BODIES.values(), ids=str)
def test_left_and_right_of_a_ready_made_table_are_mirror_images(table, body):
    names = name_table(table).joints
    labels = sorted({point for ways in names.values() for way in ways for point in way})
    found = name_table(table).points_of(body, labels)
    assert len(found) > 0
    for joint, own in found.items():
        other = found[int(body.mirror[joint])]
        if body.mirror[joint] != joint:
            assert own != other
            mine, others = (
                [re.sub(r"left|right|^[LR]", "", labels[k], flags=re.I) for k in points]
                for points in (own, other)
            )
            assert mine == others


def test_a_table_of_ones_own_weighs_points_and_takes_the_first_whole_alternative(tmp_path):
    path = tmp_path / "lab.toml"
    lines = '"hip left" = ["A", "A", "B"]', 'WristLeft = [["C", "D"], ["c"]]', 'EYE_LEFT = "E"'
    path.write_text("\n".join(["[joints]", *lines]))
    points = name_table(path).points_of(KINECT_V1, ["Head", "B", "C", "Bob:A"])
    assert points == {
        KINECT_V1.joint("HipLeft"): [3, 3, 1],
        KINECT_V1.joint("WristLeft"): [2],
        KINECT_V1.joint("Head"): [0],
    }


def test_of_two_subjects_a_table_names_one():
    labels = [f"{subject}:{name}" for subject in ("Ann", "Bob") for name in PLUG_IN_GAIT]
    assert fitting_table(AZURE_KINECT, labels).points_of(AZURE_KINECT, labels) == {}
    assert name_table("plug-in-gait").points_of(AZURE_KINECT, labels) == {}


def test_a_missing_table_is_named_with_the_ready_made_ones():
    with pytest.raises(DeviceError, match=r"No table of names 'vicon'.*plug-in-gait, gait2392, mixamo"):
        name_table("vicon")
