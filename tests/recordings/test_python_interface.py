"""The Python interface: what a researcher writes from the documents alone, and laws of what it gives."""

import copy
import pickle
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from datetime import timedelta
from functools import cache
from multiprocessing import get_context

import numpy as np
import pandas
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from devices import DeviceError
from devices.simulated.kinect import simulated_pair
from fusion import BODIES, KINECT_V2, DuplexError
from fusion.movement.humanoid import human_bones
from fusion.movement.joint_rotations import rotations_of
from recordings import RecordingError, Session, UnknownNameError, fuse, fuse_arrays
from recordings.quality.figures import report
from recordings.replaying import Replay
from recordings.testing import SessionsDifferError, assert_session, assert_sessions_match, simulated_session
from tests.helpers.recorded_pairs import write_recordings

seconds = st.floats(0.0, 1.0)  # shares of a session
REFUSED = {
    "depth": lambda s: s.depth("A"),
    "angles": lambda s: s.angles["knee"],
    "rotations": lambda s: s.rotations["knie"],
    "gait": lambda s: s.gait.of_side("Left"),
    "curves": lambda s: s.gait.curves("knee"),
    "export": lambda s: s.export("s.fbx"),
    "table": lambda s: s.to_arrow("broad"),
    "names": lambda s: s.export("s.bvh", names="vicon"),
    "body": lambda s: fuse_arrays("kinect_v3", s.time, s.b_in_a, s.b_in_a),
    "truth": lambda s: s.compare_with("s.xlsx"),
    "tolerance": lambda s: assert_sessions_match(s, s, joints_mm={"rwist": 1.0}),
    "joint": lambda s: s.body.joint("rwist"),
    "verdict": lambda s: assert_session(s, verdict="poor"),
    "another session": lambda s: s.compare_with(s.part(s.time < 1.0), offset=1.0),
}
NAMES = {
    "depth": "a, b", "angles": "knee_flexion_left", "rotations": "KneeLeft", "gait": "left, right",
    "curves": "knee_flexion_left", "export": ".trc", "table": "long, wide", "names": "humanoid, mixamo",
    "body": "kinect_v2", "truth": ".c3d, .trc, .csv", "tolerance": "WristRight",
    "joint": "WristRight", "verdict": "good, usable", "another session": "`offset` is for motion capture",
}  # fmt: skip


@cache
def walk_of(name):
    """Three seconds of a walk."""
    return simulated_session("walk", 3.0, body=name)


@cache
def walk():
    """A walk with its truth, by two Kinects v2."""
    return simulated_session("walk", 8.0, body="kinect_v2")


@pytest.fixture
def session():
    """The same; a law that fails would print a fixture."""
    return walk()


def arrays_in(value, path="session", seen=None):
    """Every array that a session leads to, by its path: data, what is computed from it, and its body."""
    seen = {} if seen is None else seen
    if isinstance(value, np.ndarray):
        yield path, value
    elif id(value) not in seen:
        seen[id(value)] = value  # kept, so that no other value gets its id
        if isinstance(value, tuple):
            for k, item in enumerate(value):
                yield from arrays_in(item, f"{path}[{k}]", seen)
        elif type(value).__module__.partition(".")[0] in ("fusion", "devices", "recordings"):
            named = {*dir(type(value)), *vars(value)} if hasattr(value, "__dict__") else ()
            for name in sorted(named):
                public = not name.startswith("_") and not callable(getattr(type(value), name, None))
                if public and (found := getattr(value, name)) is getattr(value, name):  # not made anew
                    yield from arrays_in(found, f"{path}.{name}", seen)


# What a researcher writes


def test_the_knee_over_the_gait_cycle(session):
    for side in ("left", "right"):
        curves = session.gait.curves(f"knee_flexion_{side}")
        assert curves.shape == (len(session.gait.cycles(side)), 101)
        assert len(curves) >= 2
        knee, ends = session.angles[f"knee_flexion_{side}"], session.gait.cycles(side)
        np.testing.assert_allclose(curves[:, [0, -1]], np.interp(ends, session.time, knee))


def _fused(folder):
    return fuse(folder / "a.csv", folder / "b.csv")


