"""Files as they come, drawn at random of a known recording: what is read is right, or a line says why."""

import json
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from devices.sensor import DeviceError
from devices.skeletons.csv_files.reader import read_csv
from devices.skeletons.file_sensor import SkeletonRecording
from devices.skeletons.stated_format import METRES, StatedFormat
from fusion.body import AZURE_KINECT, BODIES, KINECT_V2
from tests.helpers.command_line import duplex, one_line
from tests.helpers.two_views import FRAME_NS, moving
from viewer_app.flags import in_flags

FRAMES, INTERVAL_NS = 45, 33_333_333
LIMBS = {
    "feet": ("foot",),
    "legs": ("foot", "ankle", "knee"),
    "legs and hips": ("foot", "ankle", "knee", "hip"),
    "hands": ("hand", "thumb"),
    "an arm": ("elbowleft", "wristleft", "handleft", "handtipleft", "thumbleft"),
}
UNSEEN = {
    "zeros": ("0", "0", "0", "0"),
    "zeros that count as tracked": ("0", "0", "0", "2"),
    "empty": ("", "", "", ""),
    "NaN": ("NaN", "nan", "N/A", "0"),
    "a constant place": ("0.25", "0.5", "1.5", "2"),
    "behind": ("-1", "-1", "-1", "2"),
    "far": ("99999", "99999", "99999", "2"),
}
TIMES = {
    "time_us": lambda ns: str(ns // 1000),
    "time_ms": lambda ns: f"{ns / 1e6:.3f}",
    "time_s": lambda ns: f"{ns / 1e9:.6f}",
    "time_ns": str,
    "time": lambda ns: str(ns // 100),
    "Timestamp": lambda ns: f"{ns / 1e6:.2f}",
    "timestamp_usec": lambda ns: str(ns // 1000),
    "Relative Time (ticks)": lambda ns: str(ns // 100),
    "t": lambda ns: f"{ns / 1e9:.4f}",
    "Ticks": lambda ns: str(638_000_000_000_000_000 + ns // 100),
    "file_time": lambda ns: str(133_000_000_000_000_000 + ns // 100),
    "device_time": lambda ns: str(round(ns * 0.06)),
    "clock": lambda ns: str(ns),
    "DateTime": lambda ns: (datetime(2026, 11, 25, 12) + timedelta(microseconds=ns // 1000)).isoformat(),
    "time_of_day": lambda ns: str(timedelta(microseconds=ns // 1000)),
    "seconds": lambda ns: f"{(86_399.5 + ns / 1e9) % 86_400:.6f}",
    "time_us in ticks": lambda ns: str(ns // 100),
    "time_us in milliseconds": lambda ns: f"{ns / 1e6:.1f}",
    "time_us in 60 MHz": lambda ns: str(round(ns * 0.06)),
    "time_ms in eighths": lambda ns: str(round(ns / 125_000)),
    "time_s in exponent form": lambda ns: f"{1.7e9 + ns / 1e9:.4E}",
    "frame": lambda ns: str(ns // INTERVAL_NS),
    "time_s in whole seconds": lambda ns: str(ns // 10**9),
}
STATES = {
    "": None,
    "state": ("not_tracked", "inferred", "tracked"),
    "TrackingState": ("NotTracked", "Inferred", "Tracked"),
    "confidence": ("0", "1", "2"),
    "Confidence": ("None", "Low", "Medium"),
    "is_inferred": ("0", "1", "0"),  # whether there is a position decides on the rest
    "joint_score": ("0.1", "0.45", "0.97"),
}


SPELLINGS = {
    "PELVIS (x)": lambda joint, axis: f"{joint} ({axis})",
    "SpineBase_X": lambda joint, axis: f"{joint}_{axis.upper()}",
    "ShoulderLeftX": lambda joint, axis: f"{joint}{axis.upper()}",
    "pelvis_x": lambda joint, axis: f"{joint.lower()}_{axis}",
    "PELVIS.x": lambda joint, axis: f"{joint}.{axis}",
    "Pelvis_pos_x": lambda joint, axis: f"{joint.title()}_pos_{axis}",
    "K4ABT_JOINT_PELVIS_x": lambda joint, axis: f"K4ABT_JOINT_{joint}_{axis}",
}
"""Columns of a file that has a row for all joints of a person."""


@dataclass(frozen=True)
class Drawn:
    """A way in which a file may be written."""

    body: str
    unit: str
    limb: str
    unseen: str
    time: str
    state: str
    lines: int  # how often each frame is logged
    gap: bool  # of ten minutes
    separator: str
    decimal_comma: bool
    two_people: bool
    spelling: str
    by_axis: bool  # all x, then all y, then all z
    seed: int


DRAWN = st.builds(
    Drawn,
    st.sampled_from(["kinect_v1", "kinect_v2", "azure_kinect"]),
    st.sampled_from(list(METRES)),
    st.sampled_from(list(LIMBS)),
    st.sampled_from(list(UNSEEN)),
    st.sampled_from(list(TIMES)),
    st.sampled_from(list(STATES)),
    st.sampled_from([1, 1, 2, 3]),
    st.booleans(),
    st.sampled_from([",", ";", "\t"]),
    st.booleans(),
    st.booleans(),
    st.sampled_from(list(SPELLINGS)),
    st.booleans(),
    st.integers(0, 2**32),
)


LOST = ("time_s in exponent form", "time_s in whole seconds")
"""These times tell frames apart no more."""


def scene(drawn, body):
    """Times (T,), positions (T, J, 3) and states (T, J) of the first person; (J,) which joints are unseen."""
    random = np.random.default_rng(drawn.seed)
    truth = moving(body, FRAMES, drawn.seed % 7) + random.normal(0.0, 0.005, (FRAMES, len(body), 3))
    times = np.arange(FRAMES, dtype=np.int64) * INTERVAL_NS
    times[FRAMES // 2 :] += 600_000_000_000 * drawn.gap
    plain = [name.lower().replace("_", "") for name in body.joints]
    unseen = np.array([any(part in name for part in LIMBS[drawn.limb]) for name in plain])
    states = random.choice([1, 2], (FRAMES, len(body)), p=[0.1, 0.9])
    return times, truth, states, unseen


def places(drawn, truth, states, unseen, t, person):
    """The cells x, y, z, state of each joint of a person in frame t."""
    for joint, hidden in enumerate(unseen):
        place = (truth[t, joint] + [0.8 * person, 0.0, 0.5 * person]) / METRES[drawn.unit][0]
        yield UNSEEN[drawn.unseen] if hidden else (*(f"{v:.6f}" for v in place), str(states[t, joint]))


def expected(times, truth, states, unseen):
    """What a reader should give of the first person."""
    truth[:, unseen] = np.nan
    states[:, unseen] = 0
    return times, truth, states


def as_csv(drawn, path, wide=False):
    """Writes a file; the times (T,), positions (T, J, 3) and states (T, J) of its first person."""
    body = BODIES[drawn.body]
    times, truth, states, unseen = scene(drawn, body)
    words = STATES[drawn.state]
    rows = [[drawn.time.split(" in ")[0], "body", "joint", *"xyz", *([drawn.state] if words else [])]]
    for t, time in enumerate(times):
        for again in range(drawn.lines):
            told = TIMES[drawn.time](int(time + again * INTERVAL_NS // drawn.lines))
            for person in range(1 + drawn.two_people):
                cells = places(drawn, truth, states, unseen, t, person)
                for name, (*at, seen) in zip(body.joints, cells, strict=True):
                    rows.append([told, f"{person}", name, *at, *([words[int(seen or 0)]] if words else [])])
    if wide:  # a row for all joints of a person
        header, *rest = rows
        order = list(product(range(len(body)), range(3, len(header))))
        order = sorted(order, key=lambda place: place[1]) if drawn.by_axis else order
        spell = SPELLINGS[drawn.spelling]
        prefixed = drawn.spelling.startswith("K4ABT")  # then all of a joint's columns are
        names = (
            spell(body.joints[j], header[k]) if k < 6 or prefixed else f"{body.joints[j]}_{header[k]}"
            for j, k in order
        )
        rows = [[header[0], "body", *names]]
        for n in range(0, len(rest), len(body)):
            rows.append([*rest[n][:2], *(rest[n + j][k] for j, k in order)])
    comma = drawn.decimal_comma and drawn.separator != ","
    header, *rest = rows
    rows = [
        [cell.replace(".", ",") if comma and (wide or k != 2) else cell for k, cell in enumerate(row)]
        for row in rest
    ]
    path.write_text("\n".join(map(drawn.separator.join, [header, *rows])) + "\n", encoding="utf-8")
    times, truth, states = expected(times, truth, states, unseen)
    return times, truth, states if words and drawn.state != "joint_score" else np.where(states, 2, 0)


WHOLE_TIMES = [name for name in TIMES if name not in LOST and TIMES[name](0).isdigit()]
"""Those that are whole numbers, as timestamp_usec is."""


def numbers(at):
    return [float("nan" if cell in ("", "N/A") else cell) for cell in at]


def as_json(drawn, path):
    """The same as offline_processor writes it: whole times, no states."""
    body = BODIES[drawn.body]
    times, truth, states, unseen = scene(drawn, body)
    frames = []
    for t, time in enumerate(times):
        for again in range(drawn.lines):
            told = int(TIMES[drawn.time](int(time + again * INTERVAL_NS // drawn.lines)))
            people = range(1 + drawn.two_people)
            cells = [places(drawn, truth, states, unseen, t, person) for person in people]
            bodies = [
                {"body_id": person, "joint_positions": [numbers(at) for *at, _ in cells[person]]}
                for person in people
            ]
            frames.append({"timestamp_usec": told, "num_bodies": len(bodies), "bodies": bodies})
    path.write_text(json.dumps({"joint_names": body.joints, "frames": frames}), encoding="utf-8")
    times, truth, states = expected(times, truth, states, unseen)
    return times, truth, np.where(states, 2, 0)


def as_skeleton(drawn, path):
    """The same as NTU RGB+D has it: of a Kinect v2, in its axes, without times, with some blank lines."""
    body = BODIES["kinect_v2"]
    times, truth, states, unseen = scene(replace(drawn, gap=False), body)
    lines = [str(FRAMES)]
    for t in range(FRAMES):
        lines += [""] * drawn.decimal_comma + [str(1 + drawn.two_people)]
        for person in range(1 + drawn.two_people):
            lines += [f"{person} 0 1 1 1 1 0 0.1 0.2 2", "25"]
            for *at, state in places(drawn, truth, states, unseen, t, person):
                x, y, z = numbers(at)
                lines.append(f"{-x} {-y} {z} 0 0 0 0 0 0 0 1 {state.replace('N/A', '') or 0}")
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return expected(times, truth, states, unseen)


def is_right(read, times, truth, states):
    """Whether the first person's frames are those of the recording, but for one time added to all."""
    view = read.people.view(("0",))
    if len(view.time_ns) != FRAMES or (view.states != states).any():
        return False
    off_ns = np.ptp(view.time_ns - times)
    return off_ns < 3_000_000 and np.nanmax(np.abs(view.positions - truth)) < 1e-4


def in_digits(drawn, time):
    """The same with times that are whole numbers; a frame's number that is there twice is refused."""
    return replace(drawn, time=time, lines=1 if time == "frame" else drawn.lines)


SOURCES = {
    "long.csv": as_csv,
    "wide.csv": lambda drawn, path: as_csv(drawn, path, wide=True),
    "a.json": as_json,
    "a.skeleton": as_skeleton,
}


@pytest.mark.parametrize("source", SOURCES)
@given(drawn=DRAWN, time=st.sampled_from(WHOLE_TIMES))
def test_one_capture_is_read_the_same_from_every_source_or_refused(tmp_path, source, drawn, time):
    """Law 2 of issue 59: with any clock, in any unit and spelling, whatever is not seen."""
    drawn = in_digits(drawn, time) if source == "a.json" else drawn
    recorded = SOURCES[source](drawn, tmp_path / source)
    if source.endswith("csv") and drawn.time in LOST:
        words = "[Aa] column named frame that counts them is enough"
        with pytest.raises(DeviceError, match=words), SkeletonRecording(tmp_path / source):
            pass
        return
    with SkeletonRecording(tmp_path / source) as recording:
        assert is_right(recording.content, *recorded)


# --- Files with a row for all joints of a person, such as HEAD_x,HEAD_y,HEAD_z: they say what long files say.


JOINTS = KINECT_V2.joints
TIMES_US = [str(t * FRAME_NS // 1000) for t in range(99)]


def write_rows(path, rows, separator=","):
    path.write_text("\n".join(map(separator.join, rows)) + "\n", encoding="utf-8")
    return path


def walking(body=AZURE_KINECT, frames=8):
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
    return write_rows(path, rows, ";")


@given(
    wide=st.booleans(), state=st.sampled_from([None, "2", "tracked"]), by_axis=st.booleans(),
    digits=st.sampled_from([0, 4]), data=st.data(),
)  # fmt: skip
def test_a_file_cut_off_anywhere_in_its_last_row_is_refused(tmp_path, wide, state, by_axis, digits, data):
    """Complete but for the newline, which some writers leave out, it is read."""
    at = walking(KINECT_V2) * (1.0 if digits else 1e3)
    kinds = [*([] if state is None else ["state"]), *"xyz"]
    order = [(j, k) for k in kinds for j in JOINTS] if by_axis else [(j, k) for j in JOINTS for k in kinds]
    lines = [["time_us", *(f"{j}_{k}" for j, k in order)] if wide else ["time_us", "joint", *kinds]]
    for time, places in zip(TIMES_US, at, strict=False):
        cells = {
            (j, k): f"{v:.{digits}f}"
            for j, p in zip(JOINTS, places, strict=True)
            for k, v in zip("xyz", p, strict=True)
        }
        cells |= {(j, "state"): state for j in JOINTS}
        each = [[time, *(cells[of] for of in order)]] if wide else []
        lines += each or [[time, j, *(cells[j, k] for k in kinds)] for j in JOINTS]
    path = write_rows(tmp_path / "a.csv", lines, ";")
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
    at = walking(KINECT_V2)
    rows = [["time_us", "joint", *"xyz"]]
    for time, places in zip(TIMES_US, at, strict=False):
        rows += [[time, j, *(f"{v:.6f}" for v in p)] for j, p in zip(labels, places, strict=True)]
    wide = [["time_us", *(f"mixamorig:{label}_{axis}" for label in labels for axis in "xyz")]]
    wide += [[time, *(f"{v:.6f}" for v in p.ravel())] for time, p in zip(TIMES_US, at, strict=False)]
    read = [
        SkeletonRecording(write_rows(tmp_path / f"{len(each)}.csv", each), StatedFormat(names="mixamo"))
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
    good = write_master(tmp_path / "good.csv", walking(), confidence=False)
    rows = [line.split(";") for line in good.read_text(encoding="utf-8").splitlines()]
    path = write_rows(tmp_path / "a.csv", change(rows))
    try:
        told = " ".join(read_csv(path).warnings)
    except DeviceError as error:
        told = str(error)
        assert duplex("fuse", path, good, "--no-viewer") == 2
        assert one_line(capsys) == in_flags(f"duplex: {told}\n")
    assert words in told
