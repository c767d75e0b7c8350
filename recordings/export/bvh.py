"""Export to BVH, a skeleton file for animation: a rest pose, and a rotation per joint and frame.

S* has constant bone lengths, so BVH represents it exactly. BVH needs an even frame rate, at which S* is
interpolated with exact bones. BVH stores one length per bone (programs disagree on position channels of inner
joints), but a new calibration changes the lengths. Therefore only the frames of the last calibration are
written, and the number of omitted frames is reported. Rotations are those of :mod:`fusion.joint_rotations`.
If several bones leave a joint, their angles vary and one rotation cannot represent all of them. The joint
then gets the rotation of the pelvis, trunk, head, hand or foot, and each bone gets an extra joint at the same
position for the remaining rotation. Centimetres, y up.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fusion.body import Body
from fusion.joint_rotations import joint_bones, rotations_of
from recordings.errors import RecordingError
from recordings.export.even_frames import even_moments, y_up, y_up_rotations
from recordings.interpolation import positions_at
from recordings.session import Session

_CM = 100.0
_STUB = 0.2  # length of the end site behind a last joint, as a share of the last bone; some programs draw it


@dataclass(frozen=True)
class _Node:
    """One joint of the file: its parent, its offset, and the bones that it rotates."""

    name: str
    depth: int
    offset: NDArray[np.float64]  # (3,) metres, from the parent node, in the rest pose
    bone: int  # the bone whose rotation it shows, by its end joint; -1: a last joint, which does not turn
    above: int  # index of the parent node; -1 for the root
    end: NDArray[np.float64] | None  # (3,) metres, end site of a last joint


def write_bvh(session: Session, path: Path, rate: float | None = None) -> str:
    """Writes S* as BVH. BVH has no gaps: the last pose is held during a gap.

    Raises:
        RecordingError: No frame with the last bone lengths has an S*.
    """
    first = _first_of_last_lengths(session)
    rows = session.rows[first:]
    even = even_moments(rows, rate)
    positions = y_up(positions_at(rows, even.time_ns))  # (N, J, 3)
    present = np.isfinite(positions).all(axis=(1, 2))
    if not present.any():
        since = f" from frame {first} on, where its bones got their last lengths" if first else ""
        raise RecordingError(f"{session} has no frame with an S*{since}; there is nothing to export.")
    held = np.maximum.accumulate(np.where(present, np.arange(len(positions)), -1))
    held[held < 0] = int(np.argmax(present))
    positions = positions[held]
    body = session.body
    rest = y_up(body.rest) * session.calibration.bone_lengths[:, None]  # metres: standing, facing +z, y up
    nodes = list(_nodes(body, rest))
    rotations = _rotations(nodes, y_up_rotations(rotations_of(body, y_up(positions), even.time_ns)))
    angles = [r.as_euler("ZXY", degrees=True, suppress_warnings=True) for r in rotations]
    motion = np.concatenate([positions[:, body.root] * _CM, *angles], axis=1)
    lines = [*_hierarchy(nodes), "MOTION", f"Frames: {len(positions)}", f"Frame Time: {1.0 / even.rate:.9f}"]
    lines += [" ".join(f"{v:.6f}" for v in row) for row in motion]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    words = even.in_words
    if not present.all():
        words += f"; {np.count_nonzero(~present)} of them hold the pose before, for lack of an S*"
    if first:
        between = session.rows.time_ns[first - 1 : first + 1].mean() * 1e-9
        words += (
            f"; without the {first} frames before, whose bones were calibrated to other lengths: cut them "
            f"out with `duplex trim --to {between:.3f}` to export them"
        )
    return words


def _first_of_last_lengths(session: Session) -> int:
    """The first frame with the bone lengths of the last calibration."""
    first, last = session.calibrations[-1]
    for number, calibration in reversed(session.calibrations):
        if not np.array_equal(calibration.bone_lengths, last.bone_lengths):
            break
        first = number
    return first


def _nodes(body: Body, rest: NDArray[np.float64]) -> Iterator[_Node]:
    children = [[c for c in range(len(body)) if body.parents[c] == j] for j in range(len(body))]
    shown = joint_bones(body)
    count = 0

    def visit(joint: int, depth: int, above: int) -> Iterator[_Node]:
        nonlocal count
        bones, offset = tuple(children[joint]), np.zeros(3) if above < 0 else rest[joint]
        end = None if bones else _STUB * rest[joint]
        here, count = count, count + 1
        yield _Node(body.joints[joint], depth, offset, int(shown[joint]) if bones else -1, above, end)
        for bone in bones:
            if len(bones) == 1:
                yield from visit(bone, depth + 1, here)
                continue
            carrier, count = count, count + 1
            name = f"{body.joints[joint]}_to_{body.joints[bone]}"
            yield _Node(name, depth + 1, np.zeros(3), bone, here, None)
            yield from visit(bone, depth + 2, carrier)

    yield from visit(body.root, 0, -1)


def _rotations(nodes: list[_Node], bones: NDArray[np.float64]) -> list[Rotation]:
    """Rotations (N,) per node, relative to the parent node, from those of the bones (N, J, 4)."""
    world: list[Rotation] = []
    local: list[Rotation] = []
    for node in nodes:
        above = Rotation.identity(len(bones)) if node.above < 0 else world[node.above]
        own = above if node.bone < 0 else Rotation.from_quat(bones[:, node.bone])
        local.append(above.inv() * own)
        world.append(own)
    return local


def _hierarchy(nodes: list[_Node]) -> Iterator[str]:
    def offset(metres: NDArray[np.float64]) -> str:
        return "OFFSET " + " ".join(f"{v:.6f}" for v in metres * _CM)

    yield "HIERARCHY"
    open_at: list[int] = []
    for node in nodes:
        while open_at and open_at[-1] >= node.depth:
            yield "  " * open_at.pop() + "}"
        pad = "  " * node.depth
        yield f"{pad}{'JOINT' if node.depth else 'ROOT'} {node.name}"
        yield pad + "{"
        yield f"{pad}  {offset(node.offset)}"
        position = "" if node.depth else "Xposition Yposition Zposition "
        yield f"{pad}  CHANNELS {3 if node.depth else 6} {position}Zrotation Xrotation Yrotation"
        if node.end is not None:
            yield from (f"{pad}  End Site", pad + "  {", f"{pad}    {offset(node.end)}", pad + "  }")
        open_at.append(node.depth)
    while open_at:
        yield "  " * open_at.pop() + "}"