def test_recordings_are_fused_in_processes(tmp_path):
    folders = [tmp_path / name for name in ("one", "two")]
    for folder in folders:
        folder.mkdir()
        write_recordings(folder)
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        sessions = list(pool.map(_fused, folders))
    here = _fused(folders[0])
    assert sessions[0].body is here.body
    assert_sessions_match(sessions[0], here, position_mm=0.0)
    assert sessions[1].verdict.word == here.verdict.word
    sessions[1].save(tmp_path / "s.rrd")


def test_an_export_is_compared_with_the_session(session, tmp_path):
    said = session.export(tmp_path / "x.trc", rate=30)
    assert said.endswith("frames at a constant 30 Hz")
    found = session.compare_with(tmp_path / "x.trc")
    assert found.offset.seconds == pytest.approx(0.0, abs=0.02)
    assert np.nanmedian(found.distance["fused"]) < 2e-3, "metres; the offset is found from the views"
    assert session.compare_with(tmp_path / "x.trc", offset=0.0).offset.seconds == 0.0
    before = (tmp_path / "x.trc").read_bytes()
    with pytest.raises(RecordingError, match="`table` is for"):
        session.export(tmp_path / "x.trc", table="wide")
    assert (tmp_path / "x.trc").read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == ["x.trc"]


def test_a_session_is_compared_with_another_as_on_the_command_line(session):
    fused = session.fused.copy()
    fused[30:40, session.body.joint("wrist left"), 0] += 0.004
    moved = replace(session, rows=replace(session.rows, fused=fused))
    found = session.compare_with(moved.part(session.time >= 1.0))
    assert len(found) == (session.time >= 1.0).sum()
    np.testing.assert_allclose(np.nanmax(found.apart), 0.004)
    ((t, joint),) = found.worst(1)
    assert (found.first.frame[t], session.body.joints[joint]) == (30, "WristLeft")


def test_the_speed_of_the_wrist_where_it_was_measured(session):
    wrist = session.body.joint("wrist right")
    at = np.where(session.quality.predicted[:, [wrist]], np.nan, session.fused[:, wrist])
    speed = np.linalg.norm(np.gradient(at, session.time, axis=0), axis=1)
    assert 0.5 < np.nanmax(speed) < 10.0
    off = [
        np.nanmedian(np.linalg.norm(view - session.fused, axis=2))
        for view in (session.skeleton_a.positions, session.b_in_a)
    ]
    assert max(off) < 0.1
    by_hand = session.rotation @ session.skeleton_b.positions.swapaxes(1, 2).astype(float)
    np.testing.assert_allclose(session.b_in_a, by_hand.swapaxes(1, 2) + session.translation[:, None])
    late = session.at(session.time[-1] - 1.0)[0, wrist]
    near = np.abs(session.time - (session.time[-1] - 1.0)).argmin()
    assert np.linalg.norm(late - session.fused[near, wrist]) < 0.2
    assert (session.sigma[:, wrist] > 0.0).all()


def test_arrays_become_a_session():
    a, b, truth = simulated_pair(motion="walk", seconds=4.0, body=KINECT_V2)
    points = [np.array([frame.people["1"].positions for frame in sensor.frames()]) for sensor in (a, b)]
    time = np.arange(len(points[0])) / 30.0
    made = fuse_arrays("kinect_v2", 12.0 + time, *points)
    np.testing.assert_allclose(made.time, time, atol=1e-9)
    np.testing.assert_array_equal(made.skeleton_a.positions, points[0].astype(np.float32))
    off = np.linalg.norm(made.fused - truth.positions_at(made.time_ns), axis=2)
    assert np.nanmedian(off) < 0.08, "metres; the simulated tracker's errors are of centimetres"
    for wrong, said in (
        ((KINECT_V2, time[::-1], *points), "seconds that increase"),
        ((KINECT_V2, time[1:], *points), r"`positions_a` has the shape .* need"),
        ((KINECT_V2, time, points[0], 1e3 * points[1]), "`positions_b`: most joints are where no sensor"),
        ((KINECT_V2, time[:0], points[0][:0], points[1][:0]), "at least one frame"),
    ):
        with pytest.raises(RecordingError, match=said):
            fuse_arrays(*wrong)


