"""``duplex info`` of recordings and of motion capture; of sessions see test_session_commands."""

import numpy as np
import pytest

from devices.skeletons.stated_format import AXES
from fusion.body import KINECT_V2
from tests.helpers.command_line import duplex
from tests.helpers.motion_capture import write_c3d, write_trc
from tests.helpers.recorded_pairs import write_view
from tests.helpers.two_views import moving

FEET = [KINECT_V2.joint(f"Foot{side}") for side in ("Left", "Right")]


def told(capsys, *arguments):
    """The rows that were printed, by name, and the code and errors."""
    code = duplex("info", *arguments)
    printed = capsys.readouterr()
    rows = (line.strip().partition("  ") for line in printed.out.splitlines())
    return {name: value.strip() for name, _, value in rows}, code, printed.err


@pytest.fixture
def recording(tmp_path):
    """Of millimetres, feet that were never seen, a column that is ignored, and a pause of two seconds."""
    positions = 1e3 * (moving(KINECT_V2, 40) + np.random.default_rng(0).normal(0.0, 0.005, (40, 25, 3)))
    positions[:, FEET] = 0.0
    path = write_view(tmp_path / "a.csv", KINECT_V2, positions)
    header, *rows = path.read_text().splitlines()
    cells = [row.split(",") for row in rows]
    late = [[str(int(row[0]) + 2_000_000 * (k >= 500)), *row[1:]] for k, row in enumerate(cells)]
    path.write_text("\n".join([f"{header},remark", *(f"{','.join(row)},none" for row in late)]) + "\n")
    return path


def test_what_is_in_a_recording_of_skeletons(recording, capsys):
    rows, code, _ = told(capsys, recording)
    assert code == 0
    assert rows["joints"] == "23 of 25 of kinect_v2"
    assert rows["never seen"] == "FootLeft, FootRight"
    assert rows["people"] == "'0' in 40 frames"
    assert rows["frames"] == "40 in 3.30 s, 30.0 per second"
    assert rows["gaps"] == "1, of 2.03 s at 0.63 s"
    assert rows["unit"].startswith("millimetres; the person is 2.6")
    assert rows["mirror image"] == "unknown, without feet or trunk"
    assert rows["ignored"] == "columns remark"
    assert "are read as millimetres" in rows["note"]
    assert rows["fuse it"] == f"duplex fuse {recording} OTHER.csv --unit mm --save s.rrd"
    rows, code, _ = told(capsys, recording, "--unit", "mm")
    assert "note" not in rows
    assert rows["fuse it"].endswith("--unit mm --save s.rrd")


@pytest.mark.parametrize("axes", AXES)
def test_the_axes_of_another_program_are_recognised(tmp_path, capsys, axes):
    theirs = moving(KINECT_V2, 20) + np.random.default_rng(0).normal(0.0, 0.005, (20, 25, 3))
    sources = [part.strip("-") for part in AXES[axes].split(",")]
    signs = [-1.0 if part.startswith("-") else 1.0 for part in AXES[axes].split(",")]
    written = np.stack(
        [theirs[..., sources.index(axis)] * signs[sources.index(axis)] for axis in "xyz"], axis=-1
    )
    path = write_view(tmp_path / "a.csv", KINECT_V2, written)
    rows, code, _ = told(capsys, path)
    assert code == 0
    assert rows["axes"] == axes
    assert rows["mirror image"] == "no"
    assert rows["fuse it"] == f"duplex fuse {path} OTHER.csv --axes {axes} --save s.rrd"


def test_a_recording_that_cannot_be_read_is_described_and_says_why(recording, capsys):
    recording.write_text(recording.read_text().replace("joint", "bone_of", 1))
    rows, code, errors = told(capsys, recording)
    assert code == 2
    assert rows["begins with"] == ascii(recording.read_text()[:60])
    assert rows["format"].endswith("it cannot be read")
    assert "no column joint" in errors
    other = recording.with_suffix(".txt")
    other.write_text("a\n")
    rows, code, errors = told(capsys, other)
    assert (code, rows["file"]) == (2, "a.txt, 0 kB")
    assert ".txt is not a format that can be read" in errors


@pytest.mark.parametrize("write", [write_c3d, write_trc])
def test_what_is_in_motion_capture(tmp_path, capsys, write):
    path = tmp_path / {"write_c3d": "t.c3d", "write_trc": "t.trc"}[write.__name__]
    points = np.random.default_rng(0).normal(0.0, 800.0, (50, 2, 3))
    points[:, 1] = np.nan
    rows, code, _ = told(capsys, write(path, ("LASI", "RASI"), np.arange(50) / 120.0, points))
    assert code == 0
    assert rows["points"] == "2: LASI, RASI"
    assert rows["never seen"] == "RASI"
    assert rows["frames"] == "50 in 0.41 s, 120.0 per second"
    assert rows["compare it"] == f"duplex compare s.rrd {path}"


def test_what_is_in_a_recording_of_images(shared, capsys):
    rows, code, _ = told(capsys, shared / "azure" / "recording.mkv")
    assert code == 0
    assert rows["sensor"].endswith("NFOV_UNBINNED, standalone")
    assert rows["recorded"] == "2020-08-31T15:20:37.000000Z"
    assert "5 frames per second, as the file states" in rows["duration"]
