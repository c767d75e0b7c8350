"""Files with a row for all joints of a person, such as HEAD_x,HEAD_y,HEAD_z: they say what long files say."""

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from devices.sensor import DeviceError
from devices.skeletons.csv_files.reader import read_csv
from devices.skeletons.file_sensor import SkeletonRecording
from devices.skeletons.stated_format import StatedFormat
from fusion.body import AZURE_KINECT, BODIES, KINECT_V2
from tests.helpers.command_line import duplex, one_line
from tests.helpers.two_views import FRAME_NS, moving
from viewer_app.flags import in_flags

SPELLINGS = {
    "PELVIS (x)": lambda joint, axis: f"{joint} ({axis})",
    "SpineBase_X": lambda joint, axis: f"{joint}_{axis.upper()}",
    "ShoulderLeftX": lambda joint, axis: f"{joint}{axis.upper()}",
    "pelvis_x": lambda joint, axis: f"{joint.lower()}_{axis}",
    "PELVIS.x": lambda joint, axis: f"{joint}.{axis}",
    "Pelvis_pos_x": lambda joint, axis: f"{joint.title()}_pos_{axis}",
    "K4ABT_JOINT_PELVIS_x_m": lambda joint, axis: f"K4ABT_JOINT_{joint}_{axis}_m",
}
STATES = {  # of a joint's column and of a long file's: both names, and the values
    "none": None,
    "c": (" (c)", "confidence", ("0", "1", "2")),
    "conf": ("_Conf", "conf", ("0", "1", "2", "0.5")),
    "flag": ("_confidence", "confidence", ("0", "1")),
    "words": (".TrackingState", "TrackingState", ("NotTracked", "Inferred", "Tracked")),
    "state": ("_state", "state", ("not_tracked", "inferred", "tracked", "")),
    "inferred": ("_inferred", "inferred", ("0", "1")),
    "only inferred": ("_is_inferred", "inferred", ("True",)),
}
OTHERS = ("{}_qw", "{}_tracked", "{}_color_x", "{}_color_y", *(f"{{}}_world_{a}_cm" for a in "xyz"))
"""Further columns that only some joints have."""
JOINTS = KINECT_V2.joints
TIMES = [str(t * FRAME_NS // 1000) for t in range(99)]


@dataclass(frozen=True)
class Drawn:
    """How one recording is written."""

    body: str
    joints: float  # the share that is there
    frames: int
    people: int
    spelling: str
    states: str
    separator: str
    decimal_comma: bool
    by_axis: bool  # all x, then all y, then all z
    others: bool
    head: tuple[str, str]
    seed: int


DRAWN = st.builds(
    Drawn,
    st.sampled_from(list(BODIES)),
    st.floats(0.25, 1.0),
    st.integers(3, 6),
    st.integers(1, 3),
    st.sampled_from(list(SPELLINGS)),
    st.sampled_from(list(STATES)),
    st.sampled_from([",", ";", "\t"]),
    st.booleans(),
    st.booleans(),
    st.booleans(),
    st.sampled_from([("timestamp", "body_idx"), ("Time_us", "BodyID"), ("time", "Index")]),
    st.integers(0, 2**32),
)


def tables(drawn):
    """The rows of a wide and of a long file of one recording, and the numbers of the wide one's places."""
    random = np.random.default_rng(drawn.seed)
    body, spell, states = BODIES[drawn.body], SPELLINGS[drawn.spelling], STATES[drawn.states]
    there = random.permutation(len(body))[: max(5, round(drawn.joints * len(body)))]
    joints = [body.joints[k] for k in there]
    kinds = [*"xyz", *(["state"] if states else [])]
    order = [(j, kind) for kind in kinds for j in joints] if drawn.by_axis else []
    order = order or [(j, kind) for j in joints for kind in random.permutation(kinds)]
    names = {(j, kind): spell(j, kind) if kind in "xyz" else j + states[0] for j, kind in order}
    lost = [name for name in body.joints if name not in joints][:1] * drawn.others
    extra = [each.format(j) for j in joints[:3] for each in OTHERS] if drawn.others else []
    extra += [spell(j, axis) for j in lost for axis in "xy"]
    wide = [[*drawn.head, *extra, *names.values()]]
    long = [[*drawn.head, "joint", *"xyz", *([states[1]] if states else [])]]
    for time in TIMES[: drawn.frames]:
        for person in random.permutation(drawn.people)[: random.integers(1, drawn.people + 1)]:
            person = 0 if drawn.head[1] == "Index" else person  # no person's id
            cells = {}
            for j, kind in order:
                values = states[2] if kind == "state" else ("", "nan", "0")
                place = kind != "state" and random.random() < 0.9
                cells[j, kind] = f"{random.normal():.4f}" if place else str(random.choice(values))
            wide.append([time, str(person), *["7"] * len(extra), *cells.values()])
            long += [[time, str(person), j, *(cells[j, kind] for kind in kinds)] for j in joints]
            if drawn.head[1] == "Index":
                break
    return wide, long, list(names.values())


def write(path, rows, separator=",", comma=False):
    comma = comma and separator != ","
    header, *rest = (separator.join(row) for row in rows)
    text = "\n".join([header, *(row.replace(".", ",") if comma else row for row in rest)]) + "\n"
    path.write_text(text, encoding="utf-8")
    return path


@given(drawn=DRAWN, block=st.sampled_from([-1, 50, 400, 3000]))
def test_a_wide_file_says_what_a_long_one_says(tmp_path, drawn, block):
    wide, long, names = tables(drawn)
    read, expected = (
        read_csv(write(tmp_path / "a.csv", rows, drawn.separator, drawn.decimal_comma), block=block)
        for rows in (wide, long)
    )
    assert read.points.body is expected.points.body
    assert (list(read.ids), read.warnings) == (list(expected.ids), expected.warnings)
    for name in ("time_ns", "frame", "person"):
        np.testing.assert_array_equal(getattr(read, name), getattr(expected, name))
    for values, others in zip(read.view[:3], expected.view[:3], strict=True):
        np.testing.assert_array_equal(values, others)
    unused = {*wide[0]} - {*names, drawn.head[0]} - ({drawn.head[1]} - {"Index"})
    assert {*read.ignored} - {*expected.ignored} == unused - {*expected.ignored}


@given(drawn=DRAWN, row=st.integers(0, 99), column=st.integers(0, 999), block=st.sampled_from([-1, 50, 3000]))
def test_a_wrong_number_is_named_with_its_line_and_column(tmp_path, drawn, row, column, block):
    wide, _, names = tables(drawn)
    suffix = (STATES[drawn.states] or "-")[0]
    places = [k for k, name in enumerate(wide[0]) if name in names and not name.endswith(suffix)]
    row, column = 1 + row % (len(wide) - 1), places[column % len(places)]
    wide[row][column] = "one"
    with pytest.raises(DeviceError) as refused:
        read_csv(write(tmp_path / "a.csv", wide, drawn.separator), block=block)
    expected = f", line {row + 1}: {wide[0][column]} must be a number; got 'one'."
    assert str(refused.value).endswith(expected)


def walk(body=AZURE_KINECT, frames=8):
    noise = np.random.default_rng(0).normal(0.0, 0.005, (frames, len(body), 3))
    return moving(body, frames) + noise


def write_master(path, positions, confidence=True):
    """As the recorder of a pair of Azure Kinects writes (T, J, 3) positions of one person."""
    kinds = "cxyz" if confidence else "xyz"
    rows = [["timestamp", "body_idx", *(f"{j} ({kind})" for j in AZURE_KINECT.joints for kind in kinds)]]
    for time, at in zip(map(str, range(0, 33333 * len(positions), 33333)), positions * 1e3, strict=True):
        cells = [f"{v:.6f}" for v in at.ravel()]
        each = [["2"] * confidence + cells[k : k + 3] for k in range(0, len(cells), 3)]
        rows.append([time, "1", *(cell for joint in each for cell in joint)])
    return write(path, rows, ";")


@given(
    wide=st.booleans(), state=st.sampled_from([None, "2", "tracked"]), by_axis=st.booleans(),
    digits=st.sampled_from([0, 4]), data=st.data(),
)  # fmt: skip
def test_a_file_cut_off_anywhere_in_its_last_row_is_refused(tmp_path, wide, state, by_axis, digits, data):
    """Complete but for the newline, which some writers leave out, it is read."""
    at = walk(KINECT_V2) * (1.0 if digits else 1e3)
    kinds = [*([] if state is None else ["state"]), *"xyz"]
    order = [(j, k) for k in kinds for j in JOINTS] if by_axis else [(j, k) for j in JOINTS for k in kinds]
    lines = [["time_us", *(f"{j}_{k}" for j, k in order)] if wide else ["time_us", "joint", *kinds]]
    for time, places in zip(TIMES, at, strict=False):
        cells = {
            (j, k): f"{v:.{digits}f}"
            for j, p in zip(JOINTS, places, strict=True)
            for k, v in zip("xyz", p, strict=True)
        }
        cells |= {(j, "state"): state for j in JOINTS}
        each = [[time, *(cells[of] for of in order)]] if wide else []
        lines += each or [[time, j, *(cells[j, k] for k in kinds)] for j in JOINTS]
    path = write(tmp_path / "a.csv", lines, ";")
    whole = path.read_text(encoding="utf-8")[:-1]
    path.write_text(whole, encoding="utf-8")
    read_csv(path)
    lost = data.draw(st.integers(1, len(whole) - whole.rindex("\n") - 2))
    path.write_text(whole[:-lost], encoding="utf-8")
    with pytest.raises(DeviceError, match=r"cut off|number"):
        read_csv(path)


def test_points_of_a_table_of_names_may_be_wide(tmp_path):
    theirs = {"SpineBase": "Hips", "AnkleLeft": "LeftFoot", "KneeLeft": "LeftLeg", "KneeRight": "RightLeg"}
    labels = [theirs.get(joint, joint if joint in ("Head", "Neck") else f"end {joint}") for joint in JOINTS]
    at = walk(KINECT_V2)
    rows = [["time_us", "joint", *"xyz"]]
    for time, places in zip(TIMES, at, strict=False):
        rows += [[time, j, *(f"{v:.6f}" for v in p)] for j, p in zip(labels, places, strict=True)]
    wide = [["time_us", *(f"mixamorig:{label}_{axis}" for label in labels for axis in "xyz")]]
    wide += [[time, *(f"{v:.6f}" for v in p.ravel())] for time, p in zip(TIMES, at, strict=False)]
    read = [
        SkeletonRecording(write(tmp_path / f"{len(each)}.csv", each), StatedFormat(names="mixamo"))
        for each in (wide, rows)
    ]
    with read[0] as one, read[1] as other:
        assert one.body is other.body
        assert other.people.skeletons.states[0].sum() >= 2 * (len(theirs) + 2)
        for values, expected in zip(one.people.skeletons[:3], other.people.skeletons[:3], strict=True):
            np.testing.assert_array_equal(values, expected)


REFUSED = {
    "no time": (lambda rows: [row[1:] for row in rows], "no column time_us. Columns"),
    "four joints": (lambda rows: [row[:14] for row in rows], "no column joint, x, y, z. Columns"),
    "a column twice": (lambda rows: [[*row, row[3]] for row in rows], "repeats a column name"),
    "a row twice": (lambda rows: [*rows, rows[-1]], "has two rows in one frame, the second in line 10."),
    "rows sorted wrong": (lambda rows: [*rows[:3], rows[5], *rows[3:5], *rows[6:]], "goes back in line 5;"),
    "no rows": (lambda rows: rows[:1], "has a header and no rows"),
    "commas": (
        lambda rows: [rows[0], *([v.replace(".", ",") for v in row] for row in rows[1:])],
        "If its numbers have decimal commas, separate the columns by semicolons",
    ),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_wide_files_that_are_wrong_are_told_in_one_line(tmp_path, kind, capsys):
    change, words = REFUSED[kind]
    good = write_master(tmp_path / "good.csv", walk(), confidence=False)
    rows = [line.split(";") for line in good.read_text(encoding="utf-8").splitlines()]
    path = write(tmp_path / "a.csv", change(rows))
    try:
        told = " ".join(read_csv(path).warnings)
    except DeviceError as error:
        told = str(error)
        assert duplex("fuse", path, good, "--no-viewer") == 2
        assert one_line(capsys) == in_flags(f"duplex: {told}\n")
    assert words in told
