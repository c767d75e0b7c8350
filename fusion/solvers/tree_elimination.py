"""One Newton step of eq. (1) on the tree of bones, by elimination from the leaves to the root.

At a skeleton with the right bone lengths, with e_i = x_i - x_parent, the step d minimises

    Σ_i g_i·d_i + d_iᵀ W_i d_i + ½ λ_i |s_i|²,    d_i = d_parent + T_i s_i

where g_i = 2 W_i (x_i - m_i) is the gradient, T_i (3, 2) an orthonormal basis normal to e_i, and λ_i the
multiplier of the bone's length constraint, whose curvature it carries. That is Newton's step on the KKT
system of eq. (1), with constraints that hold already.

All quantities are in a :class:`fusion.solvers.tree_start.TreeWorkspace`.
"""

import math

from fusion.compiling.kernels import inner_kernel
from fusion.solvers.small_matrices import absolute_inverse_2x2, eigen_3x3, tangent_basis

FLAT = 1e-10  # of the subtree's information: a smaller pivot is rounding; that direction is undetermined
SADDLE = 1e-8  # of the subtree's information: a pivot below minus this leads downhill


@inner_kernel
def misfit(info, target, at, i):  # type: ignore[no-untyped-def]
    """(x - m)ᵀ W (x - m) of one joint."""
    x, y, z = at[i, 0] - target[i, 0], at[i, 1] - target[i, 1], at[i, 2] - target[i, 2]
    return (
        info[i, 0] * x * x + info[i, 3] * y * y + info[i, 5] * z * z
        + 2.0 * (info[i, 1] * x * y + info[i, 2] * x * z + info[i, 4] * y * z)
    )  # fmt: skip


@inner_kernel
def pull(parents, order, work):  # type: ignore[no-untyped-def]
    """Gradient g_i = 2 W_i (x_i - m_i), forces F_i = g_i + Σ F_children, and bones e_i.

    Returns:
        The largest tangential force over the subtree's information, m: zero at a stationary point.
    """
    at, target, info = work.positions, work.targets, work.information
    force, bone, gradient = work.forces, work.bones, work.gradients
    lengths, scales = work.lengths, work.scales
    for i in range(len(order)):
        xx, xy, xz = 2.0 * info[i, 0], 2.0 * info[i, 1], 2.0 * info[i, 2]
        yy, yz, zz = 2.0 * info[i, 3], 2.0 * info[i, 4], 2.0 * info[i, 5]
        x, y, z = at[i, 0] - target[i, 0], at[i, 1] - target[i, 1], at[i, 2] - target[i, 2]
        gx, gy, gz = xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z
        force[i, 0], force[i, 1], force[i, 2] = gx, gy, gz
        gradient[i, 0], gradient[i, 1], gradient[i, 2] = gx, gy, gz
        scales[i] = xx + yy + zz
    largest = 0.0
    for k in range(len(order) - 1, 0, -1):
        i = order[k]
        p = parents[i]
        fx, fy, fz = force[i, 0], force[i, 1], force[i, 2]
        force[p, 0] += fx
        force[p, 1] += fy
        force[p, 2] += fz
        scales[p] += scales[i]
        ex, ey, ez = at[i, 0] - at[p, 0], at[i, 1] - at[p, 1], at[i, 2] - at[p, 2]
        bone[i, 0], bone[i, 1], bone[i, 2] = ex, ey, ez
        multiplier = -(ex * fx + ey * fy + ez * fz) / (lengths[i] * lengths[i])
        fx, fy, fz = fx + multiplier * ex, fy + multiplier * ey, fz + multiplier * ez
        if scales[i] > 0.0:
            largest = max(largest, math.sqrt(fx * fx + fy * fy + fz * fz) / scales[i])
    root = order[0]
    fx, fy, fz = force[root, 0], force[root, 1], force[root, 2]
    return max(largest, math.sqrt(fx * fx + fy * fy + fz * fz) / scales[root])


