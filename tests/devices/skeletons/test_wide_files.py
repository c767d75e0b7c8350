"""Files with a row for all joints of a person, such as HEAD_x,HEAD_y,HEAD_z: they say what long files say."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from devices.sensor import DeviceError
from devices.skeletons.csv_files.reader import read_csv
from devices.skeletons.file_sensor import SkeletonRecording
from devices.skeletons.stated_format import StatedFormat
from fusion.body import AZURE_KINECT, KINECT_V2
from tests.helpers.command_line import duplex, one_line
from tests.helpers.two_views import FRAME_NS, moving
from viewer_app.flags import in_flags

JOINTS = KINECT_V2.joints
TIMES = [str(t * FRAME_NS // 1000) for t in range(99)]


def write(path, rows, separator=","):
    path.write_text("\n".join(map(separator.join, rows)) + "\n", encoding="utf-8")
    return path


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
    "a word": (
        lambda rows: [*rows[:3], [*rows[3][:4], "one", *rows[3][5:]], *rows[4:]],
        "line 4: PELVIS (z) must be a number; got 'one'",
    ),
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
