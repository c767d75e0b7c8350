"""The rotation R and translation t from K_B's frame to K_A's, eq. (12)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fusion.body import Body
from fusion.compiling.kernels import kernel
from fusion.errors import CalibrationError
from fusion.registration.keyframes import Evidence
from fusion.registration.lasting_errors import (
    COMMON_SD,
    FrontalTurn,
    common_variance,
    opposition,
    turned_apart,
)
from fusion.rigid import NOWHERE, RigidTransform, through_quaternion
from fusion.skeleton import SkeletonPair
from fusion.support.read_only import ReadOnlyArrays
from fusion.support.types import Array

LARGEST_RESIDUAL = 0.300
"""Metres: a fit whose median residual is larger cannot be right."""
NOBODY_IN_BOTH = (
    "No frame shows a person to both sensors. Check that the two recordings overlap and that the person "
    "stands in both views."
)
_FEWEST_JOINTS = 5
_STEPS = 12  # of a robust fit
_TUNING = 1.4826  # times the median distance: a larger residual counts less than a quarter
_OF_RESIDUAL = 0.3  # depth error of a pose, as a share of the residual, where that is larger than usual
_THINNEST = 0.02  # second to first singular value of the joints' spread: below, they lie on a line


def fit_rigid(points_a: Array, points_b: Array, weights: Array | None = None) -> RigidTransform:
    """The rigid transform that minimises eq. (12), J_R = Σ w_i ‖R(q_i − c_q) + t − (p_i − c_p)‖².

    R is the rotation nearest to the points' covariance (SVD, reflections excluded), normalised as a unit
    quaternion as in the paper. t then follows from the centres, c_p = R c_q + t. (scipy's ``align_vectors``
    differs in the last bits, and version 0.1 fused recordings with these.)

    Args:
        points_a: (N, 3) p, metres, in K_A's frame.
        points_b: (N, 3) q, the same points in K_B's frame.
        weights: (N,) w; all 1 as in the paper where None.

    Returns:
        ``a_from_b``.

    Raises:
        CalibrationError: The points do not determine a rotation: fewer than three, or all on one line.
    """
    if len(points_a) < 3:
        raise CalibrationError(f"A rigid fit needs at least 3 points; there are {len(points_a)}.")
    centre_a, centre_b = (np.average(points, axis=0, weights=weights) for points in (points_a, points_b))
    spread_b = np.linalg.svd(points_b - centre_b, compute_uv=False)
    if spread_b[1] < _THINNEST * spread_b[0] or spread_b[0] == 0.0:
        raise CalibrationError(
            "The joints seen by both sensors lie on one line, which leaves a rotation open."
        )
    a = points_a - centre_a if weights is None else weights[:, None] * (points_a - centre_a)
    U, _, Vt = np.linalg.svd(a.T @ (points_b - centre_b))
    U[:, 2] *= np.sign(np.linalg.det(U @ Vt))
    R = through_quaternion(U @ Vt)
    return RigidTransform.of(R, centre_a - R @ centre_b)


def fit_recording(p: Array, q: Array) -> RigidTransform:
    """The robust rigid fit ``a_from_b`` of one view's joints to the other's over a whole recording.

    All joints of all frames have equal weight; see :func:`robust_fits`. For figures and baselines.

    Args:
        p, q: (…, 3) the same joints in K_A's and in K_B's frame, metres; NaN where unknown.

    Raises:
        CalibrationError: See :func:`fit_rigid`.
    """
    both = np.isfinite(p).all(axis=-1) & np.isfinite(q).all(axis=-1)
    fit_rigid(p[both], q[both])  # raises what leaves the rotation open
    rotation, translation = robust_fits(p[both][None], q[both][None])
    return RigidTransform.of(rotation[0], translation[0])


def robust_fits(p: Array, q: Array) -> tuple[Array, Array]:
    """Robust rigid fits of K sets of N points at once.

    Iteratively re-weighted least squares: Geman–McClure weights 1 / (1 + (r / s)²)² with s from the median
    residual.

    Args:
        p: (K, N, 3) or (1, N, 3) points, metres, in K_A's frame; NaN where unknown.
        q: (K, N, 3) the same points in K_B's frame.

    Returns:
        (K, 3, 3) R and (K, 3) t of ``a_from_b``; NaN where the points leave the rotation open.
    """
    p = np.ascontiguousarray(p, dtype=np.float64)
    q = np.ascontiguousarray(q, dtype=np.float64)
    known = np.isfinite(sum_of_coordinates(p) + sum_of_coordinates(q))
    apart, count = np.where(known, 0.0, np.nan), known.sum(axis=1)
    scale, sums = np.full(len(q), np.inf), np.empty((len(q), 25))  # all weights are 1 at first
    undetermined = count < 3
    for step in range(_STEPS):
        _weighted_sums(p, q, apart, scale, sums)
        total = np.maximum(sums[:, :1], 1e-300)
        centre_p, centre_q = sums[:, 1:4] / total, sums[:, 4:7] / total
        p_by_q, q_by_q = ((sums[:, k : k + 9] / total).reshape(-1, 3, 3) for k in (7, 16))
        if not step:
            squares = np.linalg.eigvalsh(q_by_q - centre_q[:, :, None] * centre_q[:, None])  # least first
            undetermined |= squares[:, 1] <= _THINNEST**2 * squares[:, 2]
        U, _, Vt = np.linalg.svd(p_by_q - centre_p[:, :, None] * centre_q[:, None])
        U[:, :, 2] *= np.sign(np.linalg.det(U @ Vt))[:, None]
        R = U @ Vt
        t = centre_p - (R @ centre_q[:, :, None])[:, :, 0]
        if step < _STEPS - 1:
            _distances(p, q, R, t, apart)
            medians = [np.partition(row, k)[k] for row, k in zip(apart, count // 2, strict=True)]
            scale = np.maximum(_TUNING * np.array(medians), 1e-9)
    R[undetermined], t[undetermined] = np.nan, np.nan
    return R, t


def sum_of_coordinates(points: Array) -> Array:
    """(…) of (…, 3) points. ``np.sum`` takes longer along so short an axis."""
    return np.asarray(points[..., 0] + points[..., 1] + points[..., 2])


@kernel
def _distances(p, q, R, t, apart):  # type: ignore[no-untyped-def]
    """(K, N) metres between p and R q + t; NaN stays where a point is unknown."""
    for k in range(len(q)):
        of = min(k, len(p) - 1)
        for n in range(q.shape[1]):
            if apart[k, n] == apart[k, n]:
                square = 0.0
                for i in range(3):
                    off = p[of, n, i] - t[k, i]
                    for j in range(3):
                        off -= R[k, i, j] * q[k, n, j]
                    square += off * off
                apart[k, n] = math.sqrt(square)


@kernel
def _weighted_sums(p, q, apart, scale, sums):  # type: ignore[no-untyped-def]
    """(K, 25) sums of w, w p, w q, w p qᵀ and, in the first step, w q qᵀ over the known points."""
    for k in range(len(q)):
        of, first = min(k, len(p) - 1), scale[k] == np.inf
        for i in range(sums.shape[1]):
            sums[k, i] = 0.0
        for n in range(q.shape[1]):
            if apart[k, n] == apart[k, n]:
                ratio = apart[k, n] / scale[k]
                weight = 1.0 / (1.0 + ratio * ratio) ** 2
                sums[k, 0] += weight
                for i in range(3):
                    wp, wq = weight * p[of, n, i], weight * q[k, n, i]
                    sums[k, 1 + i] += wp
                    sums[k, 4 + i] += wq
                    for j in range(3):
                        sums[k, 7 + 3 * i + j] += wp * q[k, n, j]
                        if first:
                            sums[k, 16 + 3 * i + j] += wq * q[k, n, j]


@dataclass(frozen=True, eq=False)
class Registration(ReadOnlyArrays):
    """A transform between the sensors and its uncertainty."""

    a_from_b: RigidTransform  # R and t
    residual_median: float  # metres between p_i and R q_i + t over all joints and frames
    residual_rms: float
    joint_residuals: Array
    """(J,) metres, the median of each joint; NaN for a joint never tracked in both views."""
    rotation_sd: float
    """Radians, standard deviation of R about its least certain axis, with the errors of
    :mod:`fusion.registration.lasting_errors`. A joint's bias is the same in all frames of a pose."""
    frames: int  # how many pairs were used
    body: Body  # the body the joints belong to
    translation_sd: float = float("nan")
    """Metres, standard deviation of R q + t at the centre, along the least certain axis, with the trackers'
    lasting errors; NaN where a session does not have it."""
    centre: Array = field(default_factory=lambda: NOWHERE)
    """(3,) metres, the mean place of the joints that were used, in K_A's frame; NaN likewise."""

    @staticmethod
    def between(
        body: Body, p: Array, q: Array, seen: NDArray[np.bool_], a_from_b: RigidTransform, *sd: float
    ) -> Registration:
        """The registration of (T, J, 3) views at the (T, J) joints that both see; ``sd`` as above."""
        apart = np.full(seen.shape, np.nan)
        known = apart[seen] = np.linalg.norm(p[seen] - a_from_b.apply(q[seen]), axis=1)
        joints = np.full(len(body), np.nan)
        for joint in np.flatnonzero(seen.any(axis=0)):
            joints[joint] = np.median(apart[seen[:, joint], joint])
        median, rms = float(np.median(known)), float(np.sqrt(np.mean(known**2)))
        turn, shift = sd
        return Registration(a_from_b, median, rms, joints, turn, len(p), body, shift, p[seen].mean(axis=0))

    def sd_at(self, distance: float) -> float:
        """Metres, standard deviation of R q + t at this distance from the centre, at most."""
        return float(np.hypot(self.translation_sd, distance * self.rotation_sd))

    def worst_joints(self, count: int = 3) -> list[tuple[str, float]]:
        """The joints with the largest disagreement: (name, median residual in metres), worst first."""
        known = np.flatnonzero(np.isfinite(self.joint_residuals))
        worst = known[np.argsort(-self.joint_residuals[known])][:count]
        return [(self.body.joints[j], float(self.joint_residuals[j])) for j in worst]


