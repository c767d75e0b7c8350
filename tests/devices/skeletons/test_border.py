"""The border behind all readers: units, points that nobody saw, states, columns, counts that do not fit."""

import json
import re

import numpy as np
import pytest

from devices.sensor import DeviceError
from devices.skeletons.file_sensor import SkeletonRecording
from devices.skeletons.stated_format import UNSTATED, StatedFormat
from fusion.body import AZURE_KINECT, KINECT_V2
from tests.helpers.recorded_pairs import write_view
from tests.helpers.two_views import FRAME_NS, moving

FRAMES = 30
TRUE = moving(KINECT_V2, FRAMES) + np.random.default_rng(0).normal(0.0, 0.005, (FRAMES, len(KINECT_V2), 3))


def opened(path, stated=UNSTATED):
    with SkeletonRecording(path, stated) as recording:
        return recording.content


def positions_of(read):
    return read.people.skeletons.positions


def as_json(path, positions, **changes):
    """As offline_processor writes it; ``changes`` of each frame."""
    frames = [
        {
            "timestamp_usec": t * FRAME_NS // 1000,
            "num_bodies": 1,
            "bodies": [{"body_id": 1, "joint_positions": at.tolist()}],
        }
        | changes
        for t, at in enumerate(positions)
    ]
    path.write_text(json.dumps({"joint_names": KINECT_V2.joints, "frames": frames}), encoding="utf-8")
    return path


def as_skeleton(path, positions, count=None, ids=("7",)):
    """As NTU RGB+D has it."""
    lines = [str(len(positions) if count is None else count)]
    for at in positions:
        lines.append(str(len(ids)))
        for person in ids:
            lines += [f"{person} 0 1 1 1 1 0 0.02 0.01 2", "25"]
            lines += [f"{-x:.7f} {-y:.7f} {z:.7f} 0 0 0 0 0 0 0 0 2" for x, y, z in at]
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


WRITERS = {".json": (as_json, 1e3), ".skeleton": (as_skeleton, 1.0)}


@pytest.mark.parametrize("stated", [False, True])
@pytest.mark.parametrize("written", ["m", "cm", "mm"])
@pytest.mark.parametrize("suffix", WRITERS)
def test_b2_every_format_has_a_unit(tmp_path, suffix, written, stated):
    """Found by the size of the person, with a line where it is not the format's; or the one stated."""
    write, of_format = WRITERS[suffix]
    scale = {"m": 1.0, "cm": 1e2, "mm": 1e3}[written]
    path = write(tmp_path / f"a{suffix}", TRUE * scale)
    read = opened(path, StatedFormat(written if stated else "auto"))
    np.testing.assert_allclose(positions_of(read), TRUE, atol=1e-5)
    assert any("are read as" in line for line in read.warnings) == (not stated and scale != of_format)


@pytest.mark.parametrize("suffix", WRITERS)
def test_b2_impossible_positions_are_told_of_every_format(tmp_path, suffix):
    write, scale = WRITERS[suffix]
    spoiled = TRUE * scale
    spoiled[5:7, 3] = 0.0, 0.0, 99.0 * scale
    read = opened(write(tmp_path / f"a{suffix}", spoiled))
    assert (
        "2 positions are impossible and count as not tracked, first in frame 5, z = 99 m" in read.warnings[0]
    )
    assert np.isnan(positions_of(read)[5:7, 3]).all()


def test_b2_two_people_of_one_id_are_refused(tmp_path):
    twice = as_json(tmp_path / "a.json", TRUE)
    document = json.loads(twice.read_text())
    document["frames"][4]["bodies"] *= 2
    twice.write_text(json.dumps(document))
    for path in (twice, as_skeleton(tmp_path / "a.skeleton", TRUE, ids=("7", "7"))):
        with pytest.raises(DeviceError, match=r"frame \d has two people of one id, [17]"):
            opened(path)


def test_b2_counts_that_do_not_fit_are_told(tmp_path):
    read = opened(as_skeleton(tmp_path / "a.skeleton", TRUE, count=12))
    assert read.warnings == (f"{tmp_path / 'a.skeleton'}: it states 12 frames and has 30; all were read.",)
    assert len(read.people) == FRAMES
    read = opened(as_json(tmp_path / "a.json", TRUE, num_bodies=2))
    assert "frame 0 states 2 bodies and has 1" in read.warnings[0]


