"""Files of motion capture, written by others and by this program."""

import math
import tracemalloc
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation
from scipy.stats import ttest_rel

from devices.skeletons.name_tables import name_table
from fusion.body import AZURE_KINECT, BODIES, KINECT_V1, KINECT_V2
from fusion.clocks import Clock
from fusion.clocks.fit import best_offsets, part_offsets
from fusion.errors import FusionError
from fusion.movement.joint_rotations import rotations_of
from fusion.pair_arrays import View
from fusion.registration.rigid_fit import fit_recording
from fusion.rigid import RigidTransform
from fusion.setup import FuserSettings
from fusion.skeleton import TRACKED
from fusion.support import large_arrays
from recordings.comparing import c3d_file, truth_files, truth_timing
from recordings.comparing.agreement import agreement, step_agreement
from recordings.comparing.session_comparison import Comparison
from recordings.comparing.truth_comparison import SKELETONS, TruthComparison
from recordings.comparing.truth_files import TruthFile, read_truth
from recordings.comparing.truth_timing import JointPath, TimeOffset
from recordings.errors import RecordingError
from recordings.file.session_writer import write_session
from recordings.gait import SIDES, Gait
from recordings.gait.events import find_gait
from recordings.quality.without_truth import FusedPair, facing, figures_without_truth, judge_registration
from recordings.session import Session
from tests.benchmarks.scores import accuracy
from tests.helpers.footfalls import walker
from tests.helpers.frame_pairs import frame_pairs
from tests.helpers.motion_capture import (
    captured,
    true_positions,
    write_c3d,
    write_c3d_of,
    write_motive,
    write_nexus,
    write_qualisys,
    write_trc,
)
from tests.helpers.two_views import A_FROM_B, calibration_of, standing

LABELS = ("Ann:LASI", "Ann:RASI", "Ann:C7")


def points_of(count):
    rng = np.random.default_rng(3)
    points = rng.normal(0.0, 800.0, (count, len(LABELS), 3))
    points[rng.random(points.shape[:2]) < 0.1] = np.nan
    return np.arange(count) / 120.0, points


@pytest.mark.parametrize(
    ("writer", "name"),
    [
        (write_c3d, "t.c3d"), (write_trc, "T.TRC"), (write_motive, "t.csv"), (write_nexus, "t.csv"),
        (write_qualisys, "t.tsv"),
    ],
)  # fmt: skip
def test_points_of_other_writers_are_read(writer, name, tmp_path):
    times, points = points_of(50)
    read = read_truth(writer(tmp_path / name, LABELS, times, points))
    assert read.labels == LABELS
    np.testing.assert_allclose(read.seconds, times, atol=1e-5)
    np.testing.assert_allclose(read.points, points, atol=1e-3)


@pytest.mark.parametrize("name", ["s.c3d", "s.trc"])
def test_what_this_program_exports_is_read(fused_run, tmp_path, name):
    session = fused_run(frame_pairs(KINECT_V1, 40, gap=(20,)), calibration_of(KINECT_V1))
    session.export(tmp_path / name)
    read = read_truth(tmp_path / name)
    assert read.labels == KINECT_V1.joints
    np.testing.assert_allclose(read.seconds, session.time_ns * 1e-9, atol=1e-3)
    apart, expected = (np.linalg.norm(at[:, 1:] - at[:, :-1], axis=2) for at in (read.points, session.fused))
    known = np.isfinite(apart).all(axis=1)
    assert known.sum() >= 37  # an even rate leaves out the frames beside the gap
    assert known[20] == name.endswith(".trc"), "a .trc is interpolated over a gap of one frame"
    known[20] = False
    np.testing.assert_allclose(1e-3 * apart[known], expected[known], atol=1e-5)


