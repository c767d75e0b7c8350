"""R and t by the surface of the person that both sensors see, and the floor.

A tracker shifts all joints along its sensor's ray. A fit of joints puts that into t. The skin or the cloth
that both depth images show is one surface, whatever the trackers say:

    e = n · [(p − δ u_A) − (R (q + δ u_B) + t)]

p and q are the nearest points of the two images, n is the mean of their normals, u_A and u_B are the rays to
them. δ is half the difference of the depth cameras' offsets. Only points that face both sensors count. An
offset that both cameras share does not show: it stays in t as offset · (u_A − u_B).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from fusion.body import Body
from fusion.calibration.calibration import Calibration
from fusion.registration.keyframes import Evidence, match_sides
from fusion.registration.lasting_errors import common_variance
from fusion.registration.robust_fit import RobustFit, registration_of
from fusion.rigid import RigidTransform, rotation_of, rotation_vector
from fusion.skeleton import nearer
from fusion.support.types import Array

FEWEST_MATCHES, FEWEST_MOMENTS = 300, 4
_LARGEST_RMS = 0.008  # metres, between the surfaces after the fit
_EXTENT = 0.15  # metres: matches of a moment whose largest standard deviation is less are of one limb
_LARGEST_CHANGE = 3.0  # standard deviations of the joints' fit, for each of its six numbers
_FAR, _NEAR, _NARROWING = 0.08, 0.025, 8  # metres between matches at first and at last; steps in between
_STEPS = 25
_ALIKE = 0.87  # cosine between the normals of two matches
_FACING = 0.15  # least cosine between a normal and the ray to either sensor
_SURFACE_SD, _TUNING, _TEMPERING = 0.006, 0.008, 100.0  # metres, metres; each match is found from both sides
_FLOOR_TURN, _FLOOR_HEIGHT = np.radians(0.5), 0.004  # radians; metres at the person
_ACROSS_SD, _DEPTH_SD = 0.012, 0.028
"""Metres, error of the joints' t: across the rays; along each ray, of which t contains u_A − u_B."""
_LEAST_TURN = np.radians(1.0)  # standard deviation of the joints' R: whole limbs are off at once
_LASTING = np.diag([0.002**2] * 3 + [np.radians(0.25) ** 2] * 3)
"""Of the surface itself, metres and radians: of material, of grazed and of moved surfaces."""
_SAME_JOINT = 0.2  # metres between both views of a joint; more is a wrong joint
_NOISE_SD, _ERROR_SD = 0.03, 0.03  # metres, of a joint, and of a view's depth error before it is measured
_INDEPENDENT = 40.0  # a recording counts as so many independent joints
_OFFSET_SD = (
    0.010  # metres, of the depth offset that both cameras share; devices of one model are 5 to 10 mm apart
)
_OWN_OFFSET_SD = 0.004  # metres, of half the difference between the cameras' depth offsets


class Surface(NamedTuple):
    """The person in one depth image."""

    points: Array  # (N, 3) metres, in the sensor's frame
    normals: Array  # (N, 3) unit vectors towards the sensor


class SharedSurface(NamedTuple):
    """What the depth images of some moments show to both sensors."""

    moments: list[tuple[Surface, Surface]]  # A's and B's
    floors: tuple[Array | None, Array | None]  # (4,) n, h of the floor n · x = h in each frame, n upwards


class SurfaceFit(NamedTuple):
    """A fit of joints and surface."""

    fit: RobustFit
    matches: int
    moments: int  # that have matches
    rms: float  # metres between the surfaces; NaN without matches
    extent: float  # metres, median of the moments' largest standard deviation of the matches
    change: float  # from the joints' fit, in standard deviations of it; root mean square of six
    floor: bool

    @property
    def certain(self) -> bool:
        """Whether enough of the person was seen by both, and fits."""
        return (
            self.matches >= FEWEST_MATCHES
            and self.moments >= FEWEST_MOMENTS
            and self.rms < _LARGEST_RMS
            and self.extent > _EXTENT
            and self.change < _LARGEST_CHANGE
        )


