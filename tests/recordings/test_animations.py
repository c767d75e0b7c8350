"""BVH and GLB as animations: S* through the skin, the T-pose, names of bones, the floor."""

import re
import sys
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from devices.skeletons.name_tables import name_table
from fusion.body import BODIES
from fusion.rigid import RigidTransform
from recordings.appearance.body_shape import capsule_lengths, capsule_radii, parents
from recordings.appearance.floor import floor_under
from recordings.errors import RecordingError
from recordings.export import writer_for
from recordings.export.even_frames import even_moments
from tests.helpers.animations import Glb, bvh_joints
from tests.helpers.documents import ROOT
from tests.helpers.fused_runs import record_with_a_gap

pytest.importorskip("pygltflib", reason="writing GLB needs the extra 'export'")
GAP = range(20, 30)


@pytest.fixture(params=BODIES.values(), ids=str)
def session(request, tmp_path):
    return record_with_a_gap(tmp_path / "s.rrd", request.param, gap=GAP)


def exported(session, name, **how):
    path = session.path.with_name(name)
    how |= {"feet": "free"} if path.suffix in (".bvh", ".glb") else {}
    writer_for(path, **how)(session, path)
    return path


def expected(session):
    """(N, J, 3) metres, y up; the pose before a gap is held."""
    there = session.at(1e-9 * even_moments(session.rows).time_ns)
    seen = np.isfinite(there).all(axis=(1, 2))
    assert seen[0]
    held = np.maximum.accumulate(np.where(seen, np.arange(len(there)), 0))
    return floor_under(session.rows).inverse().apply(there[held]) * [1.0, -1.0, -1.0]


def test_the_skin_of_a_glb_follows_the_joints_of_s(session):
    file, body, joints = Glb(exported(session, "s.glb")), session.body, expected(session)
    np.testing.assert_allclose(np.diff(file.seconds), 1.0 / 30.0, rtol=1e-4)
    assert len(file.seconds) == len(joints)
    lengths = capsule_lengths(body, session.calibration.bone_lengths)
    for frame in range(0, len(joints), 7):
        worlds = file.worlds(frame)
        np.testing.assert_allclose(
            [worlds[name][:3, 3] for name in body.joints], joints[frame], atol=1e-5, err_msg=frame
        )
        towards = joints[frame][parents(body)] - joints[frame]
        towards /= np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), 1e-9)
        middles = joints[frame] + 0.5 * lengths[:, None] * towards
        capsules = file.points(frame).reshape(len(body), -1, 3)
        np.testing.assert_allclose(capsules.mean(axis=1), middles, atol=1e-5)
        radii = np.linalg.norm(capsules - middles[:, None], axis=2).max(axis=1) - 0.5 * lengths
        np.testing.assert_allclose(radii, capsule_radii(body), atol=1e-5)
    a, b, c = (file.rest[file.faces[:, k]] for k in range(3))
    volumes = np.einsum("fi,fi->f", np.cross(a, b), c).reshape(len(body), -1).sum(axis=1) / 6.0
    full = np.pi * capsule_radii(body) ** 2 * (4.0 / 3.0 * capsule_radii(body) + lengths)
    assert (volumes > 0.9 * full).all()  # positive: the faces look outwards
    assert (volumes < full).all()


def test_a_pose_is_held_without_the_least_motion(session):
    file = Glb(exported(session, "s.glb"))
    held = np.array([file.points(frame) for frame in range(GAP[0] + 1, GAP[-1])])
    assert np.ptp(held, axis=0).max() == 0.0
    assert np.ptp([file.points(frame) for frame in (0, 19, 59)], axis=0).max() > 0.05


def rest_of(session, names):
    """Places of nodes in the T-pose of both formats, metres, by name."""
    bvhio = pytest.importorskip("bvhio")
    root = bvhio.readAsHierarchy(str(exported(session, "s.bvh", names=names)))
    root.loadRestPose()
    bvh = {node.Name: np.array(node.PositionWorld) / 100.0 for node, _, _ in root.layout()}
    glb = {
        name: world[:3, 3] for name, world in Glb(exported(session, "s.glb", names=names)).worlds().items()
    }
    return bvh, glb