@pytest.mark.parametrize("table", ["long", "wide"])
def test_of_exported_frames_of_one_time_the_last_is_read(fused_run, tmp_path, table):
    session = fused_run(frame_pairs(KINECT_V1, 100), calibration_of(KINECT_V1))
    time_ns = session.time_ns.copy()
    time_ns[1] = time_ns[2]
    session = replace(session, rows=replace(session.rows, time_ns=time_ns))
    session.export(tmp_path / "s.csv", table=table)
    read = read_truth(tmp_path / "s.csv").points
    np.testing.assert_array_equal(read, np.delete(session.rows.seen, 1, axis=0))


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
    assert "time_us in milliseconds" in second.warning


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


@pytest.mark.parametrize("processor", [84, 85, 86], ids=["intel", "dec", "mips"])
@pytest.mark.parametrize("scale", [-0.01, 0.125], ids=["floats", "integers"])
@pytest.mark.parametrize("part", [1, 200, 1 << 20])
def test_a_c3d_of_any_processor_is_read_as_by_another_library(processor, scale, part, tmp_path, monkeypatch):
    times, points = points_of(40)
    path = write_c3d_of(processor, scale, tmp_path / "t.c3d", LABELS, times, points)
    monkeypatch.setattr(c3d_file, "_PART", part)
    read = read_truth(path)
    assert read.labels == LABELS
    np.testing.assert_allclose(read.seconds, times, atol=1e-5)
    np.testing.assert_allclose(read.points, points, atol=1e-3 if scale < 0.0 else 0.07)
    with path.open("rb") as file:
        other = np.stack([at for _, at, _ in pytest.importorskip("c3d").Reader(file).read_frames()])
    known = other[..., 3] >= 0.0
    np.testing.assert_allclose(read.points[known], other[known][:, :3], atol=1e-3)


@given(seed=st.integers(0, 999), rate=st.sampled_from([5.0, 30.0, 120.0]), size=st.integers(1, 400))
def test_a_path_is_the_spline_of_what_is_known_however_it_is_taken_apart(seed, rate, size, monkeypatch):
    random = np.random.default_rng(seed)
    seconds = np.cumsum(random.uniform(0.5, 1.5, 90)) / rate
    points = np.cumsum(random.normal(0.0, 0.02, (90, 3, 3)), axis=0).astype(np.float32)
    points[random.random((90, 3)) < 0.2] = np.nan
    points[40 : 40 + round(0.5 * rate), 0] = np.nan  # longer than is bridged
    path = JointPath.of(seconds, points)
    times = random.uniform(seconds[0] - 0.1, seconds[-1] + 0.1, 300)
    found = path.positions(times)
    longest = max(0.1, 2.5 * np.median(np.diff(seconds)))
    for joint in range(3):
        known = np.flatnonzero(np.isfinite(points[:, joint, 0]))
        of = seconds[known]
        after = np.clip(np.searchsorted(of, times), 1, len(of) - 1)
        inside = (times >= of[0]) & (times <= of[-1]) & (of[after] - of[after - 1] <= longest)
        expected = np.where(inside[:, None], CubicSpline(of, points[known, joint])(times), np.nan)
        np.testing.assert_allclose(found[:, joint], expected, atol=1e-5)
    monkeypatch.setattr(truth_timing, "parts", lambda count: large_arrays.parts(count, size))
    np.testing.assert_array_equal(path.positions(times), found)


@given(seed=st.integers(0, 999), size=st.integers(1, 400))
def test_strays_are_the_same_however_the_frames_are_taken_apart(seed, size, tmp_path, monkeypatch):
    random = np.random.default_rng(seed)
    points = random.normal(0.0, 500.0, (60, 5, 3))
    points[random.random((60, 5)) < 0.05] *= 100.0
    path = write_c3d(tmp_path / "s.c3d", list("ABCDE"), np.arange(60) / 30, points)
    whole = read_truth(path)
    monkeypatch.setattr(truth_files, "parts", lambda count: large_arrays.parts(count, size))
    assert read_truth(path).warning == whole.warning
    np.testing.assert_array_equal(read_truth(path).points, whole.points)


