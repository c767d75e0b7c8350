"""Skeleton files as other programs and accidents leave them: read, or refused with a line that helps."""

import gzip
import os
import re

import numpy as np
import pytest

from devices.recorded.two_recordings import RecordingChoice, read_two
from devices.sensor import DeviceError
from devices.skeletons.file_sensor import SkeletonRecording
from devices.skeletons.stated_format import StatedFormat
from fusion.body import AZURE_KINECT, BLAZEPOSE, KINECT_V2
from tests.helpers.command_line import duplex, one_line
from tests.helpers.recorded_pairs import REAL, write_recordings, write_view
from tests.helpers.two_views import A_FROM_B, moving
from viewer_app.flags import in_flags


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    noise = np.random.default_rng(0).normal(0.0, 0.005, (20, len(KINECT_V2), 3))
    return write_view(tmp_path_factory.mktemp("good") / "a.csv", KINECT_V2, moving(KINECT_V2, 20) + noise)


def rewritten(text, change):
    """The file with the cells of each row changed; the first row has number 0."""
    header, *rows = text.splitlines()
    cells = (change(k, row.split(",")) for k, row in enumerate(rows))
    return "\n".join([header, *(",".join(row) for row in cells)]) + "\n"


def with_xyz(value):
    return lambda text: rewritten(text, lambda _, c: [*c[:3], value, value, value, *c[6:]])


def with_commas(text):
    return text.replace(".", ",")


@pytest.mark.parametrize("before", [True, False])
@pytest.mark.parametrize("place", ["", "p", "position_", "Camera", "pos_"])
@pytest.mark.parametrize("other", ["r", "euler_", "w", "dir.", "angle_", ("x", "y")])
def test_columns_beside_a_place_are_not_taken_for_it(good, tmp_path, before, place, other):
    """Angles, axes and directions; x and y alone are pixels."""
    header, *rows = good.read_text().splitlines()
    names, of_place = header.split(","), [f"{place}{axis}" for axis in "xyz"]
    more = list(other) if isinstance(other, tuple) else [f"{other}{axis}" for axis in "xyz"]
    if set(more) & set(of_place):
        pytest.skip("a column twice")
    lines = []
    for k, row in enumerate([",".join(names), *rows]):
        cells = row.split(",")
        given = of_place if k == 0 else cells[3:6]
        values = more if k == 0 else ["77.5"] * len(more)
        middle = values + given if before else given + values
        lines.append(",".join(cells[:3] + middle + cells[6:]))
    path = tmp_path / "a.csv"
    path.write_text("\n".join(lines) + "\n")
    with SkeletonRecording(path) as read, SkeletonRecording(good) as wanted:
        for one, other_frame in zip(read.frames(), wanted.frames(), strict=True):
            ((_, a),), ((_, b),) = one.people.items(), other_frame.people.items()
            np.testing.assert_array_equal(a.positions, b.positions)


def test_two_places_that_may_be_the_joints_are_named(good, tmp_path):
    header, *rows = good.read_text().splitlines()
    names = header.replace("x,y,z", "local_x,local_y,local_z,eye_x,eye_y,eye_z")
    path = tmp_path / "a.csv"
    path.write_text("\n".join([names, *(",".join([*c[:6], *c[3:]]) for c in (r.split(",") for r in rows))]))
    with pytest.raises(DeviceError, match="may be local_x or eye_x; name its columns x, y and z"):
        read_two(RecordingChoice(path), RecordingChoice(good))