def test_the_rest_is_a_t_pose_on_the_floor_that_faces_plus_z(session):
    bvh, glb = rest_of(session, "humanoid")
    assert set(glb) == {*bvh, "person"}
    for name, at in bvh.items():
        np.testing.assert_allclose(at, glb[name] - glb["Hips"], atol=1e-6)
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        arm = [glb[side + bone] for bone in ("UpperArm", "LowerArm", "Hand", "MiddleProximal")]
        reach = np.diff(arm, axis=0)
        assert (sign * reach[:, 0] > 0.07).all()
        np.testing.assert_allclose(reach[:, 1:], 0.0, atol=1e-6)
        leg = [glb[side + bone] for bone in ("UpperLeg", "LowerLeg", "Foot")]
        np.testing.assert_allclose(np.diff(leg, axis=0)[:, ::2], 0.0, atol=1e-6)
        toes = glb[side + "Toes"] - glb[side + "Foot"]
        assert toes[2] > 0.1
        assert toes[1] < 0.0 < glb[side + "Toes"][1] < glb[side + "Foot"][1] < 0.12
    assert Glb(session.path.with_name("s.glb")).rest[:, 1].min() == pytest.approx(0.0, abs=1e-6)
    spine = np.diff([glb[bone] for bone in ("Hips", "Spine", "Chest", "Head")], axis=0)
    assert (spine[:, 1] > 0.05).all()
    np.testing.assert_allclose(glb["Hips"][[0, 2]], 0.0, atol=1e-6)


_SIDE = {
    "Shoulder": "Spine2", "Arm": "Shoulder", "ForeArm": "Arm", "Hand": "ForeArm", "HandMiddle1": "Hand",
    "UpLeg": "Hips", "Leg": "UpLeg", "Foot": "Leg", "ToeBase": "Foot",
}  # fmt: skip
MIXAMO = {"Hips": None, "Spine": "Hips", "Spine2": "Spine", "Neck": "Spine2", "Head": "Neck"} | {
    side + bone: (side if above in _SIDE else "") + above
    for side in ("Left", "Right")
    for bone, above in _SIDE.items()
}
"""Bones of Mixamo's skeleton, and the nearest of them above each."""


def test_names_are_those_of_mixamo_and_in_its_order(session):
    files = {names: Glb(exported(session, "s.glb", names=names)) for names in ("body", "mixamo")}
    file = files["mixamo"]
    for bone, parent in MIXAMO.items():
        above = file.above.get(f"mixamorig:{bone}")
        while above is not None and above.removeprefix("mixamorig:") not in MIXAMO:
            above = file.above.get(above)
        assert above == (parent and f"mixamorig:{parent}")
        assert f"mixamorig:{bone}" in file.turning or bone.endswith(("Head", "ToeBase", "HandMiddle1"))
    np.testing.assert_array_equal(file.points(50), files["body"].points(50))
    places = [{n: w[:3, 3] for n, w in each.worlds(50).items()} for each in (file, files["body"])]
    found = name_table("mixamo").points_of(session.body, list(file.nodes))  # as duplex compare reads them
    assert len(found) > 15
    for joint, (label,) in found.items():
        name = session.body.joints[joint]
        if name != "SpineShoulder":  # Mixamo's neck begins there, Kinect's above it
            np.testing.assert_allclose(places[0][list(file.nodes)[label]], places[1][name], err_msg=name)


def chains(*texts):
    """Bones and above each the bone before it, by chains."""
    ways = [text.split() for text in texts]
    return {ways[0][0]: None} | {bone: above for way in ways for above, bone in pairwise(way)}


RIGIFY = chains(
    "spine spine.001 spine.003 spine.004 spine.006",
    "spine.003 shoulder upper_arm forearm hand f_middle.01",
    "spine thigh shin foot toe",
)
"""Of Blender 5.0's human meta-rig, without palms and inner vertebrae."""
UE5 = chains(
    "pelvis spine_01 spine_05 neck_01 head",
    "spine_05 clavicle upperarm lowerarm hand middle_01",
    "pelvis thigh calf foot ball",
)