@pytest.mark.parametrize(
    ("writer", "name"),
    [
        (write_c3d, "t.c3d"), (write_trc, "t.trc"), (write_motive, "t.csv"), (write_nexus, "t.csv"),
        (write_qualisys, "t.tsv"),
    ],
)  # fmt: skip
def test_reading_takes_twice_the_memory_of_the_points(writer, name, tmp_path):
    def peak(count):
        points = np.random.default_rng(1).normal(0.0, 500.0, (count, 20, 3))
        path = writer(tmp_path / name, [f"P{k}" for k in range(20)], np.arange(count) / 120.0, points)
        tracemalloc.start()
        try:
            return read_truth(path).points.nbytes, tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    peak(20)  # with what is imported
    (few, less), (many, more) = peak(4500), peak(9000)
    assert more - less < 2.0 * (many - few)


@given(at=st.integers(0, 2559), value=st.integers(0, 255), end=st.integers(0, 2560))
def test_a_damaged_c3d_is_read_or_refused(tmp_path, at, value, end):
    path = write_c3d(tmp_path / "m.c3d", ["A", "B"], np.arange(20) / 30, np.ones((20, 2, 3)))
    damaged = bytearray(path.read_bytes())
    damaged[at] = value
    path.write_bytes(damaged[: max(end, at)])
    with suppress(RecordingError):
        read = read_truth(path)
        assert read.points.shape == (len(read.seconds), len(read.labels), 3)


# --- Comparison with motion capture whose offset, frame and errors are known.


SECONDS = 22.0


@pytest.fixture(scope="module")
def walk(tmp_path_factory):
    return captured(tmp_path_factory.mktemp("walk") / "s.rrd", AZURE_KINECT, "walk", SECONDS, seed=11)


@pytest.fixture(scope="module")
def half(walk):
    """The same, but the session is of 12 s: the search takes a third of the time."""
    return replace(walk, session=replace(walk.session, rows=walk.session.rows[:360]))


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
        lambda *_: TimeOffset(Clock(-3.7e9, 1e9 * sd), correlation=0.9, lag_seconds=lag),
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


def test_gaps_of_half_a_second_stay_gaps(half):
    times, points = half.truth(3.7, 8.0)
    points[200:250, 5] = np.nan
    found = TruthComparison.of(half.session, TruthFile("t", AZURE_KINECT.joints, times, points))
    inside = np.abs(found.time_ns * 1e-9 - 3.7 - 2.25) < 0.24
    assert np.isnan(found.distance["fused"][inside, 5]).all()
    assert np.isfinite(found.distance["fused"][~inside, 5]).mean() > 0.99
    assert np.isfinite(found.distance["fused"][inside, 6]).all()


def test_markers_of_a_subject_need_no_table(half):
    times, points = half.truth(3.7, 8.0)
    markers = {"Ann:LASI": 18, "Ann:RASI": 22, "Ann:LPSI": 18, "Ann:RPSI": 22, "Ann:C7": 3, "Ann:CLAV": 3}
    for side, (hip, shoulder) in {"L": (18, 5), "R": (22, 12)}.items():
        parts = {"KNE": hip + 1, "ANK": hip + 2, "TOE": hip + 3}
        arms = {"SHO": shoulder, "ELB": shoulder + 1, "WRA": shoulder + 2, "WRB": shoulder + 2}
        markers |= {f"Ann:{side}{part}": joint for part, joint in (parts | arms).items()}
    points = points[:, list(markers.values())]
    found = TruthComparison.of(half.session, TruthFile("t", tuple(markers), times, points))
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
        AZURE_KINECT, "t", "bodies", np.arange(len(AZURE_KINECT)), "metres", TimeOffset(Clock()),
        RigidTransform.identity(), 0.0, rows.frame, rows.time_ns, every,
        every | {"fused": rows.fused - moved}, np.array([0.0, -1.0, 0.0]),
    )  # fmt: skip
    np.testing.assert_allclose(found.constant["fused"], put_in, atol=1e-6)
    np.testing.assert_allclose(found.rest["fused"], 0.0, atol=1e-6)
    np.testing.assert_allclose(
        found.distance["fused"].mean(axis=0), np.linalg.norm(put_in, axis=1), atol=1e-6
    )
    np.testing.assert_array_equal(found.distance["a"], 0.0)