def test_people_are_those_whose_bones_s_star_has(session, tmp_path):
    """Somebody of 0.7 times the size is there from the middle on, after a pause of two seconds.

    Sizes are looked at every 0.1 s: three frames.
    """
    views, half = [session.skeleton_a.positions, session.skeleton_b.positions], len(session) // 2
    of_two = []
    for at in views:
        root = at[half:, session.body.root, None]
        nobody = np.full_like(at[half - 60 : half], np.nan)
        of_two.append(np.concatenate((at[: half - 60], nobody, root + 0.7 * (at[half:] - root))))
    made = fuse_arrays(session.body, session.time, *of_two)
    made.save(tmp_path / "s.rrd")
    again = Replay.of(Session.open(tmp_path / "s.rrd")).fused()
    for each in (made, again, again.part(slice(half // 2, None))):
        one, other = each.people
        assert (one.person, one.first, one.end, other.person, other.end) == (0, 0, other.first, 1, len(each))
        assert abs(other.first - (half - len(made) + len(each))) <= 3
        assert other.height / one.height == pytest.approx(0.7, abs=0.02)
        np.testing.assert_array_equal(each.bone_lengths[-1], other.bone_lengths)
    (alone,) = made.part(slice(-5, None)).people
    np.testing.assert_array_equal(alone.bone_lengths, other.bone_lengths)
    (one,) = session.people
    assert one.seconds == (0.0, session.time[-1])


# Laws


@given(when=st.lists(seconds, max_size=5))
def test_s_star_at_any_time_within_is_there_and_at_a_frame_is_that_of_the_frame(when):
    session = walk()
    times = np.array(when) * session.time[-1]
    found = session.at(times)
    assert found.shape == (len(times), len(session.body), 3)
    assert np.isfinite(found).all()
    assert np.isfinite(session.sigma_at(times)).all()
    exact = np.rint(1e9 * times).astype("timedelta64[ns]")
    np.testing.assert_array_equal(session.at(exact), found)
    whole = [timedelta(microseconds=round(1e6 * each)) for each in times.tolist()]
    np.testing.assert_array_equal(session.at(whole), session.at(np.array(whole, dtype="timedelta64[us]")))
    frames = np.searchsorted(session.time, times)
    np.testing.assert_array_equal(session.at(session.time[frames]), session.fused[frames])
    for one, of_list in zip(times, found, strict=True):
        np.testing.assert_array_equal(session.at(one), of_list[None])


@given(rate=st.floats(1.0, 1000.0), ending=st.sampled_from([".trc", ".bvh"]))
def test_an_exported_rate_is_that_of_the_file(rate, ending, tmp_path):
    session = walk()
    short = replace(session, rows=session.rows[:10])
    path = tmp_path / f"s{ending}"
    said = short.export(path, rate=rate)
    expected = int(short.time[-1] * rate + 0.01) + 1
    assert said.startswith(f"{expected} frames at a constant {rate:.6g} Hz")
    lines = path.read_text(encoding="utf-8").splitlines()
    if ending == ".trc":
        stamps = np.array([float(line.split("\t")[1]) for line in lines[6:]])
        np.testing.assert_allclose(stamps, np.arange(expected) / rate, atol=1e-6)
        assert lines[2].split("\t")[0] == f"{rate:.6g}"
    else:
        assert f"Frames: {expected}" in lines
        assert len(lines) - lines.index("MOTION") == 3 + expected


@given(
    name=st.sampled_from(sorted(BODIES)),
    frames=st.integers(1, 6),
    lost=st.sets(st.integers(0, 5), max_size=3),
)
def test_arrays_survive_a_file_and_a_process(name, frames, lost, tmp_path):
    whole = walk_of(name)
    rows = whole.rows[60 : 60 + frames]
    at = [rows.positions_a.copy(), rows.positions_b.copy()]
    for k in lost & set(range(frames)):
        at[k % 2][k] = np.nan
    time = whole.time[60 : 60 + frames]
    made = fuse_arrays(name, time, *at, calibration=whole.calibration)
    made.save(tmp_path / "s.rrd")
    opened, moved = Session.open(tmp_path / "s.rrd"), pickle.loads(pickle.dumps(made))
    for other in (opened, moved, copy.deepcopy(made)):
        assert_sessions_match(made, other, position_mm=0.0)
        assert other.body is made.body
        assert len(other) == frames
        np.testing.assert_array_equal(other.time, made.time)
    np.testing.assert_array_equal(np.isnan(opened.skeleton_a.positions[..., 0]).all(axis=1),
                                  [k in lost and k % 2 == 0 for k in range(frames)])  # fmt: skip


def test_every_array_is_read_only_and_computed_once(session, tmp_path):
    session.save(tmp_path / "s.rrd")
    for each in (session, Session.open(tmp_path / "s.rrd"), pickle.loads(pickle.dumps(session))):
        found = dict(arrays_in(each))
        assert len(found) > 70
        assert {"session.body.mirror", "session.calibration.bone_lengths", "session.fused"} <= {*found}
        assert [path for path, values in found.items() if values.flags.writeable] == []
        with pytest.raises(ValueError, match="read-only"):
            each.fused[0] = 0.0
        with pytest.raises(TypeError, match="item assignment"):
            each.about["session"]["tracker"] = ["another"]
        with pytest.raises(TypeError, match="read-only"):
            each.angles.update(trunk_lean=each.time)
        turned = each.rotations.body.apply(each.fused[:, 0].copy())  # scipy 1.17 takes no other, 1.18 does
        assert turned.shape == (len(each), 3)
        for name in ("angles", "gait", "rotations", "quality", "verdict", "quality_per_second", "b_in_a"):
            assert getattr(each, name) is getattr(each, name)


def test_rotations_are_those_of_other_programs(session):
    expected = rotations_of(session.body, session.fused, session.time_ns)
    for joint, name in enumerate(session.body.joints):
        assert isinstance(session.rotations[name], Rotation)
        np.testing.assert_allclose(session.rotations[name].as_quat(), expected[:, joint], atol=1e-12)
    hips = human_bones(session.body)[0]
    np.testing.assert_allclose(session.rotations.body.as_quat(), expected[:, hips.bone], atol=1e-12)
    assert list(session.rotations) == list(session.body.joints)


@pytest.mark.parametrize("missing", [[0], [2, 3], range(1000)])
def test_rotations_are_nan_without_a_person(session, missing):
    fused = session.fused.copy()
    lost = np.isin(np.arange(len(fused)), missing)
    fused[lost] = np.nan
    rotations = replace(session, rows=replace(session.rows, fused=fused)).rotations
    for turned in (rotations.body, rotations["KneeLeft"]):
        np.testing.assert_array_equal(np.isnan(turned.as_quat()).any(axis=1), lost)


def test_tables_name_their_columns_and_units(session):
    frame = session.to_pandas()
    assert len(frame) == len(session)
    units = frame.attrs["units"]
    assert {units["time_s"], units["HipLeft_x"], units["knee_flexion_left"]} == {"s", "m", "deg"}
    np.testing.assert_array_equal(frame["HipLeft_x"], session.fused[:, session.body.joint("HipLeft"), 0])
    np.testing.assert_array_equal(frame["time_s"], session.time)
    table = session.to_arrow("long")
    assert table.schema.field("x").metadata == {b"unit": b"m"}
    wide, long = session.to_pandas(sigma=True), session.to_pandas("long", sigma=True)
    for j, joint in enumerate(session.body.joints):
        np.testing.assert_array_equal(wide[f"{joint}_sigma"], session.sigma[:, j])
    for k, angle in enumerate(session.angles.names):
        np.testing.assert_array_equal(wide[f"{angle}_sigma"], session.angles.sigma[:, k])
    np.testing.assert_array_equal(long["sigma"][long["skeleton"] == "fused"], session.sigma.ravel())
    assert wide.attrs["units"].keys() == {*wide.columns} - {"frame", "gait"}
    assert list(frame.columns) == [name for name in wide.columns if not name.endswith("_sigma")]
    pandas.testing.assert_frame_equal(pandas.DataFrame(session.angles), frame[list(session.angles)])
    assert table.schema.metadata[b"body"] == b"kinect_v2"
    assert table.num_rows == 3 * session.fused[..., 0].size


# The verdict


def test_the_verdict_is_that_of_the_reports(session):
    found = session.verdict
    assert found.word in ("good", "usable", "poor", "unknown")
    assert report(session) == found.figures | {"verdict": report(session)["verdict"]}
    assert report(session)["verdict"]["word"] == found.word
    assert len(found.reasons) == len(found.findings)
    assert (found.word == "good") == (not found.reasons)
    assert str(found).startswith(found.word)


@given(begin=seconds, lasts=seconds, side=st.sampled_from("ab"))
def test_a_second_that_one_view_lacks_is_poor_and_says_so(begin, lasts, side):
    session = walk()
    rows, at = session.rows, int(begin * len(session))
    lost = np.arange(len(session)) >= at
    lost &= session.time <= session.time[min(at, len(session) - 1)] + lasts * session.time[-1]
    states, positions = (getattr(rows, f"{what}_{side}").copy() for what in ("states", "positions"))
    states[lost], positions[lost] = 0, np.nan
    changed = {f"states_{side}": states, f"positions_{side}": positions}
    changed_session = replace(session, rows=replace(rows, **changed))
    found = changed_session.quality_per_second
    of_frame = np.array([found[int(moment)].word == "good" for moment in session.time])
    np.testing.assert_array_equal(changed_session.good_frames, of_frame)
    spans = np.array(changed_session.good_spans).reshape(-1, 2)
    assert (np.diff(spans.ravel()) > 0.0).all()  # in order, and none touches the next
    within = (spans[:, :1] <= session.time) & (session.time < spans[:, 1:] - 1e-9)
    np.testing.assert_array_equal(within.any(axis=0), of_frame)
    assert [each.start for each in found] == list(range(len(found)))
    for each, before in zip(found, session.quality_per_second, strict=True):
        assert (each.word == "good") == (each.reason == "")
        within = (session.time >= each.start - 0.04) & (session.time < each.start + 1.0)
        if lost[within].all():
            assert each == (each.start, "poor", "one view alone has the person for 100 % of it")
        elif not lost[within].any():
            assert each == before


def test_a_session_that_is_not_good_fails_with_its_reasons(session):
    far = replace(session, rows=replace(session.rows, positions_b=session.rows.positions_b + np.float32(0.4)))
    assert_session(session, verdict=None, gap_s=0.5)
    assert_session(far, verdict=None)
    assert far.verdict.word == "poor"
    with pytest.raises(SessionsDifferError, match=r"is poor; asked for was usable\.\n  poor: ") as found:
        assert_session(far, verdict="usable")
    assert "\n  0 s poor: the views differ by" in str(found.value)
    assert found.value.sessions == (far,)
    fused = session.fused.copy()
    fused[30:60] = np.nan
    fused[100, session.body.joint("HandLeft"), 0] += 0.1
    broken = replace(session, rows=replace(session.rows, fused=fused))
    with pytest.raises(AssertionError, match=r"a bone of S\* is .* mm off in frame 100; asked for was 0"):
        assert_session(broken, verdict=None)
    with pytest.raises(AssertionError, match=r"no S\* for 1\.0\d s from 0\.9\d s on; asked for was 0\.5 s"):
        assert_session(broken, verdict=None, bones_mm=None, gap_s=0.5)


def test_a_joint_may_have_a_tolerance_of_its_own(session):
    fused = session.fused.copy()
    fused[10, session.body.joint("wrist left"), 0] += 0.004
    moved = replace(session, rows=replace(session.rows, fused=fused))
    assert_sessions_match(moved, session, joints_mm={"wrist left": 5.0})
    for joints_mm in ({"wrist left": 3.0}, {"wrist right": 5.0}):
        with pytest.raises(SessionsDifferError, match="more than a joint's tolerance in 1 of"):
            assert_sessions_match(moved, session, joints_mm=joints_mm)


# Errors


@pytest.mark.parametrize("what", REFUSED)
def test_a_wrong_name_is_an_error_that_lists_the_right_ones(what, session):
    with pytest.raises(DuplexError) as found:
        REFUSED[what](session)
    assert NAMES[what] in str(found.value)
    if isinstance(found.value, UnknownNameError):
        assert isinstance(found.value, KeyError)
        assert str(found.value).startswith("There is no ")


def test_a_missing_file_is_a_file_not_found_error(session, tmp_path):
    missing = tmp_path / "missing"
    for kind, asked in (
        (RecordingError, lambda: Session.open(missing.with_suffix(".rrd"))),
        (RecordingError, lambda: session.compare_with(missing.with_suffix(".trc"))),
        (RecordingError, lambda: session.compare_with(missing.with_suffix(".csv"))),
        (DeviceError, lambda: fuse(missing.with_suffix(".csv"), missing.with_suffix(".json"))),
        (DeviceError, lambda: fuse(missing.with_suffix(".mkv"), missing.with_suffix(".json"))),
        (DeviceError, lambda: session.compare_with(missing.with_suffix(".trc"), names=missing)),
    ):
        with pytest.raises(FileNotFoundError, match="missing") as found:
            asked()
        assert isinstance(found.value, kind)
        assert isinstance(found.value, DuplexError)