@inner_kernel
def eliminate(parents, order, work, damping, compressed):  # type: ignore[no-untyped-def]
    """Leaves to root: each bone's step s_i as a function of its parent's d_p.

    With the children's terms summed into A_i = 2 W_i + Σ P_c and b_i = g_i + Σ r_c:

        M_i = T_iᵀ A_i T_i + λ_i I  (2, 2)
        s_i = -M_i⁻¹ T_iᵀ (b_i + A_i d_p)
        P_i = A_i - A_i T_i M_i⁻¹ T_iᵀ A_i    r_i = b_i - A_i T_i M_i⁻¹ T_iᵀ b_i

    Each M_i is a pivot of a block LDLᵀ factorisation; |M_i|, with eigenvalues raised to a floor, replaces
    one that is not safely positive, so that the step leads downhill.

    Args:
        parents, order, work: As in :func:`fusion.solvers.tree_solver.solve_tree`.
        damping: Added to the eigenvalues of M_i, as a share of the subtree's information.
        compressed: The share of a negative λ_i that counts: 1.0, or 0.0, which keeps every pivot positive.

    Returns:
        (the first joint with a clearly negative pivot or -1, its eigenvector in T_i's basis: two numbers).
    """
    info, gradient, scales = work.information, work.gradients, work.scales
    bone, lengths, multipliers = work.bones, work.lengths, work.multipliers
    total, reduced_force = work.reduced, work.reduced_forces
    basis, reduced_basis, pivot, pivot_force = work.basis, work.reduced_basis, work.pivots, work.pivot_forces
    for i in range(len(order)):
        for c in range(6):
            total[i, c] = 2.0 * info[i, c]
        for c in range(3):
            reduced_force[i, c] = gradient[i, c]
    saddle = -1
    saddle_1 = saddle_2 = 0.0
    for k in range(len(order) - 1, 0, -1):
        i = order[k]
        scale = scales[i]
        if scale == 0.0:
            continue
        p = parents[i]
        inverse_length = 1.0 / lengths[i]
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
        reduced_basis[i, 0], reduced_basis[i, 1], reduced_basis[i, 2] = px, py, pz
        reduced_basis[i, 3], reduced_basis[i, 4], reduced_basis[i, 5] = qx, qy, qz
        curvature = max(multipliers[i], 0.0) + compressed * min(multipliers[i], 0.0) + damping * scale
        # M = Tᵀ A T + λ I, (2, 2), and its inverse
        i11, i12, i22, lowest, v1, v2 = absolute_inverse_2x2(
            ax * px + ay * py + az * pz + curvature,
            ax * qx + ay * qy + az * qz,
            bx * qx + by * qy + bz * qz + curvature,
            FLAT * scale,
        )
        if lowest < -SADDLE * scale and saddle < 0:
            saddle, saddle_1, saddle_2 = i, v1, v2
        rx, ry, rz = reduced_force[i, 0], reduced_force[i, 1], reduced_force[i, 2]
        y1, y2 = ax * rx + ay * ry + az * rz, bx * rx + by * ry + bz * rz
        pivot[i, 0], pivot[i, 1], pivot[i, 2], pivot_force[i, 0], pivot_force[i, 1] = i11, i12, i22, y1, y2
        # b - A T M⁻¹ Tᵀ b, on to the parent
        s1, s2 = i11 * y1 + i12 * y2, i12 * y1 + i22 * y2
        reduced_force[p, 0] += rx - px * s1 - qx * s2
        reduced_force[p, 1] += ry - py * s1 - qy * s2
        reduced_force[p, 2] += rz - pz * s1 - qz * s2
        # A - A T M⁻¹ Tᵀ A, on to the parent
        cx, cy, cz = i11 * px + i12 * qx, i11 * py + i12 * qy, i11 * pz + i12 * qz
        dx, dy, dz = i12 * px + i22 * qx, i12 * py + i22 * qy, i12 * pz + i22 * qz
        total[p, 0] += xx - px * cx - qx * dx
        total[p, 1] += xy - px * cy - qx * dy
        total[p, 2] += xz - px * cz - qx * dz
        total[p, 3] += yy - py * cy - qy * dy
        total[p, 4] += yz - py * cz - qy * dz
        total[p, 5] += zz - pz * cz - qz * dz
    return saddle, saddle_1, saddle_2


@inner_kernel
def solve_root(A, b, scale):  # type: ignore[no-untyped-def]
    """The root's step -|A|⁻¹ b, with eigenvalues that are no more than rounding left out.

    Returns:
        (x, y, z of the step, the lowest eigenvalue if it was needed else +1, its eigenvector).
    """
    xx, xy, xz, yy, yz, zz = A[0], A[1], A[2], A[3], A[4], A[5]
    floor = FLAT * scale
    if xx > floor:
        lx, ly = xy / xx, xz / xx
        syy, syz, szz = yy - lx * xy, yz - lx * xz, zz - ly * xz
        if syy > floor:
            lz = syz / syy
            last = szz - lz * syz
            if last > floor:
                ry = b[1] - lx * b[0]
                rz = b[2] - ly * b[0] - lz * ry
                z = rz / last
                y = ry / syy - lz * z
                return -(b[0] / xx - lx * y - ly * z), -y, -z, 1.0, 0.0, 0.0, 0.0
    values, vectors = eigen_3x3(xx, xy, xz, yy, yz, zz)
    x = y = z = 0.0
    lowest, which = values[0], 0
    for c in range(3):
        value, (vx, vy, vz) = values[c], vectors[c]
        if value < lowest:
            lowest, which = value, c
        s = (vx * b[0] + vy * b[1] + vz * b[2]) / max(abs(value), floor)
        x, y, z = x - s * vx, y - s * vy, z - s * vz
    vx, vy, vz = vectors[which]
    return x, y, z, lowest, vx, vy, vz