def test_what_cannot_be_compared_says_why(half, tmp_path, monkeypatch):
    walk, good = half, truth_of(half, offset_s=3.7, seconds=8.0)

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
    # of whole nanoseconds, at less than 8 m/s, and of float32 some metres away
    np.testing.assert_allclose(given.distance["fused"], found.distance["fused"], atol=1e-6)


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
def test_a_mirror_image_is_called_so_and_nothing_else(half, change, words):
    truth = truth_of(half, offset_s=3.7, seconds=8.0)
    with pytest.raises(RecordingError, match=words) as raised:
        TruthComparison.of(half.session, replace(truth, points=change(truth.points)))
    if words is None:
        assert "mirror" not in str(raised.value)
        assert "exchanged" not in str(raised.value)


@pytest.mark.parametrize("motion", ["squat", "turn"])
def test_another_movement_is_refused(half, motion):
    times = np.arange(800) / 100.0
    file = TruthFile("t", AZURE_KINECT.joints, times, true_positions(AZURE_KINECT, motion)(times + 4.0))
    with pytest.raises(RecordingError, match="no offset in time makes the movements match"):
        TruthComparison.of(half.session, file)


# --- Agreement of two methods: against scipy and an analysis of variance, and how often intervals cover.


SEEDS = st.integers(0, 2**32 - 1)
COUNTS = st.integers(6, 40)


def samples(seed, n, bias=1.0, noise=2.0, spread=8.0):
    random = np.random.default_rng(seed)
    true = spread * random.normal(size=n)
    return true + bias + noise * random.normal(size=n), true


def icc_by_variances(found, true):
    """ICC(A,1) by the mean squares of rows, columns and the rest (McGraw and Wong 1996)."""
    values = np.stack([found, true], axis=1)
    n, k = values.shape
    rows, columns = values.mean(axis=1), values.mean(axis=0)
    of_rows, of_columns = k * rows.var(ddof=1), n * columns.var(ddof=1)
    rest = values - rows[:, None] - columns + values.mean()
    error = np.sum(rest**2) / ((n - 1) * (k - 1))
    return (of_rows - error) / (of_rows + (k - 1) * error + k / n * (of_columns - error))


@given(seed=SEEDS, n=COUNTS)
def test_figures_are_those_of_the_sources(seed, n):
    found, true = samples(seed, n)
    of = agreement(found, true)
    off = found - true
    assert (of.n, of.bias) == (n, pytest.approx(off.mean()))
    assert of.limits == pytest.approx([off.mean() + side * 1.96 * off.std(ddof=1) for side in (-1, 1)])
    assert of.rmse == pytest.approx(math.sqrt(np.mean(off**2)))
    assert of.icc == pytest.approx(icc_by_variances(found, true))
    paired = ttest_rel(found, true).confidence_interval(0.95)
    assert of.bias_interval == pytest.approx((paired.low, paired.high))


@given(seed=SEEDS, n=COUNTS, factor=st.floats(0.1, 100.0), offset=st.floats(-100.0, 100.0))
def test_units_and_origin_do_not_matter(seed, n, factor, offset):
    found, true = samples(seed, n)
    one, other = agreement(found, true), agreement(factor * found + offset, factor * true + offset)
    for name in ("bias", "bias_interval", "limits", "rmse", "rmse_interval"):
        np.testing.assert_allclose(getattr(other, name), factor * np.array(getattr(one, name)), rtol=1e-6)
    np.testing.assert_allclose(other.icc_interval, one.icc_interval, rtol=1e-6)


@given(seed=SEEDS, n=COUNTS, repeats=st.integers(2, 5))
def test_values_of_a_block_count_once(seed, n, repeats):
    """Frames that repeat each other tell no more; as values of their own they seem to."""
    found, true = samples(seed, n)
    blocks = np.repeat(np.arange(n), repeats)
    one, many = agreement(found, true), agreement(found[blocks], true[blocks], blocks)
    np.testing.assert_allclose(many.bias_interval, one.bias_interval, rtol=1e-9)
    np.testing.assert_allclose(many.rmse_interval, one.rmse_interval, rtol=1e-9)
    alone = agreement(found[blocks], true[blocks])
    assert np.ptp(alone.rmse_interval) < np.ptp(many.rmse_interval)


