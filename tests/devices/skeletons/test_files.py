# ruff: noqa: E501, E731
"""Skeleton files as programs and accidents leave them: read, or refused with a line that helps."""

import gzip
import json
import os
import re
from dataclasses import dataclass

import numpy as np
import pandas
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from devices.recorded.two_recordings import RecordingChoice, read_two
from devices.sensor import DeviceError
from devices.skeletons.file_sensor import SkeletonRecording
from devices.skeletons.name_tables import READY_MADE, fitting_table, name_table
from devices.skeletons.stated_format import StatedFormat
from devices.skeletons.times import TIME_COLUMNS, find_time_unit
from fusion.body import AZURE_KINECT, BLAZEPOSE, BODIES, KINECT_V1, KINECT_V2
from recordings import Session, fuse
from tests.helpers.command_line import duplex, one_line
from tests.helpers.recorded_pairs import REAL, assert_same_session, write_recordings, write_view
from tests.helpers.two_views import A_FROM_B, FRAME_NS, moving
from viewer_app.batch.worker import fuse_job
from viewer_app.flags import in_flags

FRAMES, JOINTS = 30, KINECT_V2.joints
TRUE = moving(KINECT_V2, FRAMES) + np.random.default_rng(0).normal(0.0, 0.005, (FRAMES, len(JOINTS), 3))
FEET = [k for k, name in enumerate(JOINTS) if name[:3] == "Foo"]
UNITS = {"m": (1.0, 6), "cm": (1e2, 4), "mm": (1e3, 3)}
STATES = {
    "state": "012", "State": ("NotTracked", "Inferred", "Tracked"), "TrackingState": ("0.0", "1.0", "2.0"),
    "tracking_state": ("TrackingState.NotTracked", "TrackingState.Inferred", "TrackingState.Tracked"),
    "confidence": "013", "Confidence Level": ("NONE", "low", "Medium"),
    "joint_confidence": tuple(f"K4ABT_JOINT_CONFIDENCE_{word}" for word in ("NONE", "LOW", "HIGH")),
}  # fmt: skip
SPELLED = {
    "time_us": "Timestamp (us)", "body": "TrackingId", "joint": "JointType", "x": "Position.X", "y": "Position.Y",
    "z": "Position.Z",
}  # fmt: skip


