"""Files of other programs: their units of time, their axes, their names of the joints."""

import json

import numpy as np
import pandas
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from devices.sensor import DeviceError
from devices.skeletons.file_sensor import SkeletonRecording
from devices.skeletons.stated_format import AXES, UNSTATED, StatedFormat
from devices.skeletons.times import TIME_COLUMNS, find_time_unit
from fusion.body import KINECT_V2
from recordings import Session, fuse
from tests.helpers.command_line import duplex, one_line
from tests.helpers.recorded_pairs import assert_same_session, write_recordings, write_view
from tests.helpers.two_views import A_FROM_B, moving
from viewer_app.batch.worker import fuse_job

FRAMES = 40
PER_SECOND = {"time_s": 1.0, "time_ms": 1e3, "time_us": 1e6, "time_ns": 1e9}
SENSOR_FROM = {
    "kinect": [[-1, 0, 0], [0, -1, 0], [0, 0, 1]],
    "unity": [[1, 0, 0], [0, -1, 0], [0, 0, 1]],
    "opengl": [[1, 0, 0], [0, -1, 0], [0, 0, -1]],
    "ros": [[0, -1, 0], [0, 0, -1], [1, 0, 0]],
}
"""x right, y down, z forward of each program's axes, as its documentation has them."""


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


def retimed(column, per_second, rate=30.0, start=0.0):
    def change(table):
        frame = table.index // len(KINECT_V2)
        times = (start + frame / rate) * per_second
        times = times if per_second < 1e6 else times.round().astype("int64")
        return table.assign(time_us=times).rename(columns={"time_us": column})

    return change


def turned(path, made, sensor_from):
    """Writes a recording in other axes."""

    def change(table):
        return table.assign(**dict(zip("xyz", np.linalg.solve(sensor_from, table[[*"xyz"]].T), strict=True)))

    return changed(path, made, change)


@pytest.mark.parametrize(("rate", "start"), [(5.0, 0.0), (30.0, 1_763_900_000.25), (120.0, 0.0)])
@pytest.mark.parametrize("unit", PER_SECOND)
def test_the_unit_of_time_is_found_by_the_rate(tmp_path, good, unit, rate, start):
    for column in ("time_us", "time", unit):
        path = changed(good, tmp_path / f"{column}.csv", retimed(column, PER_SECOND[unit], rate, start))
        read = read_csv(path)
        expected = np.rint((start + np.arange(FRAMES) / rate) * 1e6) * 1000
        np.testing.assert_allclose(np.diff(read.people.time_ns), np.diff(expected), rtol=0, atol=2001)
        assert read.people.time_ns[0] == pytest.approx(expected[0], abs=1001)
        told = f"{column} is read as {TIME_COLUMNS[unit][1]}, so that there are {rate:g} frames per second"
        told += f". Name the column {unit} to state this unit."
        assert [told in warning for warning in read.warnings] == [True] * (column != unit)


@pytest.mark.parametrize("interval", [300e-6, 0.001, 0.4, 1.2, 1500.0, 1e9])
def test_an_interval_of_no_body_tracker_is_refused(tmp_path, good, interval):
    path = changed(good, tmp_path / "odd.csv", retimed("time_us", 1.0, 1.0 / interval))
    with pytest.raises(DeviceError, match="unit of time_us is unclear; in no unit is its usual interval"):
        read_csv(path)


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
        us, told = find_time_unit("a.csv", column, times)
    except DeviceError:
        return
    assert told or us == pytest.approx(UNITS_US[unit])
    if column == "time" and rate in (15.0, 30.0):
        assert us == pytest.approx(UNITS_US[unit])


@given(
    milliseconds=st.permutations([32] * 26 + [34] * 16 + [35] * 8 + [66] * 3 + [500]),
    unit=st.sampled_from(["ticks", "60 MHz"]),
)
def test_stamps_in_whole_milliseconds_tell_their_unit(milliseconds, unit):
    """Kinect v2: most often 32 ms from frame to frame, which is 31 per second by the median."""
    us, told = find_time_unit("a.csv", "time_us", np.cumsum(milliseconds) * 1e3 / UNITS_US[unit])
    assert us == pytest.approx(UNITS_US[unit])
    assert told


@pytest.mark.parametrize("spelling", ["name", "list"])
@pytest.mark.parametrize("axes", SENSOR_FROM)
def test_axes_of_other_programs_are_turned(tmp_path, good, axes, spelling):
    path = turned(good, tmp_path / "a.csv", SENSOR_FROM[axes])
    read = read_csv(path, StatedFormat(axes=axes if spelling == "name" else AXES[axes]))
    assert read.warnings == ()
    expected = read_csv(good).people.skeletons.positions
    np.testing.assert_allclose(read.people.skeletons.positions, expected, rtol=0, atol=1e-6)


WRONG_AXES = {
    "x,x,z": "has x twice",
    "x,y": "neither kinect, unity, opengl, ros, nor three axes",
    "x,y,w": "neither kinect, unity, opengl, ros, nor three axes",
    "x,-y,z": "by --axes x,-y,z the person is a mirror image, so the result is left-handed",
    "unity": "by --axes unity the person is a mirror image",
    "-x,y,-z": "most joints have a negative z",
}


@pytest.mark.parametrize("axes", WRONG_AXES)
def test_wrong_axes_are_refused_in_one_line(tmp_path, good, axes, capsys):
    other = write_view(tmp_path / "b.csv", KINECT_V2, A_FROM_B.inverse().apply(moving(KINECT_V2, FRAMES)))
    # a right-handed file, or the person of a left-handed one
    assert duplex("fuse", good, other, "--no-viewer", "--axes", axes) == 2
    assert WRONG_AXES[axes] in one_line(capsys)


def test_axes_that_nothing_proves_are_said_to_be_unproved(tmp_path, good):
    """Of a file without feet, as of OpenPose; these axes mirror the person."""
    path = changed(good, tmp_path / "a.csv", lambda table: table[~table["joint"].str.startswith("Foot")])
    said, _ = read_csv(path, StatedFormat(axes="unity")).warnings  # and that the head is below
    assert said.startswith(f"{path}: whether the person is a mirror image by `axes=unity` is unknown")
    assert read_csv(path).warnings == ()


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
        made = turned(tmp_path / f"{side}.csv", folder / f"{side}.csv", SENSOR_FROM["unity"])
        changed(made, made, retimed("time", 1.0))
        table = pandas.read_csv(made).rename(columns={"time": "time_us"})
        renamed(table).rename(columns={"time_us": "time"}).to_csv(made, index=False)
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
    assert said.count("time is read as seconds, so that there are 30 frames per second") == 2
    assert said.count("these points are no joints: ring finger.") == 2
    session = Session.open(save)
    np.testing.assert_allclose(session.fused, expected.fused, atol=1e-4)
    recorded = {"Head": [["crown", "chin"]], "SpineBase": [["Hips"]], "HandLeft": [["palm_l"], ["LeftHand"]]}
    assert json.loads(session.about["session"]["joint_names"][0]) == recorded
    assert duplex("replay", save, "--verify") == 0
    assert duplex("replay", save, "--no-viewer", "--save", tmp_path / "again.rrd") == 0
    assert Session.open(tmp_path / "again.rrd").about["session"]["axes"] == ["x,-y,z"]
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
