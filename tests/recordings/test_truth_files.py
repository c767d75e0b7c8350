"""Files of motion capture, written by others and by this program."""

import numpy as np
import pytest

from fusion.body import KINECT_V1
from recordings.comparing import c3d_file
from recordings.comparing.truth_files import read_truth
from recordings.errors import RecordingError
from recordings.export import writer_for
from tests.helpers.frame_pairs import frame_pairs
from tests.helpers.motion_capture import write_c3d, write_trc
from tests.helpers.two_views import calibration_of
from tests.helpers.unreliable import never_ends

LABELS = ("Ann:LASI", "Ann:RASI", "Ann:C7")


def points_of(count):
    rng = np.random.default_rng(3)
    points = rng.normal(0.0, 800.0, (count, len(LABELS), 3))
    points[rng.random(points.shape[:2]) < 0.1] = np.nan
    return np.arange(count) / 120.0, points


@pytest.mark.parametrize(("writer", "name"), [(write_c3d, "t.c3d"), (write_trc, "T.TRC")])
def test_points_of_other_writers_are_read(writer, name, tmp_path):
    times, points = points_of(50)
    read = read_truth(writer(tmp_path / name, LABELS, times, points))
    assert read.labels == LABELS
    np.testing.assert_allclose(read.seconds, times, atol=1e-5)
    np.testing.assert_allclose(read.points, points, atol=1e-3)


@pytest.mark.parametrize(
    ("name", "table"), [("s.c3d", "long"), ("s.trc", "long"), ("s.csv", "long"), ("s.csv", "wide")]
)
def test_what_this_program_exports_is_read(fused_run, tmp_path, name, table):
    session = fused_run(frame_pairs(KINECT_V1, 40, gap=(20,)), calibration_of(KINECT_V1))
    writer_for(tmp_path / name, table)(session, tmp_path / name)
    read = read_truth(tmp_path / name)
    assert read.labels == KINECT_V1.joints
    np.testing.assert_allclose(read.seconds, session.time_ns * 1e-9, atol=1e-3)
    unit = 1.0 if name.endswith(".csv") else 1e-3  # metres, but in axes of the format
    apart, expected = (np.linalg.norm(at[:, 1:] - at[:, :-1], axis=2) for at in (read.points, session.fused))
    known = np.isfinite(apart).all(axis=1)
    assert known.sum() >= 37  # an even rate leaves out the frames beside the gap
    assert known[20] == name.endswith(".trc"), "a .trc is interpolated over a gap of one frame"
    known[20] = False
    np.testing.assert_allclose(unit * apart[known], expected[known], atol=1e-5)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("t.c3d", "no motion", "not a .c3d that ezc3d can read"),
        ("t.trc", "PathFileType\n\n\n\n\n\n\n", "fourth line does not begin with Frame#"),
        ("t.trc", "\n\n\nFrame#\tTime\tA\n\n1\t0\t1\t2\t3\n2\tx\t1\t2\t3\n", "line 7: not a row of numbers"),
        ("t.trc", "\n\n\nFrame#\tTime\tA\n\n1\t0\t1\t2\t3\n2\t0\t1\t2\t3\n", "times that increase"),
        ("t.trc", "\n\n\nFrame#\tTime\tA\n\n1\t0\t\t\t\n2\t1\t\t\t\n", "has no points"),
        ("t.trc", "\n\n\nFrame#\tTime\tA\n\n1\t0\t1\t2\t3\n2\t1\t1\t2\n", "line 7 is cut off"),
        (
            "t.trc",
            "\n\n\nFrame# Time A\n\n1 0 1 2 3\n2 1   1 2\n",
            "line 7 has spaces instead of tabs and lacks",
        ),
        ("t.csv", "a,b\n1,2\n", "no column time_us"),
        ("t.csv", "time_s,HEAD_x,HEAD_y\n0,1,2\n", "it has no column HEAD_z"),
        ("t.csv", "time_s,joint,x,y,z\n0,HEAD,1,2,3\n0,HEAD,1,2,3\n", "line 3: HEAD has a second row"),
        ("t.csv", "time_s,joint,x,y,z\n0,HEAD,1,2,3\n1,HEAD,1,two,3\n", "line 3: y must be a number"),
        ("t.csv", "time_s,joint,x,y,z\n0,HEAD,1,2,3\n1,HEAD,1,2\n", "does not have 5 columns"),
        ("t.csv", "time_s,joint,x,y\n0,HEAD,1,2\n", "Its columns must be those of duplex export"),
        (
            "t.csv",
            "time_us,body,joint,x,y,z\n0,1,HEAD,1,2,3\n0,2,HEAD,1,2,3\n",
            "has 2 bodies, and one is compared",
        ),
        ("t.csv", "", "is empty"),
    ],
)
def test_a_file_that_cannot_be_read_says_why(name, text, message, tmp_path):
    (tmp_path / name).write_text(text)
    with pytest.raises(RecordingError, match=message) as raised:
        read_truth(tmp_path / name)
    assert "\n" not in str(raised.value)