@pytest.mark.parametrize("unseen", [(0.0, 0.0, 0.0), (0.0, 0.0, 30.0), (0.0, 0.0, -1.0), (np.nan, 1.0, 2.0)])
def test_b3_a_mean_needs_all_its_points(tmp_path, unseen):
    path, names = tmp_path / "a.csv", tmp_path / "names.toml"
    lines = write_view(path, KINECT_V2, TRUE).read_text().splitlines()
    hand = [k for k, line in enumerate(lines) if ",HandLeft," in line]
    for number, k in enumerate(hand):
        lines[k] = lines[k].replace("HandLeft", "HL1")
        other = lines[k].replace("HL1", "HL2").split(",")
        lines[k] += "\n" + ",".join([*other[:3], *map(str, unseen), other[6]] if number % 2 else other)
    path.write_text("\n".join(lines) + "\n")
    names.write_text('[joints]\nHandLeft = ["HL1", "HL2"]\n')
    found = positions_of(opened(path, StatedFormat(names=str(names))))[:, KINECT_V2.joint("HandLeft")]
    assert np.isnan(found[1::2]).all()
    np.testing.assert_allclose(found[::2], TRUE[::2, KINECT_V2.joint("HandLeft")], atol=1e-6)


@pytest.mark.parametrize("separator", ["\t", ";"])
def test_b5_a_separator_of_thousands_is_no_decimal_comma(tmp_path, separator):
    path = tmp_path / "a.csv"
    lines = write_view(path, KINECT_V2, TRUE).read_text().splitlines()

    def spoilt(of):
        rows = [line.split(",") for line in lines[1:]]
        rows = [separator.join([*row[:3], *map(of, row[3:6]), row[6]]) for row in rows]
        path.write_text("\n".join([lines[0].replace(",", separator), *rows]) + "\n")
        return path

    with pytest.raises(
        DeviceError, match=r"whether the comma in '[12],\d\d\d' separates thousands is unclear"
    ):
        opened(spoilt(lambda value: f"{1000 * float(value):,.0f}"))
    with pytest.raises(DeviceError, match=r"there is '.*\..*', too"):
        opened(spoilt(lambda value: value.replace(".", ",") if value.startswith("-") else value))
    read = opened(spoilt(lambda value: f"{float(value):.3f}".replace(".", ",")))
    np.testing.assert_allclose(positions_of(read), TRUE, atol=6e-4)


def test_b8_a_whole_number_that_lost_digits_is_refused(tmp_path):
    path = tmp_path / "a.csv"
    lines = write_view(path, KINECT_V2, TRUE).read_text().splitlines()
    rows = [line.split(",")[:6] for line in lines]
    text = "\n".join(",".join([*row[:3], *(f"{1000 * float(v):.0f}" for v in row[3:])]) for row in rows[1:])
    path.write_text("time_us,body,joint,x,y,z\n" + text)
    opened(path)
    path.write_text("time_us,body,joint,x,y,z\n" + text[:-2])
    with pytest.raises(DeviceError, match="seems to be cut off in its last line"):
        opened(path)


ODD = {
    "a separator at each line's end": lambda lines: [lines[0], *(f"{line}," for line in lines[1:])],
    "the header, too": lambda lines: [f"{line}," for line in lines],
    "sep=": lambda lines: ["sep=,", *lines],
    "comments": lambda lines: ["# by hand", *lines[:9], "# a pause", *lines[9:]],
    "blank first lines": lambda lines: ["", "", *lines],
    "a header in a comment": lambda lines: [f"# {lines[0]}", *lines[1:]],
    "no body": lambda lines: [re.sub(r"^([^,]*),[^,]*", r"\1", line) for line in lines],
    "other spellings": lambda lines: [
        "Timestamp (us),TrackingId,JointType,Position.X,Position.Y,Position.Z,TrackingState", *lines[1:]
    ],
    "numbers of joints": lambda lines: [
        ",".join([*cells[:2], str(KINECT_V2.joints.index(cells[2])) if k else "joint", *cells[3:]])
        for k, cells in enumerate(line.split(",") for line in lines)
    ],
    "each row twice": lambda lines: [lines[0], *(line for line in lines[1:] for _ in range(2))],
}  # fmt: skip


@pytest.mark.parametrize("kind", ODD)
def test_d17_odd_tables_are_read(tmp_path, kind):
    path = tmp_path / "a.csv"
    lines = write_view(path, KINECT_V2, TRUE).read_text().splitlines()
    path.write_text("\n".join(ODD[kind](lines)) + "\n")
    np.testing.assert_allclose(positions_of(opened(path)), TRUE, atol=1e-6)


