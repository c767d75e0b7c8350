"""Files of motion capture, written by others and by this program."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from devices.skeletons.name_tables import name_table
from fusion.body import AZURE_KINECT, KINECT_V1
from fusion.movement.joint_rotations import rotations_of
from fusion.pair_arrays import View
from fusion.registration.clock_search import best_offsets, part_offsets
from fusion.registration.rigid_fit import fit_recording
from fusion.rigid import RigidTransform
from fusion.skeleton import TRACKED
from recordings.comparing import c3d_file
from recordings.comparing.truth_comparison import SKELETONS, TruthComparison
from recordings.comparing.truth_files import TruthFile, read_truth
from recordings.comparing.truth_timing import TimeOffset
from recordings.errors import RecordingError
from recordings.export import writer_for
from tests.benchmarks.scores import accuracy
from tests.helpers.frame_pairs import frame_pairs
from tests.helpers.motion_capture import captured, true_positions, write_c3d, write_trc
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


@given(
    frame=st.integers(0, 59), joint=st.integers(0, 24), axis=st.integers(0, 2),
    value=st.floats(10.0, 1.7e308) | st.floats(-1.7e308, -10.0),
)  # fmt: skip
def test_a_wrong_sample_costs_that_sample_and_is_told(tmp_path, frame, joint, axis, value):
    pairs = frame_pairs(KINECT_V1, 60)
    times = np.array([pair.time_ns for pair in pairs]) * 1e-9
    points = np.stack([pair.skeletons.a.positions for pair in pairs])
    joint %= points.shape[1]
    write_trc(tmp_path / "t.trc", KINECT_V1.joints, times, points)
    whole = read_truth(tmp_path / "t.trc")
    assert whole.warning == ""
    lines = (tmp_path / "t.trc").read_text().splitlines()
    at = next(k for k, line in enumerate(lines) if line.startswith("1\t")) + frame
    cells = lines[at].split("\t")
    cells[2 + 3 * joint + axis] = repr(value)
    lines[at] = "\t".join(cells)
    (tmp_path / "t.trc").write_text("\n".join(lines))
    read = read_truth(tmp_path / "t.trc")
    expected = whole.points.copy()
    expected[frame, joint] = np.nan
    np.testing.assert_array_equal(read.points, expected)
    assert read.warning.startswith("1 position is left out")
    assert KINECT_V1.joints[joint] in read.warning


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


# --- Comparison with motion capture whose offset, frame and errors are known.


SECONDS = 22.0


@pytest.fixture(scope="module")
def walk(tmp_path_factory):
    return captured(tmp_path_factory.mktemp("walk") / "s.rrd", AZURE_KINECT, "walk", SECONDS, seed=11)


def truth_of(walk, labels=AZURE_KINECT.joints, **how):
    return TruthFile("truth.c3d", tuple(labels), *walk.truth(**how))


@pytest.fixture(scope="module")
def right(walk):
    """A truth of 15 s, and its comparison."""
    truth = truth_of(walk, offset_s=3.7, seconds=15.0)
    return truth, TruthComparison.of(walk.session, truth)


@pytest.mark.parametrize(
    ("writer", "name", "unit", "rate", "offset", "seconds"),
    [
        (write_trc, "t.trc", 1.0, 100.0, 3.7, 15.0),
        (write_c3d, "t.c3d", 1000.0, 240.0, -3.7, 22.0),  # begins before the session
        (write_trc, "t.trc", 100.0, 25.0, -8.0, 45.0),  # longer than the session
        (write_c3d, "t.c3d", 1000.0, 120.0, 12.3, 5.0),  # a part only
    ],
)
def test_offset_and_distance_are_those_of_the_benchmark(
    walk, writer, name, unit, rate, offset, seconds, tmp_path
):
    times, points = walk.truth(offset, seconds, rate, missing=0.1, unit=unit)
    file = read_truth(writer(tmp_path / name, AZURE_KINECT.joints, times, points))
    found = TruthComparison.of(walk.session, file)
    assert found.offset.seconds == pytest.approx(offset, abs=0.002)
    rows = walk.session.rows[found.frame]
    truth = walk.positions_at(rows.time_ns * 1e-9)
    truth = fit_recording(rows.fused, truth).apply(truth)
    expected = accuracy(AZURE_KINECT, rows.fused, truth, rows.states_a, rows.states_b, 1 / 30)["mpjpe"]
    assert np.nanmean(found.distance["fused"]) == pytest.approx(expected, abs=0.0005)


@pytest.mark.parametrize(("offset", "seconds"), [(9.2, 1.5), (12.7, 2.5)])
def test_the_offset_of_a_few_steps_is_found_or_listed(walk, offset, seconds):
    file = truth_of(walk, offset_s=offset, seconds=seconds, missing=0.1)
    found = TruthComparison.of(walk.session, file).offset
    nearest = min((found.seconds, *found.others), key=lambda each: abs(each - offset))
    assert nearest == pytest.approx(offset, abs=0.003)
    if nearest != found.seconds:  # the simulated walk repeats itself
        assert abs(found.seconds - offset) == pytest.approx(11.5, abs=0.003)


@pytest.mark.parametrize("rate", [12.0, 8.0, 5.0])
def test_a_truth_of_few_frames_per_second_is_found(walk, rate):
    found = TruthComparison.of(walk.session, truth_of(walk, offset_s=3.7, seconds=15.0, rate=rate)).offset
    assert found.seconds == pytest.approx(3.7, abs=0.002)
    assert found.others == ()


@pytest.mark.parametrize(("sd", "lag"), [(0.05, 0.0), (0.001, -0.2)])
def test_an_offset_that_is_not_certain_is_refused_unless_it_is_given(walk, sd, lag, monkeypatch):
    monkeypatch.setattr(
        "recordings.comparing.truth_comparison.find_offset",
        lambda *_: TimeOffset(3.7, sd_seconds=sd, correlation=0.9, lag_seconds=lag),
    )
    file = truth_of(walk, offset_s=3.7, seconds=12.0)
    with pytest.raises(RecordingError, match="moves too little to find the offset; give `offset`"):
        TruthComparison.of(walk.session, file)
    given = TruthComparison.of(walk.session, file, offset_s=3.75).offset
    assert given.seconds == 3.75
    assert np.isnan(given.sd_seconds)


def test_a_truth_of_somebody_who_stands_is_refused(walk):
    with pytest.raises(RecordingError, match="of a person who moves enough"):
        TruthComparison.of(walk.session, truth_of(walk, offset_s=0.3, seconds=2.0))


def test_gaps_of_half_a_second_stay_gaps(walk):
    times, points = walk.truth(3.7, 8.0)
    points[200:250, 5] = np.nan
    found = TruthComparison.of(walk.session, TruthFile("t", AZURE_KINECT.joints, times, points))
    inside = np.abs(found.time_ns * 1e-9 - 3.7 - 2.25) < 0.24
    assert np.isnan(found.distance["fused"][inside, 5]).all()
    assert np.isfinite(found.distance["fused"][~inside, 5]).mean() > 0.99
    assert np.isfinite(found.distance["fused"][inside, 6]).all()


def test_markers_of_a_subject_need_no_table(walk):
    times, points = walk.truth(3.7, 8.0)
    markers = {"Ann:LASI": 18, "Ann:RASI": 22, "Ann:LPSI": 18, "Ann:RPSI": 22, "Ann:C7": 3, "Ann:CLAV": 3}
    for side, (hip, shoulder) in {"L": (18, 5), "R": (22, 12)}.items():
        parts = {"KNE": hip + 1, "ANK": hip + 2, "TOE": hip + 3}
        arms = {"SHO": shoulder, "ELB": shoulder + 1, "WRA": shoulder + 2, "WRB": shoulder + 2}
        markers |= {f"Ann:{side}{part}": joint for part, joint in (parts | arms).items()}
    points = points[:, list(markers.values())]
    found = TruthComparison.of(walk.session, TruthFile("t", tuple(markers), times, points))
    assert found.table == "plug-in-gait"
    assert found.offset.seconds == pytest.approx(3.7, abs=0.002)
    knee = AZURE_KINECT.joint("KNEE_LEFT")
    assert np.nanmean(found.distance["fused"][:, knee]) < 0.03
    angles, true = found.angles["fused"]
    assert np.isfinite(true).all()
    assert np.sqrt(np.nanmean((angles - true)[:, :2] ** 2)) < 5.0  # knees


def test_the_constant_part_is_another_definition_of_the_joint(walk):
    rows = walk.session.rows[200:300]
    turns = rotations_of(AZURE_KINECT, rows.fused, rows.time_ns)
    put_in = np.random.default_rng(2).normal(0.0, 0.03, (len(AZURE_KINECT), 3))
    moved = np.stack([Rotation.from_quat(turns[:, j]).apply(put_in[j]) for j in range(len(put_in))], axis=1)
    every = dict.fromkeys(SKELETONS, rows.fused)
    found = TruthComparison(
        AZURE_KINECT, "t", "bodies", np.arange(len(AZURE_KINECT)), "metres", TimeOffset(0.0),
        RigidTransform.identity(), 0.0, rows.frame, rows.time_ns, every,
        every | {"fused": rows.fused - moved}, np.array([0.0, -1.0, 0.0]),
    )  # fmt: skip
    np.testing.assert_allclose(found.constant["fused"], put_in, atol=1e-6)
    np.testing.assert_allclose(found.rest["fused"], 0.0, atol=1e-6)
    np.testing.assert_allclose(
        found.distance["fused"].mean(axis=0), np.linalg.norm(put_in, axis=1), atol=1e-6
    )
    np.testing.assert_array_equal(found.distance["a"], 0.0)


def test_what_cannot_be_compared_says_why(walk, tmp_path, monkeypatch):
    good = truth_of(walk, offset_s=3.7, seconds=8.0)

    def error(session=walk.session, truth=good, **how):
        with pytest.raises(RecordingError) as raised:
            TruthComparison.of(session, truth, **how)
        return str(raised.value)

    few = replace(good, labels=good.labels[:4], points=good.points[:, :4])
    assert "4 of the joints of azure_kinect" in error(truth=few)
    assert "has PELVIS, SPINE_NAVEL, SPINE_CHEST, NECK" in error(truth=few)
    nobody = replace(walk.session.rows, fused=np.full_like(walk.session.fused, np.nan))
    assert "has no S*" in error(replace(walk.session, rows=nobody))
    assert "times the size" in error(truth=replace(good, points=1.8 * good.points))
    still = replace(good, points=np.repeat(good.points[:1], len(good.points), axis=0))
    assert "no offset in time makes the movements match" in error(truth=still)
    scrambled = tmp_path / "t.toml"
    scrambled.write_text("[joints]\n" + "\n".join(
        f'{joint} = "{other}"' for joint, other in zip(good.labels, good.labels[::-1], strict=True)
    ))  # fmt: skip
    assert "t.toml, right?" in error(table=name_table(scrambled))
    assert "or another table of names is needed" in error(table=name_table(scrambled), offset_s=3.7)
    # A stated offset is used as it is.
    monkeypatch.setattr("recordings.comparing.truth_comparison.find_offset", lambda *_: None)
    assert "have 0 frames with an S*" in error(offset_s=100.0)
    mirrored = replace(good, points=good.points * [-1.0, 1.0, 1.0])
    assert "is a mirror image" in error(truth=mirrored, offset_s=3.7)


def test_standing_before_a_movement_that_repeats_itself_is_no_part_of_it():
    positions_at, noise = true_positions(AZURE_KINECT, "squat"), np.random.default_rng(5)

    def view(count, begin, sd):  # before the movement begins, the person stands
        seconds = np.arange(count) / 30.0
        at = positions_at(np.maximum(seconds + begin, 0.0))
        at += noise.normal(0.0, sd, at.shape)
        states = np.full(at.shape[:2], TRACKED, dtype=np.uint8)
        return View(np.rint(1e9 * seconds).astype(np.int64), at.astype(np.float32), states)

    truth, session = view(660, -3.7, 0.001), view(900, 0.0, 0.03)  # at 8 s more, all of the truth is covered
    offsets = part_offsets(AZURE_KINECT, truth, session)
    first, *_ = best_offsets(truth, session, offsets)
    assert offsets[first] == pytest.approx(3.7e9, abs=3e7)


@pytest.mark.parametrize("fast", [-0.001, 0.02])
def test_a_truth_whose_clock_has_another_speed_is_found(walk, right, fast):
    truth, best = right
    wrong = replace(truth, seconds=(1.0 + fast) * truth.seconds)
    found = TruthComparison.of(walk.session, wrong)
    # the right one's clock is that of the simulator, from which errors of S* may take it
    assert found.offset.fast - best.offset.fast == pytest.approx(fast, abs=4.0 * found.offset.fast_sd)
    assert found.offset.seconds == pytest.approx(3.7, abs=0.003)
    means = [np.nanmean(each.distance["fused"]) for each in (found, best)]
    assert means[0] == pytest.approx(means[1], rel=0.01)
    given = TruthComparison.of(walk.session, wrong, offset_s=found.offset.seconds)
    assert given.offset.fast == found.offset.fast
    np.testing.assert_allclose(given.distance["fused"], found.distance["fused"], atol=1e-9)


def test_a_session_with_a_pause_in_its_middle_is_compared(walk):
    """The search of the clock's speed begins there."""
    rows = walk.session.rows
    kept = np.abs(1e-9 * rows.time_ns - 0.5 * SECONDS) > 4.0
    session = replace(walk.session, rows=rows[np.flatnonzero(kept)])
    found = TruthComparison.of(session, truth_of(walk, offset_s=0.3, seconds=21.0))
    assert found.offset.seconds == pytest.approx(0.3, abs=0.002)
    assert found.offset.fast == 0.0


def test_a_right_clock_stays_as_it_is(right):
    assert right[1].offset.fast == 0.0


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda points: points * [1.0, -1.0, 1.0], "a mirror image: its axes are left-handed"),
        (lambda points: points[:, AZURE_KINECT.mirror], "whose left and right are exchanged"),
        (lambda points: points[::-1], None),
    ],
    ids=["mirrored", "exchanged", "backwards"],
)
def test_a_mirror_image_is_called_so_and_nothing_else(walk, change, words):
    truth = truth_of(walk, offset_s=3.7, seconds=8.0)
    with pytest.raises(RecordingError, match=words) as raised:
        TruthComparison.of(walk.session, replace(truth, points=change(truth.points)))
    if words is None:
        assert "mirror" not in str(raised.value)
        assert "exchanged" not in str(raised.value)


@pytest.mark.parametrize("motion", ["squat", "turn"])
def test_another_movement_is_refused(walk, motion):
    times = np.arange(1100) / 100.0
    file = TruthFile("t", AZURE_KINECT.joints, times, true_positions(AZURE_KINECT, motion)(times + 4.0))
    with pytest.raises(RecordingError, match="no offset in time makes the movements match"):
        TruthComparison.of(walk.session, file)