def test_a_trc_of_spaces_is_read(tmp_path):
    times, points = points_of(50)
    path = write_trc(tmp_path / "t.trc", LABELS, times, np.nan_to_num(points))
    expected = read_truth(path)
    path.write_text(path.read_text().replace("\t\t\t", "\t").replace("\t", "  "))
    read = read_truth(path)
    assert read.labels == LABELS
    np.testing.assert_array_equal(read.points, expected.points)


def test_a_c3d_that_is_cut_off_says_so(tmp_path):
    path = write_c3d(tmp_path / "t.c3d", LABELS, *points_of(500))
    path.write_bytes(path.read_bytes()[:8000])
    with pytest.raises(RecordingError, match=r"cut off: it states 500 frames and has 134"):
        read_truth(path)


def test_a_trc_that_is_cut_off_says_so(tmp_path):
    path = write_trc(tmp_path / "t.trc", LABELS, *points_of(50))
    path.write_text("".join(path.read_text().splitlines(keepends=True)[:30]))
    with pytest.raises(RecordingError, match=r"cut off: it states 50 frames and has 24"):
        read_truth(path)


def test_points_at_the_origin_are_missing(tmp_path):
    times, points = points_of(50)
    expected = read_truth(write_trc(tmp_path / "t.trc", LABELS, times, points)).points
    read = read_truth(write_trc(tmp_path / "t.trc", LABELS, times, np.nan_to_num(points)))
    np.testing.assert_array_equal(read.points, expected)


def test_a_csv_may_have_semicolons_decimal_commas_and_other_units_of_time(tmp_path):
    (tmp_path / "a.csv").write_text("time_us,body,joint,x,y,z\n" + "".join(
        f"{50_000 * t},1,{joint},{t}.5,-1.25,{k}\n" for t in range(9) for k, joint in enumerate(LABELS)
    ))  # fmt: skip
    (tmp_path / "b.csv").write_text("time_us;joint;x;y;z\n" + "".join(
        f"{50 * t};{joint};{t},5;-1,25;{k}\n" for t in range(9) for k, joint in enumerate(LABELS)
    ))  # fmt: skip
    first, second = (read_truth(tmp_path / f"{name}.csv") for name in "ab")
    np.testing.assert_allclose(first.seconds, 0.05 * np.arange(9), atol=1e-12)
    np.testing.assert_allclose(second.seconds, first.seconds, atol=1e-12)
    np.testing.assert_array_equal(second.points, first.points)
    assert first.points[4].tolist() == [[4.5, -1.25, k] for k in range(3)]
    assert first.warning == ""
    assert "time_us is read as milliseconds" in second.warning


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(RecordingError, match=r"No file .*none\.c3d"):
        read_truth(tmp_path / "none.c3d")


@pytest.mark.parametrize("at", [534, 540, 550])
def test_a_damaged_c3d_does_not_take_the_program_along(tmp_path, at):
    """ezc3d crashes at these bytes of the parameters."""
    pytest.importorskip("ezc3d")
    path = tmp_path / "m.c3d"
    write_c3d(path, ["A", "B"], np.arange(20) / 30, np.ones((20, 2, 3)))
    assert read_truth(path).labels == ("A", "B")
    damaged = bytearray(path.read_bytes())
    damaged[at] = 255
    path.write_bytes(damaged)
    with pytest.raises(RecordingError, match=r"m\.c3d is not a \.c3d that ezc3d can read"):
        read_truth(path)


def test_a_c3d_that_never_ends_is_given_up(tmp_path, monkeypatch):
    pytest.importorskip("ezc3d")
    path = tmp_path / "m.c3d"
    write_c3d(path, ["A", "B"], np.arange(20) / 30, np.ones((20, 2, 3)))
    monkeypatch.setattr(c3d_file, "content", never_ends)
    monkeypatch.setattr(c3d_file, "_SECONDS", 0.2)
    with pytest.raises(RecordingError, match="does not end"):
        read_truth(path)
