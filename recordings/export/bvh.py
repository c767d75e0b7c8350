"""Export to BVH, a skeleton file for animation, from :mod:`recordings.export.animation`.

Programs disagree on position channels of inner joints, so only the root has them. Centimetres, y up. Programs
interpolate channels one by one, so angles do not jump between equal rotations, and may exceed 180°. Near a
second angle of 90° they turn fast though the bone does not: each node has the order of axes in which they are
nearest to its rotation half-way between frames, Z, X, Y where others are hardly better.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from recordings.export import Feet, Names
from recordings.export.animation import Animation, Node
from recordings.session_series import SessionSeries

_CM = 100.0
_ORDERS = ("ZXY", "ZYX", "XYZ", "XZY", "YXZ", "YZX")
_HARDLY = 1.0  # degrees by which another order's largest error is less, at least
_STUB = 0.2  # length of the end site behind a last joint, as a share of the last bone; some programs draw it


def write_bvh(
    session: SessionSeries,
    path: Path,
    rate: float | None = None,
    names: Names = "body",
    feet: Feet = "planted",
) -> str:
    """Writes S* as BVH. BVH has no gaps: the last pose is held during a gap.

    Raises:
        RecordingError: No frame has an S*.
    """
    animation = Animation(session, rate, names, feet)
    orders = _best_orders(animation)
    head = [*_hierarchy(animation.nodes, orders), "MOTION", f"Frames: {len(animation)}"]
    before = np.zeros((len(animation.nodes), 3))
    with path.open("w", encoding="utf-8") as file:
        file.write("\n".join([*head, f"Frame Time: {1.0 / animation.rate:.9f}"]) + "\n")
        for positions, rotations in animation.parts():
            angles = np.empty((*rotations.shape[:2], 3))
            for order in set(orders):
                some = [k for k, each in enumerate(orders) if each == order]
                angles[:, some] = _continuous_angles(rotations[:, some], before[some], order)
            before = angles[-1]
            motion = np.concatenate((positions * _CM, angles.reshape(len(positions), -1)), axis=1)
            file.writelines(" ".join(f"{v:.6f}" for v in row) + "\n" for row in motion.tolist())
    return animation.in_words


def _best_orders(animation: Animation) -> list[str]:
    """The order of axes in which each node's channels are nearest to its rotation between frames."""
    K = len(animation.nodes)
    largest = np.zeros((len(_ORDERS), K))
    angles = np.zeros((len(_ORDERS), 1, K, 3))
    last = np.empty((0, K, 4))
    for _, new in animation.parts():
        rotations = np.concatenate((last, new))
        first, second = (Rotation.from_quat(each.reshape(-1, 4)) for each in (rotations[:-1], rotations[1:]))
        between = first * Rotation.from_rotvec(0.5 * (first.inv() * second).as_rotvec())
        before, angles = angles[:, -1], np.empty((len(_ORDERS), len(rotations), K, 3))
        for k, order in enumerate(_ORDERS):
            angles[k] = _continuous_angles(rotations, before[k], order)
            half = 0.5 * (angles[k, :-1] + angles[k, 1:])
            shown = Rotation.from_euler(order, half.reshape(-1, 3), degrees=True)
            off = np.degrees((between.inv() * shown).magnitude()).reshape(-1, K)
            largest[k] = np.maximum(largest[k], off.max(axis=0, initial=0.0))
        last = new[-1:]
    largest[0] -= _HARDLY
    return [_ORDERS[k] for k in largest.argmin(axis=0)]


def _continuous_angles(
    rotations: NDArray[np.float64], before: NDArray[np.float64], order: str
) -> NDArray[np.float64]:
    """(N, K, 3) degrees about the axes of (N, K, 4) quaternions, each nearest to those of the frame before.

    Equal rotations are (z, x, y) and (z + 180°, 180° - x, y + 180°), and whole turns more of each angle; in
    other orders of the axes alike.

    Args:
        before: (K, 3) degrees of the frame before the first.
        order: Of the axes, such as ``ZXY``.
    """
    angles = Rotation.from_quat(rotations.reshape(-1, 4)).as_euler(
        order, degrees=True, suppress_warnings=True
    )
    angles = np.concatenate((before[None], np.reshape(angles, (*rotations.shape[:2], 3))))
    other = angles * [1.0, -1.0, 1.0] + 180.0
    to_same, to_other = (
        np.abs((each[1:] - angles[:-1] + 180.0) % 360.0 - 180.0).sum(axis=2) for each in (angles, other)
    )
    turned = np.cumsum(to_other < to_same, axis=0) % 2 == 1
    angles[1:][turned] = other[1:][turned]
    return np.unwrap(angles, period=360.0, axis=0)[1:]


def _hierarchy(nodes: Sequence[Node], orders: Sequence[str]) -> Iterator[str]:
    def offset(metres: NDArray[np.float64]) -> str:
        return "OFFSET " + " ".join(f"{v:.6f}" for v in (metres * _CM).round(6) + 0.0)

    depths: list[int] = []
    yield "HIERARCHY"
    for k, node in enumerate(nodes):
        depth = depths[node.above] + 1 if k else 0
        yield from ("  " * d + "}" for d in range(depths[-1] if k else -1, depth - 1, -1))
        depths.append(depth)
        pad = "  " * depth
        yield f"{pad}{'JOINT' if k else 'ROOT'} {node.name}"
        yield pad + "{"
        yield f"{pad}  {offset(node.offset)}"
        channels = "3" if k else "6 Xposition Yposition Zposition"
        yield f"{pad}  CHANNELS {channels} " + " ".join(f"{axis}rotation" for axis in orders[k])
        if node.bone < 0:
            end = f"{pad}    {offset(_STUB * node.offset)}"
            yield from (f"{pad}  End Site", pad + "  {", end, pad + "  }")
    yield from ("  " * d + "}" for d in range(depths[-1], -1, -1))
