"""Each format read back by a library that is not ours."""

import re
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace
from typing import get_args
from xml.etree import ElementTree

import numpy as np
import pyarrow.csv
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fusion.body import BODIES, KINECT_V2
from fusion.calibration.bone_lengths import bone_lengths_of
from fusion.movement.angles import ANGLES, joint_angles
from fusion.rigid import RigidTransform
from fusion.setup import FuserSettings, Method
from recordings.appearance.floor import floor_under
from recordings.data.interpolation import positions_at
from recordings.errors import RecordingError, UnknownNameError
from recordings.export import writer_for
from recordings.export.bvh import _ORDERS, _best_orders, _continuous_angles
from recordings.export.even_frames import even_moments
from recordings.export.opensim_setup import MODEL
from recordings.export.tables import long_table, wide_table
from recordings.file.session_writer import write_session
from recordings.gait import SIDES
from recordings.session import Session
from tests.helpers.animations import bvh_joints
from tests.helpers.command_line import duplex
from tests.helpers.footfalls import walking_session
from tests.helpers.frame_pairs import frame_pairs
from tests.helpers.fused_runs import GAP, record_fused, record_with_a_gap
from tests.helpers.laws import COSTLY
from tests.helpers.machine import lacks
from tests.helpers.motion_capture import captured, true_positions
from tests.helpers.poses import posed
from tests.helpers.recalibrated import record_recalibrated
from tests.helpers.ros import OPTICAL, messages, nanoseconds, rosbags
from tests.helpers.two_views import calibration_of


def uneven(session, draw):
    """The first frames of a session at other times, with gaps; the first one has an S*."""
    steps = draw(st.lists(st.sampled_from([8_000_000, 33_333_333, 111_000_000]), min_size=8, max_size=40))
    steps[draw(st.integers(0, len(steps) - 1))] = 1
    times = np.cumsum([0, *steps])
    rows = session.rows[: len(times)]
    gone = np.zeros(len(times), dtype=bool)
    for begin, count in draw(st.lists(st.tuples(st.integers(0, 39), st.integers(1, 15)), max_size=3)):
        gone[begin : begin + count] = True
    gone[0] = False
    fused = np.where(gone[:, None, None], np.nan, rows.fused)
    return replace(session, rows=replace(rows, time_ns=times, fused=fused))


def write_person(opensim, folder):
    """Writes a model with a lumbar joint and limbs, whose joint centres are where markers.xml has them."""
    zero, inertia = opensim.Vec3(0), opensim.Inertia(0.1)
    model, bodies = opensim.Model(), {}
    model.setName("person")
    ends = {}
    for marker in ElementTree.parse(folder / "markers.xml").iter("Marker"):
        name = marker.find("socket_parent_frame").text.rpartition("/")[2]
        ends[marker.get("name")] = name, opensim.Vec3(*map(float, marker.find("location").text.split()))

    def add(name, parent, place, *axes):
        """A body that turns about axes by the coordinates of these names."""
        bodies[name] = opensim.Body(name, 1.0, zero, inertia)
        model.addBody(bodies[name])
        turns = opensim.SpatialTransform()
        for number, (axis, coordinate) in enumerate(axes):
            one = turns.getTransformAxis(number)
            one.setAxis(opensim.Vec3(*axis))
            if coordinate:
                one.setCoordinateNames(words(opensim, coordinate))
                one.set_function(opensim.LinearFunction(1.0, 0.0))
        model.addJoint(
            opensim.CustomJoint(f"to_{name}", bodies[parent], place, zero, bodies[name], zero, zero, turns)
        )

    bodies["pelvis"] = opensim.Body("pelvis", 1.0, zero, inertia)
    model.addBody(bodies["pelvis"])
    model.addJoint(opensim.FreeJoint("to_pelvis", model.getGround(), bodies["pelvis"]))
    above = ends["HipLeft"][1].get(0) - ends["ShoulderLeft"][1].get(0)  # shoulders are above the hips
    x, y, z = (1, 0, 0), (0, 1, 0), (0, 0, 1)
    lumbar = "L5_S1_Flex_Ext", "L5_S1_Lat_Bending", "L5_S1_axial_rotation"
    add("torso", "pelvis", opensim.Vec3(above, 0.1, 0), *zip((z, x, y), lumbar, strict=True))
    for side, letter, way in (("Left", "l", -1), ("Right", "r", 1)):
        outwards = z, (way, 0, 0), (0, way, 0)
        for trunk, upper, joint, names, lower, hinge, bends, axis in (
            (
                "pelvis",
                "femur",
                "Hip",
                ("hip_flexion", "hip_adduction", "hip_rotation"),
                "tibia",
                "Knee",
                "knee_angle",
                -1,
            ),
            (
                "torso",
                "humerus",
                "Shoulder",
                ("arm_flex", "arm_add", "arm_rot"),
                "radius",
                "Elbow",
                "elbow_flex",
                1,
            ),
        ):
            own = [f"{name}_{letter}" for name in names]
            add(f"{upper}_{letter}", trunk, ends[f"{joint}{side}"][1], *zip(outwards, own, strict=True))
            bent = ((0, 0, axis), f"{bends}_{letter}"), (x, ""), (y, "")
            add(f"{lower}_{letter}", f"{upper}_{letter}", ends[f"{hinge}{side}"][1], *bent)
    model.finalizeConnections()
    model.printToXML(str(folder / MODEL))


