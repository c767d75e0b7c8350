"""Avatars as VRM files."""

import json
import struct


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
    text = json.dumps({"asset": {"version": "2.0"}, "nodes": nodes, "extensions": humanoid}).encode()
    text += b" " * (-len(text) % 4)
    head = struct.pack("<4sII I4s", b"glTF", 2, 20 + len(text), len(text), b"JSON")
    path.write_bytes(head + text)
    return path
