"""Laws of skeleton files: they hold for any file, not only for those of the other tests."""

import shlex
from datetime import datetime, timedelta
from functools import cache

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from devices.sensor import DeviceError
from devices.simulated.kinect import simulated_pair
from devices.skeletons.csv_files.reader import read_csv
from devices.skeletons.file_sensor import SkeletonRecording
from devices.skeletons.likelihood import axes_likelihood, stature_of
from devices.skeletons.meaning import MeaningError
from devices.skeletons.name_tables import FilePoints
from devices.skeletons.stated_format import AXES, METRES, SIGNED, StatedFormat, called_axes
from devices.skeletons.times import FEWEST, TIME_COLUMNS, capture_times, find_time_unit, moments_of
from fusion.body import BODIES, KINECT_V2
from fusion.rigid import RigidTransform
from fusion.skeleton import FARTHEST_JOINT as FARTHEST
from fusion.skeleton import impossible
from tests.helpers.command_line import duplex, one_line
from tests.helpers.exercises import POSES, UP, posed
from tests.helpers.skeleton_files import NAMES, TIMES, read_found, write_meaning
from tests.helpers.two_views import FRAME_NS, moving

BODY = KINECT_V2
ROW = 45  # bytes
HEADER = "time_us,body,joint,x,y,z,state"
FAULTS = {  # what is done to a row, and what is told of it; None: nothing
    "none": (lambda row: [row], None),
    "a word": (lambda row: [[*row[:4], "one", *row[5:]]], "y must be a number; got 'one'"),
    "a time of no number": (lambda row: [["now", *row[1:]]], "time_us must be a number; got 'now'"),
    "an unknown state": (lambda row: [[*row[:6], "maybe"]], "state 'maybe' is none of"),
    "too few cells": (lambda row: [row[:6]], "does not have 7 columns"),
    "a row twice": (lambda row: [row, row], "has two rows in one frame"),
    "a joint behind the sensor": (lambda row: [[*row[:5], "-1", "tracked"]], "1 position is impossible"),
    "a joint far away": (lambda row: [[*row[:3], "1e6", *row[4:]]], "1 position is impossible"),
}


def rows_of(frames, people):
    for t, at in enumerate(moving(BODY, frames)):
        for person in range(people):
            for joint, xyz in zip(BODY.joints, at + 0.4 * person, strict=True):
                yield [f"{t * FRAME_NS // 1000}", f"{person}", joint, *(f"{v:.6f}" for v in xyz), "tracked"]


def outcome(path, block):
    """What is read and told, and in how many passes through the file."""
    passes = []

    def progress(blocks, what, total):
        passes.append((what, total))
        return blocks

    try:
        read = read_found(path, read_csv(path, progress=progress, block=block))
    except DeviceError as error:
        return None, {str(error)}, passes
    return read.people, set(read.warnings), passes