def test_intervals_cover_the_true_figures():
    """Of 20 values; the jackknife covers a few per cent less than 95. One deviation of a share is 1.2 %."""
    bias, noise, spread = 1.0, 2.0, 8.0
    of_rows = 2.0 * (spread**2 + 0.25 * noise**2)
    error = 0.5 * noise**2
    true = {
        "bias_interval": bias,
        "rmse_interval": math.hypot(bias, noise),
        "icc_interval": (of_rows - error) / (of_rows + error + bias**2),
    }
    hits = dict.fromkeys(true, 0)
    for seed in range(400):
        of = agreement(*samples(seed, 20, bias, noise, spread))
        for name, value in true.items():
            low, high = getattr(of, name)
            hits[name] += low <= value <= high
    assert all(0.89 * 400 < count < 0.985 * 400 for count in hits.values()), hits


def test_few_values_have_no_interval():
    of = agreement(*samples(0, 4))
    assert np.isnan([of.bias_interval, of.rmse_interval, of.icc_interval, *of.limits_intervals]).all()
    assert np.isfinite([of.bias, of.rmse, of.icc, *of.limits]).all()


@pytest.fixture(scope="module")
def gait():
    times, positions = walker(12.0, 30.0)
    found = find_gait(AZURE_KINECT, times, positions, (0.0, -1.0, 0.0))
    assert len(found.steps) > 8
    return found


def test_steps_that_are_off_by_a_constant_have_it_as_bias(gait):
    off = Gait(
        tuple(
            step._replace(strike=step.strike + 0.03, toe_off=step.toe_off - 0.02, length=step.length + 0.05)
            for step in gait.steps
        )
    )
    found = step_agreement(off, gait)
    assert (found.missed, found.extra) == (0, 0)
    bias = {name: of.bias for name, (_, of) in found.of_each.items()}
    assert bias["heel strike"] == pytest.approx(0.03)
    assert bias["toe-off"] == pytest.approx(-0.02)
    assert bias["step length"] == pytest.approx(0.05)
    for name in ("step time", "step width", "speed", "cadence"):
        assert bias[name] == pytest.approx(0.0, abs=1e-12)
    cycles = [b.strike - a.strike for s in SIDES for a, b in pairwise(gait.of_side(s)) if a.walk == b.walk]
    assert bias["stance"] == pytest.approx(-5.0 * np.mean(1.0 / np.array(cycles)))
    assert math.isnan(found.of_each["heel strike"][1].icc)  # it grows with time, whatever a method finds
    assert {unit for unit, _ in found.of_each.values()} == {"s", "m", "%", "1/min", "m/s"}


def test_steps_of_one_of_both_are_counted(gait):
    fewer = replace(gait, steps=(*gait.steps[:4], *gait.steps[5:]))
    assert (step_agreement(fewer, gait).missed, step_agreement(fewer, gait).extra) == (1, 0)
    assert (step_agreement(gait, fewer).missed, step_agreement(gait, fewer).extra) == (0, 1)


def test_other_steps_do_not_agree(gait):
    apart = Gait(tuple(step._replace(strike=step.strike + 100.0) for step in gait.steps))
    assert step_agreement(apart, gait) is None
    assert step_agreement(Gait(()), gait) is step_agreement(gait, Gait(())) is None


# --- ``duplex compare`` on fusions with known differences.


@pytest.fixture
def session(fused_run):
    return fused_run(frame_pairs(KINECT_V1, 40), calibration_of(KINECT_V1))


def with_fused(session, fused):
    return replace(session, rows=replace(session.rows, fused=fused))


def test_a_limb_exchanged_with_its_mirror_image_is_swapped(session):
    left, right = KINECT_V1.joint("WristLeft"), KINECT_V1.joint("WristRight")
    fused = session.rows.fused.copy()
    fused[7:10, [left, right]] = fused[7:10, [right, left]]
    comparison = Comparison.of(session, with_fused(session, fused))
    expected = np.zeros(comparison.swapped.shape, dtype=bool)
    expected[7:10, [left, right]] = True
    np.testing.assert_array_equal(comparison.swapped, expected)


