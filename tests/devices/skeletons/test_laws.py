"""Laws of skeleton files: they hold for any file, not only for those of the other tests."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from devices.sensor import DeviceError
from devices.skeletons.border import (
    METRES,
    check_metres_forward,
    checked,
    find_unit,
    impossible,
    upside_down,
)
from devices.skeletons.csv_files.reader import read_csv
from devices.skeletons.read_file import Bodies, found_of
from devices.skeletons.stated_format import FilePoints
from fusion.body import BODIES, KINECT_V2
from fusion.skeleton import FARTHEST_JOINT as FARTHEST
from tests.helpers.two_views import FRAME_NS, moving, standing

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
        read = checked(path, read_csv(path, progress=progress, block=block))
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
    body=st.sampled_from(list(BODIES.values())),
    unit=st.sampled_from(list(METRES)),
    stature=st.floats(0.75, 1.2),
    outliers=st.floats(0.0, 0.45),
    seed=st.integers(0, 2**32),
)
def test_the_unit_is_found_whatever_a_minority_of_frames_says(body, unit, stature, outliers, seed):
    random = np.random.default_rng(seed)
    positions = np.repeat(standing(body)[None] * stature / METRES[unit][0], 60, axis=0)
    for t in range(int(outliers * 60)):
        positions[t] *= random.uniform(0.0, 1000.0, (len(body), 1))
    assert find_unit("a.csv", body, positions)[0] == METRES[unit][0]


@given(behind=st.integers(0, 60), seed=st.integers(0, 2**32))
def test_a_file_is_refused_where_most_joints_are_behind_the_sensor(behind, seed):
    positions = np.random.default_rng(seed).uniform(0.5, 4.0, (60, 3))
    positions[:behind, 2] *= -1
    if behind > 30:
        with pytest.raises(DeviceError, match="negative z"):
            check_metres_forward("a.csv", positions)
    elif behind < 30:
        check_metres_forward("a.csv", positions)


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


def recorded(*people):
    """The recording of (T, J, 3) people."""
    points = FilePoints(BODY, {name: k for k, name in enumerate(BODY.joints)})
    frames = [
        Bodies(t * FRAME_NS, [(str(k), at, None) for k, at in enumerate(each)])
        for t, each in enumerate(zip(*people, strict=True))
    ]
    return found_of(Path("a.json"), points, "time_ns", frames)


@given(still=st.lists(st.booleans(), min_size=1, max_size=3), share=st.floats(0, 1))
def test_a_person_who_is_followed_and_stands_still_is_told(still, share):
    """Repeated in more than 90 % of the frames; of people who are seen as long, the last one is followed."""
    shaken = np.random.default_rng(0).normal(0.0, 0.01, (60, len(BODY), 3)) + standing(BODY)
    frames = round(share * 59)
    held = shaken.copy()
    held[59 - frames :] = held[59 - frames]
    told = checked(Path("a.json"), recorded(*(held if each else shaken for each in still))).warnings
    assert any("repeats the one before" in line for line in told) == (still[-1] and frames > 0.9 * 59)


@given(
    y_up=st.booleans(),
    lifted=st.sampled_from([(), ("left",), ("right",)]),
    height=st.sampled_from([0.3, 0.6, 0.9, 1.2, 1.4]),
)
def test_a_y_axis_that_points_up_is_told_whichever_leg_is_lifted(y_up, lifted, height):
    positions = np.repeat(standing(BODY)[None], 50, axis=0)
    for side in lifted:
        positions[:, BODY.joint(f"ankle {side}"), 1] -= height
    positions[..., 1] *= -1.0 if y_up else 1.0
    assert bool(upside_down("a.csv", BODY, positions)) == y_up


@pytest.mark.parametrize("followed", [0, 1])
def test_d14_upside_down_is_told_of_the_person_who_is_followed(followed):
    """Of two people who are seen as long, the last one is followed."""
    shaken = np.random.default_rng(0).normal(0.0, 0.01, (60, len(BODY), 3)) + standing(BODY)
    down = shaken * (1.0, -1.0, 1.0)
    told = checked(Path("a.json"), recorded(*((shaken, down) if followed else (down, shaken)))).warnings
    assert any("the head is below the feet" in line for line in told) == bool(followed)


@given(
    groups=st.lists(st.lists(st.integers(0, 9), min_size=1, max_size=4), min_size=1, max_size=4),
    seed=st.integers(0, 2**32),
)
def test_a_joint_is_tracked_as_its_worst_point_is(groups, seed):
    random = np.random.default_rng(seed)
    at, states = random.normal(size=(6, 10, 3)), random.integers(0, 3, (6, 10)).astype(np.uint8)
    points = FilePoints(BODY, {f"p{k}": k for k in range(10)}, dict(enumerate(groups)))
    _, found = points.joints(at, states)
    for joint, of in enumerate(groups):
        for t in range(6):
            assert found[t, joint] == min(int(states[t, point]) for point in of)
    assert not found[:, len(groups) :].any()
