# ruff: noqa: E501, E731
"""The border behind all readers: a good file as programs write it, and files with one thing wrong."""

import json
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from devices.sensor import DeviceError
from devices.skeletons.file_sensor import SkeletonRecording
from devices.skeletons.stated_format import StatedFormat
from fusion.body import AZURE_KINECT, KINECT_V2
from tests.helpers.two_views import FRAME_NS, moving

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