def with_surface(
    body: Body,
    evidence: Evidence,
    fitted: Calibration,
    joints: RobustFit | None,
    shared: SharedSurface | None,
) -> Calibration:
    """A calibration with R and t by the surface that both sensors see, if they see enough of it.

    Args:
        joints: The fit of the keyframes; what the calibration states if None.
    """
    known = fitted.registration
    if shared is None or known is None or not (evidence.weights > 0.5).any():
        return fitted
    rests = f"fit of joints in {len(evidence.a)} keyframes"
    if joints is None:
        rests, variances = fitted.how, np.repeat(np.square((known.translation_sd, known.rotation_sd)), 3)
        joints = RobustFit(
            fitted.a_from_b, np.diag(variances), known.centre, np.zeros((3, len(body), 3)), 0.02
        )
    found = fit_surface(shared, joints)
    if not found.certain:
        return replace(fitted, how=f"{fitted.how}; both sensors see too little of one surface")
    fit = found.fit
    match_sides(body, evidence, fit.a_from_b)
    errors = depth_errors(evidence, fit.a_from_b)
    registration = registration_of(body, without_depth_errors(evidence, errors), fit)
    floor = " and the floor" if found.floor else ""
    return replace(
        fitted,
        a_from_b=fit.a_from_b,
        how=f"{rests}, of the surface in {found.moments} moments ({1e3 * found.rms:.0f} mm apart){floor}",
        registration=replace(registration, frames=max(registration.frames, known.frames)),
        depth_errors=errors,
    )