def test_differences_and_bone_deviations_are_those_put_in(session):
    hand = KINECT_V1.joint("HandLeft")
    fused = session.rows.fused.copy()
    along = fused[12, hand] - fused[12, KINECT_V1.parents[hand]]
    fused[12, hand] += 0.03 * along / np.linalg.norm(along)
    comparison = Comparison.of(session, with_fused(session, fused))
    apart = np.zeros(comparison.apart.shape)
    apart[12, hand] = 0.03
    np.testing.assert_allclose(comparison.apart, apart, atol=1e-12)
    # both ends of a bone are kept in float32: within 2⁻²³ m each, on each axis, at 4 m
    rounding = 2 * np.sqrt(3) * 2.0**-23
    assert np.nanmax(comparison.bone_deviation[0]) < rounding
    expected = np.zeros(len(KINECT_V1))
    expected[hand] = 0.03
    of_bones = KINECT_V1.bone_joints
    np.testing.assert_allclose(comparison.bone_deviation[1][of_bones], expected[of_bones], atol=rounding)
    assert comparison.worst(5) == [(12, hand)]
    assert comparison.worst(0) == []


def test_only_fusions_of_the_same_skeletons_are_compared(fused_run, tmp_path):
    calibration = calibration_of(KINECT_V1)
    one = fused_run(frame_pairs(KINECT_V1, 40), calibration)
    chance = fused_run(frame_pairs(KINECT_V1, 40, noise=0.03), calibration)  # the same times
    with pytest.raises(RecordingError, match="40 frames of the same time, but S_A or S_B of frame 0"):
        Comparison.of(one, chance)
    for name in ("clock_b", "positions_a", "positions_b", "states_a", "states_b"):
        other = getattr(one.rows, name).copy()
        other[23] += 1
        for pair in ((one, changed := replace(one, rows=replace(one.rows, **{name: other}))), (changed, one)):
            with pytest.raises(RecordingError, match="frame 23 differs from frame 23: not the same capture"):
                Comparison.of(*pair)
    again = fused_run(frame_pairs(KINECT_V1, 40), calibration, FuserSettings("paper", h=0.9))
    write_session(again.part(range(10, 30)), tmp_path / "part.rrd")
    part = Comparison.of(one, Session.open(tmp_path / "part.rrd"))
    assert part.first.frame.tolist() == list(range(10, 30))
    assert part.second.frame.tolist() == list(range(20))


# --- Figures without ground truth, on motions with known figures.


FRAME_NS = 33_333_333
FRAMES = 200
BODY = KINECT_V2


def walking(metres_per_second, *, backwards=False):
    """(T, J, 3) a stiff person who is carried in the direction faced, or against it."""
    still = standing(BODY)
    left = (still[BODY.joint("HipLeft")] - still[BODY.joint("HipRight")])[[0, 2]]
    left /= np.linalg.norm(left)
    way = np.array([left[1], 0.0, -left[0]]) * (-1.0 if backwards else 1.0)
    travelled = metres_per_second * FRAME_NS * 1e-9 * np.arange(FRAMES)
    return still + travelled[:, None, None] * way


def pair(a, fused=None, b_in_a=None):
    b = A_FROM_B.inverse().apply(a if b_in_a is None else b_in_a)
    times = np.arange(len(a), dtype=np.int64) * FRAME_NS
    return FusedPair(BODY, times, a, b, a if fused is None else fused, (A_FROM_B,) * len(a))


@pytest.mark.parametrize("body", BODIES.values(), ids=list(BODIES))
def test_a_person_faces_the_sensor_in_a_rest_pose(body):
    at = np.zeros((1, len(body), 3))
    for joint in body.order[1:]:
        at[0, joint] = at[0, body.parents[joint]] + body.nominal_lengths[joint] * body.rest[joint]
    np.testing.assert_allclose(facing(body, at), [[0.0, -1.0]], atol=1e-12)


