"""Bone lengths of the averaged skeleton of the start-up pose, eq. (13)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fusion.body import Body
from fusion.errors import CalibrationError
from fusion.rigid import RigidTransform
from fusion.skeleton import SkeletonPair

SHORTEST = 0.01
"""Metres: a shorter measured bone is a tracker's error and counts as unseen."""


def measure_bone_lengths(
    body: Body, pairs: Sequence[SkeletonPair], a_from_b: RigidTransform
) -> NDArray[np.float64]:
    """The mean length of each bone of the averaged skeleton p* = ½(p + R q + t), eq. (13).

    A bone whose joints are never tracked in both views at once takes its length in one view, then that of its
    mirror image, then an adult's proportions scaled to the measured bones.

    Args:
        body: The body of all pairs.
        pairs: A few seconds of the start-up pose.
        a_from_b: R and t.

    Returns:
        (J,) metres, by the joint at the bone's far end; 0 at the root.

    Raises:
        CalibrationError: No bone is seen at all.
    """
    averaged, single = [], []
    for pair in pairs:
        p = np.full((len(body), 3), np.nan) if pair.a is None else pair.a.positions.astype(np.float64)
        q = np.full((len(body), 3), np.nan) if pair.b is None else a_from_b.apply(pair.b.positions)
        if pair.a is not None and pair.b is not None:
            both = (pair.a.tracked & pair.b.tracked)[:, None]
            averaged.append(bone_lengths_of(body, np.where(both, 0.5 * (p + q), np.nan)))
        single += [bone_lengths_of(body, p), bone_lengths_of(body, q)]
    length = _mean_where_seen(body, averaged)
    length = np.where(np.isnan(length), _mean_where_seen(body, single), length)
    length = np.where(np.isnan(length), length[body.mirror], length)
    measured = np.isfinite(length) & (body.nominal_lengths > 0.0)
    if not measured.any():
        raise CalibrationError("No bone is seen in any frame. The whole body must be in view at the start.")
    scale = float(np.median(length[measured] / body.nominal_lengths[measured]))
    length = np.where(np.isnan(length), scale * body.nominal_lengths, length)
    length[body.root] = 0.0
    return length


def bone_lengths_of(body: Body, positions: NDArray[np.floating]) -> NDArray[np.float64]:
    """(…, J) length of the bone that ends in each joint, for (…, J, 3) positions; NaN at the root."""
    at = np.asarray(positions, dtype=np.float64)
    length = np.linalg.norm(at - at[..., body.parent_indices, :], axis=-1)
    length[..., body.root] = np.nan
    return np.asarray(length, dtype=np.float64)


def _mean_where_seen(body: Body, lengths: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    if not lengths:
        return np.full(len(body), np.nan)
    stacked = np.array(lengths)
    seen = np.isfinite(stacked)
    total = np.where(seen, stacked, 0.0).sum(axis=0)
    count = seen.sum(axis=0)
    mean = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    return np.where(mean >= SHORTEST, mean, np.nan)