@given(
    frames=st.integers(8, 14),
    people=st.integers(1, 3),
    fault=st.sampled_from(list(FAULTS)),
    at=st.integers(0, 999),
    line_end=st.sampled_from(["\n", "\r\n", "\r", "\n\n"]),
    decimal_comma=st.booleans(),
    order=st.sampled_from(["of time", "of time", "people apart", "any"]),
    blocks=st.integers(1, 3),
    rows_after=st.integers(1, 50),
)
def test_a_file_says_the_same_in_blocks_and_at_once(
    tmp_path, frames, people, fault, at, line_end, decimal_comma, order, blocks, rows_after
):
    rows = list(rows_of(frames, people))
    row, (change, words) = at * len(rows) // 1000, FAULTS[fault]
    rows[row : row + 1] = change(rows[row])
    if order == "any":
        rows = [rows[k] for k in np.random.default_rng(row).permutation(len(rows))]
    elif order == "people apart":
        rows.sort(key=lambda cells: cells[1])
    text = line_end.join([HEADER, *map(",".join, rows)]) + line_end
    path = tmp_path / "a.csv"
    path.write_bytes((text.replace(",", ";").replace(".", ",") if decimal_comma else text).encode())
    whole, told, _ = outcome(path, -1)
    read, also_told, passes = outcome(path, (len(text) - rows_after * ROW) // blocks)
    assert also_told == told
    assert (read is None) == (whole is None)
    if whole is not None:
        assert read.ids == whole.ids
        np.testing.assert_array_equal(read.time_ns, whole.time_ns)
        for values, expected in zip(read.skeletons[:3], whole.skeletons[:3], strict=True):
            np.testing.assert_array_equal(values, expected)
    if order != "of time":
        return
    if words is None:
        assert not told
        assert len(whole) == frames
        # The lines of an old Mac have no end by which a block could end.
        assert len(passes) == 1 or line_end == "\r"
    else:
        line = 1 + (row + 1 + (fault == "a row twice")) * (2 if line_end == "\n\n" else 1)
        (said,) = told
        assert words in said
        assert f"line {line}" in said


@given(
    people=st.integers(1, 2),
    cut=st.integers(1, len(BODY) - 1),
    blocks=st.integers(1, 2),
    rows_after=st.integers(1, 2 * len(BODY)),
)
def test_a_file_cut_off_in_its_last_frame_is_refused_wherever_a_block_ends(
    tmp_path, people, cut, blocks, rows_after
):
    rows = list(rows_of(8, people))[:-cut]
    path = tmp_path / "a.csv"
    path.write_text("\n".join([HEADER, *map(",".join, rows)]))
    read, (told,), _ = outcome(path, (path.stat().st_size - rows_after * ROW) // blocks)
    assert read is None
    assert "seems to be cut off" in told


@given(
    xy=st.tuples(*[st.floats(-FARTHEST, FARTHEST, exclude_min=True, exclude_max=True)] * 2),
    z=st.floats(1e-6, 9.9),
)
def test_a_position_behind_the_sensor_is_impossible(xy, z):
    assert not impossible(np.array([*xy, z]))
    assert impossible(np.array([*xy, -z]))
    assert not impossible(np.zeros(3))
    for axis in range(3):
        far = np.array([*xy, z])
        far[axis] = FARTHEST * 1.01
        assert impossible(far)


@given(
    groups=st.lists(st.lists(st.integers(0, 9), min_size=1, max_size=4), min_size=1, max_size=4),
    seed=st.integers(0, 2**32),
)
def test_a_joint_is_tracked_as_its_worst_point_is(groups, seed):
    random = np.random.default_rng(seed)
    at, states = random.normal(size=(6, 10, 3)), random.integers(0, 3, (6, 10)).astype(np.uint8)
    points = FilePoints(BODY, [f"p{k}" for k in range(10)], dict(enumerate(groups)))
    _, found = points.joints(at, states)
    for joint, of in enumerate(groups):
        for t in range(6):
            assert found[t, joint] == min(int(states[t, point]) for point in of)
    assert not found[:, len(groups) :].any()


# Law 3: any subset of joints in any axes, each file its own, is read right or refused with the options.

WITHOUT = {
    "nothing": (),
    "feet": ("foot", "heel"),
    "arms": ("elbow", "wrist", "hand", "thumb"),
    "face": ("nose", "eye", "ear"),
    "legs": ("knee", "ankle", "foot", "heel", "hip"),
    "legs and head": ("knee", "ankle", "foot", "heel", "hip", "head", "neck", "nose", "eye", "ear"),
    "all but a leg": ("pelvis", "spine", "shoulder", "elbow", "wrist", "hand", "head", "neck", "hipright"),
}


@cache
def simulated(motion, body, height=1.75, pose="stand"):
    """Both views of six seconds, ten frames each: times, positions and states."""
    body = BODIES[body]
    a, b, truth = simulated_pair(motion=motion, body=body, seed=3, seconds=6.0, height=height)
    views = []
    for sensor in (a, b):
        frames = list(sensor.frames())[::3]
        people = [one for frame in frames for one in frame.people.values()]
        times = np.array([one.time_ns for one in people])
        views.append((times, *(np.array([getattr(p, of) for p in people]) for of in ("positions", "states"))))
    if pose == "stand":
        return views
    forwards, left = POSES[pose][3:]  # and 0.6 m lower, without the trackers' errors
    times = views[0][0]
    lying = [posed(body, at, 0, 20, 40, forwards, left, 70.0) for at in truth.positions_at(times)]
    states = np.full((len(times), len(body)), 2)
    at = np.array(lying) - 0.6 * UP
    return [(times, of.apply(at), states) for of in (RigidTransform.identity(), truth.a_from_b.inverse())]


def written(folder, motion, body, without, axes, scene=(1.75, "stand"), **meaning):
    """Both files, and what they hold; ``axes`` of A and of B, ``scene`` the person's height and pose."""
    body, files = BODIES[body], []
    plain = [name.lower() for name in body.joints]
    hidden = np.array([any(part in name for part in WITHOUT[without]) for name in plain])
    for side, (times, at, states), own in zip("ab", simulated(motion, body.name, *scene), axes, strict=True):
        seen = np.where(hidden, 0, states)
        path = folder / f"{side}.csv"
        has = write_meaning(path, body, times, at, seen, own, **meaning)
        files.append((path, times, at, seen, has))
    return files


def read_pair(files, **stated):
    """Both recordings, read with each other's help."""
    a, b = (
        SkeletonRecording(path, StatedFormat(side=side, **stated))
        for (path, *_), side in zip(files, "ab", strict=True)
    )
    a.partner, b.partner = b, a
    with a, b:
        return a.content, b.content


def assert_right(read, body, times, at, seen, has):
    (person,) = read.people.ids
    view = read.people.view((person,))
    assert np.ptp(np.diff(view.time_ns) - np.diff(times)) < 3_000_000
    for joint in has:
        own = read.body.find(body.joints[joint])
        if own is not None and seen[:, joint].any():
            there = view.states[:, own] > 0
            np.testing.assert_allclose(view.positions[there, own], at[there, joint], atol=2e-3)


MEANINGS = {
    "motion": st.sampled_from(["walk", "squat", "sit", "idle"]),
    "body": st.sampled_from(["kinect_v2", "azure_kinect", "kinect_v1"]),
    "unit": st.sampled_from(list(METRES)),
    "time": st.sampled_from(list(TIMES)),
    "axes": st.tuples(*[st.sampled_from(SIGNED)] * 2),
    "same": st.booleans(),
}


@given(names=st.sampled_from(NAMES), **MEANINGS)
def test_whole_bodies_are_read_right_in_any_meaning(tmp_path, motion, body, unit, time, axes, same, names):
    files = written(
        tmp_path, motion, body, "nothing", axes[:1] * 2 if same else axes, unit=unit, time=time, names=names
    )
    for read, (_, *truth) in zip(read_pair(files), files, strict=True):
        assert_right(read, BODIES[body], *truth)


LYING = st.sampled_from([pose for pose in POSES if pose.startswith("on the")])
SCENES = st.tuples(st.just(1.75), LYING)
SCENES |= st.tuples(st.sampled_from([1.0, 1.2, 1.75]), st.just("stand"))


@given(without=st.sampled_from(list(WITHOUT)), scene=SCENES, **MEANINGS)
@example("walk", "kinect_v2", "m", "time_us", ("y,z,x", "y,z,x"), True, "all but a leg", (1.75, "stand"))
@example("sit", "kinect_v2", "m", "time_us", ("y,z,x", "y,z,x"), True, "legs and head", (1.75, "stand"))
def test_parts_of_bodies_and_who_lies_are_read_right_or_refused_with_the_options(
    tmp_path, motion, body, unit, time, axes, same, without, scene
):
    axes = axes[:1] * 2 if same else axes
    files = written(tmp_path, motion, body, without, axes, scene, unit=unit, time=time)
    refused = None
    try:
        reads = read_pair(files)
    except MeaningError as error:
        refused = error
    if refused is None:
        for read, (_, *truth) in zip(reads, files, strict=True):
            assert_right(read, BODIES[body], *truth)
    else:
        options = [option for option, behind in refused.table["axes"] if behind > -6.0]
        assert called_axes(axes["b.csv" in str(refused)]) in options
        assert "`axes_" in str(refused) or "`unit_" in str(refused)


UNROLLED = [axes for axes in SIGNED if axes not in ("-y,x,z", "y,-x,z")]


@given(motion=MEANINGS["motion"], pose=LYING, axes=st.sampled_from(UNROLLED), side=st.sampled_from([0, 1]))
def test_one_file_of_who_lies_is_read_right_or_refused_with_the_options(tmp_path, motion, pose, axes, side):
    """But for a sensor on its side: in its image who lies is like who stands before a sensor that stands."""
    path, *truth = written(tmp_path, motion, "kinect_v2", "nothing", (axes, axes), (1.75, pose))[side]
    refused = ""
    try:
        with SkeletonRecording(path) as recording:
            assert_right(recording.content, BODIES["kinect_v2"], *truth)
    except MeaningError as error:
        refused = str(error)
    assert not refused or f"`axes={called_axes(axes)}`" in refused


@given(
    axes=MEANINGS["axes"], unit=MEANINGS["unit"], names=st.sampled_from(NAMES), time=MEANINGS["time"],
    without=st.sampled_from(list(WITHOUT)),
)  # fmt: skip
def test_what_info_proposes_works(tmp_path, capsys, axes, unit, names, time, without):
    """And where nothing is clear, it proposes nothing."""
    folder = tmp_path / "of two sensors"
    folder.mkdir(exist_ok=True)
    (a, *_), (b, *_) = written(folder, "walk", "kinect_v2", without, axes, unit=unit, time=time, names=names)
    capsys.readouterr()
    code = duplex("info", a)
    out = capsys.readouterr().out
    commands = [shlex.split(line) for line in out.splitlines() if "duplex fuse" in line]
    assert len(commands) == (code == 0)
    assert "likely axes" in out
    assert "likely unit" in out
    for words in commands:
        words = [{"OTHER.csv": b, "s.rrd": tmp_path / "s.rrd"}.get(word, word) for word in words]
        assert duplex(*words[words.index("duplex") + 1 :], "--no-viewer", "--force") == 0


@given(st.floats(0.1, 0.4))
def test_who_rises_and_sinks_is_the_less_likely(rises):
    """By the square of so many standard deviations of 0.15 statures; a hop aside costs nothing."""
    body, seconds = BODIES["kinect_v2"], np.arange(60) / 30.0
    still = np.repeat(moving(body, 1), 60, axis=0)
    wave = np.sqrt(2.0) * rises * stature_of(body, still) * np.sin(2.0 * np.pi * seconds)[:, None, None]
    up, aside = (
        axes_likelihood(body, seconds, still + wave * np.eye(3)[axis])[2][0, SIGNED.index("x,y,z")]
        for axis in (1, 0)
    )
    assert aside - up == pytest.approx(0.5 * (rises / 0.15) ** 2, rel=0.1, abs=0.1)


def test_stated_axes_are_tested_by_the_same_likelihood(tmp_path, capsys):
    files = written(tmp_path, "walk", "kinect_v2", "nothing", (AXES["kinect"],) * 2)
    for read, (_, *truth) in zip(read_pair(files, axes="kinect"), files, strict=True):
        assert_right(read, BODIES["kinect_v2"], *truth)
        assert read.warnings == ()
    for read in read_pair(files, orientation=180):
        assert read.warnings == ()
    told = read_pair(files, axes="x,y,z")[0].warnings
    assert "by `axes_a=x,y,z` the person is not upright; `axes_a=kinect` fits better" in "".join(told)
    for axes, words in {
        "unity": "by --axes-a unity the person is a mirror image",
        "x,-y,-z": "by --axes-a x,-y,-z the person is not before the sensor",
        "x,x,z": "has x twice",
        "x,y": "neither kinect, unity, opengl, ros, nor three axes",
    }.items():
        assert duplex("fuse", *(path for path, *_ in files), "--axes", axes, "--no-viewer") == 2
        assert words in one_line(capsys)


@given(
    st.sampled_from([5, 15, 30, 60, 90]), st.sampled_from([name for name in TIME_COLUMNS if name != "time"])
)
def test_the_rate_of_a_sensor_is_told_of_no_other_unit(rate, column):
    times = np.arange(30) / rate * 1e6 / TIME_COLUMNS[column][0]
    assert find_time_unit("a", column, times) == (TIME_COLUMNS[column][0], "", [])


@given(st.datetimes(max_value=datetime(9999, 12, 31)), st.integers(1, 10**9))
@example(datetime(1, 1, 1), 33_333)
def test_times_of_any_year_go_on(moment, us):
    """As .NET writes a time since a start: in the year 1."""
    first, second = moments_of([of.isoformat() for of in (moment, moment + timedelta(microseconds=us))])
    assert (second - first) % (9 * 10**18) == 1000 * us


def test_positions_relative_to_the_person_are_refused_in_these_words(tmp_path):
    times, at, states = simulated("walk", "azure_kinect")[0]
    write_meaning(tmp_path / "a.csv", BODIES["azure_kinect"], times, at - at[:, :1], states)
    with pytest.raises(DeviceError, match="relative to the person"), SkeletonRecording(tmp_path / "a.csv"):
        pass


def test_both_sensors_in_one_file_are_split(tmp_path):
    body, lines = BODIES["kinect_v2"], []
    for device, (times, at, states) in enumerate(simulated("walk", "kinect_v2")):
        path = tmp_path / f"{device}.csv"
        write_meaning(path, body, times, at, states)
        header, *rows = path.read_text().splitlines()
        lines += [f"{row},{device}" for row in rows]
    both = tmp_path / "both.csv"
    both.write_text(
        "\n".join([f"{header},device_index", *sorted(lines, key=lambda row: int(row.split(",")[0]))]) + "\n"
    )
    for read, side in zip(read_pair(((both,), (both,))), (0, 1), strict=True):
        with SkeletonRecording(tmp_path / f"{side}.csv") as expected:
            np.testing.assert_array_equal(
                read.people.skeletons.positions, expected.people.skeletons.positions
            )
        assert "has 2 sensors by the column device_index" in read.warnings[0]


MOVES_S = st.one_of(st.floats(-60.0, -0.05), st.floats(3601.0, 1e8), st.floats(-1e8, -60.0))


@given(
    st.lists(st.tuples(st.integers(15, 200), MOVES_S), min_size=1, max_size=4),
    st.sampled_from((5, 30, 120)),
    st.floats(0.0, 0.1),
    st.lists(st.tuples(st.integers(0, 899), st.floats(-1e6, 1e6)), max_size=3),
)
@example([(100, -1.0)], 30, 0.0, [])
@example([(100, 31_536_000.0)], 30, 0.0, [])
def test_times_go_on_where_a_clock_is_set_whenever_and_by_whatever(parts, rate, jitter, strays):
    """To within a frame, and it is told in one line. Stray times count as those between their neighbours."""
    random = np.random.default_rng(round(1e6 * jitter))
    count = sum(frames for frames, _ in parts) + 30
    true = np.arange(count) / rate + jitter / rate * random.uniform(-1.0, 1.0, count)
    said, begins = true + 10.0, 0
    for frames, moves_s in parts:
        begins += frames
        said[begins:] += moves_s
    edges, inner = [0, *np.cumsum([frames for frames, _ in parts]), count], []
    for k, by_s in strays:
        if all(abs(k % count - edge) > FEWEST for edge in (*edges, *inner)):  # shorter runs tell nothing
            inner.append(k % count)
            said[k % count] += by_s
    times = capture_times("a.csv", "time_us", np.rint(1e6 * said).astype(np.int64))
    found = 1e-9 * (times.time_ns - times.time_ns[0])
    assert (np.diff(times.time_ns) > 0).all()
    each = len(parts) + len(set(inner))
    assert np.abs(found - true + true[0]).max() <= (0.3 + each) / rate
    assert sum("the times go on" in line for line in times.told) == 1
    assert len(times.told) <= 3