@inner_kernel
def substitute(parents, order, work, saddle):  # type: ignore[no-untyped-def]
    """Root to leaves: s_i = -M⁻¹ Tᵀ (b_i + A_i d_p), d_i = d_p + T s_i.

    With a ``saddle`` joint the right-hand side is zero but for that joint's own step (in the workspace):
    the direction along which its negative pivot is the curvature.

    Returns:
        (the slope of the objective along the step; the longest step of a bone's end, over its length; in m).
    """
    force, lengths, scales = work.forces, work.lengths, work.scales
    basis, reduced_basis, pivot, pivot_force = work.basis, work.reduced_basis, work.pivots, work.pivot_forces
    step, move = work.steps, work.moves
    root = order[0]
    slope = force[root, 0] * move[root, 0] + force[root, 1] * move[root, 1] + force[root, 2] * move[root, 2]
    relative = 0.0
    longest = max(abs(move[root, 0]), abs(move[root, 1]), abs(move[root, 2]))
    for k in range(1, len(order)):
        i = order[k]
        p = parents[i]
        dx, dy, dz = move[p, 0], move[p, 1], move[p, 2]
        if scales[i] == 0.0:
            step[i, 0] = step[i, 1] = 0.0
            move[i, 0], move[i, 1], move[i, 2] = dx, dy, dz
            continue
        if i == saddle:
            s1, s2 = step[i, 0], step[i, 1]
        else:
            y1 = reduced_basis[i, 0] * dx + reduced_basis[i, 1] * dy + reduced_basis[i, 2] * dz
            y2 = reduced_basis[i, 3] * dx + reduced_basis[i, 4] * dy + reduced_basis[i, 5] * dz
            if saddle < 0:
                y1 += pivot_force[i, 0]
                y2 += pivot_force[i, 1]
            s1 = -(pivot[i, 0] * y1 + pivot[i, 1] * y2)
            s2 = -(pivot[i, 1] * y1 + pivot[i, 2] * y2)
        size = math.sqrt(s1 * s1 + s2 * s2)
        longest = max(longest, size)
        relative = max(relative, size / lengths[i])
        tx = basis[i, 0] * s1 + basis[i, 3] * s2
        ty = basis[i, 1] * s1 + basis[i, 4] * s2
        tz = basis[i, 2] * s1 + basis[i, 5] * s2
        slope += force[i, 0] * tx + force[i, 1] * ty + force[i, 2] * tz
        step[i, 0], step[i, 1] = s1, s2
        move[i, 0], move[i, 1], move[i, 2] = dx + tx, dy + ty, dz + tz
    return slope, relative, longest


@inner_kernel
def retract(parents, order, work):  # type: ignore[no-untyped-def]
    """The trial point x_i = x_p + l_i normalise(e_i + T_i s_i); returns its objective."""
    trial, target, info = work.trial, work.targets, work.information
    bone, lengths, step, basis = work.bones, work.lengths, work.steps, work.basis
    root = order[0]
    for c in range(3):
        trial[root, c] = work.positions[root, c] + work.moves[root, c]
    objective = misfit(info, target, trial, root)
    for k in range(1, len(order)):
        i = order[k]
        p = parents[i]
        s1, s2 = step[i, 0], step[i, 1]
        x = bone[i, 0] + basis[i, 0] * s1 + basis[i, 3] * s2
        y = bone[i, 1] + basis[i, 1] * s1 + basis[i, 4] * s2
        z = bone[i, 2] + basis[i, 2] * s1 + basis[i, 5] * s2
        scale = lengths[i] / math.sqrt(x * x + y * y + z * z)
        trial[i, 0], trial[i, 1], trial[i, 2] = (
            trial[p, 0] + x * scale, trial[p, 1] + y * scale, trial[p, 2] + z * scale,
        )  # fmt: skip
        objective += misfit(info, target, trial, i)
    return objective


@inner_kernel
def measure_multipliers(order, work):  # type: ignore[no-untyped-def]
    """λ_i = -e_i·F_i / l_i²: exact at a stationary point, where its curvature is to be judged."""
    force, bone, lengths, multipliers = work.forces, work.bones, work.lengths, work.multipliers
    for k in range(1, len(order)):
        i = order[k]
        along = bone[i, 0] * force[i, 0] + bone[i, 1] * force[i, 1] + bone[i, 2] * force[i, 2]
        multipliers[i] = -along / (lengths[i] * lengths[i])


@inner_kernel
def update_multipliers(order, work):  # type: ignore[no-untyped-def]
    """λ_i = -e_i·(b_i + A_i d_i) / l_i²: from the force in the bone that the model predicts."""
    total, reduced_force, move = work.reduced, work.reduced_forces, work.moves
    bone, lengths, multipliers = work.bones, work.lengths, work.multipliers
    for k in range(1, len(order)):
        i = order[k]
        dx, dy, dz = move[i, 0], move[i, 1], move[i, 2]
        fx = reduced_force[i, 0] + total[i, 0] * dx + total[i, 1] * dy + total[i, 2] * dz
        fy = reduced_force[i, 1] + total[i, 1] * dx + total[i, 3] * dy + total[i, 4] * dz
        fz = reduced_force[i, 2] + total[i, 2] * dx + total[i, 4] * dy + total[i, 5] * dz
        multipliers[i] = -(bone[i, 0] * fx + bone[i, 1] * fy + bone[i, 2] * fz) / (lengths[i] * lengths[i])