def table(at=TRUE, digits=6, person="0", state="tracked"):
    """The columns of a file by name."""
    t, joint = np.divmod(np.arange(at.shape[0] * len(JOINTS)), len(JOINTS))
    columns = {"time_us": [str(k * FRAME_NS // 1000) for k in t], "body": [person] * len(t)}
    columns["joint"] = [JOINTS[k] for k in joint]
    columns |= {axis: [f"{v:.{digits}f}" for v in at[..., k].ravel()] for k, axis in enumerate("xyz")}
    return columns | ({"state": [state] * len(t)} if state else {})


def text(columns, separator=","):
    rows = [list(columns), *map(list, zip(*columns.values(), strict=True))]
    return "\n".join(separator.join(row) for row in rows) + "\n"


def read(folder, content, name="a.csv", **stated):
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with SkeletonRecording(path, StatedFormat(**stated)) as recording:
        return recording.content


@given(data=st.data())
def test_whatever_a_program_writes_around_a_good_table_is_read_the_same(tmp_path, data):
    pick = lambda *of: data.draw(st.sampled_from(of))
    unit, how, separator = pick(*UNITS), pick(None, *STATES), pick(",", ";", "\t", ", ")
    scale, digits = UNITS[unit]
    columns, states = table(scale * TRUE, digits, state=""), np.full((FRAMES, len(JOINTS)), 2)
    if how:
        states = np.random.default_rng(data.draw(st.integers(0, 9))).choice([0, 1, 2, 2, 2], states.shape)
        columns[how] = [STATES[how][k] for k in states.ravel()]
    name = pick("{0}", "{1}", "joint{1}", "Body0_{0}", "Bob:{0}")
    columns["joint"] = [name.format(of, JOINTS.index(of)) for of in columns["joint"]]
    if pick(False, True):
        columns = {"": list(map(str, range(len(columns["joint"]))))} | columns
    if pick(False, True):
        del columns["body"]
    if pick(False, True):
        columns["hand_state"] = ["open"] * len(columns["joint"])
    if separator in (";", "\t") and pick(False, True):
        columns |= {axis: [value.replace(".", ",") for value in columns[axis]] for axis in "xyz"}
    if pick(False, True):
        words = pick("Position.", "real.", "pose_")
        columns = {SPELLED.get(name, name).replace("Position.", words): of for name, of in columns.items()}
    order = data.draw(st.permutations(list(columns)))
    lines = text({name: columns[name] for name in order}, separator).splitlines()
    if pick(False, True):
        lines = [lines[0], *(line for line in lines[1:] for _ in range(2))]
    if separator != ", " and pick(False, True):
        lines = [
            "".join(f'{separator}"{c}"' for c in line.split(separator))[len(separator) :] for line in lines
        ]
    elif pick(False, True):
        lines = [line + separator.strip(" ") for line in lines]
    if pick(False, True):
        lines[9:9] = ["# a pause"]
    lines = [*pick([], ["", ""], ["# by hand"], [f"sep={separator[0]}"], ["Recording", "of Ann"]), *lines]
    ending = pick("\n", "\r\n")
    found = read(tmp_path, pick("", "\ufeff") + ending.join(lines) + pick("", ending))
    np.testing.assert_allclose(
        found.people.skeletons.positions, np.where((states == 0)[..., None], np.nan, TRUE), atol=1e-5
    )
    np.testing.assert_array_equal(found.people.skeletons.states, states)
    assert np.ptp(found.people.time_ns - np.arange(FRAMES) * FRAME_NS // 1000 * 1000) == 0
    assert any("etres" in line for line in found.warnings) == (unit != "m")


def as_json(at=1e3 * TRUE, twice=-1, **changes):
    """As offline_processor writes it; `changes` of each frame."""
    frames = []
    for t, frame in enumerate(at.tolist()):
        bodies = [{"body_id": 1, "joint_positions": frame}] * (2 if t == twice else 1)
        of = {"timestamp_usec": t * FRAME_NS // 1000, "num_bodies": len(bodies), "bodies": bodies}
        frames.append(of | changes)
    return json.dumps({"joint_names": JOINTS, "frames": frames})


def as_skeleton(at=TRUE, count=FRAMES):
    """As NTU RGB+D has it."""
    lines = [count]
    for frame in at:
        joints = [f"{-x:.7f} {-y:.7f} {z:.7f} 0 0 0 0 0 0 0 0 2" for x, y, z in frame]
        lines += [1, "7 0 1 1 1 1 0 0.02 0.01 2", 25, *joints]
    return "\n".join(map(str, lines))


@given(
    slots=st.lists(st.sampled_from([0.0, np.nan, -1.0]), max_size=5),
    first=st.booleans(),
    unit=st.sampled_from([*UNITS]),
)
def test_slots_of_nobody_do_not_hide_the_axes_and_the_unit_of_the_person(tmp_path, slots, first, unit):
    """Programs log six bodies, whoever is there."""
    scale, digits = UNITS[unit]
    people = [scale * TRUE * (-1.0, -1.0, 1.0), *(np.full_like(TRUE, of) for of in slots)]
    files = [text(table(at, digits, str(k))) for k, at in enumerate(people)]
    header, rows = files[0].partition("\n")[0], [of.partition("\n")[2] for of in files]
    found = read(tmp_path, header + "\n" + "".join(rows if first else rows[::-1])).people
    np.testing.assert_allclose(found.view(("0",)).positions, TRUE, atol=1e-3)


@given(shares=st.lists(st.sampled_from([0.0, 0.6, 1.0]), min_size=1, max_size=3), rests=st.booleans())
def test_joints_at_one_place_are_unseen_and_joints_at_rest_are_not(tmp_path, shares, rests):
    """Of several people, in whole centimetres: the feet are in one place for a share of the frames, and all
    but the arms rest, to 4 mm."""
    rng, lines, expected = np.random.default_rng(0), [], []
    arms = [name.startswith(("Elbow", "Wrist", "Hand", "Thumb")) for name in JOINTS]
    sd = np.where(arms, 0.1, 0.004 if rests else 0.1)[:, None]
    for person, share in enumerate(shares):
        at = (
            moving(KINECT_V2, 100)[: 1 if rests else None]
            + person
            + sd * rng.normal(size=(100, len(JOINTS), 3))
        )
        unseen = rng.permutation(100) < 100 * share
        whole = np.rint(100.0 * at)
        whole[np.ix_(unseen, FEET)] = 30, 90, 140
        header, *rows = text(table(whole, 0, str(person))).splitlines()
        lines += rows
        expected.append(unseen)
    found = read(tmp_path, "\n".join([header, *lines]) + "\n", unit="cm", axes="x,y,z")
    for person, unseen in enumerate(expected):
        seen = found.people.view((str(person),)).states > 0
        np.testing.assert_array_equal(seen[:, FEET[0]], ~unseen)
        assert np.delete(seen, FEET, axis=1).all()


def test_many_ids_of_a_tracker_count_no_rows(tmp_path):
    rows = table()
    rows["body"] = [str(k // (2 * len(JOINTS))) for k in range(len(rows["body"]))]
    assert len(read(tmp_path, text(rows)).people.ids) == FRAMES // 2


@pytest.mark.parametrize("unseen", [(0.0, 0.0, 0.0), (0.0, 0.0, 30.0), (0.0, 0.0, -1.0), (np.nan, 1.0, 2.0)])
def test_a_mean_needs_all_its_points(tmp_path, unseen):
    header, *lines = text(table()).splitlines()
    for number, k in enumerate(range(JOINTS.index("HandLeft"), len(lines), len(JOINTS))):
        cells = lines[k].split(",")
        other = [*cells[:2], "HL2", *(map(str, unseen) if number % 2 else cells[3:6]), cells[6]]
        lines[k] = ",".join([*cells[:2], "HL1", *cells[3:]]) + "\n" + ",".join(other)
    (tmp_path / "names.toml").write_text('[joints]\nHandLeft = ["HL1", "HL2"]\n')
    found = read(tmp_path, "\n".join([header, *lines]), names=str(tmp_path / "names.toml"))
    at, hand = found.people.skeletons.positions[:, JOINTS.index("HandLeft")], JOINTS.index("HandLeft")
    assert np.isnan(at[1::2]).all()
    np.testing.assert_allclose(at[::2], TRUE[::2, hand], atol=1e-6)


def with_column(name, value):
    columns = table(state="")
    return text(columns | {name: [value(k) for k in range(len(columns["joint"]))]})


def of_thousands(separator, change):
    columns = table()
    return text(columns | {axis: [change(value) for value in columns[axis]] for axis in "xyz"}, separator)


WHOLE_JSON, NTU = as_json(), as_skeleton().splitlines()
WHOLE_MM = text(table(1e3 * TRUE, 0, state=""))
OTHER = {name: of[5 * len(JOINTS) :] for name, of in table(person="72057594037931101").items()}
ABSENT = text(table(np.zeros_like(TRUE), 0, state="not_tracked"))
TWO = [{name: of for name, of in table(TRUE + k).items() if name != "body"} for k in (0.0, 5.0)]
BONE = {"position": {"x": 0.0, "y": 1.0, "z": 2.0}, "confidence_level": 2}
PYK = json.dumps([{"id": 1, "skeleton": {"joints": [BONE] * len(AZURE_KINECT)}}])
DUMPED = "# timestamp, jointType, position.X, position.Y, position.Z, orientation.W, state\n" + "\n".join(
    f"{1e-6 * t * FRAME_NS:.4f}, {k}, {-x:.6f}, {-y:.6f}, {z:.6f}, 1, 2"
    for t, at in enumerate(TRUE) for k, (x, y, z) in enumerate(at)
)  # fmt: skip
UNCLEAR = r"whether the comma in '[12],\d\d\d' separates thousands is unclear"
REFUSED = {
    **{f"thousands {s!r}": (of_thousands(s, lambda v: f"{1000 * float(v):,.0f}"), UNCLEAR) for s in "\t;"},
    **{
        f"a point, too {s!r}": (of_thousands(s, lambda v: v.replace(".", "," if v[0] == "-" else ".")), r"there is '.*\..*', too")
        for s in "\t;"
    },
    "cut off": (WHOLE_MM[:-3], "seems to be cut off in its last line"),
    "gone": ("sep=,\n# by hand\n\n" + text(table()).replace("tracked", "gone", 7).replace("gone", "tracked", 6), "line 11: state 'gone'"),
    "no body": (text(TWO[0]) + text(TWO[1]).partition("\n")[2], "There is no column body: name the one that distinguishes"),
    "an id twice.json": (as_json(twice=4), "two rows in one frame, the second in frame 4"),
    "pyKinectAzure.json": (PYK, r"does not hold one object\). .* write a \.csv"),
    "documents.json": (f"{PYK}\n{PYK}", r"Extra data.*\). .* write a \.csv"),
    "a table.json": (text(table()), "is not JSON: it begins with 'time_us"),
    "a table.skeleton": (text(table()), "expected the number of frames"),
    "half.json": (WHOLE_JSON[: len(WHOLE_JSON) // 2], "not complete JSON"),
    "empty.json": ("", "is empty"),
    "noise.json": (bytes(range(256)), "not text"),
    "list.json": ("[]", "not as offline_processor"),
    "object.json": ("{}", "no 'joint_names'"),
    "pictures.json": (WHOLE_JSON.replace('"frames"', '"pictures"'), "no 'frames'"),
    "tail.json": (WHOLE_JSON.replace('"Head"', '"TAIL"'), "Unknown joint 'TAIL'"),
    "root twice.json": (WHOLE_JSON.replace('"SpineMid"', '"SpineBase"'), "names a joint twice"),
    "soon.json": (WHOLE_JSON.replace('"timestamp_usec": 33333,', '"timestamp_usec": "soon",'), "frame 1"),
    "a word.json": (WHOLE_JSON.replace('"joint_positions": [[', '"joint_positions": [["x", ', 1), "frame 0"),
    "empty.skeleton": ("", "is empty"),
    "cut.skeleton": ("\n".join(NTU[:20]), "cut off at line 21"),
    "a part.skeleton": ("\n".join([*NTU[:9], NTU[9][:30]]), "12 numbers"),
    "many.skeleton": ("\n".join(["many", *NTU[1:]]), "line 1: expected the number of frames; got .many."),
    "left.skeleton": ("\n".join([*NTU[:5], NTU[5].replace(" 0", " left", 1), *NTU[6:]]), "line 6: expected 12"),
    "20 joints.skeleton": ("\n".join([*NTU[:3], "20", *NTU[4:]]), "a body has 20 joints"),
    "a.txt": ("", r"Known: \.csv, \.json, \.skeleton; with images: \.mkv, \.bag, \.db3"),
    "no time": ("moment,body,joint,x,y,z\n0,0,Head,0,0,2\n", "no column time_us.*named frame that counts"),
    "a joint of nobody": ("time_us,body,joint,x,y,z\n0,0,Tail,0,0,2\n", "Unknown joint 'Tail'"),
}  # fmt: skip


@pytest.mark.parametrize("kind", REFUSED)
def test_files_with_one_thing_wrong_are_refused(tmp_path, kind):
    content, said = REFUSED[kind]
    with pytest.raises(DeviceError, match=said):
        read(tmp_path, content, kind if "." in kind else "a.csv")


@dataclass
class Told:
    """A file that is read with lines for the user."""

    content: str
    said: str
    more: object = lambda read: len(read.people) == FRAMES
    axes: str = "auto"


TOLD = {
    "whole millimetres": Told(WHOLE_MM, "millimetres"),
    "inferred": Told(with_column("inferred", lambda _: "2"), "'2', are no states: 0, 1, false, true. Every joint"),
    "visibility": Told(
        with_column("visibility", lambda k: str(k % 97 / 100)),
        "column visibility is ignored, because its values, such as '0.01', are no states",
        lambda read: read.ignored == ("visibility",) and (read.people.skeletons.states == 2).all(),
    ),
    "12 frames.skeleton": Told(as_skeleton(count=12), "it states 12 frames and has 30; all were read."),
    "2 bodies.json": Told(as_json(num_bodies=2), "frame 0 states 2 bodies and has 1"),
    "six bodies": Told(ABSENT + 2 * ABSENT.partition("\n")[2] + text(OTHER).partition("\n")[2], "", lambda read: (
        read.people.ids == ["72057594037931101"] and len(read.people) == FRAMES
        and np.allclose(read.people.skeletons.positions, TRUE[5:], atol=1e-6))),
    "dump_kinect_skeleton": Told(DUMPED, "read as the numbers of joints as those of kinect_v2", lambda read: (
        np.allclose(read.people.skeletons.positions, TRUE, atol=1e-6)
        and abs(read.people.time_ns[-1] - 29 * FRAME_NS) <= 2000 and "read as" not in "".join(read.warnings[1:])), "kinect"),
}  # fmt: skip


@pytest.mark.parametrize("kind", TOLD)
def test_what_is_odd_is_told(tmp_path, kind):
    of = TOLD[kind]
    found = read(
        tmp_path,
        of.content,
        kind if "." in kind else "a.csv",
        **({"axes": of.axes} if of.axes != "auto" else {}),
    )
    assert of.said in "\n".join(found.warnings)
    assert of.more(found)


# --- Skeleton files as other programs and accidents leave them: read, or refused with a line that helps.


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


UNUSABLE = {
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


@pytest.mark.parametrize("kind", UNUSABLE)
def test_files_that_cannot_be_used_are_refused_in_one_line(tmp_path, good, kind, capfd):
    make, message = UNUSABLE[kind]
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


# --- Files of other programs: their units of time, their axes, their names of the joints.


UNITY = np.diag([1, -1, 1])
"""From its axes to the sensor's, as its documentation has them."""


def changed(path, made, change):
    """Writes a recording with its table changed."""
    change(pandas.read_csv(path)).to_csv(made, index=False)
    return made


def turned(path, made, sensor_from):
    """Writes a recording in other axes."""

    def change(table):
        return table.assign(**dict(zip("xyz", np.linalg.solve(sensor_from, table[[*"xyz"]].T), strict=True)))

    return changed(path, made, change)


@pytest.mark.parametrize("interval", [300e-6, 0.001, 0.4, 1e9])
def test_an_interval_of_no_body_tracker_is_refused(interval):
    with pytest.raises(DeviceError, match="unit of time_us is unclear; in no unit is its usual interval"):
        find_time_unit("a.csv", "time_us", interval * np.arange(FRAMES))


UNITS_US = {"ns": 1e-3, "us": 1.0, "ms": 1e3, "s": 1e6, "ticks": 0.1, "60 MHz": 1 / 60, "1/8 ms": 125.0}


@given(
    unit_rate=st.tuples(st.sampled_from(list(UNITS_US)), st.sampled_from([15.0, 30.0, 60.0, 90.0]))
    | st.tuples(st.sampled_from(["ns", "us", "ms", "s"]), st.floats(5.0, 120.0)),
    column=st.sampled_from(list(TIME_COLUMNS)),
    start=st.floats(0.0, 1e5),
)
def test_a_rate_is_found_or_told(unit_rate, column, start):
    """By the column's unit or by another one: the true rate, or a line."""
    unit, rate = unit_rate
    assume(column != "time_ticks" or unit == "ticks")  # 5 per second in microseconds are 50 in ticks
    times = (start + np.arange(20) / rate) * 1e6 / UNITS_US[unit]
    try:
        us, clock, told = find_time_unit("a.csv", column, times)
    except DeviceError:
        return
    assert clock or told or us == pytest.approx(UNITS_US[unit])
    if column == "time" and rate in (15.0, 30.0):
        assert us == pytest.approx(UNITS_US[unit])


@given(
    milliseconds=st.permutations([32] * 26 + [34] * 16 + [35] * 8 + [66] * 3 + [500]),
    unit=st.sampled_from(["ticks", "60 MHz"]),
)
def test_stamps_in_whole_milliseconds_tell_their_unit(milliseconds, unit):
    """Kinect v2: most often 32 ms from frame to frame, which is 31 per second by the median."""
    us, clock, _ = find_time_unit("a.csv", "time_us", np.cumsum(milliseconds) * 1e3 / UNITS_US[unit])
    assert us == pytest.approx(UNITS_US[unit])
    assert clock


NAMES = """
[joints]
SpineBase = "Hips"
Head = ["crown", "chin"]
HandLeft = [["palm_l"], ["LeftHand"]]
"""
THEIRS = {"SpineBase": "Hips", "HandLeft": "LeftHand"}


def renamed(table):
    """Other names for two joints, two points for the head, and a point that is no joint."""
    head = table[table["joint"] == "Head"]
    up = head.assign(joint="Crown", y=head["y"] - 0.1)
    down = head.assign(joint="Chin", y=head["y"] + 0.1)
    ring = head.assign(joint="ring finger")
    rest = table[table["joint"] != "Head"].assign(joint=table["joint"].replace(THEIRS))
    return pandas.concat([rest, up, down, ring]).sort_values("time_us", kind="stable")


@pytest.fixture(scope="module")
def own_pair(tmp_path_factory):
    """A pair in seconds, Unity's axes and other names, and the session expected of it."""
    tmp_path = tmp_path_factory.mktemp("own")
    folder = tmp_path / "mine"
    folder.mkdir()
    expected = fuse(*write_recordings(tmp_path))
    for side in "ab":
        made = turned(tmp_path / f"{side}.csv", folder / f"{side}.csv", UNITY)
        table = renamed(pandas.read_csv(made))
        table.assign(time_us=table["time_us"] * 1e-6).rename(columns={"time_us": "time"}).to_csv(
            made, index=False
        )
    return folder, expected


def fused_here(jobs, _):
    """Instead of in other processes."""
    yield from map(fuse_job, jobs)


def test_files_of_another_program_are_fused_and_replayed(own_pair, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("viewer_app.batch.processes.run_in_processes", fused_here)
    folder, expected = own_pair
    a, b, names = folder / "a.csv", folder / "b.csv", tmp_path / "names.toml"
    names.write_text(NAMES, encoding="utf-8")
    stated = ["--axes", "x,-y,z", "--names", names]
    save = tmp_path / "s.rrd"
    assert duplex("fuse", a, b, "--no-viewer", *stated, "--save", save) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert said.count("time in seconds, so that there are 30 frames per second") == 2
    assert said.count("these points are no joints: ring finger.") == 2
    session = Session.open(save)
    np.testing.assert_allclose(session.fused, expected.fused, atol=1e-4)
    recorded = {"Head": [["crown", "chin"]], "SpineBase": [["Hips"]], "HandLeft": [["palm_l"], ["LeftHand"]]}
    assert json.loads(session.about["session"]["joint_names"][0]) == recorded
    assert duplex("replay", save, "--verify") == 0
    assert duplex("replay", save, "--no-viewer", "--save", tmp_path / "again.rrd") == 0
    assert Session.open(tmp_path / "again.rrd").about["session"]["axes"] == ("x,-y,z",)
    out = tmp_path / "out"
    for axes, code in (("x,-y,z", 0), ("x,-y,z", 0), ("unity", 2)):
        assert duplex("batch", folder, "--out", out, "--axes", axes, "--names", names) == code
    assert "was fused with another --axes" in one_line(capsys)
    assert_same_session(out / "mine" / "mine.rrd", save)
    names.write_text(NAMES.replace("chin", "crown"), encoding="utf-8")
    assert duplex("batch", folder, "--out", out, *stated) == 2
    assert "was fused with another --names" in one_line(capsys)


def test_a_ready_made_table_without_a_fitting_point_is_refused(tmp_path, good):
    path = changed(good, tmp_path / "a.csv", lambda table: table.assign(joint="p" + table["joint"]))
    with pytest.raises(DeviceError, match="by mixamo none of its points is a joint: pSpineBase, "):
        SkeletonRecording(path, StatedFormat(names="mixamo")).__enter__()


@pytest.mark.parametrize(
    "stated", [StatedFormat(axes="unity"), StatedFormat(names="mixamo")], ids=["axes", "names"]
)
@pytest.mark.parametrize("suffix", [".json", ".skeleton"])
def test_formats_with_axes_and_names_of_their_own_take_none(tmp_path, suffix, stated):
    path = tmp_path / f"a{suffix}"
    path.write_text("{}", encoding="utf-8")
    with pytest.raises(DeviceError, match=r"is for \.csv files"), SkeletonRecording(path, stated):
        pass


PLUG_IN_GAIT = """
    LFHD RFHD LBHD RBHD C7 T10 CLAV STRN LSHO LELB LWRA LWRB LFIN RSHO RELB RWRA RWRB RFIN
    LASI RASI LPSI RPSI LTHI LKNE LTIB LANK LHEE LTOE RTHI RKNE RTIB RANK RHEE RTOE
""".split()  # noqa: SIM905
GAIT2392 = """
    Sternum R.Acromium L.Acromium Top.Head R.ASIS L.ASIS V.Sacral R.Thigh.Upper R.Knee.Lat R.Knee.Med
    R.Ankle.Lat R.Ankle.Med R.Heel R.Toe.Tip L.Thigh.Upper L.Knee.Lat L.Knee.Med L.Ankle.Lat L.Ankle.Med
    L.Heel L.Toe.Tip
""".split()  # noqa: SIM905
MIXAMO = """
    Hips Spine Spine1 Spine2 Neck Head LeftShoulder LeftArm LeftForeArm LeftHand RightArm RightForeArm
    RightHand LeftUpLeg LeftLeg LeftFoot LeftToeBase RightUpLeg RightLeg RightFoot RightToeBase
""".split()  # noqa: SIM905


@pytest.mark.parametrize(
    ("table", "labels", "joints"),
    [
        ("plug-in-gait", [f"Subject:{name}" for name in PLUG_IN_GAIT], {"WRIST_LEFT": ["LWRA", "LWRB"]}),
        ("plug-in-gait", [*PLUG_IN_GAIT, "LFEO"], {"KNEE_LEFT": ["LFEO"], "KNEE_RIGHT": ["RKNE"]}),
        ("gait2392", [name.lower() for name in GAIT2392], {"KNEE_LEFT": ["L.Knee.Lat", "L.Knee.Med"]}),
        ("mixamo", [f"mixamorig:{name}" for name in MIXAMO], {"SHOULDER_LEFT": ["LeftArm"]}),
        ("mixamo", [f"mixamorig{name}" for name in MIXAMO], {"SHOULDER_LEFT": ["mixamorigLeftArm"]}),
        ("mixamo", [f"mixamorig1_{name}" for name in MIXAMO], {"HEAD": ["mixamorig1_Head"]}),
        ("bodies", KINECT_V2.joints, {"PELVIS": ["SpineBase"], "ELBOW_LEFT": ["ElbowLeft"]}),
    ],
)
def test_the_table_of_a_file_is_found_by_its_labels(table, labels, joints):
    found = fitting_table(AZURE_KINECT, labels)
    assert found.name == table
    points = found.points_of(AZURE_KINECT, labels)
    for joint, names in joints.items():
        short = [labels[k].rpartition(":")[2].lower() for k in points[AZURE_KINECT.joint(joint)]]
        assert short == [name.lower() for name in names]
    lateral = {"hip", "knee", "ankle", "shoulder"}
    assert {f"{part} {side}" for part in lateral for side in ("left", "right")} <= {
        AZURE_KINECT.joints[j].lower().replace("_", " ") for j in points
    }


@pytest.mark.parametrize("table", READY_MADE)
@pytest.mark.parametrize("body", BODIES.values(), ids=str)
def test_left_and_right_of_a_ready_made_table_are_mirror_images(table, body):
    names = name_table(table).joints
    labels = sorted({point for ways in names.values() for way in ways for point in way})
    found = name_table(table).points_of(body, labels)
    assert len(found) > 0
    for joint, own in found.items():
        other = found[int(body.mirror[joint])]
        if body.mirror[joint] != joint:
            assert own != other
            mine, others = (
                [re.sub(r"left|right|^[LR]", "", labels[k], flags=re.I) for k in points]
                for points in (own, other)
            )
            assert mine == others


def test_a_table_of_ones_own_weighs_points_and_takes_the_first_whole_alternative(tmp_path):
    path = tmp_path / "lab.toml"
    lines = '"hip left" = ["A", "A", "B"]', 'WristLeft = [["C", "D"], ["c"]]', 'EYE_LEFT = "E"'
    path.write_text("\n".join(["[joints]", *lines]))
    points = name_table(path).points_of(KINECT_V1, ["Head", "B", "C", "Bob:A"])
    assert points == {
        KINECT_V1.joint("HipLeft"): [3, 3, 1],
        KINECT_V1.joint("WristLeft"): [2],
        KINECT_V1.joint("Head"): [0],
    }


def test_of_two_subjects_a_table_names_one():
    labels = [f"{subject}:{name}" for subject in ("Ann", "Bob") for name in PLUG_IN_GAIT]
    assert fitting_table(AZURE_KINECT, labels).points_of(AZURE_KINECT, labels) == {}
    assert name_table("plug-in-gait").points_of(AZURE_KINECT, labels) == {}


def test_a_missing_table_is_named_with_the_ready_made_ones():
    with pytest.raises(DeviceError, match=r"No table of names 'vicon'.*plug-in-gait, gait2392, mixamo"):
        name_table("vicon")