REFUSED = {
    "empty": (lambda _: "", "is empty"),
    "blank": (lambda _: "\n \n", "is empty"),
    "header only": (lambda text: text.splitlines()[0] + "\n", "a header and no rows"),
    "all NaN": (with_xyz("nan"), "no joint has a position in any frame"),
    "all zero": (with_xyz("0"), "no joint has a position in any frame"),
    "all infinite": (with_xyz("inf"), "no joint has a position in any frame"),
    "a time that is no number": (
        lambda text: rewritten(text, lambda k, c: ["nan" if k == 30 else c[0], *c[1:]]),
        "line 32: time_us must be a number; got 'nan'",
    ),
    "a time twice": (
        lambda text: text + text.splitlines()[1] + "\n",
        "two rows in one frame, the second in line 502. Are two",
    ),
    "a clock reset": (
        lambda text: rewritten(text, lambda k, c: [str(int(c[0]) - 333_333 * (k >= 250)), *c[1:]]),
        "two rows in one frame, the second in line 252. Are two recordings",
    ),
    "empty lines, a bad state": (
        lambda text: text.replace("\n", "\n\n").replace("tracked", "maybe"),
        "line 3: state 'maybe'",
    ),
    "decimal commas": (
        lambda text: rewritten(text, lambda _, c: [*c[:3], *(with_commas(v) for v in c[3:6]), *c[6:]]),
        "line 2: .* does not have 7 columns. If its numbers have decimal commas, separate",
    ),
    "Latin-1": (lambda text: text.replace(",0,", ",José,", 1).encode("latin-1"), "byte 37, in line 2. Save"),
    "UTF-16": (lambda text: text.encode("utf-16"), "UTF-16; save it as UTF-8"),
    "gzip": (lambda text: gzip.compress(text.encode()), "compressed by gzip; unpack it first"),
    "a session": (lambda _: b"RRF2" + bytes(40), "look at it with duplex review"),
    "a video": (lambda _: b"\x1aE\xdf\xa3" + bytes(40), "must end in .mkv"),
    "JSON": (lambda _: '{"joint_names": []}\n', "This looks like JSON: name it .json"),
    "a hole": (lambda text: text.encode() + bytes(5000), "is damaged: zero bytes in line 502"),
    "the least integer": (
        lambda text: rewritten(text, lambda k, c: [str(-(2**63)), *c[1:]] if k == 0 else c),
        "time_us goes beyond",
    ),
    "noise": (lambda _: bytes(range(128, 256)), "not text in UTF-8: byte 1, in line 1"),
    "a wide table": (lambda _: "time,head_x\n1,2\n", "no column joint, x, y, z"),
    "kilometres": (
        lambda text: rewritten(
            text, lambda _, c: [*c[:3], *(f"{float(v) / 1e3:.9f}" for v in c[3:6]), *c[6:]]
        ),
        "the unit of the positions is unclear; the person would be 0.0",
    ),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_files_that_cannot_be_used_are_refused_in_one_line(tmp_path, good, kind, capfd):
    make, message = REFUSED[kind]
    content = make(good.read_text(encoding="utf-8"))
    odd = tmp_path / "odd.csv"
    odd.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(DeviceError, match=message) as refused, SkeletonRecording(odd, StatedFormat(side="b")):
        pass
    assert duplex("fuse", good, odd, "--no-viewer") == 2
    assert capfd.readouterr().err == in_flags(f"duplex: {refused.value}\n")


def test_what_is_not_a_file_is_refused(tmp_path):
    (tmp_path / "folder.csv").mkdir()
    os.mkfifo(tmp_path / "pipe.csv")  # opened, it would be waited for without end
    with (tmp_path / "hole.csv").open("wb") as hole:
        hole.truncate(2_000_000_000)
    for name, message in (
        ("folder.csv", "it is a folder"),
        ("pipe.csv", "it is not a file"),
        ("hole.csv", "it contains zero bytes"),
        ("none.csv", "No file"),
    ):
        with pytest.raises(DeviceError, match=message), SkeletonRecording(tmp_path / name):
            pass


@pytest.mark.skipif(not hasattr(os, "getuid") or os.getuid() == 0, reason="root may read every file")
def test_a_file_without_permission_is_refused(tmp_path, good):
    secret = tmp_path / "a.csv"
    secret.write_bytes(good.read_bytes())
    secret.chmod(0)
    with pytest.raises(DeviceError, match="cannot be read: Permission denied"), SkeletonRecording(secret):
        pass


def test_the_unit_of_nobody_is_asked_for(tmp_path):
    nobody = write_view(tmp_path / "a.csv", KINECT_V2, 0.1 * moving(KINECT_V2, 3))
    with pytest.raises(DeviceError, match="State it with `unit`"), SkeletonRecording(nobody):
        pass


def test_impossible_positions_are_counted(tmp_path, good):
    def spoil(row, cells):
        return {7: [*cells[:3], "inf", *cells[4:]], 9: [*cells[:5], "1e300", *cells[6:]]}.get(row, cells)

    odd = tmp_path / "odd.csv"
    odd.write_text(rewritten(good.read_text(encoding="utf-8"), spoil), encoding="utf-8")
    with SkeletonRecording(odd) as read:
        assert read.warnings == [
            f"{odd}: 2 positions are impossible and count as not tracked, first in line 9, x = inf m. "
            "Each coordinate must be within 20 m, and z above 0."
        ]
        assert next(read.frames()).people["0"].has_position.sum() == len(KINECT_V2) - 2


def test_frames_out_of_order_are_sorted_with_a_warning(tmp_path, good):
    odd = tmp_path / "odd.csv"
    header, *rows = good.read_text(encoding="utf-8").splitlines()
    odd.write_text("\n".join([header, *rows[250:], *rows[:250]]) + "\n", encoding="utf-8")
    with SkeletonRecording(odd) as read:
        assert read.warnings == [f"{odd}: the time goes back in line 252; the frames were sorted by time."]
        times = [frame.time_ns for frame in read.frames()]
    assert times == sorted(times)


def test_one_recording_twice_is_refused(tmp_path):
    a, _ = write_recordings(tmp_path)
    copy = tmp_path / "copy.csv"
    copy.write_bytes(a.read_bytes())
    for other in (a, tmp_path / "." / "a.csv", copy):
        with pytest.raises(DeviceError, match="are the same recording"):
            read_two(RecordingChoice(a), RecordingChoice(other))
    empty = tmp_path / "empty_a.csv", tmp_path / "empty_b.csv"
    for path in empty:
        path.write_text("")
    with pytest.raises(DeviceError, match=r"empty_a\.csv is empty"):
        read_two(*map(RecordingChoice, empty))
    with pytest.raises(DeviceError, match="is a folder, not a recording"):
        read_two(RecordingChoice(tmp_path), RecordingChoice(tmp_path))


def write_seen(path, body, view, leave_out):
    """A recording without the joints whose names match."""
    write_view(path, body, view)
    lines = path.read_text(encoding="utf-8").splitlines()
    rows = [line for line in lines if not re.search(leave_out, line.split(",")[2])]
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")
    return path


TRUNK_AND_MORE = r"PELVIS|SPINE|NECK|CLAVICLE|TIP|THUMB|NOSE|EYE|EAR|HEEL"


@pytest.mark.parametrize(
    ("body", "missing_in_a", "missing_in_b", "stated", "found"),
    [
        (BLAZEPOSE, "nothing", "HEEL", "", "blazepose"),
        (BLAZEPOSE, "HEEL", "nothing", "", "blazepose"),
        (AZURE_KINECT, "nothing", TRUNK_AND_MORE, "", "azure_kinect"),
        (BLAZEPOSE, TRUNK_AND_MORE, TRUNK_AND_MORE, "blazepose", "blazepose"),
        (BLAZEPOSE, TRUNK_AND_MORE, TRUNK_AND_MORE, "", "kinect_v1"),
    ],
)
def test_the_body_is_that_of_both_files_together(tmp_path, body, missing_in_a, missing_in_b, stated, found):
    truth = moving(body, 70)
    views = {"a": (truth, missing_in_a), "b": (A_FROM_B.inverse().apply(truth), missing_in_b)}
    files = [write_seen(tmp_path / f"{s}.csv", body, *of) for s, of in views.items()]
    read = read_two(*(RecordingChoice(path, body=stated) for path in files))
    assert read.body.name == found
    assert any("State the family of yours with `body`." in said for said in read.warnings) == (
        found == "kinect_v1"
    )
    elbow = read.body.joint("ELBOW_LEFT")
    for view, (expected, _) in zip(read.pairing.pairs.skeletons.views, views.values(), strict=True):
        np.testing.assert_allclose(
            view.positions[:, elbow], expected[:, body.joint("ELBOW_LEFT")], rtol=0, atol=1e-6
        )
        assert (view.states[:, elbow] == 2).all()


def test_a_number_of_too_many_digits_is_refused_in_one_line(tmp_path, capsys):
    a, _ = write_recordings(tmp_path)
    (tmp_path / "b.json").write_text('{"joint_names": ' + 5000 * "1" + "}", encoding="utf-8")
    assert duplex("fuse", a, tmp_path / "b.json", "--no-viewer") == 2
    assert "is not complete JSON" in one_line(capsys)


@pytest.mark.parametrize("name", REAL)
def test_real_recordings_give_no_warning(shared, name):
    folder = shared / "real" / f"kinect_v2_90deg_{name}"
    with SkeletonRecording(folder / "a.csv") as a, SkeletonRecording(folder / "b.csv") as b:
        assert (*a.warnings, *b.warnings) == ()


@pytest.mark.parametrize("frames", [1, 2])
def test_few_frames_are_fused_and_nothing_is_claimed(tmp_path, frames, capsys):
    for path in write_recordings(tmp_path):
        lines = path.read_text(encoding="utf-8").splitlines()
        path.write_text("\n".join(lines[: 1 + frames * len(KINECT_V2)]) + "\n", encoding="utf-8")
    assert duplex("fuse", tmp_path / "a.csv", tmp_path / "b.csv", "--no-viewer") == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "unknown: calibrated on" in said
    assert "at least 15 are needed" in said
