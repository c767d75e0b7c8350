"""Bone lengths of the averaged skeleton of the start-up pose, eq. (13), and of a moving person."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fusion.body import Body
from fusion.errors import CalibrationError
from fusion.registration.keyframes import Evidence
from fusion.rigid import RigidTransform
from fusion.skeleton import SkeletonPair
from fusion.support.types import Array

SHORTEST = 0.01
"""Metres: a shorter measured bone is a tracker's error and counts as unseen."""
_FEWEST_KEYFRAMES = 8  # keyframes in which a bone must be seen
_ASYMMETRIC = 4.0  # standard errors by which left and right must differ to be told apart
_SPREAD_FACTOR = 1.253  # standard error of a median over that of a mean, normal errors
_WANDER_FRAMES = 6.0  # neighbouring keyframes share the tracker's scale: this many count as one


def measure_bone_lengths(body: Body, pairs: Sequence[SkeletonPair], a_from_b: RigidTransform) -> Array:
    """The mean length of each bone of the averaged skeleton p* = ½(p + R q + t), eq. (13).

    A bone whose joints are never tracked in both views at once takes its length in one view, then that of its
    mirror image, then an adult's proportions scaled to the measured bones.

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


def bone_lengths_of(body: Body, positions: NDArray[np.floating]) -> Array:
    """(…, J) length of the bone that ends in each joint, for (…, J, 3) positions; NaN at the root."""
    at = np.asarray(positions, dtype=np.float64)
    length = np.linalg.norm(at - at[..., body.parent_indices, :], axis=-1)
    length[..., body.root] = np.nan
    return np.asarray(length, dtype=np.float64)


def _mean_where_seen(body: Body, lengths: list[Array]) -> Array:
    if not lengths:
        return np.full(len(body), np.nan)
    stacked = np.array(lengths)
    seen = np.isfinite(stacked)
    total = np.where(seen, stacked, 0.0).sum(axis=0)
    count = seen.sum(axis=0)
    mean = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    return np.where(mean >= SHORTEST, mean, np.nan)


def robust_bone_lengths(body: Body, evidence: Evidence, a_from_b: RigidTransform, fallback: Array) -> Array:
    """The median length of each bone over the keyframes, the same on both sides of the body.

    A keyframe's length is the mean of the two views' own lengths. The length of the averaged skeleton, eq.
    (13), would be shorter wherever the views disagree. Left and right share one length unless their medians
    differ by more than four standard errors and by 5 %.

    Args:
        a_from_b: R and t; joints at which the views disagree by far are left out.
        fallback: (J,) metres, for bones that were not seen; scaled to the measured bones.

    Returns:
        (J,) metres, by the joint at the bone's far end; 0 at the root.

    Raises:
        CalibrationError: No bone is seen often enough.
    """
    length, error = _medians(body, evidence, a_from_b)
    measured = np.isfinite(length)
    if not measured.any():
        raise CalibrationError("No bone is seen by both sensors often enough to be measured.")
    length, error = _symmetric(body, length, error)
    known = np.isfinite(length) & (fallback > 0.0)
    scale = float(np.median(length[known] / fallback[known])) if known.any() else 1.0
    length = np.where(np.isfinite(length), length, scale * fallback)
    length[body.root] = 0.0
    return np.asarray(length)


def _medians(body: Body, evidence: Evidence, a_from_b: RigidTransform) -> tuple[Array, Array]:
    """(J,) median lengths and their standard errors; NaN where a bone was seen too rarely."""
    apart = np.linalg.norm(evidence.a - a_from_b.apply(evidence.b), axis=2)  # (K, J)
    sure = evidence.weights > 0.5 * evidence.weights.max(initial=0.0)
    if sure.any():
        sure &= apart < 3.0 * np.median(apart[sure])
    seen = sure & sure[:, body.parent_indices]
    mean = 0.5 * (bone_lengths_of(body, evidence.a) + bone_lengths_of(body, evidence.b))
    length, error = np.full(len(body), np.nan), np.full(len(body), np.nan)
    for joint in body.bone_joints:
        values = mean[seen[:, joint], joint]
        if len(values) < _FEWEST_KEYFRAMES:
            continue
        median = float(np.median(values))
        if median >= SHORTEST:
            length[joint] = median
            spread = 1.4826 * float(np.median(np.abs(values - median)))
            error[joint] = _SPREAD_FACTOR * spread * np.sqrt(_WANDER_FRAMES / len(values))
    return length, error


def _symmetric(body: Body, length: Array, error: Array) -> tuple[Array, Array]:
    """The mean of both sides, or the side that was seen, unless the sides differ significantly."""
    other, other_error = length[body.mirror], error[body.mirror]
    both = np.isfinite(length) & np.isfinite(other)
    differs = np.abs(length - other)
    objects = both & (differs > _ASYMMETRIC * np.hypot(error, other_error))
    objects &= differs > 0.05 * np.minimum(length, other)
    # Weights are inverse variances.
    weight, other_weight = (1.0 / np.maximum(sd, 1e-4) ** 2 for sd in (error, other_error))
    mean = (weight * length + other_weight * other) / (weight + other_weight)
    shared = np.where(both & ~objects, mean, length)
    return (np.where(np.isfinite(shared), shared, other), np.where(np.isfinite(error), error, other_error))