@pytest.fixture
def session(request, tmp_path):
    return record_with_a_gap(tmp_path / "s.rrd", getattr(request, "param", KINECT_V2))


OF_EVERY_BODY = pytest.mark.parametrize("session", BODIES.values(), indirect=True, ids=str)


def unseen(session, never):
    """The session, but no sensor ever saw some of the joints."""
    rows = session.rows
    states = {f"states_{view}": np.where(never, 0, getattr(rows, f"states_{view}")) for view in "ab"}
    return replace(session, rows=replace(rows, **states))


@pytest.mark.parametrize("suffix", [".bvh", ".c3d", ".glb", ".mcap", ".mot", ".trc", ""])
def test_a_session_without_a_fused_frame_is_not_written(session, tmp_path, suffix):
    none = replace(session, rows=replace(session.rows, fused=np.full_like(session.fused, np.nan)))
    with pytest.raises(RecordingError, match=r"nothing to export|installed"):
        none.export(tmp_path / f"none{suffix}")
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == [session.path]


def on_floor(session, positions):
    """Metres: x right, y up, z towards the sensor. test_animations.py has the floor on known truth."""
    return floor_under(session.rows).inverse().apply(positions) * [1.0, -1.0, -1.0]


def exported(session, name, **how):
    path = session.path.with_name(name)
    writer_for(path, **how)(session, path)
    return path


@pytest.mark.parametrize("seed", range(3))
def test_a_joint_that_was_never_seen_has_no_place_and_no_angle(session, seed):
    rows, random = session.rows, np.random.default_rng(seed)
    never = random.random(len(session.body)) < 0.2
    changed = unseen(session, never)
    assert changed.never_seen == tuple(np.array(session.body.joints)[never])
    table = long_table(changed).to_pandas()
    fused = table[table.skeleton == "fused"]
    np.testing.assert_array_equal(fused.state == "never_seen", np.tile(never, len(rows)))
    expected = np.where(never[:, None], np.nan, rows.fused)
    np.testing.assert_array_equal(fused[["x", "y", "z"]], expected.reshape(-1, 3))
    columns = [f"{joint}_{axis}" for joint in session.body.joints for axis in "xyz"]
    wide = wide_table(changed).to_pandas()[columns]
    np.testing.assert_array_equal(wide, expected.reshape(len(rows), -1))
    np.testing.assert_array_equal(changed.angles.degrees, joint_angles(session.body, expected, changed.up))


def test_a_joint_that_was_never_seen_is_a_gap_of_marker_files(session):
    ezc3d, pandas = pytest.importorskip("ezc3d"), pytest.importorskip("pandas")
    never = np.arange(len(session.body)) % 5 == 4
    changed = unseen(session, never)
    points = ezc3d.c3d(str(exported(changed, "s.c3d")))["data"]["points"]
    lines = pandas.read_csv(exported(changed, "s.trc"), sep="\t", skiprows=6, header=None)
    table = lines.iloc[:, 2:].to_numpy(dtype=float).reshape(-1, len(never), 3)
    for places in (points[:3].transpose(2, 1, 0), table):
        np.testing.assert_array_equal(np.isnan(places).all(axis=(0, 2)), never)


@pytest.mark.parametrize("name", ["s.csv", "s.npz", "s.NPZ"])
def test_export_says_whether_joints_that_were_never_seen_have_places(session, tmp_path, capsys, name):
    never = np.arange(len(session.body)) == len(session.body) - 1
    write_session(unseen(session, never), tmp_path / "never.rrd")
    assert duplex("export", tmp_path / "never.rrd", "--to", tmp_path / name) == 0
    (line,) = (line for line in capsys.readouterr().out.splitlines() if "No sensor ever saw" in line)
    if name.endswith("csv"):
        table = pyarrow.csv.read_csv(tmp_path / name).to_pandas()
        fused = table[(table.skeleton == "fused") & (table.joint == session.body.joints[-1])]
        has_places = fused[["x", "y", "z"]].notna().any(axis=None)
    else:
        with np.load(tmp_path / name) as arrays:
            has_places = np.isfinite(arrays["fused"][:, never]).any()
    assert ("places guessed by the bones" in line) == has_places


def test_long_csv_has_every_skeleton_in_k_a_s_frame(session):
    pandas = pytest.importorskip("pandas")
    table = pandas.read_csv(exported(session, "s.csv"))
    rows, T, J = session.rows, len(session), len(session.body)
    for name, expected in (("a", rows.positions_a), ("b", rows.b_in_a), ("fused", rows.fused)):
        part = table[table.skeleton == name]
        assert part.joint.tolist()[:J] == list(session.body.joints)
        np.testing.assert_allclose(part[["x", "y", "z"]].to_numpy().reshape(T, J, 3), expected, atol=1e-9)
    np.testing.assert_allclose(part.time_s.to_numpy()[::J], rows.time_ns * 1e-9, atol=1e-9)
    assert table[(table.frame == GAP[0]) & (table.skeleton == "fused")].x.isna().all()


