"""S* as an animation: a tree of nodes in the T-pose, and a rotation per node at a constant rate.

Bones of constant length, see :mod:`recordings.export.bones`, are represented exactly by rotations. Rotations
are those of :mod:`fusion.movement.joint_rotations`. If several bones leave a joint, their angles vary and one
rotation cannot represent all of them. The node of the joint then turns with the pelvis, trunk, head, hand or
foot, and each other bone gets a node of its own at the same position.

Axes: x right, y up, z towards the first sensor, the floor at y = 0; the origin is below the sensor. The
T-pose faces +z.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fusion.body import Body
from fusion.movement.humanoid import human_bones, name_in, rest_from_t_pose
from fusion.movement.joint_rotations import JointRotations, joint_bones
from fusion.support.large_arrays import PART
from fusion.support.types import Array
from recordings.appearance.floor import floor_under
from recordings.data.interpolation import positions_at, sigma_at
from recordings.errors import RecordingError
from recordings.export import Feet, Names
from recordings.export.bones import with_lengths
from recordings.export.even_frames import even_moments, y_up, y_up_rotations
from recordings.planted_feet import planted_feet
from recordings.session_series import SessionSeries


@dataclass(frozen=True, eq=False)
class Node:
    """A point of the tree."""

    name: str
    above: int  # index of the parent node; -1 for the root
    joint: int  # the joint at its position
    bone: int  # the bone that it turns, by its end joint; -1: a last joint, which does not turn
    offset: Array  # (3,) metres, from the parent node, in the T-pose


class Animation:
    """S* of a session as rotations of nodes.

    Attributes:
        nodes: K nodes; a parent precedes its children.
        rest: (J, 3) metres, the joints in the T-pose, the root at the origin.
        rate: Frames per second.
        in_words: The frames, those that hold a pose, and those that are left out.
    """

    def __init__(
        self,
        session: SessionSeries,
        rate: float | None = None,
        names: Names = "body",
        feet: Feet = "planted",
    ) -> None:
        """Chooses the frames.

        Raises:
            RecordingError: No frame has an S*.
        """
        self._rows = session.rows
        self._planted: Array | None = None
        self._body = body = session.body
        self._floor_from_a = floor_under(session.rows).inverse()
        even = even_moments(self._rows, rate)
        self.rate, self._time_ns = even.rate, even.time_ns
        present = np.concatenate([np.isfinite(self._at(p)).all(axis=(1, 2)) for p in self._parts()])
        if not present.any():
            raise RecordingError(f"{session} has no frame with an S*; there is nothing to export.")
        self._shown = np.maximum.accumulate(np.where(present, np.arange(len(present)), -1))
        self._shown[self._shown < 0] = np.argmax(present)
        self.in_words = even.in_words
        if not present.all():
            self.in_words += f"; {np.count_nonzero(~present)} of them hold the pose before, for lack of an S*"
        self._rest_from_t_pose = Rotation.from_quat(rest_from_t_pose(body))
        offsets = y_up(self._rest_from_t_pose.inv().apply(body.rest.copy()))
        offsets *= session.calibration.bone_lengths[:, None]
        self.rest = np.zeros((len(body), 3))
        for joint in body.order[1:]:
            self.rest[joint] = self.rest[body.parents[joint]] + offsets[joint]
        self.nodes = tuple(_nodes(body, offsets, _labels(body, names)))
        if feet == "planted":
            positions = np.concatenate([self._at(part) for part in self._parts()])
            positions = with_lengths(body, positions, session.calibration.bone_lengths)
            sigma = sigma_at(self._rows, self._time_ns)
            self._planted = planted_feet(body, self._time_ns, positions, sigma)

    def __len__(self) -> int:
        return len(self._time_ns)

    def parts(self) -> Iterator[tuple[Array, Array]]:
        """The frames in parts: (N, 3) metres of the root, and (N, K, 4) quaternions x, y, z, w.

        A rotation is that of a node from the T-pose, relative to the parent node; its sign is continuous.
        The pose before a gap is held.
        """
        above = np.array([node.above for node in self.nodes])
        bones = np.array([node.bone for node in self.nodes])
        turning = bones >= 0
        rotations, newest = JointRotations(self._body), -1
        before = np.zeros((1, len(above), 4))
        for part in self._parts():
            shown = self._shown[part]
            positions = self._at(shown)
            turned = np.empty((*positions.shape[:2], 4))
            for n, frame in enumerate(shown.tolist()):
                if frame != newest:
                    pose = rotations.update(positions[n], int(self._time_ns[frame]))
                    newest = frame
                turned[n] = pose
            world = np.zeros((len(shown), len(above), 4))
            for k in np.flatnonzero(turning):
                from_t_pose = Rotation.from_quat(turned[:, bones[k]]) * self._rest_from_t_pose[bones[k]]
                world[:, k] = y_up_rotations(from_t_pose.as_quat())
            world[:, ~turning] = world[:, above[~turning]]
            local = world.copy()
            for k in np.flatnonzero(above >= 0):
                parent = Rotation.from_quat(world[:, above[k]])
                local[:, k] = (parent.inv() * Rotation.from_quat(world[:, k])).as_quat()
            same = np.einsum("nki,nki->nk", local, np.concatenate((before, local[:-1])))
            local *= np.where(same < 0.0, -1.0, 1.0).cumprod(axis=0)[..., None]
            before = local[-1:]
            yield y_up(positions[:, self._body.root]), local

    def _at(self, frames: NDArray[np.int64]) -> Array:
        """(N, J, 3) metres in the floor's frame: x right, y down, z forward."""
        if self._planted is not None:
            return self._planted[frames]
        return np.asarray(self._floor_from_a.apply(positions_at(self._rows, self._time_ns[frames])))

    def _parts(self) -> Iterator[NDArray[np.int64]]:
        """The indices of the frames."""
        return (np.arange(k, min(k + PART, len(self))) for k in range(0, len(self), PART))


def _labels(body: Body, names: Names) -> dict[tuple[int, int], str]:
    """Names of nodes, by the joint and the bone that they turn."""
    if names == "body":
        return {}
    bones = [((bone.begin, bone.bone), bone.name) for bone in human_bones(body)]
    shown = joint_bones(body)
    for side in ("Left", "Right"):
        hand = body.joint("Hand" + side)
        bones.append(((hand, int(shown[hand])), f"{side}MiddleProximal"))
    return {key: name_in(names, name) for key, name in bones}


def _nodes(body: Body, offsets: Array, labels: dict[tuple[int, int], str]) -> Iterator[Node]:
    children = [[c for c in range(len(body)) if body.parents[c] == j] for j in range(len(body))]
    shown = joint_bones(body)
    count = 0

    def node(name: str, above: int, joint: int, bone: int, offset: Array) -> Node:
        nonlocal count
        count += 1
        return Node(name, above, joint, bone, offset)

    def visit(joint: int, above: int) -> Iterator[Node]:
        here, own = count, int(shown[joint])
        name = labels.get((joint, own), body.joints[joint])
        yield node(name, above, joint, own if children[joint] else -1, offsets[joint])
        for bone in children[joint]:
            parent = here
            if bone != own:
                parent = count
                name = labels.get((joint, bone), f"{body.joints[joint]}_to_{body.joints[bone]}")
                yield node(name, here, joint, bone, np.zeros(3))
            yield from visit(bone, parent)

    return visit(body.root, -1)
