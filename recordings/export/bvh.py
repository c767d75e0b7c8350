"""Export to BVH, a skeleton file for animation, from :mod:`recordings.export.animation`.

Programs disagree on position channels of inner joints, so only the root has them. Centimetres, y up. Angles
do not jump between equal rotations, so they may exceed 180°: programs interpolate channels one by one.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from recordings.export.animation import Animation, Names, Node
from recordings.session_series import SessionSeries

_CM = 100.0
_STUB = 0.2  # length of the end site behind a last joint, as a share of the last bone; some programs draw it


def write_bvh(session: SessionSeries, path: Path, rate: float | None = None, names: Names = "body") -> str:
    """Writes S* as BVH. BVH has no gaps: the last pose is held during a gap.

    Raises:
        RecordingError: No frame has an S*.
    """
    animation = Animation(session, rate, names)
    head = [*_hierarchy(animation.nodes), "MOTION", f"Frames: {len(animation)}"]
    before = np.zeros((len(animation.nodes), 3))
    with path.open("w", encoding="utf-8") as file:
        file.write("\n".join([*head, f"Frame Time: {1.0 / animation.rate:.9f}"]) + "\n")
        for positions, rotations in animation.parts():
            angles = _continuous_angles(rotations, before)
            before = angles[-1]
            motion = np.concatenate((positions * _CM, angles.reshape(len(positions), -1)), axis=1)
            file.writelines(" ".join(f"{v:.6f}" for v in row) + "\n" for row in motion.tolist())
    return animation.in_words


def _continuous_angles(rotations: NDArray[np.float64], before: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N, K, 3) degrees about Z, X, Y of (N, K, 4) quaternions, each nearest to those of the frame before.

    Equal rotations are (z, x, y) and (z + 180°, 180° - x, y + 180°), and whole turns more of each angle.

    Args:
        before: (K, 3) degrees of the frame before the first.
    """
    angles = Rotation.from_quat(rotations.reshape(-1, 4)).as_euler(
        "ZXY", degrees=True, suppress_warnings=True
    )
    angles = np.concatenate((before[None], np.reshape(angles, (*rotations.shape[:2], 3))))
    other = angles * [1.0, -1.0, 1.0] + 180.0
    to_same, to_other = (
        np.abs((each[1:] - angles[:-1] + 180.0) % 360.0 - 180.0).sum(axis=2) for each in (angles, other)
    )
    turned = np.cumsum(to_other < to_same, axis=0) % 2 == 1
    angles[1:][turned] = other[1:][turned]
    return np.unwrap(angles, period=360.0, axis=0)[1:]


def _hierarchy(nodes: Sequence[Node]) -> Iterator[str]:
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
        yield f"{pad}  CHANNELS {channels} Zrotation Xrotation Yrotation"
        if node.bone < 0:
            end = f"{pad}    {offset(_STUB * node.offset)}"
            yield from (f"{pad}  End Site", pad + "  {", end, pad + "  }")
    yield from ("  " * d + "}" for d in range(depths[-1], -1, -1))