def test_wide_csv_has_a_row_a_frame(session):
    pandas = pytest.importorskip("pandas")
    table = pandas.read_csv(exported(session, "s.csv", table="wide"))
    joint = session.body.joints[5]
    np.testing.assert_allclose(table[f"{joint}_y"].to_numpy(), session.rows.fused[:, 5, 1], atol=1e-9)
    np.testing.assert_allclose(table.time_s.to_numpy(), session.rows.time_ns * 1e-9, atol=1e-9)
    assert len(table.columns) == 2 + 3 * len(session.body) + len(ANGLES) + 3
    angles = joint_angles(session.body, session.fused, session.up)
    np.testing.assert_allclose(table[list(ANGLES)].to_numpy(), angles, atol=1e-9)
    assert table[["contact_left", "contact_right", "gait"]].isna().all(axis=None)


def test_a_walk_s_steps_are_in_the_wide_tables_and_in_npz(tmp_path):
    pandas = pytest.importorskip("pandas")
    session = walking_session(tmp_path / "s.rrd")
    events = {event for _, event in session.gait.events}
    assert len(events) == 4
    for name in ("s.csv", "s.parquet"):
        path = exported(session, name, table="wide")
        table = pandas.read_csv(path) if name == "s.csv" else pandas.read_parquet(path)
        told = table[table.gait.notna()]
        assert told.gait.tolist() == [event for _, event in session.gait.events]
        np.testing.assert_allclose(told.time_s, [seconds for seconds, _ in session.gait.events], atol=0.017)
        for side in SIDES:
            contact = session.gait.contact(side, session.time_ns * 1e-9)
            np.testing.assert_allclose(table[f"contact_{side}"], contact, atol=1e-9)
            assert {0.0, 1.0} <= set(np.round(contact[np.isfinite(contact)]))
    with np.load(exported(session, "s.npz")) as arrays:
        assert tuple(arrays["angle_names"]) == ANGLES
        np.testing.assert_array_equal(arrays["angles"], session.angles.degrees)
        assert arrays["steps"]["side"].tolist() == [step.side for step in session.gait.steps]
        np.testing.assert_array_equal(arrays["steps"]["strike"], [step.strike for step in session.gait.steps])


def test_strikes_and_toe_offs_are_events_of_a_c3d(tmp_path):
    c3d = pytest.importorskip("c3d")
    pytest.importorskip("ezc3d")
    session = walking_session(tmp_path / "s.rrd")
    with exported(session, "s.c3d").open("rb") as file:
        group = c3d.Reader(file).get("EVENT")
        minutes, seconds = np.ravel(group.get("TIMES").float_array).reshape(-1, 2).T
        labels, sides = (
            [str(each).strip() for each in group.get(name).string_array] for name in ("LABELS", "CONTEXTS")
        )
    names = {"Foot Strike": "heel_strike", "Foot Off": "toe_off"}
    told = [f"{names[label]}_{side.lower()}" for label, side in zip(labels, sides, strict=True)]
    assert told == [name for _, name in session.gait.events]
    expected = [at for at, _ in session.gait.events]
    np.testing.assert_allclose(60.0 * minutes + seconds, expected, atol=1e-4)


def read_mot(path):
    """The head of a .mot and its table."""
    lines = path.read_text(encoding="utf-8").split("\n")
    return dict(line.split("=") for line in lines[1:5]), pytest.importorskip("pandas").read_csv(
        path, sep="\t", skiprows=6
    )


@OF_EVERY_BODY
def test_mot_has_the_coordinates_of_opensim_s_model(session):
    head, table = read_mot(exported(session, "s.mot"))
    assert head == {
        "version": "1", "nRows": str(len(table)), "nColumns": str(len(table.columns)), "inDegrees": "yes",
    }  # fmt: skip
    seconds = even_moments(session.rows).time_ns * 1e-9
    np.testing.assert_allclose(table.time, seconds, atol=1e-6)
    present = np.isfinite(session.at(seconds)).all(axis=(1, 2))  # else in the gap
    places = on_floor(session, session.at(seconds))[present][..., [2, 1, 0]] * [1.0, 1.0, -1.0]
    table = table[present]
    angles = dict(
        zip(ANGLES, joint_angles(session.body, session.at(seconds)[present], session.up).T, strict=True)
    )
    np.testing.assert_allclose(table.knee_angle_r, angles["knee_flexion_right"], atol=1e-4)
    np.testing.assert_allclose(table.hip_adduction_l, -angles["hip_abduction_left"], atol=1e-4)
    # the pelvis turns about z, x and y; the hips are where the model's are, and the trunk is its long axis
    turned = Rotation.from_euler(
        "ZXY", table[["pelvis_tilt", "pelvis_list", "pelvis_rotation"]].to_numpy(), degrees=True
    )
    hips, shoulders = (
        places[:, [session.body.joint(f"{name} {side}") for side in SIDES]] for name in ("hip", "shoulder")
    )
    at = table[["pelvis_tx", "pelvis_ty", "pelvis_tz"]].to_numpy()
    model_s = turned.apply([-0.056276, -0.07849, 0.0])
    np.testing.assert_allclose(at + model_s, hips.mean(axis=1), atol=1e-5)
    trunk = shoulders.mean(axis=1) - hips.mean(axis=1)
    np.testing.assert_allclose(
        turned.apply([0.0, 1.0, 0.0]), trunk / np.linalg.norm(trunk, axis=1, keepdims=True), atol=1e-5
    )
    lateral = turned.inv().apply((hips + shoulders)[:, 1] - (hips + shoulders)[:, 0])
    assert (lateral[:, 2] > 0.0).all()  # z is the person's right
    np.testing.assert_allclose(lateral[:, 0], 0.0, atol=1e-5)