@pytest.mark.parametrize(("backwards", "against"), [(False, 0.0), (True, 1.0)])
def test_walking_backwards_fast_is_against_the_motion(backwards, against):
    found = figures_without_truth(pair(walking(1.2, backwards=backwards)))
    assert (found.against_a, found.against_b, found.against_fused) == (against,) * 3
    assert found.flips_per_minute == 0.0
    assert found.apart < 1e-9
    assert found.rotation_off < 1e-6


@pytest.mark.parametrize(("in_b", "together"), [(False, 0.25), (True, 0.0)])
def test_hands_in_one_place_that_a_view_has_apart_are_counted(in_b, together):
    walk = walking(1.2)
    joined, wrists = walk.copy(), [BODY.joint("WristLeft"), BODY.joint("WristRight")]
    joined[: FRAMES // 4, wrists] = joined[: FRAMES // 4, wrists].mean(axis=1, keepdims=True)
    found = figures_without_truth(pair(joined if in_b else walk, joined))  # then no view has them apart
    assert found.hands_together == together


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("rate", [5, 10, 15, 60, 90])
def test_figures_are_of_seconds_and_not_of_frames(rate):
    """The walk of 30 frames per second is seen at another rate; its last three pairs have one time."""

    def seen(a, fused):
        recording = pair(a, fused)
        times = (np.arange(len(a)) * 1e9 / rate).astype(np.int64)
        times[-2:] = times[-3]
        return figures_without_truth(replace(recording, time_ns=times))

    count = 8 * rate
    still, way = standing(BODY), 25.0 * (walking(1.2)[1] - walking(1.2)[0])
    seconds = (np.arange(count) / rate)[:, None, None]
    walk = still + 1.2 * seconds * way
    turned = walk.copy()
    turned[3 * rate : 4 * rate] = turned[3 * rate : 4 * rate][:, BODY.mirror]
    found = seen(walk, turned)
    assert found.jumps_a == found.against_a == 0.0
    # of eight seconds without 0.4 s at each end; at five frames per second a frame is 3 %
    assert found.against_fused == pytest.approx(1.0 / 7.2, abs=0.03)
    assert found.flips_per_minute == pytest.approx(2 * 60.0 / ((count - 3) / rate), rel=0.01)
    stays = np.repeat(still[None], count, axis=0)
    assert seen(stays, still + 4.0 * seconds * way).jumps_own == 0.0
    assert seen(stays, still + 5.0 * seconds * way).jumps_own == pytest.approx(1.0, abs=0.06)


def test_slow_walking_backwards_is_not_judged():
    assert np.isnan(figures_without_truth(pair(walking(0.5, backwards=True))).against_fused)


def test_roughness_is_the_mean_second_difference():
    still = np.repeat(standing(BODY)[None], FRAMES, axis=0)
    shaken = still.copy()
    shaken[::2, :, 0] += 0.01  # second differences of 20 mm, always
    found = figures_without_truth(pair(still, fused=shaken))
    assert found.rough_fused == pytest.approx(0.02)
    assert found.rough_a == found.rough_b == pytest.approx(0.0, abs=1e-12)
    found = figures_without_truth(pair(still, shaken, b_in_a=shaken))
    assert found.rough_mean == pytest.approx(0.01, rel=0.01)
    assert found.roughness_ratio == pytest.approx(2.0, rel=0.01)


def test_only_a_jump_that_neither_view_made_counts_for_the_fused_skeleton():
    still = np.repeat(standing(BODY)[None], FRAMES, axis=0)
    hand, foot = BODY.joint("HandLeft"), BODY.joint("FootRight")
    fused, a = still.copy(), still.copy()
    fused[50:60, hand] += [0.2, 0.0, 0.0]  # two steps of S* alone
    fused[100:, foot] += [0.0, 0.2, 0.0]  # one step that view A makes, too
    a[100:, foot] += [0.0, 0.2, 0.0]
    found = figures_without_truth(pair(a, fused, b_in_a=still))
    steps = (FRAMES - 1) * len(BODY)
    assert found.jumps_fused == pytest.approx(3 / steps)
    assert found.jumps_own == pytest.approx(2 / steps)
    assert found.jumps_a == pytest.approx(1 / steps)
    assert found.jumps_b == 0.0


def test_a_mirrored_spell_is_two_flips():
    still = np.repeat(standing(BODY)[None], FRAMES, axis=0)
    fused = still.copy()
    fused[80:120] = fused[80:120][:, BODY.mirror]
    minutes = (FRAMES - 1) * FRAME_NS * 1e-9 / 60.0
    assert figures_without_truth(pair(still, fused)).flips_per_minute == pytest.approx(2 / minutes)


def test_an_unseen_joint_gives_no_figure():
    a = walking(1.2)
    a[20:40] = np.nan
    a[:, BODY.joint("ThumbLeft")] = np.nan
    found = figures_without_truth(pair(a, fused=walking(1.2)))
    assert found.rough_fused < 1e-9
    assert found.jumps_own == 0.0


def test_too_short_a_recording_is_an_error():
    with pytest.raises(FusionError, match="30 pairs or more to be judged; got 29"):
        figures_without_truth(pair(walking(1.0)[:29]))


def test_a_registration_is_judged_where_the_person_is():
    a = walking(1.2)
    b = A_FROM_B.inverse().apply(a)
    turned = RigidTransform.of(np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]), np.zeros(3))
    off = judge_registration(RigidTransform.of(np.eye(3), [0.03, 0.0, 0.04]) @ A_FROM_B, a, b)
    assert off.rotation_off < 1e-6
    assert off.position_off == pytest.approx(0.05)
    assert off.apart == pytest.approx(0.05)
    assert judge_registration(turned @ A_FROM_B, a, b).rotation_off == pytest.approx(np.pi / 2)


