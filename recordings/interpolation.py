"""S* between the moments of a session, with bones of constant length."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recordings.session_arrays import SessionArrays

Array = NDArray[np.float64]
_LONGEST_NS = 300_000_000  # S* is not interpolated across a longer interval


def positions_at(rows: SessionArrays, time_ns: ArrayLike) -> Array:
    """S* at (N,) times since the first pair, ns, from the frames before and after.

    The root moves in a straight line. Each bone turns at a constant rate about the axis across both of its
    directions (spherical linear interpolation), so that its length stays that of the frame before.

    Returns:
        (N, J, 3) metres in K_A's frame; the recorded S* at the times of frames. NaN before the first and
        after the last frame, in intervals of more than 0.3 s, and where a frame has no S*.
    """
    wanted = np.atleast_1d(np.asarray(time_ns, dtype=np.int64))
    times, fused, body = rows.time_ns, rows.fused, rows.body
    if len(times) == 0:
        return np.full((len(wanted), len(body), 3), np.nan)
    before = np.clip(np.searchsorted(times, wanted, side="right") - 1, 0, len(times) - 1)
    after = np.minimum(before + 1, len(times) - 1)
    step = times[after] - times[before]
    share = (wanted - times[before]) / np.maximum(step, 1)
    start, end, lengths = fused[before], fused[after], rows.bone_lengths[before]
    found = np.empty((len(wanted), len(body), 3))
    found[:, body.root] = start[:, body.root] + share[:, None] * (end[:, body.root] - start[:, body.root])
    for joint in body.order[1:]:
        parent = body.parents[joint]
        direction = _between(start[:, joint] - start[:, parent], end[:, joint] - end[:, parent], share)
        found[:, joint] = found[:, parent] + lengths[:, joint, None] * direction
    exact = share == 0.0
    found[exact] = start[exact]
    outside = (wanted < times[0]) | (wanted > times[-1]) | (~exact & (step > _LONGEST_NS))
    found[outside] = np.nan
    return found


def _between(start: Array, end: Array, share: Array) -> Array:
    """(N, 3) unit vectors from the direction of ``start`` to that of ``end``."""
    u, v = (each / np.linalg.norm(each, axis=1, keepdims=True) for each in (start, end))
    angle = np.arccos(np.clip(np.sum(u * v, axis=1), -1.0, 1.0))[:, None]
    sine = np.sin(angle)
    small = sine < 1e-6  # (almost) parallel, where straight and spherical interpolation agree
    divisor = np.where(small, 1.0, sine)
    of_u = np.where(small, 1.0 - share[:, None], np.sin((1.0 - share[:, None]) * angle) / divisor)
    of_v = np.where(small, share[:, None], np.sin(share[:, None] * angle) / divisor)
    mixed = of_u * u + of_v * v
    return np.asarray(mixed / np.linalg.norm(mixed, axis=1, keepdims=True))