_ELBOW = np.array([0.226047, 0.022269, 0.973863])
_FOREARM = np.array([-0.015524, -0.248848, 0.039693])
"""Of Rajagopal's model as published: the axis of the right elbow, and from there to the wrist, metres."""


def _limb(row, names, side):
    """The upper bone and the frame of a limb of the model, in the ground."""
    outwards = [1.0, -1.0, -1.0] if side == "l" else [1.0, 1.0, 1.0]
    pelvis = Rotation.from_euler("ZXY", row[["pelvis_tilt", "pelvis_list", "pelvis_rotation"]], degrees=True)
    own = [row[f"{name}_{side}"] for name in names]
    limb = pelvis * Rotation.from_euler("ZXY", own * np.array(outwards), degrees=True)
    return limb, limb.apply([0.0, -1.0, 0.0])


def _apart(a, b):
    return np.degrees(np.arccos(np.clip(a @ b / np.linalg.norm(a) / np.linalg.norm(b), -1.0, 1.0)))


@given(data=st.data())
def test_a_mot_puts_bent_limbs_where_s_has_them(data, tmp_path_factory):
    """By forward kinematics of the published model, at whose wrists the elbow's axis is inclined."""
    walk, direction = _walk(), st.tuples(st.floats(-0.9, 0.9), st.floats(0.2, 1.0), st.floats(-0.9, 0.9))
    limbs = {}
    for upper, lower in (("Knee", "Ankle"), ("Elbow", "Wrist")):
        for side in SIDES:
            first = np.array(data.draw(direction, f"{upper} {side}"))
            aside = np.cross(first, data.draw(direction, f"axis of {upper} {side}"))
            assume(np.linalg.norm(aside) > 0.1)
            bend = np.radians(data.draw(st.floats(31.0, 110.0), f"bend of {upper} {side}"))
            turn = Rotation.from_rotvec(bend * aside / np.linalg.norm(aside))
            first = first / np.linalg.norm(first)
            limbs |= {f"{upper}{side.title()}": first, f"{lower}{side.title()}": turn.apply(first)}
    pose = np.broadcast_to(posed(walk.body, limbs), walk.fused.shape)
    session = replace(walk, rows=replace(walk.rows, fused=np.array(pose)))
    path = tmp_path_factory.mktemp("s") / "s.mot"
    session.export(path)
    row = read_mot(path)[1].iloc[0]
    at = on_floor(session, pose[0])[:, [2, 1, 0]] * [1.0, 1.0, -1.0]
    for side in SIDES:
        hip, knee, ankle, shoulder, elbow, wrist = (
            at[session.body.joint(f"{part} {side}")]
            for part in ("hip", "knee", "ankle", "shoulder", "elbow", "wrist")
        )
        leg, thigh = _limb(row, ("hip_flexion", "hip_adduction", "hip_rotation"), side[0])
        shin = leg.apply(
            Rotation.from_euler("z", -row[f"knee_angle_{side[0]}"], degrees=True).apply([0, -1, 0])
        )
        arm, upper_arm = _limb(row, ("arm_flex", "arm_add", "arm_rot"), side[0])
        mirror = np.array([1.0, 1.0, -1.0 if side == "left" else 1.0])
        bent = Rotation.from_rotvec(np.radians(row[f"elbow_flex_{side[0]}"]) * _ELBOW)
        forearm = arm.apply(mirror * bent.apply(_FOREARM))
        assert max(_apart(thigh, knee - hip), _apart(upper_arm, elbow - shoulder)) < 0.01
        assert _apart(shin, ankle - knee) < 0.01
        assert _apart(forearm, wrist - elbow) < 6.0


@given(data=st.data())
def test_opensim_s_files_have_an_even_rate_and_no_cell_that_it_cannot_read(data, tmp_path_factory):
    folder = tmp_path_factory.mktemp("s")
    session = uneven(_walk(), data.draw)
    moments = even_moments(session.rows).time_ns
    said = {name: session.export(folder / name) for name in ("s.trc", "s.mot")}
    rows = [line.split("\t") for line in (folder / "s.trc").read_text(encoding="utf-8").splitlines()[6:]]
    cells = np.array(rows, dtype=float)  # an empty cell is no number
    np.testing.assert_allclose(cells[:, 1], 1e-9 * moments, atol=1e-6)
    assert (np.diff(cells[:, 1]) > 0.0).all()
    known = np.isfinite(cells).all(axis=1)
    present = np.isfinite(session.fused).all(axis=(1, 2))
    for time_ns, has in zip(moments, known, strict=True):
        before, after = (
            session.time_ns[present & (session.time_ns <= time_ns)],
            session.time_ns[present & (session.time_ns >= time_ns)],
        )
        reached = len(before) and len(after) and after[0] - before[-1] <= 250_000_000
        assert has == bool(reached)
    head, table = read_mot(folder / "s.mot")
    assert int(head["nRows"]) == len(table) == known.sum()
    assert table.notna().all(axis=None)
    np.testing.assert_allclose(table.time, cells[known, 1], atol=1e-6)
    left = np.count_nonzero(~known)
    assert (f"; {left} in longer gaps are left out" in said["s.mot"]) == (left > 0)
    assert (f"; {left} in longer gaps are nan" in said["s.trc"]) == (left > 0)


