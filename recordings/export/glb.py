"""Export to binary glTF 2.0: one skinned person of capsules, with one animation, in metres, y up.

The tree and the rotations are those of :mod:`recordings.export.animation`, the capsules those of
:mod:`recordings.appearance.body_shape`. Each capsule follows one node.
"""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from recordings.appearance.body_shape import capsule_lengths, capsule_radii, parents
from recordings.appearance.colors import SKELETON_COLORS
from recordings.export import Feet, Names
from recordings.export.animation import Animation
from recordings.session_series import SessionSeries

_AROUND, _ALONG = 16, 4  # faces around a capsule, and from its rim to its tip


def write_glb(
    session: SessionSeries,
    path: Path,
    rate: float | None = None,
    names: Names = "body",
    feet: Feet = "planted",
) -> str:
    """Writes S* as a ``.glb``. The last pose is held during a gap.

    Raises:
        RecordingError: No frame has an S*.
    """
    import pygltflib as gl

    animation = Animation(session, rate, names, feet)
    nodes, person = animation.nodes, len(animation.nodes)
    file, blob = gl.GLTF2(asset=gl.Asset(generator="duplex-kinects")), bytearray()

    def accessor(values: NDArray[Any], kind: str, target: int | None = None, limits: bool = False) -> int:
        """The index of an accessor to the values, which are appended to the file."""
        types = {"float32": gl.FLOAT, "uint8": gl.UNSIGNED_BYTE, "uint16": gl.UNSIGNED_SHORT}
        file.bufferViews.append(
            gl.BufferView(buffer=0, byteOffset=len(blob), byteLength=values.nbytes, target=target)
        )
        blob.extend(values.tobytes())
        blob.extend(bytes(-len(blob) % 4))
        rows = values.reshape(len(values), -1)
        file.accessors.append(
            gl.Accessor(
                bufferView=len(file.bufferViews) - 1,
                componentType=types[values.dtype.name],
                count=len(values),
                type=kind,
                min=rows.min(axis=0).tolist() if limits else None,
                max=rows.max(axis=0).tolist() if limits else None,
            )
        )
        return len(file.accessors) - 1

    points, normals, faces, followed = _person(animation, session)
    worlds = np.array([animation.rest[node.joint] for node in nodes], dtype=np.float32)
    worlds[:, 1] -= points[:, 1].min()  # the rest pose stands on the floor
    points[:, 1] -= points[:, 1].min()
    for k, node in enumerate(nodes):
        offset = node.offset if k else worlds[0]
        children = [n for n, each in enumerate(nodes) if each.above == k]
        file.nodes.append(gl.Node(name=node.name, translation=offset.tolist(), children=children))
    inverse = np.tile(np.eye(4, dtype=np.float32), (person, 1, 1))
    inverse[:, 3, :3] = -worlds  # by columns
    file.skins.append(
        gl.Skin(joints=list(range(person)), skeleton=0, inverseBindMatrices=accessor(inverse, gl.MAT4))
    )
    weights, joints = np.zeros((2, len(points), 4), dtype=np.float32)
    weights[:, 0], joints[:, 0] = 1.0, followed
    shape = gl.Attributes(
        POSITION=accessor(points, gl.VEC3, gl.ARRAY_BUFFER, limits=True),
        NORMAL=accessor(normals, gl.VEC3, gl.ARRAY_BUFFER),
        JOINTS_0=accessor(joints.astype(np.uint8), gl.VEC4, gl.ARRAY_BUFFER),
        WEIGHTS_0=accessor(weights, gl.VEC4, gl.ARRAY_BUFFER),
    )
    triangles = accessor(faces.ravel(), gl.SCALAR, gl.ELEMENT_ARRAY_BUFFER)
    file.meshes.append(
        gl.Mesh(name="person", primitives=[gl.Primitive(attributes=shape, indices=triangles, material=0)])
    )
    color = (np.array(SKELETON_COLORS["fused"]) / 255.0) ** 2.2  # linear
    surface = gl.PbrMetallicRoughness(
        baseColorFactor=[*color.tolist(), 1.0], metallicFactor=0.0, roughnessFactor=0.8
    )
    file.materials.append(gl.Material(name="person", pbrMetallicRoughness=surface))
    file.nodes.append(gl.Node(name="person", mesh=0, skin=0))
    file.scenes.append(gl.Scene(nodes=[0, person]))
    file.scene = 0

    places = np.empty((len(animation), 3), dtype=np.float32)
    turns = np.empty((person, len(animation), 4), dtype=np.float32)
    begin = 0
    for at, rotations in animation.parts():
        part = slice(begin, begin + len(at))
        places[part], turns[:, part] = at, rotations.swapaxes(0, 1)
        begin = part.stop
    seconds = (np.arange(len(animation)) / animation.rate).astype(np.float32)
    times = accessor(seconds, gl.SCALAR, limits=True)
    motion = gl.Animation(name=Path(session.name).stem)

    def animate(node: int, what: str, values: NDArray[np.float32], kind: str) -> None:
        motion.samplers.append(
            gl.AnimationSampler(input=times, output=accessor(values, kind), interpolation=gl.ANIM_LINEAR)
        )
        target = gl.AnimationChannelTarget(node=node, path=what)
        motion.channels.append(gl.AnimationChannel(sampler=len(motion.samplers) - 1, target=target))

    animate(0, "translation", places, gl.VEC3)
    for k, node in enumerate(nodes):
        if node.bone >= 0:
            animate(k, "rotation", turns[k], gl.VEC4)
    file.animations.append(motion)
    file.buffers.append(gl.Buffer(byteLength=len(blob)))
    file.set_binary_blob(blob)
    file.save_binary(str(path))
    return animation.in_words


