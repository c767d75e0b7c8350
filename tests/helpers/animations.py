"""Readers of animations: BVH by another library, GLB by the formulas of the glTF 2.0 specification."""

import json
import struct

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

_TYPES = {5121: np.uint8, 5123: np.uint16, 5126: np.float32}
_SIZES = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}


def bvh_joints(path, body):
    """(N, J, 3) metres, as another library makes them of the file."""
    bvhio = pytest.importorskip("bvhio")
    root = bvhio.readAsHierarchy(str(path))
    nodes = {node.Name: node for node, _, _ in root.layout()}
    found = []
    for moment in range(len(root.Keyframes)):
        root.loadPose(moment)
        found.append([np.array(nodes[joint].PositionWorld) for joint in body.joints])
    return np.array(found) / 100.0


class Glb:
    """A binary glTF file with one skin and one animation.

    Attributes:
        nodes: The nodes by name.
        above: The name of the parent of each node that has one.
        seconds: (N,) times of the animation.
        rest: (V, 3) points of the mesh as stored.
        turning: Names of nodes whose rotation is animated.
    """

    def __init__(self, path):
        data = path.read_bytes()
        magic, version, size, length, kind = struct.unpack_from("<4sII I4s", data)
        assert (magic, version, size, kind) == (b"glTF", 2, len(data), b"JSON")
        self.json = json.loads(data[20 : 20 + length])
        chunk, kind = struct.unpack_from("<I4s", data, 20 + length)
        assert kind == b"BIN\0"
        self._blob = data[28 + length : 28 + length + chunk]
        every = self.json["nodes"]
        self.nodes = {node["name"]: node for node in every}
        assert len(self.nodes) == len(every)
        self.above = {every[c]["name"]: n["name"] for n in every for c in n.get("children", ())}
        (self._skin,) = self.json["skins"]
        (self._animation,) = self.json["animations"]
        self._motion = {}
        for channel in self._animation["channels"]:
            sampler, target = self._animation["samplers"][channel["sampler"]], channel["target"]
            assert sampler["interpolation"] == "LINEAR"
            self.seconds = self._values(sampler["input"])[:, 0]
            self._motion[every[target["node"]]["name"], target["path"]] = self._values(sampler["output"])
        self.turning = {name for name, path in self._motion if path == "rotation"}
        (mesh,) = self.json["meshes"]
        (primitive,) = mesh["primitives"]
        self._attributes = {name: self._values(k) for name, k in primitive["attributes"].items()}
        self.rest = self._attributes["POSITION"]
        self.faces = self._values(primitive["indices"]).reshape(-1, 3)

    def _values(self, index):
        accessor = self.json["accessors"][index]
        view = self.json["bufferViews"][accessor["bufferView"]]
        kind, size = _TYPES[accessor["componentType"]], _SIZES[accessor["type"]]
        begin = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        values = np.frombuffer(self._blob, kind, accessor["count"] * size, begin)
        return values.reshape(-1, size)

    def worlds(self, frame=None):
        """(4, 4) from each node to the scene, by name; in the rest pose where no frame is given."""
        found = {}

        def world(name):
            if name not in found:
                node, own = self.nodes[name], np.eye(4)
                pose = {path: node[path] for path in ("translation", "rotation") if node.get(path)}
                if frame is not None:
                    pose |= {path: values[frame] for (of, path), values in self._motion.items() if of == name}
                own[:3, 3] = pose.get("translation", (0.0, 0.0, 0.0))
                own[:3, :3] = Rotation.from_quat(pose.get("rotation", (0.0, 0.0, 0.0, 1.0))).as_matrix()
                found[name] = world(self.above[name]) @ own if name in self.above else own
            return found[name]

        return {name: world(name) for name in self.nodes}

    def skin(self, frame):
        """(K, 4, 4) from the mesh to the scene, for the joints of the skin."""
        inverse = self._values(self._skin["inverseBindMatrices"]).reshape(-1, 4, 4).swapaxes(1, 2)
        worlds, every = self.worlds(frame), self.json["nodes"]
        return np.stack([worlds[every[k]["name"]] for k in self._skin["joints"]]) @ inverse

    def points(self, frame):
        """(V, 3) points of the mesh in a frame."""
        matrices, weights = self.skin(frame), self._attributes["WEIGHTS_0"]
        np.testing.assert_allclose(weights.sum(axis=1), 1.0)
        mixed = np.einsum("vk,vkij->vij", weights, matrices[self._attributes["JOINTS_0"]])
        return np.einsum("vij,vj->vi", mixed[:, :3, :3], self.rest) + mixed[:, :3, 3]