@cache
def _walk():
    pairs = frame_pairs(KINECT_V2, 60, gap=(), jitter_ns=0)
    with TemporaryDirectory() as folder:
        return record_fused(Path(folder) / "s.rrd", pairs, calibration_of(KINECT_V2))


@pytest.mark.parametrize(
    ("joint", "gone"),
    [
        ("ankle left", {"knee_angle_l", "hip_rotation_l"}),
        ("wrist right", {"elbow_flex_r", "arm_rot_r"}),
        ("knee right", {"knee_angle_r", "hip_flexion_r", "hip_adduction_r", "hip_rotation_r"}),
    ],
)
def test_mot_has_no_column_of_an_angle_that_needs_a_joint_that_was_never_seen(session, joint, gone):
    never = np.arange(len(session.body)) == session.body.joint(joint)
    files = exported(session, "whole.mot"), exported(unseen(session, never), "s.mot")
    whole, left = (set(file.read_text(encoding="utf-8").split("\n")[6].split("\t")) for file in files)
    assert whole - left == gone
    assert left <= whole
    assert f"nColumns={len(left)}\n" in files[1].read_text(encoding="utf-8")


@OF_EVERY_BODY
@pytest.mark.parametrize("seed", range(3))
def test_set_ups_of_opensim_name_what_their_files_have(session, seed, tmp_path):
    never = np.random.default_rng(seed).random(len(session.body)) < 0.2
    unseen(session, never).export(tmp_path / "opensim")
    documents = {path.name: ElementTree.parse(path) for path in (tmp_path / "opensim").glob("*.xml")}
    scale, inverse = documents["scale.xml"], documents["inverse_kinematics.xml"]
    markers = {each.get("name") for each in documents["markers.xml"].iter("Marker")}
    kinds = ("hip", "knee", "ankle", "shoulder", "elbow", "wrist")
    joints = [session.body.joint(f"{kind} {side}") for kind in kinds for side in SIDES]
    assert markers == {session.body.joints[joint] for joint in joints if not never[joint]}
    assert {each.get("name") for each in inverse.iter("IKMarkerTask")} == markers
    assert {name for pair in scale.iter("markers") for name in pair.text.split()} <= markers
    table = read_mot(tmp_path / "opensim" / "fused.mot")[1]
    followed = [
        each for each in inverse.iter("IKCoordinateTask") if each.find("value_type").text == "from_file"
    ]
    assert {each.get("name") for each in followed} == set(table) & {
        f"{n}_{s}"
        for n in ("hip_flexion", "hip_adduction", "hip_rotation", "knee_angle", "elbow_flex", "arm_rot")
        for s in "lr"
    }
    begin, end = map(float, scale.find(".//time_range").text.split())
    measured = table.time[(table.time >= begin - 1e-6) & (table.time <= end + 1e-6)]
    assert np.diff(measured).max() < 0.04  # no gap
    assert len(measured) > len(table) / 3


def test_parquet_has_the_same_rows_and_says_its_units(session):
    pandas = pytest.importorskip("pandas")
    pyarrow_parquet = pytest.importorskip("pyarrow.parquet")
    path = exported(session, "s.parquet")
    table = pandas.read_parquet(path)
    fused = table[table.skeleton == "fused"][["x", "y", "z"]].to_numpy()
    np.testing.assert_array_equal(fused.reshape(session.rows.fused.shape), session.rows.fused)
    assert pyarrow_parquet.read_schema(path).metadata[b"units"] == b"metres, seconds, degrees"


@OF_EVERY_BODY
def test_npz_has_every_array(session):
    with np.load(exported(session, "s.npz")) as arrays:
        np.testing.assert_array_equal(arrays["fused"], session.rows.fused)
        np.testing.assert_array_equal(arrays["positions_b"], session.rows.positions_b)
        assert tuple(arrays["joints"]) == session.body.joints


def test_trc_is_in_millimetres_and_has_a_rate(session):
    pandas = pytest.importorskip("pandas")
    path = exported(session, "s.trc")
    lines = path.read_text(encoding="utf-8").split("\n")
    head = dict(zip(lines[1].split("\t"), lines[2].split("\t"), strict=True))
    moments = even_moments(session.rows).time_ns
    assert (head["Units"], head["NumFrames"]) == ("mm", str(len(moments)))
    assert float(head["DataRate"]) == session.frame_rate == 30.0
    assert [name for name in lines[3].split("\t")[2:] if name] == list(session.body.joints)
    table = pandas.read_csv(path, sep="\t", skiprows=6, header=None, skip_blank_lines=False)
    assert np.isfinite(table.to_numpy()).all()  # three frames are no long gap
    np.testing.assert_allclose(table[1], moments * 1e-9, atol=1e-6)
    first = int(head["OrigDataStartFrame"])
    assert table[0].tolist() == list(range(first, first + len(moments)))


def test_c3d_is_read_by_another_library(session):
    pytest.importorskip("ezc3d")
    c3d = pytest.importorskip("c3d")
    path = exported(session, "s.c3d")
    with path.open("rb") as file:
        reader = c3d.Reader(file)
        assert reader.point_rate == 30.0
        assert reader.get("POINT").get("UNITS").string_value.strip() == "mm"
        assert [label.strip() for label in reader.point_labels] == list(session.body.joints)
        assert len(list(reader.read_frames())) == len(even_moments(session.rows).time_ns)