@pytest.mark.parametrize(
    ("old", "new"),
    [("\n100\n", "\n0\n"), (",,Force", ',,"Force'), ("\n40,0", "\n\n40,0")],
    ids=["rate", "quote", "no frames"],
)
def test_a_text_of_another_program_that_cannot_be_read_is_refused_in_one_line(tmp_path, old, new):
    times, points = 0.01 * np.arange(30), np.arange(180.0).reshape(30, 2, 3)
    path = write_nexus(tmp_path / "n.csv", ["A", "B"], times, points)
    text = path.read_text("utf-8")
    assert old in text
    path.write_text(text.replace(old, new, 1) + "x," * 80_000, "utf-8")
    with pytest.raises(RecordingError, match="is not complete, or not as its program writes it"):
        read_truth(path)


def test_what_another_programs_text_lacks_is_unknown_however_it_was_saved(tmp_path):
    """Empty cells in the first frame of a Qualisys text with times; commas that a spreadsheet adds."""
    times, points = 0.01 * np.arange(4), np.arange(24.0).reshape(4, 2, 3)
    lines = write_qualisys(tmp_path / "q.tsv", ["A", "B"], times, points).read_text("utf-8").splitlines()
    head, rows = (
        lines[:5],
        [f"{k + 1}\t{t}\t{row}" for k, (t, row) in enumerate(zip(times, lines[5:], strict=True))],
    )
    rows[0] = "1\t0.0\t\t\t\t" + lines[5].split("\t", 3)[3]
    (tmp_path / "q.tsv").write_text("\n".join([*head, *rows]), "utf-8")
    read = read_truth(tmp_path / "q.tsv").points
    assert np.isnan(read[0, 0]).all()
    expected = read[1, 1] / points[1, 1]  # metres, whatever the unit
    np.testing.assert_allclose(read[1:], points[1:] * expected, atol=1e-9)
    path = write_nexus(tmp_path / "n.csv", ["A", "B"], times, points)
    whole = read_truth(path).points
    text = path.read_text("utf-8")
    path.write_text("Trajectories" + "," * 120 + text.split("Trajectories", 1)[1], "utf-8")
    np.testing.assert_array_equal(read_truth(path).points, whole)