def test_d17_a_line_of_a_file_with_odd_first_lines_is_named(tmp_path):
    path = tmp_path / "a.csv"
    lines = write_view(path, KINECT_V2, TRUE).read_text().splitlines()
    lines[7] = lines[7].replace(",tracked", ",gone")
    path.write_text("\n".join(["sep=,", "# by hand", "", *lines]) + "\n")
    with pytest.raises(DeviceError, match="line 11: state 'gone'"):
        opened(path)


@pytest.mark.parametrize(
    ("column", "words"),
    [
        ("state", ("0", "1", "2")),
        ("State", ("NotTracked", "Inferred", "Tracked")),
        ("TrackingState", ("0.0", "1.0", "2.0")),
        ("tracking_state", ("TrackingState.NotTracked", "TrackingState.Inferred", "TrackingState.Tracked")),
        ("confidence", ("0", "1", "3")),
        ("Confidence Level", ("NONE", "low", "Medium")),
        ("joint_confidence", tuple(f"K4ABT_JOINT_CONFIDENCE_{word}" for word in ("NONE", "LOW", "HIGH"))),
        ("is_tracked", ("False", "2", "True")),
    ],
)
def test_states_are_read_under_any_name(tmp_path, column, words):
    path = tmp_path / "a.csv"
    rows = [line.rpartition(",")[0] for line in write_view(path, KINECT_V2, TRUE).read_text().splitlines()]
    each = [words[k % 3] for k in range(len(rows) - 1)]
    lines = [f"{row},{word}" for row, word in zip(rows, [column, *each], strict=True)]
    path.write_text("\n".join(lines) + "\n")
    expected = np.resize([0, 1, 2] if column != "is_tracked" else [0, 2, 2], (FRAMES, len(KINECT_V2)))
    np.testing.assert_array_equal(opened(path).people.skeletons.states, expected)


def test_a_column_of_inferred_joints_is_told_its_own_values(tmp_path):
    path = tmp_path / "a.csv"
    lines = [line.rpartition(",")[0] for line in write_view(path, KINECT_V2, TRUE).read_text().splitlines()]
    path.write_text("\n".join([f"{lines[0]},inferred", *(f"{row},2" for row in lines[1:])]) + "\n")
    (line,) = opened(path).warnings
    assert "such as '2', are no states: 0, 1, false, true. Every joint" in line


def test_a_column_whose_values_are_no_states_is_said_to_be_ignored(tmp_path):
    path = tmp_path / "a.csv"
    lines = [line.rpartition(",")[0] for line in write_view(path, KINECT_V2, TRUE).read_text().splitlines()]
    rows = [f"{row},{k % 97 / 100},open" for k, row in enumerate(lines[1:])]
    path.write_text("\n".join([f"{lines[0]},visibility,hand_state", *rows]) + "\n")
    read = opened(path)
    (line,) = read.warnings
    assert "column visibility is ignored, because its values, such as '0.01', are no states" in line
    assert read.ignored == ("visibility", "hand_state")
    assert (read.people.skeletons.states == 2).all()


@pytest.mark.parametrize("place", [(0.0, 0.0, 0.0), (0.3, 0.9, 1.4), (-1.0, -1.0, -1.0), (9e3, 9e3, 9e3)])
@pytest.mark.parametrize("metres", [1.0, 0.001])
@pytest.mark.parametrize("held", [(), (22, 27)])
def test_a_place_of_joints_that_nobody_sees_changes_nothing_else(tmp_path, place, metres, held):
    """Legs at a constant place; the other joints, the unit and the size as without them.

    In some frames the tracker holds all joints.
    """
    legs = [k for k, name in enumerate(KINECT_V2.joints) if name[:3] in ("Kne", "Ank", "Foo")]
    true = TRUE.copy()
    for frame in held:
        true[frame] = true[frame - 1]
    unseen = true / metres
    unseen[:, legs] = place
    read = opened(write_view(tmp_path / "a.csv", KINECT_V2, unseen))
    true[:, legs] = np.nan
    np.testing.assert_allclose(positions_of(read), true, atol=1e-5)
    assert any("KneeLeft" in line and "keep their places" in line for line in read.warnings) == any(place)


def test_foreign_json_is_named(tmp_path):
    joint = {"position": {"x": 0.0, "y": 1.0, "z": 2.0}, "confidence_level": 2}
    body = {"id": 1, "skeleton": {"joints": [joint] * len(AZURE_KINECT)}}
    path = tmp_path / "a.json"
    path.write_text(json.dumps([body]))
    with pytest.raises(DeviceError, match=r"bodies of pyKinectAzure, which have no times; .* Write a \.csv"):
        opened(path)
    path.write_text(json.dumps([body]) + "\n" + json.dumps([body]))
    with pytest.raises(DeviceError, match=r"holds several JSON documents; .* Write a \.csv"):
        opened(path)