def _of_trc(path):
    return 1e-3 * np.loadtxt(path, skiprows=6)[:, 2:].reshape(-1, len(KINECT_V2), 3) @ _AXES["trc"]


def _of_c3d(path):
    points = pytest.importorskip("ezc3d").c3d(str(path))["data"]["points"]
    return 1e-3 * points[:3].transpose(2, 1, 0) @ _AXES["c3d"]


_AXES = {
    "trc": np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]),  # forwards, up, right
    "c3d": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]),  # right, forwards, up
}
"""From a file's axes to right, up and towards the sensor."""


@COSTLY
@given(data=st.data())
def test_an_export_read_by_another_reader_puts_every_joint_in_its_place(data, tmp_path_factory):
    """Whenever somebody is there: markers between frames too, animations hold the last pose."""
    rosbags()
    session, folder = uneven(_walk(), data.draw), tmp_path_factory.mktemp("s")
    moments = even_moments(session.rows).time_ns
    there = positions_at(session.rows, moments)
    for name, read in (("s.trc", _of_trc), ("s.c3d", _of_c3d)):
        session.export(folder / name)
        expected = on_floor(session, there)
        found = read(folder / name)
        held = np.isfinite(expected).all(axis=(1, 2))
        np.testing.assert_allclose(found[held], expected[held], atol=1e-5)
        assert np.isfinite(found[held]).all()
    writer_for(folder / "s.bvh", feet="free")(session, folder / "s.bvh")
    at = session.at(1e-9 * moments)
    known = np.maximum.accumulate(np.where(np.isnan(at).any(axis=(1, 2)), 0, np.arange(len(at))))
    np.testing.assert_allclose(
        bvh_joints(folder / "s.bvh", KINECT_V2), on_floor(session, at[known]), atol=1e-4
    )
    session.export(folder / "s.mcap")
    markers = [message for topic, _, message in messages(folder / "s.mcap") if topic.endswith("/markers")]
    for k, (joints, _) in enumerate(message.markers for message in markers):
        assert nanoseconds(joints.header.stamp) == session.time_ns[k]
        points = np.array([[p.x, p.y, p.z] for p in joints.points]).reshape(-1, 3)
        seen = session.fused[k][~session.rows.never_seen]
        np.testing.assert_allclose(points, seen[np.isfinite(seen).all(axis=1)] @ OPTICAL.T, atol=1e-9)
    assert len(markers) == len(session)


@OF_EVERY_BODY
def test_bvh_joints_reproduce_the_fused_ones_within_a_tenth_of_a_millimetre(session):
    path = exported(session, "s.bvh", feet="free")
    even = even_moments(session.rows)
    body = session.body
    header = path.read_text(encoding="utf-8")
    assert f"Frames: {len(even.time_ns)}\nFrame Time: 0.033333" in header
    there = session.at(1e-9 * even.time_ns)
    known = np.maximum.accumulate(np.where(np.isnan(there).any(axis=(1, 2)), 0, np.arange(len(there))))
    assert (known < np.arange(len(there))).sum() >= len(GAP)  # the last pose is held
    np.testing.assert_allclose(bvh_joints(path, body), on_floor(session, there[known]), atol=1e-4)


@pytest.mark.parametrize("order", _ORDERS)
def test_angles_of_a_bvh_do_not_jump_between_equal_rotations(order):
    t = np.linspace(0.0, 1.0, 501)
    path = np.stack([800.0 * t, 151.0 * np.sin(9.0 * t), -500.0 * t], axis=1)[:, None]
    rotations = Rotation.from_euler(order, path[:, 0], degrees=True).as_quat()[:, None]
    first = _continuous_angles(rotations[:200], np.zeros((1, 3)), order)
    rest = _continuous_angles(rotations[200:], first[-1], order)
    np.testing.assert_allclose(np.concatenate((first, rest)), path, atol=1e-6)


def test_a_bvh_has_an_order_of_axes_in_which_a_bone_turns_steadily():
    """A bone that turns past 90° about x, the second of Z, X, Y, by 10° a frame, and is 1° off about each."""
    turn = Rotation.from_euler("X", np.linspace(0.0, 120.0, 13)[:, None], degrees=True)
    rotations = turn * Rotation.from_euler("xyz", [1.0, 1.0, 1.0], degrees=True)
    parts = [(None, part[:, None]) for part in np.split(rotations.as_quat(), [6])]
    (order,) = _best_orders(SimpleNamespace(nodes=[None], parts=lambda: parts))
    angles = _continuous_angles(rotations.as_quat()[:, None], np.zeros((1, 3)), order)[:, 0]
    half = Rotation.from_euler(order, 0.5 * (angles[:-1] + angles[1:]), degrees=True)
    between = rotations[:-1] * Rotation.from_rotvec(0.5 * (rotations[:-1].inv() * rotations[1:]).as_rotvec())
    assert np.degrees((between.inv() * half).magnitude()).max() < 1.0  # of Z, X, Y: 2.3°


def grown(path, factor, frame=12, person=0):
    """A session whose bones are longer from a frame on; another view is moved 8 frames later."""
    first = calibration_of(KINECT_V2)
    other = replace(first, bone_lengths=first.bone_lengths * factor, person=person)
    moved = replace(other, a_from_b=RigidTransform.of(first.a_from_b.rotation, [2.3, 0.1, 2.6]))
    parts = [(0, first), (frame, other), (frame + 8, moved)]
    return record_recalibrated(path, frame_pairs(KINECT_V2, frame + 18), parts)