def _person(
    animation: Animation, session: SessionSeries
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.uint16], NDArray[np.int64]]:
    """(V, 3) points, (V, 3) normals, (F, 3) faces and (V,) nodes to follow, of all capsules in the T-pose."""
    body, at = session.body, animation.rest
    towards = at[parents(body)] - at
    distance = np.linalg.norm(towards, axis=1, keepdims=True)
    directions = np.where(distance > 0.0, towards / np.maximum(distance, 1e-9), [0.0, 1.0, 0.0])
    lengths = capsule_lengths(body, session.calibration.bone_lengths)
    node_of = {node.bone: k for k, node in reversed(list(enumerate(animation.nodes)))}
    parts = []
    for joint, radius in enumerate(capsule_radii(body)):
        normals, outer, faces = _capsule(directions[joint])
        points = at[joint] + radius * normals + outer[:, None] * lengths[joint] * directions[joint]
        parts.append((points, normals, faces + joint * len(points), np.full(len(points), node_of[joint])))
    points, normals, faces, followed = (np.concatenate(each) for each in zip(*parts, strict=True))
    return points.astype(np.float32), normals.astype(np.float32), faces.astype(np.uint16), followed


def _capsule(axis: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.int64]]:
    """(V, 3) normals, (V,) whether a point is at the far end, and (F, 3) faces, counter-clockwise from
    outside, of a capsule along an axis.
    """
    side = np.cross(axis, [0.0, 0.0, 1.0] if abs(axis[2]) < 0.7 else [1.0, 0.0, 0.0])
    side /= np.linalg.norm(side)
    tilt = np.linspace(0.0, 0.5 * np.pi, _ALONG + 1)
    tilts, outer = np.concatenate((tilt, np.pi - tilt[::-1])), np.repeat([True, False], _ALONG + 1)
    round_ = np.linspace(0.0, 2.0 * np.pi, _AROUND, endpoint=False)
    ring = np.cos(round_)[:, None] * side + np.sin(round_)[:, None] * np.cross(axis, side)
    normals = np.sin(tilts)[:, None, None] * ring + np.cos(tilts)[:, None, None] * axis
    k, n = np.meshgrid(np.arange(len(tilts) - 1) * _AROUND, np.arange(_AROUND), indexing="ij")
    a, b = k + n, k + (n + 1) % _AROUND  # and the same on the next ring
    quads = np.stack((a, a + _AROUND, b, b, a + _AROUND, b + _AROUND), axis=-1)
    faces = quads.reshape(len(tilts) - 1, _AROUND, 2, 3)
    faces = np.concatenate((faces[0, :, 1], faces[1:-1].reshape(-1, 3), faces[-1, :, 0]))  # tips are points
    return normals.reshape(-1, 3), outer.repeat(_AROUND), faces
