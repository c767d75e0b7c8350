"""Avatars as VRM files, and how a receiver of VMC moves their bones."""

import json
import struct

import numpy as np

from tests.helpers.osc import messages

PARENTS = {
    "Spine": "Hips", "Chest": "Spine", "Neck": "Chest", "Head": "Neck",
    **{s + b: (s if a not in ("Chest", "Hips") else "") + a for s in ("Left", "Right") for b, a in (
        ("Shoulder", "Chest"), ("UpperArm", "Shoulder"), ("LowerArm", "UpperArm"), ("Hand", "LowerArm"),
        ("UpperLeg", "Hips"), ("LowerLeg", "UpperLeg"), ("Foot", "LowerLeg"), ("Toes", "Foot"),
    )},
}  # fmt: skip
"""Unity's humanoid, as its manual shows it."""
BEGINS = {
    "LeftUpperArm": "ShoulderLeft", "LeftLowerArm": "ElbowLeft", "LeftHand": "WristLeft",
    "RightUpperArm": "ShoulderRight", "RightLowerArm": "ElbowRight", "RightHand": "WristRight",
    "LeftUpperLeg": "HipLeft", "LeftLowerLeg": "KneeLeft", "LeftFoot": "AnkleLeft", "LeftToes": "FootLeft",
    "RightUpperLeg": "HipRight", "RightLowerLeg": "KneeRight", "RightFoot": "AnkleRight",
    "RightToes": "FootRight", "Head": "Head",
}  # fmt: skip
"""Where a bone begins, in every body."""


def bones(datagrams):
    found = {}
    for address, arguments in messages(datagrams):
        if address == "/VMC/Ext/Bone/Pos":
            name, *values = arguments
            found[str(name)] = np.array(values[:3]), np.array(values[3:])
    return found


def write_vrm(path, version, hips=1.0):
    """A GLB with five bones: Hips under a raised node, UpperChest between Chest and Neck."""
    front = -1.0 if version == 0 else 1.0
    nodes = [
        {"name": "root", "children": [1], "translation": [0, 0.1, 0]},
        {"name": "hips", "children": [2, 5], "translation": [0, hips - 0.1, 0]},
        {"name": "chest", "children": [3], "translation": [0, 0.3, 0.02 * front]},
        {"name": "upper chest", "children": [4], "translation": [0, 0.1, 0]},
        {"name": "neck", "translation": [0, 0.1, 0]},
        {"name": "thigh", "translation": [0.08 * front, -0.05, 0]},
    ]
    where = {"hips": 1, "chest": 2, "upperChest": 3, "neck": 4, "leftUpperLeg": 5}
    if version == 0:
        humanoid = {"VRM": {"humanoid": {"humanBones": [{"bone": b, "node": n} for b, n in where.items()]}}}
    else:
        humanoid = {"VRMC_vrm": {"humanoid": {"humanBones": {b: {"node": n} for b, n in where.items()}}}}
    return _write_glb(path, {"nodes": nodes, "extensions": humanoid})


def write_figure(path, rest):
    """A VRM 1.0 of boxes, one for each bone, in the T-pose.

    Args:
        rest: By Unity's name of a bone, parents first: (3,) metres from the bone above, in Unity's axes.
    """
    names = list(rest)
    nodes = [{"name": name, "translation": _to_gltf(rest[name]), "children": []} for name in names]
    for name, above in PARENTS.items():
        end = names.index(name)
        nodes[names.index(above)]["children"].append(end)
        along = np.array(nodes[end]["translation"])
        wide = 0.12 if above in ("Hips", "Spine", "Chest") else 0.07
        box = {"mesh": 0, "translation": (0.5 * along).tolist(), "scale": (np.abs(along) + wide).tolist()}
        nodes[names.index(above)]["children"].append(len(nodes))
        nodes.append(box)
    for node in nodes:
        if not node.get("children"):
            node.pop("children", None)
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)], np.float32)
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([(a, b, c, a, c, d) for a, b, c, d in sides], np.uint16).ravel()
    blob = corners.tobytes() + faces.tobytes()
    meta = {"name": "boxes", "authors": ["nobody"], "licenseUrl": "https://vrm.dev/licenses/1.0/"}
    bones_of = {name[0].lower() + name[1:]: {"node": k} for k, name in enumerate(names)}
    return _write_glb(
        path,
        {
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": nodes,
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
            "accessors": [
                {
                    "bufferView": 0,
                    "componentType": 5126,
                    "count": 8,
                    "type": "VEC3",
                    "min": [-0.5, -0.5, -0.5],
                    "max": [0.5, 0.5, 0.5],
                },
                {"bufferView": 1, "componentType": 5123, "count": len(faces), "type": "SCALAR"},
            ],
            "bufferViews": [
                {"buffer": 0, "byteLength": corners.nbytes},
                {"buffer": 0, "byteOffset": corners.nbytes, "byteLength": faces.nbytes},
            ],
            "buffers": [{"byteLength": len(blob)}],
            "extensionsUsed": ["VRMC_vrm"],
            "extensions": {
                "VRMC_vrm": {"specVersion": "1.0", "meta": meta, "humanoid": {"humanBones": bones_of}}
            },
        },
        blob,
    )


def _to_gltf(place):
    """Unity's left-handed axes to glTF's, as UniVRM does for VRM 1.0."""
    return (np.array(place) * [-1.0, 1.0, 1.0]).tolist()


def _write_glb(path, content, blob=b""):
    text = json.dumps({"asset": {"version": "2.0"}, **content}).encode()
    text += b" " * (-len(text) % 4)
    blob += bytes(-len(blob) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    if blob:
        chunks += struct.pack("<I4s", len(blob), b"BIN\0") + blob
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)
    return path