def test_a_file_with_a_skeleton_holds_one_person(tmp_path):
    session = grown(tmp_path / "s.rrd", 1.1, 100, 1)
    for suffix in (".bvh", ".mot", ".trc"):
        with pytest.raises(RecordingError, match=r"shows another person from 3\.3 s on.*duplex trim"):
            session.export(tmp_path / f"s{suffix}")
        assert not (tmp_path / f"s{suffix}").exists()
    assert "bones of 100 recorded frames" in session.export(tmp_path / "s.csv")


def test_who_is_not_the_person_of_a_loaded_calibration_is_one_person(tmp_path):
    """Their own bones are in force as soon as they are recognized."""
    session = grown(tmp_path / "s.rrd", 1.1, 66, 1)
    assert "bones of 66 recorded frames" in session.export(tmp_path / "s.bvh")


@pytest.mark.parametrize("suffix", [".c3d", ".trc"])
def test_bones_of_markers_keep_the_last_lengths(tmp_path, suffix):
    session, path = grown(tmp_path / "s.rrd", 1.04), tmp_path / f"s{suffix}"
    if suffix == ".c3d":
        ezc3d = pytest.importorskip("ezc3d")
    said = session.export(path)
    assert "bones of 12 recorded frames have other lengths than the file's" in said
    if suffix == ".c3d":
        at = 1e-3 * ezc3d.c3d(str(path))["data"]["points"][:3].transpose(2, 1, 0)
    else:
        at = 1e-3 * np.loadtxt(path, skiprows=6)[:, 2:].reshape(30, -1, 3)
    lengths = bone_lengths_of(KINECT_V2, at)[:, KINECT_V2.bone_joints]
    last = session.calibration.bone_lengths[KINECT_V2.bone_joints]
    np.testing.assert_allclose(lengths, np.broadcast_to(last, lengths.shape), atol=1e-5)


def test_frames_before_a_calibration_keep_their_directions_and_get_the_last_lengths(tmp_path):
    session = grown(tmp_path / "s.rrd", 1.04)
    path = tmp_path / "s.bvh"
    said = writer_for(path, feet="free")(session, path)
    expected, found = on_floor(session, session.rows.fused), bvh_joints(path, KINECT_V2)
    np.testing.assert_allclose(found[12:], expected[12:], atol=1e-4)
    root = [KINECT_V2.root]
    np.testing.assert_allclose(
        found[:12] - found[:12, root], 1.04 * (expected[:12] - expected[:12, root]), atol=1e-4
    )
    off = np.linalg.norm(found - expected, axis=2).max()
    (most,) = re.findall(r"bones of 12 recorded frames .* up to (\d+) mm off$", said)
    assert off <= 1e-3 * (int(most) + 0.5) <= 2.0 * off
    write_session(session.part(range(12)), tmp_path / "before.rrd")
    before = Session.open(tmp_path / "before.rrd")
    assert writer_for(path, feet="free")(before, path) == "12 frames at a constant 30 Hz"
    np.testing.assert_allclose(bvh_joints(path, KINECT_V2), on_floor(before, before.rows.fused), atol=1e-4)


@pytest.mark.parametrize("method", get_args(Method))
def test_s_star_beside_a_frame_and_in_a_file_is_that_of_the_frame(method, tmp_path):
    """Also of the method whose bones are only nearly right; a file with constant ones says how far off."""
    pairs = frame_pairs(KINECT_V2, 20)
    session = record_fused(tmp_path / "s.rrd", pairs, calibration_of(KINECT_V2), FuserSettings(method))
    fused = session.rows.fused
    for beside_ns in (-1, 1):
        np.testing.assert_allclose(session.at(session.time[1:-1] + 1e-9 * beside_ns), fused[1:-1], atol=1e-5)
    path = tmp_path / "s.bvh"
    said = writer_for(path, feet="free")(session, path)
    moments = session.at(1e-9 * even_moments(session.rows).time_ns)
    off = np.linalg.norm(bvh_joints(path, KINECT_V2) - on_floor(session, moments), axis=2).max()
    told = re.findall(r"bones of (\d+) recorded frames .* up to (\d+) mm off$", said)
    assert bool(told) == (method == "published")
    assert off <= 1e-3 * (sum(int(most) for _, most in told) + 0.5)


def paused(tmp_path, frames):
    """Three frames at 30 Hz and one after a pause, so that there are so many moments of 30 Hz."""
    pairs = frame_pairs(KINECT_V2, 4)
    late = replace(pairs[3].skeletons, time_ns=round((frames - 1) * 1e9 / 30))
    pairs[3] = replace(pairs[3], skeletons=late)
    return record_fused(tmp_path / "paused.rrd", pairs, calibration_of(KINECT_V2))


def test_c3d_refuses_what_its_readers_would_silently_lose(tmp_path):
    pytest.importorskip("ezc3d")
    session = paused(tmp_path, 65_536)
    with pytest.raises(RecordingError, match=r"holds 65535 frames, 36 min at 30 Hz; .* has 65536"):
        exported(session, "s.c3d")
    assert not (tmp_path / "s.c3d").exists()


