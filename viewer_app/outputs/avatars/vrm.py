"""Reads the rest pose of an avatar's bones from a VRM file (GLB with VRM 0.x or 1.0).

Only the JSON part is read. Nothing of the file is executed or drawn.
"""

import json
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from devices.input_file import open_input
from viewer_app.errors import UsageError

_LARGEST = 64 << 20  # bytes of JSON
_HEADER = struct.Struct("<4sII I4s")  # of the file and of its first chunk


class _VrmError(ValueError):
    """What is wrong with a file, for a message."""


@dataclass(frozen=True, eq=False)
class Avatar:
    """Where an avatar's bones rest."""

    translations: dict[str, NDArray[np.float64]]
    """(3,) metres in Unity's axes, by Unity's name of a bone: its place at rest relative to the node above it
    in the file."""
    hips: NDArray[np.float64]  # (3,) metres, where Hips rest above the floor
    above_hips: NDArray[np.float64]  # (3,) metres, the place of the node above Hips


def read_avatar(path: Path) -> Avatar:
    """The rest pose of a VRM."""
    try:
        with open_input(path) as file:
            return _avatar(_json_of(file.read(_LARGEST + 20)))
    except OSError as fault:
        raise UsageError(f"--avatar {path}: {fault.strerror}.") from fault
    except _VrmError as fault:
        raise UsageError(f"--avatar {path}: not a readable .vrm ({fault}).") from fault
    except KeyError as fault:
        raise UsageError(f"--avatar {path}: not a readable .vrm (it has no {fault}).") from fault
    except (IndexError, TypeError, ValueError, OverflowError, AttributeError, RecursionError) as fault:
        raise UsageError(f"--avatar {path}: not a readable .vrm (its content is damaged).") from fault


def _json_of(data: bytes) -> dict[str, Any]:
    if len(data) < _HEADER.size:
        raise _VrmError("shorter than a header")
    magic, version, _, length, kind = _HEADER.unpack_from(data)
    if magic != b"glTF" or version != 2 or kind != b"JSON":
        raise _VrmError("no binary glTF 2.0")
    if length > len(data) - 20:
        raise _VrmError("cut off")
    read = json.loads(data[20 : 20 + length])
    if not isinstance(read, dict):
        raise _VrmError("no glTF")
    return read


def _avatar(gltf: dict[str, Any]) -> Avatar:
    extensions = gltf.get("extensions", {})
    if "VRMC_vrm" in extensions:  # VRM 1.0 faces +z; Unity's importer mirrors x
        bones = {
            name: bone["node"] for name, bone in extensions["VRMC_vrm"]["humanoid"]["humanBones"].items()
        }
        to_unity = np.array([-1.0, 1.0, 1.0])
    elif "VRM" in extensions:  # VRM 0.x faces −z; Unity's importer mirrors z
        bones = {bone["bone"]: bone["node"] for bone in extensions["VRM"]["humanoid"]["humanBones"]}
        to_unity = np.array([1.0, 1.0, -1.0])
    else:
        raise _VrmError("no VRM extension")
    nodes = gltf["nodes"]
    above = {child: k for k, node in enumerate(nodes) for child in node.get("children", ())}
    worlds: dict[int, NDArray[np.float64]] = {}

    def place(node: int) -> NDArray[np.float64]:
        """(3,) metres in Unity's axes; each node's world matrix is computed once."""
        way: list[int] = []
        while node not in worlds:
            way.append(node)
            if len(way) > len(nodes):
                raise _VrmError("nodes in a circle")
            if node not in above:
                break
            node = above[node]
        for each in reversed(way):
            parent = worlds[above[each]] if each in above else np.eye(4)
            worlds[each] = parent @ _matrix(nodes[each])
        return np.asarray(worlds[way[0] if way else node][:3, 3] * to_unity)

    known = {int(node) for node in bones.values()}
    places = {node: place(node) for node in known | {above[node] for node in known if node in above}}
    if not np.isfinite(list(places.values())).all():
        raise _VrmError("a place that is not finite")
    origin = np.zeros(3)
    translations = {
        name[:1].upper() + name[1:]: places[int(n)] - (places[above[int(n)]] if int(n) in above else origin)
        for name, n in bones.items()
    }
    hips = int(bones["hips"])
    if places[hips][1] <= 0.0:
        raise _VrmError("hips that are not above the floor")
    return Avatar(translations, places[hips], places[above[hips]] if hips in above else origin)


def _matrix(node: dict[str, Any]) -> NDArray[np.float64]:
    """(4, 4) the node's own transform."""
    if "matrix" in node:
        return np.array(node["matrix"], dtype=np.float64).reshape(4, 4).T
    matrix = np.eye(4)
    rotation = Rotation.from_quat(node.get("rotation", (0.0, 0.0, 0.0, 1.0))).as_matrix()
    matrix[:3, :3] = rotation * np.array(node.get("scale", (1.0, 1.0, 1.0)), dtype=np.float64)
    matrix[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    return matrix
