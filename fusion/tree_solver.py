"""The closest joints with exactly these bone lengths, eq. (1), by Newton's method on the tree of bones.

The unknowns are the root's position and one direction a bone, so that every iterate has the right bone
lengths. A Newton step couples each joint to its parent only: eliminating joints from the leaves to the
root and substituting back solves it in O(J).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from fusion.errors import FusionError
from fusion.small_matrices import absolute_inverse_2x2, eigen_3x3, tangent_basis

import os
MAX_ITERATIONS = 50
GN0,UP,DOWN,MU0,WATCH,WREL=eval(os.environ.get('PP','(1e-9,8.,.1,1e-5,2,1.)'))
_GRADIENT_TOLERANCE = 1e-11  # m: tangential force over the information that the joint carries
_STEP_TOLERANCE = 1e-9  # m: a Newton step below it is the last
_LAST_STEP = 1e-5  # relative to the bone: a step below it leaves an error of its square
_FLOOR = 1e-10  # a pivot below this share of the information in the subtree counts as flat
_SADDLE = 1e-8  # a pivot below minus this share leads downhill even where the gradient is zero
_KICK = 0.5  # relative to the bone: how far a saddle is left at once
_CAP = 2.0  # relative to the bone: the longest step of one bone's end, an angle of 63 degrees
_ARMIJO = 1e-4
_ROUNDING = 1e-14  # relative: two objectives nearer than this are the same

# The workspace: one (J, 6) block a quantity.
_POSITION, _TRIAL, _TARGET, _INFO, _TREE_INFO, _FORCE, _BASIS, _INFO_BASIS, _PIVOT, _STEP, _BONE, _GRADIENT, _SAVED = range(13)
_BLOCKS = 13


@njit(error_model="numpy")
def _load(targets, weights, lengths, root, work):  # type: ignore[no-untyped-def]
    """Targets and information into the workspace; a joint without a finite target has no information."""
    target, info, bone = work[_TARGET], work[_INFO], work[_BONE]
    for i in range(targets.shape[0]):
        if weights.ndim == 1:
            xx = yy = zz = weights[i]
            xy = xz = yz = 0.0
        else:
            xx, xy, xz = weights[i, 0, 0], weights[i, 0, 1], weights[i, 0, 2]
            yy, yz, zz = weights[i, 1, 1], weights[i, 1, 2], weights[i, 2, 2]
        x, y, z = targets[i, 0], targets[i, 1], targets[i, 2]
        if not (math.isfinite(x + y + z) and xx + yy + zz > 0.0):
            x = y = z = xx = xy = xz = yy = yz = zz = 0.0
        target[i, 0], target[i, 1], target[i, 2] = x, y, z
        info[i, 0], info[i, 1], info[i, 2] = xx, xy, xz
        info[i, 3], info[i, 4], info[i, 5] = yy, yz, zz
        bone[i, 3] = lengths[i]
        if i != root and not (lengths[i] > 0.0 and math.isfinite(lengths[i])):
            return False
    return True


@njit(error_model="numpy")
def _place(parents, order, rest, start, from_targets, work, at):  # type: ignore[no-untyped-def]
    """A feasible skeleton into ``at``: directions of bones from a source, then the best translation.

    A bone takes its direction from the targets of its two ends (where asked, and where there are any),
    else from ``start``, else from ``rest``. Where only the far end has a target, the bone points to it.

    Returns:
        The objective.
    """
    target, info, bone = work[_TARGET], work[_INFO], work[_BONE]
    root = order[0]
    for c in range(3):
        at[root, c] = start[root, c] if math.isfinite(start[root, c]) else 0.0
    if from_targets and info[root, 0] + info[root, 3] + info[root, 5] > 0.0:
        for c in range(3):
            at[root, c] = target[root, c]
    for k in range(1, len(order)):
        i = order[k]
        p = parents[i]
        length = bone[i, 3]
        norm = 0.0
        x = y = z = 0.0
        if from_targets and info[i, 0] + info[i, 3] + info[i, 5] > 0.0:
            source = target if info[p, 0] + info[p, 3] + info[p, 5] > 0.0 else at
            x, y, z = target[i, 0] - source[p, 0], target[i, 1] - source[p, 1], target[i, 2] - source[p, 2]
            norm = math.sqrt(x * x + y * y + z * z)
        if not norm > 1e-9 * length:
            x, y, z = start[i, 0] - start[p, 0], start[i, 1] - start[p, 1], start[i, 2] - start[p, 2]
            norm = math.sqrt(x * x + y * y + z * z)
        if not (norm > 1e-9 * length and math.isfinite(norm)):
            x, y, z = rest[i, 0], rest[i, 1], rest[i, 2]
            norm = math.sqrt(x * x + y * y + z * z)
        scale = length / norm
        at[i, 0], at[i, 1], at[i, 2] = at[p, 0] + x * scale, at[p, 1] + y * scale, at[p, 2] + z * scale
    weight = x = y = z = 0.0
    for i in range(len(order)):
        w = info[i, 0] + info[i, 3] + info[i, 5]
        weight += w
        x += w * (target[i, 0] - at[i, 0])
        y += w * (target[i, 1] - at[i, 1])
        z += w * (target[i, 2] - at[i, 2])
    objective = 0.0
    for i in range(len(order)):
        if weight > 0.0:
            at[i, 0] += x / weight
            at[i, 1] += y / weight
            at[i, 2] += z / weight
        objective += _misfit(info, target, at, i)
    return objective


@njit(error_model="numpy")
def _misfit(info, target, at, i):  # type: ignore[no-untyped-def]
    """(x - m)ᵀ W (x - m) of one joint."""
    x, y, z = at[i, 0] - target[i, 0], at[i, 1] - target[i, 1], at[i, 2] - target[i, 2]
    return (
        info[i, 0] * x * x + info[i, 3] * y * y + info[i, 5] * z * z
        + 2.0 * (info[i, 1] * x * y + info[i, 2] * x * z + info[i, 4] * y * z)
    )  # fmt: skip


@njit(error_model="numpy")
def _pull(parents, order, work):  # type: ignore[no-untyped-def]
    """Forces F_i = g_i + Σ F_children with g_i = 2 W_i (x_i - m_i), bones e_i and their multipliers λ_i.

    Returns:
        The largest tangential force over the subtree's information, m: zero at a stationary point.
    """
    at, target, info = work[_POSITION], work[_TARGET], work[_INFO]
    force, bone, step, gradient = work[_FORCE], work[_BONE], work[_STEP], work[_GRADIENT]
    for i in range(len(order)):
        xx, xy, xz = 2.0 * info[i, 0], 2.0 * info[i, 1], 2.0 * info[i, 2]
        yy, yz, zz = 2.0 * info[i, 3], 2.0 * info[i, 4], 2.0 * info[i, 5]
        x, y, z = at[i, 0] - target[i, 0], at[i, 1] - target[i, 1], at[i, 2] - target[i, 2]
        gx, gy, gz = xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z
        force[i, 0], force[i, 1], force[i, 2] = gx, gy, gz
        gradient[i, 0], gradient[i, 1], gradient[i, 2] = gx, gy, gz
        step[i, 5] = xx + yy + zz
    largest = 0.0
    for k in range(len(order) - 1, 0, -1):
        i = order[k]
        p = parents[i]
        fx, fy, fz = force[i, 0], force[i, 1], force[i, 2]
        force[p, 0] += fx
        force[p, 1] += fy
        force[p, 2] += fz
        step[p, 5] += step[i, 5]
        ex, ey, ez = at[i, 0] - at[p, 0], at[i, 1] - at[p, 1], at[i, 2] - at[p, 2]
        bone[i, 0], bone[i, 1], bone[i, 2] = ex, ey, ez
        multiplier = -(ex * fx + ey * fy + ez * fz) / (bone[i, 3] * bone[i, 3])
        fx, fy, fz = fx + multiplier * ex, fy + multiplier * ey, fz + multiplier * ez
        if step[i, 5] > 0.0:
            largest = max(largest, math.sqrt(fx * fx + fy * fy + fz * fz) / step[i, 5])
    root = order[0]
    fx, fy, fz = force[root, 0], force[root, 1], force[root, 2]
    return max(largest, math.sqrt(fx * fx + fy * fy + fz * fz) / step[root, 5])


@njit(error_model="numpy")
def _eliminate(parents, order, work, damping, convex):  # type: ignore[no-untyped-def]
    """Leaves to root: each joint's tangential step as a function of its parent's.

    Returns:
        (whether every pivot was safely positive, the first joint whose pivot is negative or -1).
    """
    total, force, bone, step = work[_TREE_INFO], work[_FORCE], work[_BONE], work[_STEP]
    basis, info_basis, pivot = work[_BASIS], work[_INFO_BASIS], work[_PIVOT]
    info, gradient = work[_INFO], work[_GRADIENT]
    for i in range(len(order)):
        for c in range(6):
            total[i, c] = 2.0 * info[i, c]
        for c in range(3):
            force[i, 3 + c] = gradient[i, c]
    saddle = -1
    definite = True
    for k in range(len(order) - 1, 0, -1):
        i = order[k]
        scale = step[i, 5]
        if scale == 0.0:
            continue
        p = parents[i]
        inverse_length = 1.0 / bone[i, 3]
        ax, ay, az, bx, by, bz = tangent_basis(
            bone[i, 0] * inverse_length, bone[i, 1] * inverse_length, bone[i, 2] * inverse_length
        )
        basis[i, 0], basis[i, 1], basis[i, 2] = ax, ay, az
        basis[i, 3], basis[i, 4], basis[i, 5] = bx, by, bz
        xx, xy, xz = total[i, 0], total[i, 1], total[i, 2]
        yy, yz, zz = total[i, 3], total[i, 4], total[i, 5]
        # A T, (3, 2)
        px, py, pz = xx * ax + xy * ay + xz * az, xy * ax + yy * ay + yz * az, xz * ax + yz * ay + zz * az
        qx, qy, qz = xx * bx + xy * by + xz * bz, xy * bx + yy * by + yz * bz, xz * bx + yz * by + zz * bz
        info_basis[i, 0], info_basis[i, 1], info_basis[i, 2] = px, py, pz
        info_basis[i, 3], info_basis[i, 4], info_basis[i, 5] = qx, qy, qz
        curvature = (max(bone[i, 4], 0.0) if convex else bone[i, 4]) + damping * scale
        # M = Tᵀ A T + λ I, (2, 2), and its inverse
        i11, i12, i22, lowest, v1, v2 = absolute_inverse_2x2(
            ax * px + ay * py + az * pz + curvature,
            ax * qx + ay * qy + az * qz,
            bx * qx + by * qy + bz * qz + curvature,
            _FLOOR * scale,
        )
        if lowest <= _FLOOR * scale:
            definite = definite and lowest > -_SADDLE * scale
            if lowest < -_SADDLE * scale and saddle < 0:
                saddle = i
                step[i, 0], step[i, 1] = v1, v2
        rx, ry, rz = force[i, 3], force[i, 4], force[i, 5]
        y1, y2 = ax * rx + ay * ry + az * rz, bx * rx + by * ry + bz * rz
        pivot[i, 0], pivot[i, 1], pivot[i, 2], pivot[i, 3], pivot[i, 4] = i11, i12, i22, y1, y2
        # b - A T M⁻¹ Tᵀ b, on to the parent
        s1, s2 = i11 * y1 + i12 * y2, i12 * y1 + i22 * y2
        force[p, 3] += rx - px * s1 - qx * s2
        force[p, 4] += ry - py * s1 - qy * s2
        force[p, 5] += rz - pz * s1 - qz * s2
        # A - A T M⁻¹ Tᵀ A, on to the parent
        cx, cy, cz = i11 * px + i12 * qx, i11 * py + i12 * qy, i11 * pz + i12 * qz
        dx, dy, dz = i12 * px + i22 * qx, i12 * py + i22 * qy, i12 * pz + i22 * qz
        total[p, 0] += xx - px * cx - qx * dx
        total[p, 1] += xy - px * cy - qx * dy
        total[p, 2] += xz - px * cz - qx * dz
        total[p, 3] += yy - py * cy - qy * dy
        total[p, 4] += yz - py * cz - qy * dz
        total[p, 5] += zz - pz * cz - qz * dz
    return definite, saddle


@njit(error_model="numpy")
def _solve_root(A, b, scale):  # type: ignore[no-untyped-def]
    """The root's step -|A|⁻¹ b, with eigenvalues that are no more than rounding left out.

    Returns:
        (x, y, z of the step, the lowest eigenvalue if it was needed else +1, its eigenvector).
    """
    xx, xy, xz, yy, yz, zz = A[0], A[1], A[2], A[3], A[4], A[5]
    floor = _FLOOR * scale
    if xx > floor:
        lx, ly = xy / xx, xz / xx
        syy, syz, szz = yy - lx * xy, yz - lx * xz, zz - ly * xz
        if syy > floor:
            lz = syz / syy
            last = szz - lz * syz
            if last > floor:
                ry = b[4] - lx * b[3]
                rz = b[5] - ly * b[3] - lz * ry
                z = rz / last
                y = ry / syy - lz * z
                return -(b[3] / xx - lx * y - ly * z), -y, -z, 1.0, 0.0, 0.0, 0.0
    values, vectors = eigen_3x3(xx, xy, xz, yy, yz, zz)
    x = y = z = 0.0
    lowest, which = values[0], 0
    for c in range(3):
        value, (vx, vy, vz) = values[c], vectors[c]
        if value < lowest:
            lowest, which = value, c
        s = (vx * b[3] + vy * b[4] + vz * b[5]) / max(abs(value), floor)
        x, y, z = x - s * vx, y - s * vy, z - s * vz
    vx, vy, vz = vectors[which]
    return x, y, z, lowest, vx, vy, vz


@njit(error_model="numpy")
def _multipliers(order, work, t):
    total, force, bone, step = work[_TREE_INFO], work[_FORCE], work[_BONE], work[_STEP]
    for k in range(1, len(order)):
        i = order[k]
        dx, dy, dz = step[i, 2], step[i, 3], step[i, 4]
        fx = force[i, 3] + total[i, 0] * dx + total[i, 1] * dy + total[i, 2] * dz
        fy = force[i, 4] + total[i, 1] * dx + total[i, 3] * dy + total[i, 4] * dz
        fz = force[i, 5] + total[i, 2] * dx + total[i, 4] * dy + total[i, 5] * dz
        predicted = -(bone[i, 0] * fx + bone[i, 1] * fy + bone[i, 2] * fz) / (bone[i, 3] * bone[i, 3])
        bone[i, 4] += t * (predicted - bone[i, 4])


@njit(error_model="numpy")
def _substitute(parents, order, work, saddle, cap):  # type: ignore[no-untyped-def]
    """Root to leaves: s_i = -M⁻¹ Tᵀ (b_i + A_i d_p), d_i = d_p + T s_i.

    With a ``saddle`` joint the right-hand side is zero but for that joint's own step (in the workspace):
    the direction along which its negative pivot is the curvature.

    Returns:
        (the slope of the objective along the step, the longest step of a bone's end over its length, in m).
    """
    force, bone, step = work[_FORCE], work[_BONE], work[_STEP]
    basis, info_basis, pivot = work[_BASIS], work[_INFO_BASIS], work[_PIVOT]
    root = order[0]
    slope = force[root, 0] * step[root, 2] + force[root, 1] * step[root, 3] + force[root, 2] * step[root, 4]
    relative = 0.0
    longest = max(abs(step[root, 2]), abs(step[root, 3]), abs(step[root, 4]))
    for k in range(1, len(order)):
        i = order[k]
        p = parents[i]
        dx, dy, dz = step[p, 2], step[p, 3], step[p, 4]
        if step[i, 5] == 0.0:
            step[i, 0] = step[i, 1] = 0.0
            step[i, 2], step[i, 3], step[i, 4] = dx, dy, dz
            continue
        if i == saddle:
            s1, s2 = step[i, 0], step[i, 1]
        else:
            y1 = info_basis[i, 0] * dx + info_basis[i, 1] * dy + info_basis[i, 2] * dz
            y2 = info_basis[i, 3] * dx + info_basis[i, 4] * dy + info_basis[i, 5] * dz
            if saddle < 0:
                y1 += pivot[i, 3]
                y2 += pivot[i, 4]
            s1 = -(pivot[i, 0] * y1 + pivot[i, 1] * y2)
            s2 = -(pivot[i, 1] * y1 + pivot[i, 2] * y2)
        size = math.sqrt(s1 * s1 + s2 * s2)
        if size > cap * bone[i, 3]:
            s1, s2 = s1 * cap * bone[i, 3] / size, s2 * cap * bone[i, 3] / size
            size = cap * bone[i, 3]
        longest = max(longest, size)
        relative = max(relative, size / bone[i, 3])
        tx = basis[i, 0] * s1 + basis[i, 3] * s2
        ty = basis[i, 1] * s1 + basis[i, 4] * s2
        tz = basis[i, 2] * s1 + basis[i, 5] * s2
        slope += force[i, 0] * tx + force[i, 1] * ty + force[i, 2] * tz
        step[i, 0], step[i, 1] = s1, s2
        step[i, 2], step[i, 3], step[i, 4] = dx + tx, dy + ty, dz + tz
    return slope, relative, longest


@njit(error_model="numpy")
def _retract(parents, order, t, work):  # type: ignore[no-untyped-def]
    """The trial point x_i = x_p + l_i normalise(e_i + t T_i s_i).

    Returns:
        Its objective.
    """
    trial, target, info = work[_TRIAL], work[_TARGET], work[_INFO]
    bone, step, basis = work[_BONE], work[_STEP], work[_BASIS]
    root = order[0]
    for c in range(3):
        trial[root, c] = work[_POSITION, root, c] + t * step[root, 2 + c]
    objective = _misfit(info, target, trial, root)
    for k in range(1, len(order)):
        i = order[k]
        p = parents[i]
        s1, s2 = t * step[i, 0], t * step[i, 1]
        x = bone[i, 0] + basis[i, 0] * s1 + basis[i, 3] * s2
        y = bone[i, 1] + basis[i, 1] * s1 + basis[i, 4] * s2
        z = bone[i, 2] + basis[i, 2] * s1 + basis[i, 5] * s2
        scale = bone[i, 3] / math.sqrt(x * x + y * y + z * z)
        trial[i, 0], trial[i, 1], trial[i, 2] = (
            trial[p, 0] + x * scale, trial[p, 1] + y * scale, trial[p, 2] + z * scale,
        )  # fmt: skip
        objective += _misfit(info, target, trial, i)
    return objective


@njit(error_model="numpy")
def solve_tree(parents, order, rest, targets, weights, lengths, start, work, positions):  # type: ignore[no-untyped-def]
    """TODO docstring."""
    joints = len(order)
    if not _load(targets, weights, lengths, order[0], work):
        return -1, math.nan, False
    objective = _place(parents, order, rest, start, False, work, work[_POSITION])
    from_targets = _place(parents, order, rest, start, True, work, work[_TRIAL])
    if from_targets < objective:
        objective = from_targets
        work[_POSITION, :, :3] = work[_TRIAL, :, :3]
    converged = False
    iterations = 0
    damping = 0.0
    last_step = math.inf
    moved = True
    patience = 0
    reference = predicted = first = 0.0
    root = order[0]
    step = work[_STEP]
    work[_BONE, :, 4] = 0.0
    while True:
        if moved:
            stationary = _pull(parents, order, work) <= _GRADIENT_TOLERANCE
        if not work[_STEP, order[0], 5] > 0.0 or (stationary and last_step < _LAST_STEP):
            converged = True
            break
        definite, saddle = _eliminate(parents, order, work, damping, False)
        x, y, z, lowest, vx, vy, vz = _solve_root(work[_TREE_INFO, root], work[_FORCE, root], step[root, 5])
        if lowest < -_SADDLE * step[root, 5]:
            definite = False
            if saddle < 0:
                saddle = root
        v1, v2 = step[saddle, 0], step[saddle, 1]
        if not definite:
            _eliminate(parents, order, work, max(damping, GN0), True)
            x, y, z, _, _, _, _ = _solve_root(work[_TREE_INFO, root], work[_FORCE, root], step[root, 5])
        step[root, 2], step[root, 3], step[root, 4] = x, y, z
        slope, relative, longest = _substitute(parents, order, work, -1, math.inf)
        if definite and stationary and longest < 1e-7:
            converged = True
            break
        if iterations == MAX_ITERATIONS:
            break
        if saddle >= 0 and relative < 0.01:
            _eliminate(parents, order, work, damping, False)
            step[root, 2] = step[root, 3] = step[root, 4] = 0.0
            if saddle == root:
                step[root, 2], step[root, 3], step[root, 4] = vx, vy, vz
            else:
                step[saddle, 0], step[saddle, 1] = v1, v2
            slope, relative, longest = _substitute(parents, order, work, saddle, math.inf)
            kick = _KICK / max(relative, 1e-3)
            if slope > 0.0:
                kick = -kick
            for i in range(joints):
                for c in range(5):
                    step[i, c] *= kick
            slope *= kick
            relative = _KICK
        iterations += 1
        trial = _retract(parents, order, 1.0, work)
        slack = _ROUNDING * objective
        if patience == 0:
            reference = objective
            predicted = -0.5 * slope
            first = relative
            for i in range(joints):
                for c in range(3):
                    work[_SAVED, i, c] = work[_POSITION, i, c]
                work[_SAVED, i, 3] = work[_BONE, i, 4]
        ratio = (reference - trial + slack) / (predicted + slack)
        moved = True
        if ratio >= 0.01:
            patience = 0
            if ratio < 0.25:
                damping = max(2.0 * damping, MU0)
            elif ratio > 0.75:
                damping = damping * DOWN if damping > 1e-9 else 0.0
        elif patience < WATCH and first < WREL and relative < WREL:
            patience += 1
        else:
            moved = patience > 0
            if moved:
                for i in range(joints):
                    for c in range(3):
                        work[_POSITION, i, c] = work[_SAVED, i, c]
                    work[_BONE, i, 4] = work[_SAVED, i, 3]
                objective = reference
                last_step = math.inf
            damping = max(UP * damping, MU0)
            patience = 0
            continue
        _multipliers(order, work, 1.0)
        work[_POSITION, :, :3] = work[_TRIAL, :, :3]
        objective = trial
        last_step = relative if definite else math.inf
    positions[:, :] = work[_POSITION, :, :3]
    return iterations, objective, converged


@dataclass(frozen=True, eq=False)
class Solution:
    """S* of one frame.

    Attributes:
        positions: (J, 3) metres, in the frame of the targets.
        iterations: Newton steps taken.
        objective: The minimum of eq. (1), in m² times the unit of the weights.
        converged: Whether the point is stationary; false where the iterations ran out.
    """

    positions: NDArray[np.float64]
    iterations: int
    objective: float
    converged: bool


class TreeSolver:
    """Solves eq. (1) for one body; keeps the workspace, so that a frame allocates its result only."""

    def __init__(self, parents: ArrayLike, order: ArrayLike, rest: ArrayLike) -> None:
        """Prepares for a tree of joints.

        Args:
            parents: (J,) index of each joint's parent, -1 for the root.
            order: (J,) joints, every parent before its children.
            rest: (J, 3) direction parent → joint where nothing better is known; the root's is ignored.
        """
        self._parents = np.array(parents, dtype=np.int64)
        self._order = np.array(order, dtype=np.int64)
        self._rest = np.array(rest, dtype=np.float64)
        joints = len(self._parents)
        self._work = np.zeros((_BLOCKS, joints, 6))
        self._no_start = np.full((joints, 3), np.nan)

    def solve(
        self,
        targets: ArrayLike,
        weights: ArrayLike,
        bone_lengths: ArrayLike,
        start: ArrayLike | None = None,
    ) -> Solution:
        m = np.ascontiguousarray(targets, dtype=np.float64)
        W = np.ascontiguousarray(weights, dtype=np.float64)
        l = np.ascontiguousarray(bone_lengths, dtype=np.float64)
        s = self._no_start if start is None else np.ascontiguousarray(start, dtype=np.float64)
        positions = np.empty_like(m)
        iterations, objective, converged = solve_tree(
            self._parents, self._order, self._rest, m, W, l, s, self._work, positions
        )
        if iterations < 0:
            raise FusionError("bone length")
        return Solution(positions, iterations, objective, converged)