def register(pairs: Sequence[SkeletonPair], *, frontal: bool = False) -> Registration:
    """R and t from all joints tracked in both views, over all given pairs at once.

    Assumes that the sensors do not move. The person may move.

    Args:
        frontal: Whether to turn the sensors apart by as much as trackers show a standing person too frontal
            (:class:`fusion.registration.lasting_errors.FrontalTurn`). Otherwise the standard deviation
            contains it.

    Raises:
        CalibrationError: Too few joints tracked in both views, a degenerate configuration, or a residual
            so large that the recordings cannot belong together.
    """
    seen = [(pair.a, pair.b) for pair in pairs if pair.a is not None and pair.b is not None]
    if not seen:
        raise CalibrationError(NOBODY_IN_BOTH)
    body = seen[0][0].body
    p = np.array([a.positions for a, _ in seen], dtype=np.float64)  # (T, J, 3)
    q = np.array([b.positions for _, b in seen], dtype=np.float64)
    both = np.array([a.tracked & b.tracked for a, b in seen])  # (T, J)
    joints = int(both.any(axis=0).sum())
    if joints < _FEWEST_JOINTS:
        raise CalibrationError(
            f"Too few joints are tracked in both views: {joints}, and registration needs {_FEWEST_JOINTS}. "
            "Stand at 45° to both sensors, arms and legs apart, the whole body in both views."
        )
    a_from_b = fit_rigid(p[both], q[both])
    mean_square = float(np.mean(np.linalg.norm(p[both] - a_from_b.apply(q[both]), axis=1) ** 2))
    middle, of_tracker = p[both].mean(axis=0), FrontalTurn.of(body)
    sine, cosine = opposition(a_from_b, middle)
    rotation_se, translation_se = _standard_errors(p[both], mean_square, joints)
    # Of opposite sides of the body few joints are seen by both, and whole limbs are off at once.
    rotation_se *= float(np.hypot(1.0, 0.5 * (1.0 - cosine)))
    common_sd = max(COMMON_SD, _OF_RESIDUAL * float(np.sqrt(mean_square)))
    turn = float(np.hypot(rotation_se, of_tracker.sd_where(sine, cosine, known=frontal)))
    shift = float(np.sqrt(translation_se**2 + common_variance(a_from_b, middle, common_sd)))
    if frontal:
        a_from_b = turned_apart(a_from_b, middle, of_tracker.turn)
    registration = Registration.between(body, p, q, both, a_from_b, turn, shift)
    if registration.residual_median > LARGEST_RESIDUAL:
        raise CalibrationError(
            f"The two views disagree by {registration.residual_median * 1000:.0f} mm (median) after the best "
            f"fit; more than {LARGEST_RESIDUAL * 1000:.0f} mm cannot be right. Do both recordings show the "
            f"same person at the same time? "
            f"Worst: {', '.join(name for name, _ in registration.worst_joints())}."
        )
    return registration