@pytest.mark.parametrize(("names", "bones", "sided"), [("rigify", RIGIFY, ".L"), ("ue5", UE5, "_l")])
def test_names_are_those_of_other_programs_and_in_their_order(session, names, bones, sided):
    file = Glb(exported(session, "s.glb", names=names))
    of_sides = list(bones)[5:]
    for bone, parent in bones.items():
        name, above = (each and each + sided * (each in of_sides) for each in (bone, parent))
        found = file.above.get(name)
        while found is not None and found.removesuffix(sided) not in bones:
            found = file.above.get(found)
        assert name in file.above or name in file.nodes
        assert found == above


def heights(path, body):
    """(N, J) metres above the floor."""
    if path.suffix == ".bvh":
        return bvh_joints(path, body)[..., 1]
    if path.suffix == ".glb":
        file = Glb(path)
        worlds = [file.worlds(frame) for frame in range(len(file.seconds))]
        return np.array([[world[joint][1, 3] for joint in body.joints] for world in worlds])
    if path.suffix == ".trc":
        table = np.loadtxt(path, skiprows=6)
        return 1e-3 * table[:, 2:].reshape(len(table), -1, 3)[..., 1]
    with path.open("rb") as file:
        frames = pytest.importorskip("c3d").Reader(file).read_frames()
        return np.array([1e-3 * points[:, 2] for _, points, _ in frames])


@pytest.mark.parametrize("suffix", [".bvh", ".glb", ".c3d", ".trc"])
def test_the_person_stands_upright_at_height_zero_also_before_a_tilted_sensor(session, suffix):
    """The sensor looks 20 degrees down, rolled by 8 degrees."""
    if suffix == ".c3d":
        pytest.importorskip("ezc3d")
    a_from_level = RigidTransform.of(
        Rotation.from_euler("xz", [20.0, 8.0], degrees=True).as_matrix(), [0.1, -0.3, 0.2]
    )
    rows, body = session.rows[:18], session.body  # in which the person stands still
    tilted = replace(session, rows=replace(rows, fused=a_from_level.apply(rows.fused)))
    found = heights(exported(tilted, f"tilted{suffix}"), body)
    ankles = [body.joint("AnkleLeft"), body.joint("AnkleRight")]
    true = 0.08 + rows.fused[:, ankles, 1].max() - rows.fused[..., 1]
    np.testing.assert_allclose(found[0], true[0], atol=0.03)  # within 2 degrees and half a centimetre
    assert np.median(found[:, ankles].min(axis=1)) == pytest.approx(0.08, abs=0.0051)  # rounded to 1 cm


def test_the_recipe_moves_s_in_blender(session, monkeypatch):
    """The code of docs/animation.md, in Blender's own module; the rest of the recipe is the user's."""
    bpy = pytest.importorskip("bpy", reason="Blender as a module is 360 MB: pip install --no-deps bpy")
    page = (ROOT / "docs" / "animation.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(import bpy\n.*?)```", page, re.DOTALL)
    exported(session, "walk.glb")
    monkeypatch.chdir(session.path.parent)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    exec(code, {})
    body, joints = session.body, expected(session)
    (armature,) = (each for each in bpy.data.objects if each.type == "ARMATURE")
    scene = bpy.context.scene
    assert (scene.render.fps, scene.frame_start, scene.frame_end) == (30, 0, len(joints) - 1)
    for frame in range(0, len(joints), 7):
        scene.frame_set(frame)
        place = armature.matrix_world
        found = np.array([place @ armature.pose.bones[name].head for name in body.joints])
        x, y, z = joints[frame].T
        np.testing.assert_allclose(found, np.stack([x, -z, y], axis=1), atol=1e-3)  # Blender: z up


def test_without_the_library_one_line_names_the_extra(session, monkeypatch):
    monkeypatch.setitem(sys.modules, "pygltflib", None)
    with pytest.raises(RecordingError, match=r'pip install "duplex-kinects\[export\]"'):
        exported(session, "s.glb")