def fit_surface(shared: SharedSurface, joints: RobustFit) -> SurfaceFit:
    """The fit of joints, surface and floor: Gauss-Newton on (dt, θ, δ) with iterated weights.

    Args:
        joints: The fit of the joints. Its shift is taken as uncertain along u_A − u_B.
    """
    from scipy.spatial import cKDTree  # it loads for as long as the method

    trees = [(cKDTree(a.points), cKDTree(b.points)) for a, b in shared.moments]
    known, c = joints.a_from_b, joints.centre
    in_b = known.inverse().apply(c)
    covariance = _of_joints(joints)
    of_joints, R, t, delta = np.linalg.inv(covariance), known.rotation, known.translation, 0.0
    residuals, matched, information = np.zeros(0), [np.zeros((0, 3))], np.eye(7)
    for step in range(_STEPS):
        reach = max(_NEAR, _FAR + (_NEAR - _FAR) * step / _NARROWING)
        found = [
            _matches(*moment, *of, R, t, delta, reach)
            for moment, of in zip(shared.moments, trees, strict=True)
        ]
        matched = [each[2] for each in found]
        none = np.zeros(0), *(np.zeros((0, 3)) for _ in range(4))
        residuals, normals, at, u_a, u_b = (np.concatenate(each) for each in zip(none, *found, strict=True))
        jacobian = np.column_stack((normals, np.cross(at - c, normals), _dot(normals, u_a + u_b)))
        weights = 1.0 / (1.0 + (residuals / _TUNING) ** 2) / (_SURFACE_SD**2 * _TEMPERING)
        information, gradient = (jacobian.T * weights) @ jacobian, (jacobian.T * weights) @ residuals
        off = np.append(known.apply(in_b) - (R @ in_b + t), rotation_vector(known.rotation @ R.T))
        information[:6, :6] += of_joints
        gradient[:6] += of_joints @ off
        information[6, 6] += _OWN_OFFSET_SD**-2
        gradient[6] -= delta * _OWN_OFFSET_SD**-2
        _add_floor(information, gradient, shared.floors, R, t, c)
        move = np.linalg.solve(information, gradient)
        turn = rotation_of(move[3:6])
        R, t, delta = turn @ R, c + move[:3] + turn @ (t - c), delta + float(move[6])
        if step > _NARROWING and np.abs(move).max() < 1e-6:
            break
    U, _, Vt = np.linalg.svd(R)
    a_from_b = RigidTransform.of(U @ Vt, t)
    covariance = np.linalg.inv(information)[:6, :6] + _LASTING
    along = _rays_apart(a_from_b, c)
    covariance[:3, :3] += _OFFSET_SD**2 * np.outer(along, along)
    moved = np.append(a_from_b.apply(in_b) - c, rotation_vector(a_from_b.rotation @ known.rotation.T))
    large = [len(at) >= FEWEST_MATCHES // FEWEST_MOMENTS // 2 for at in matched]
    extents = [
        np.sqrt(np.linalg.eigvalsh(np.cov(at.T))[-1]) for at, of in zip(matched, large, strict=True) if of
    ]
    return SurfaceFit(
        replace(joints, a_from_b=a_from_b, covariance=covariance),
        len(residuals) // 2,
        sum(large),
        float(np.sqrt(np.mean(residuals**2))) if len(residuals) else float("nan"),
        float(np.median(extents)) if extents else 0.0,
        float(np.sqrt(moved @ of_joints @ moved / 6.0)),
        all(floor is not None for floor in shared.floors),
    )


def depth_errors(evidence: Evidence, a_from_b: RigidTransform) -> Array:
    """(2,) metres d_A, d_B by which both views are too far away: p − (R q + t) = d_A u_A − d_B u_B.

    Of use only where R and t come from elsewhere: a fit of the joints puts these errors into t.
    """
    seen = evidence.weights > 0.5
    p, q = evidence.a[seen], evidence.b[seen]
    residuals, rows = p - a_from_b.apply(q), np.stack((_unit(p), -_unit(q) @ a_from_b.rotation.T), axis=2)
    near = np.linalg.norm(residuals, axis=1) < _SAME_JOINT
    residuals, rows = residuals[near], rows[near]
    errors = np.zeros(2)
    for _ in range(8):
        square = ((residuals - rows @ errors) ** 2).sum(axis=1)
        weights = _INDEPENDENT / max(len(rows), 1) / (_NOISE_SD**2 + square)
        information = np.einsum("nik,nil,n->kl", rows, rows, weights) + np.eye(2) / _ERROR_SD**2
        errors = np.linalg.solve(information, np.einsum("nik,ni,n->k", rows, residuals, weights))
    return errors


def without_depth_errors(evidence: Evidence, errors: Array) -> Evidence:
    """The evidence without (2,) depth errors of A and of B, metres."""
    return evidence._replace(a=nearer(evidence.a, float(errors[0])), b=nearer(evidence.b, float(errors[1])))


def _of_joints(joints: RobustFit) -> Array:
    """(6, 6) covariance of the joints' fit, whose common error lies along u_A − u_B."""
    along = _rays_apart(joints.a_from_b, joints.centre)
    covariance = joints.covariance.copy()
    covariance[:3, :3] += _ACROSS_SD**2 * np.eye(3) + _DEPTH_SD**2 * np.outer(along, along)
    covariance[:3, :3] -= common_variance(joints.a_from_b, joints.centre) * np.eye(3)
    covariance[3:, 3:] += _LEAST_TURN**2 * np.eye(3)
    return covariance


def _rays_apart(a_from_b: RigidTransform, at: Array) -> Array:
    """(3,) u_A − u_B of the rays from both sensors to a point."""
    return _unit(at) - _unit(at - a_from_b.translation)


def _matches(
    a: Surface, b: Surface, tree_a: Any, tree_b: Any, R: Array, t: Array, delta: float, reach: float
) -> tuple[Array, Array, Array, Array, Array]:
    """Points of both views that are nearest to one of the other view, face both sensors and are alike.

    Returns:
        (N,) e; (N, 3) n, points, u_A and u_B, in K_A's frame.
    """
    from_b, normals_b = b.points @ R.T + t, b.normals @ R.T
    faces_b = _dot(a.normals, _unit(t - a.points)) > _FACING
    faces_a = _dot(normals_b, _unit(-from_b)) > _FACING
    own_a, own_b = np.flatnonzero(faces_b), np.flatnonzero(faces_a)
    near_b, index_b = tree_b.query((a.points[own_a] - t) @ R, distance_upper_bound=reach)
    near_a, index_a = tree_a.query(from_b[own_b], distance_upper_bound=reach)
    some_a, some_b = np.isfinite(near_b), np.isfinite(near_a)
    i = np.concatenate((own_a[some_a], index_a[some_b]))
    j = np.concatenate((index_b[some_a], own_b[some_b]))
    alike = faces_b[i] & faces_a[j] & (_dot(a.normals[i], normals_b[j]) > _ALIKE)
    i, j = i[alike], j[alike]
    u_a, u_b = _unit(a.points[i]), _unit(b.points[j]) @ R.T
    n = _unit(a.normals[i] + normals_b[j])
    at = from_b[j] + delta * u_b
    return _dot(n, a.points[i] - delta * u_a - at), n, at, u_a, u_b


def _add_floor(
    information: Array,
    gradient: Array,
    floors: tuple[Array | None, Array | None],
    R: Array,
    t: Array,
    c: Array,
) -> None:
    """Adds that both sensors stand over one floor: its normal, and its height below the person."""
    if floors[0] is None or floors[1] is None:
        return
    (n_a, h_a), (n_b, h_b) = ((floor[:3], floor[3]) for floor in floors if floor is not None)
    up = R @ n_b
    cross = np.array([[0.0, -up[2], up[1]], [up[2], 0.0, -up[0]], [-up[1], up[0], 0.0]])
    information[3:6, 3:6] += cross.T @ cross / _FLOOR_TURN**2
    gradient[3:6] -= cross.T @ (n_a - up) / _FLOOR_TURN**2
    below = c - n_a * (n_a @ c - h_a)
    at = below - up * (up @ (below - t) - h_b)  # the floor as B sees it, below the person
    row = np.concatenate((n_a, np.cross(at - c, n_a)))
    information[:6, :6] += np.outer(row, row) / _FLOOR_HEIGHT**2
    gradient[:6] += row * (h_a - n_a @ at) / _FLOOR_HEIGHT**2


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def _dot(one: Array, other: Array) -> Array:
    return np.asarray((one * other).sum(axis=-1))
