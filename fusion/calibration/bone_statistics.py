"""Bone lengths by robust statistics over the keyframes of a moving person."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fusion.body import Body
from fusion.calibration.bone_lengths import SHORTEST, bone_lengths_of
from fusion.errors import CalibrationError
from fusion.registration.keyframes import Evidence
from fusion.rigid import RigidTransform

Array = NDArray[np.float64]

_FEWEST = 8  # keyframes in which a bone must be seen
_ASYMMETRIC = 4.0  # standard errors by which left and right must differ to be told apart
_SPREAD_FACTOR = 1.253  # standard error of a median over that of a mean, normal errors
_WANDER_FRAMES = 6.0  # neighbouring keyframes share the tracker's scale: this many count as one


def robust_bone_lengths(body: Body, evidence: Evidence, a_from_b: RigidTransform, fallback: Array) -> Array:
    """The median length of each bone over the keyframes, the same on both sides of the body.

    A keyframe's length is the mean of the two views' own lengths. The length of the averaged skeleton, eq.
    (13), would be shorter wherever the views disagree. Left and right share one length unless their medians
    differ by more than four standard errors and by 5 %.

    Args:
        body: Of both views.
        evidence: With sides matched.
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
        if len(values) < _FEWEST:
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
    objects = both & (differs > _ASYMMETRIC * np.hypot(error, other_error)) & (differs > 0.05 * length)
    # Weights are inverse variances.
    weight, other_weight = (1.0 / np.maximum(sd, 1e-4) ** 2 for sd in (error, other_error))
    mean = (weight * length + other_weight * other) / (weight + other_weight)
    shared = np.where(both & ~objects, mean, length)
    return (
        np.where(np.isfinite(shared), shared, other),
        np.where(np.isfinite(error), error, other_error),
    )