def test_lines_of_dump_kinect_skeleton_are_read(tmp_path):
    """Milliseconds, numbers of joints, the axes of the SDK, and no id."""
    path = tmp_path / "a.csv"
    head = "# timestamp, jointType, position.X, position.Y, position.Z, orientation.X, orientation.Y, "
    rows = [
        f"{1e-6 * t * FRAME_NS:.4f}, {joint}, {-x:.6f}, {-y:.6f}, {z:.6f}, 0, 0, 0, 1, 2"
        for t, at in enumerate(TRUE)
        for joint, (x, y, z) in enumerate(at)
    ]
    path.write_text("\n".join([f"{head}orientation.Z, orientation.W, state", *rows]) + "\n")
    read = opened(path, StatedFormat(axes="kinect"))
    np.testing.assert_allclose(positions_of(read), TRUE, atol=1e-6)
    assert read.people.time_ns[-1] == pytest.approx(29 * FRAME_NS, abs=2000)
    assert "numbers of joints are read as those of kinect_v2" in read.warnings[0]
    assert "are read as" not in "".join(read.warnings[1:])


def test_a_calm_joint_in_centimetres_is_not_taken_for_unseen(tmp_path):
    """Whole centimetres, a trunk that moves by some centimetres in a second, and limbs that wave."""
    waving = moving(KINECT_V2, 120)
    waving[:, KINECT_V2.root] = TRUE[0, KINECT_V2.root] + np.linspace(0.0, 0.05, 120)[:, None]
    waving += (
        np.sin(np.arange(120))[:, None, None] * np.where(np.arange(25) == KINECT_V2.root, 0.0, 0.05)[:, None]
    )
    read = opened(write_view(tmp_path / "a.csv", KINECT_V2, np.rint(100.0 * waving)))
    assert "keep" not in "".join(read.warnings)
    assert (read.people.skeletons.states == 2).all()


@pytest.mark.parametrize("people", [1, 2])
def test_feet_at_a_constant_place_in_whole_centimetres_are_unseen(tmp_path, people):
    path = tmp_path / "a.csv"
    walking = TRUE + np.random.default_rng(1).normal(0.0, 0.02, (FRAMES, 1, 3))
    feet = [k for k, name in enumerate(KINECT_V2.joints) if name.startswith("Foot")]
    lines = []
    for person in range(people):
        whole = np.rint(100.0 * (walking + person))
        whole[:, feet] = 30, 90, 140
        header, *rows = write_view(path, KINECT_V2, whole).read_text().splitlines()
        lines += [row.replace(",0,", f",{person},", 1) for row in rows]
    path.write_text("\n".join([header, *lines]) + "\n")
    seen = opened(path).people.skeletons.states.any(axis=0)
    assert np.flatnonzero(~seen).tolist() == feet


def test_people_without_a_column_body_are_refused(tmp_path):
    path = tmp_path / "a.csv"
    lines = write_view(path, KINECT_V2, TRUE).read_text().splitlines()
    other = [line.replace(",tracked", "5,tracked") for line in lines[1:]]
    both = [re.sub(r"^([^,]*),[^,]*", r"\1", line) for line in [*lines, *other]]
    path.write_text("\n".join(both) + "\n")
    with pytest.raises(
        DeviceError, match="There is no column body: name the one that distinguishes people so"
    ):
        opened(path)


def test_bodies_that_are_not_there_are_left_out(tmp_path):
    """Kinect v2's SDK has six bodies in every frame; those that are not tracked have zeros and id 0."""
    path = tmp_path / "a.csv"
    lines = write_view(path, KINECT_V2, TRUE).read_text().splitlines()
    others = [re.sub(r",0,(\w+),.*", r",0,\1,0,0,0,not_tracked", line) for line in lines[1:]]
    seen = [line.replace(",0,", ",72057594037931101,", 1) for line in lines[1:]]
    late = seen[5 * len(KINECT_V2) :]  # the person is seen in fewer frames than the others are logged
    path.write_text("\n".join([lines[0], *others, *others, *others, *late]) + "\n")
    read = opened(path)
    assert read.people.ids == ["72057594037931101"]
    np.testing.assert_allclose(positions_of(read), TRUE[5:], atol=1e-6)
    assert len(read.people) == FRAMES