def _standard_errors(points: Array, mean_square: float, joints: int) -> tuple[float, float]:
    """Those of R, radians, and of the centre, metres, along the least certain axis of each."""
    # A rotation by a small θ moves a point at r from the centre by θ × r, so the information about θ
    # is Σ (|r|² I − r rᵀ) / σ², with σ² the variance of a residual along one axis. A joint counts once,
    # however many frames show it. The fit takes 6 of the 3 J degrees of freedom of J joints, so that σ² is
    # the mean square over 3 − 6 / J.
    r = points - points.mean(axis=0)
    information = (np.sum(r * r) * np.eye(3) - r.T @ r) * (joints / len(points))
    least = float(np.linalg.eigvalsh(information)[0])
    variance = mean_square / (3.0 - 6.0 / joints)
    rotation_se = float(np.sqrt(variance / least)) if least > 0.0 else np.inf
    return rotation_se, float(np.sqrt(variance / joints))


def label_free_fit(body: Body, evidence: Evidence) -> RigidTransform | None:
    """A robust fit of R and t to the midline and to midpoints of left and right; None if undetermined.

    These points are the same whether or not a view is mirrored. They determine R only if the person walks
    about.
    """
    own, other = body.midpoints
    usable = np.minimum(evidence.weights[:, own], evidence.weights[:, other]) > 0.5
    p = (0.5 * (evidence.a[:, own] + evidence.a[:, other]))[usable]
    q = (0.5 * (evidence.b[:, own] + evidence.b[:, other]))[usable]
    try:
        found = fit_rigid(p, q)
        for _ in range(10):
            apart = np.linalg.norm(p - found.apply(q), axis=1)
            near = apart <= 2.0 * max(float(np.median(apart)), 1e-4)
            found = fit_rigid(p[near], q[near])
    except CalibrationError:
        return None
    return found