def test_options_are_for_formats_that_have_a_use_for_them(session, tmp_path):
    path = tmp_path / "fast.bvh"
    writer_for(path, rate=60.0)(session, path)
    header = path.read_text(encoding="utf-8")
    assert "Frame Time: 0.016666667" in header
    seconds = (session.time_ns[-1] - session.time_ns[0]) * 1e-9
    assert f"Frames: {round(seconds * 60.0) + 1}\n" in header
    with pytest.raises(RecordingError, match="keeps the recorded times"):
        writer_for(tmp_path / "s.csv", rate=60.0)
    with pytest.raises(RecordingError, match=r"`names` is for \.bvh and \.glb; \.trc has"):
        writer_for(tmp_path / "s.trc", names="mixamo")
    with pytest.raises(RecordingError, match=r"`feet` is for \.bvh and \.glb; \.c3d has those of S\*"):
        writer_for(tmp_path / "s.c3d", feet="free")
    with pytest.raises(UnknownNameError, match="planted"):
        writer_for(path, feet="glued")
    with pytest.raises(RecordingError, match=r"`table` is for \.csv and \.parquet; \.bvh has one layout"):
        writer_for(path, table="wide")
    with pytest.raises(RecordingError, match="1 to 1000"):
        writer_for(path, rate=0.0)


def test_a_pause_in_the_recording_is_a_gap_at_an_even_rate(tmp_path):
    pairs = frame_pairs(KINECT_V2, 40)
    late = [p for k, p in enumerate(pairs) if not 10 <= k < 25]
    session = record_fused(tmp_path / "s.rrd", late, calibration_of(KINECT_V2))
    even = even_moments(session.rows)
    assert even.rate == 30.0
    there = np.isfinite(session.at(1e-9 * even.time_ns)).all(axis=(1, 2))
    assert there[:9].all()
    assert not there[10:25].any()
    assert there[26:].all()


@pytest.mark.parametrize(
    ("name", "package", "extra"),
    [("s.c3d", "ezc3d", "export"), ("s.glb", "pygltflib", "export"), ("s.mcap", "mcap.writer", "ros")],
)
def test_a_format_whose_library_is_missing_is_refused_before_anything_is_computed(
    name, package, extra, tmp_path, monkeypatch
):
    pytest.importorskip(package)
    assert writer_for(tmp_path / name)
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(RecordingError, match=rf"needs the package .*duplex-kinects\[{extra}\]"):
        writer_for(tmp_path / name)
    assert writer_for(tmp_path / "s.csv")


# --- Exports in OpenSim's own library: they load whole, and its tools scale a model and follow the markers.


@pytest.fixture(scope="module")
def opensim():
    try:
        import opensim
    except ImportError:
        lacks("opensim", "pip install opensim")
    opensim.Logger.setLevelString("Off")
    return opensim


@pytest.fixture(scope="module")
def walk(tmp_path_factory):
    return captured(tmp_path_factory.mktemp("walk") / "s.rrd", KINECT_V2, "walk", 8.0, seed=3).session


def rows_of(path):
    """The table of a .mot as text."""
    return path.read_text().split("endheader\n")[1].splitlines()[1:]


@given(data=st.data())
def test_opensim_loads_every_session_whole(data, opensim, walk, tmp_path_factory):
    folder = tmp_path_factory.mktemp("s")
    session = uneven(walk, data.draw)
    session.export(folder / "s.trc")
    session.export(folder / "s.mot")
    markers = opensim.TimeSeriesTableVec3(str(folder / "s.trc"))
    assert markers.getNumRows() == len((folder / "s.trc").read_text().splitlines()) - 6
    assert list(markers.getColumnLabels()) == list(session.body.joints)
    wanted = len(rows_of(folder / "s.mot"))
    assert opensim.TimeSeriesTable(str(folder / "s.mot")).getNumRows() == wanted
    assert opensim.Storage(str(folder / "s.mot")).getSize() == wanted  # reads up to the first nan


def test_scale_and_inverse_kinematics_by_their_set_ups_follow_the_mot(opensim, walk, tmp_path, monkeypatch):
    """On a model that is not as long as the person, whose hips and shoulders are those of one trunk."""
    at = true_positions(walk.body, "walk")(walk.time)
    replace(walk, rows=replace(walk.rows, fused=at)).export(tmp_path / "opensim")
    monkeypatch.chdir(tmp_path / "opensim")
    write_person(opensim, Path())
    opensim.ScaleTool("scale.xml").run()  # false, because no markers are placed
    assert opensim.InverseKinematicsTool("inverse_kinematics.xml").run()
    errors, found, sent = map(
        opensim.TimeSeriesTable, ("fused_ik_marker_errors.sto", "inverse_kinematics.mot", "fused.mot")
    )

    def column(table, name):
        return table.getDependentColumn(name).to_numpy()

    assert np.abs(column(found, "L5_S1_Flex_Ext")).max() < 1.0  # two hips do not show it
    assert np.percentile(column(errors, "marker_error_RMS"), 95.0) < 0.01
    for name in ("knee_angle_l", "knee_angle_r", "hip_flexion_l", "hip_flexion_r"):
        # both ends of a thigh of 0.4 m, 10 mm off
        assert np.percentile(np.abs(column(found, name) - column(sent, name)), 95.0) < 2.9


def words(opensim, *each):
    """OpenSim's array of strings."""
    array = opensim.ArrayStr()
    for word in each:
        array.append(word)
    return array
