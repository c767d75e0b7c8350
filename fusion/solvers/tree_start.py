"""The workspace of the tree solver, its start, and steps other than Newton's.

The workspace has one named array per quantity, one row per joint. Symmetric 3×3 matrices are six numbers:
xx, xy, xz, yy, yz, zz. A basis T (3, 2) is its two columns. The start is a skeleton with the right bone
lengths. Other steps lead away from a saddle, or are longer where the curvature is negative.
"""

import math
from typing import Annotated, NamedTuple

from fusion.compiling.kernels import inner_kernel
from fusion.solvers.small_matrices import tangent_basis
from fusion.solvers.tree_elimination import misfit, retract, substitute
from fusion.support.types import Array

FROM_START, FROM_TARGETS, BENT, BENT_AWAY = 0, 1, 2, 3
"""Sources of a bone's direction in :func:`place`."""
_DOUBLINGS = 6


class TreeWorkspace(NamedTuple):
    """Arrays that :func:`fusion.solvers.tree_solver.solve_tree` overwrites; W is in units of the weights."""

    lengths: Annotated[Array, ("J",)]  # l_i, metres
    targets: Annotated[Array, ("J", 3)]  # m_i, metres
    information: Annotated[Array, ("J", 6)]  # W_i
    aims: Annotated[Array, ("J", 3)]  # point that the bone of joint i aims at in a start, metres
    aim_counts: Annotated[Array, ("J",)]  # number of points that are averaged in it; 0 where there is none
    aim_reaches: Annotated[Array, ("J",)]  # sum of the squared bones between joint i and that point, m²
    positions: Annotated[Array, ("J", 3)]  # x_i, metres
    bones: Annotated[Array, ("J", 3)]  # e_i = x_i - x_parent, metres
    gradients: Annotated[Array, ("J", 3)]  # g_i = 2 W_i (x_i - m_i)
    forces: Annotated[Array, ("J", 3)]  # F_i: the gradient summed over the subtree
    scales: Annotated[Array, ("J",)]  # trace of twice the subtree's information
    multipliers: Annotated[Array, ("J",)]  # λ_i
    reduced: Annotated[Array, ("J", 6)]  # A_i: twice the information of the subtree, its steps eliminated
    reduced_forces: Annotated[Array, ("J", 3)]  # b_i: the subtree's force, its steps eliminated
    basis: Annotated[Array, ("J", 6)]  # T_i
    reduced_basis: Annotated[Array, ("J", 6)]  # A_i T_i
    pivots: Annotated[Array, ("J", 3)]  # M_i⁻¹: xx, xy, yy
    pivot_forces: Annotated[Array, ("J", 2)]  # T_iᵀ b_i
    steps: Annotated[Array, ("J", 2)]  # s_i: the step of bone i along T_i, metres
    moves: Annotated[Array, ("J", 3)]  # d_i: the step of joint i, metres
    trial: Annotated[Array, ("J", 3)]  # x_i after the step, metres
    best: Annotated[Array, ("J", 3)]  # the last good point while steps may climb, metres
    best_multipliers: Annotated[Array, ("J",)]  # its λ_i


@inner_kernel
def load(targets, weights, lengths, root, work):  # type: ignore[no-untyped-def]
    """Copies targets and information to the workspace; a joint without a finite target has no information.

    Returns whether all weights are finite, and all bones have a length.
    """
    target, info = work.targets, work.information
    for i in range(targets.shape[0]):
        if weights.ndim == 1:
            xx = yy = zz = weights[i]
            xy = xz = yz = 0.0
        else:
            xx, xy, xz = weights[i, 0, 0], weights[i, 0, 1], weights[i, 0, 2]
            yy, yz, zz = weights[i, 1, 1], weights[i, 1, 2], weights[i, 2, 2]
        if not math.isfinite(xx + xy + xz + yy + yz + zz):
            return False
        x, y, z = targets[i, 0], targets[i, 1], targets[i, 2]
        if not (math.isfinite(x + y + z) and xx + yy + zz > 0.0):
            x = y = z = xx = xy = xz = yy = yz = zz = 0.0
        target[i, 0], target[i, 1], target[i, 2] = x, y, z
        info[i, 0], info[i, 1], info[i, 2] = xx, xy, xz
        info[i, 3], info[i, 4], info[i, 5] = yy, yz, zz
        work.lengths[i] = lengths[i]
        work.multipliers[i] = 0.0
        if i != root and not (lengths[i] > 0.0 and math.isfinite(lengths[i])):
            return False
    return True


@inner_kernel
def aim_at(parents, order, work):  # type: ignore[no-untyped-def]
    """Writes the point that each bone is aimed at: its target, or the mean of the next ones below.

    ``work.aim_counts`` is positive where there is such a point. ``work.aim_reaches`` is the sum of the
    squares of the bones between, averaged over the paths.

    Returns:
        Whether a bone ends in a hole: a joint without data that has data below it.
    """
    target, info, lengths = work.targets, work.information, work.lengths
    aim, counts, reaches = work.aims, work.aim_counts, work.aim_reaches
    hole = False
    for i in range(len(order)):
        known = info[i, 0] + info[i, 3] + info[i, 5] > 0.0
        aim[i, 0] = aim[i, 1] = aim[i, 2] = counts[i] = reaches[i] = 0.0
        if known:
            aim[i, 0], aim[i, 1], aim[i, 2] = target[i, 0], target[i, 1], target[i, 2]
            counts[i] = 1.0
    for k in range(len(order) - 1, 0, -1):
        i = order[k]
        p = parents[i]
        if counts[i] == 0.0:
            continue
        if not info[i, 0] + info[i, 3] + info[i, 5] > 0.0:
            hole = True
            share = 1.0 / counts[i]
            aim[i, 0], aim[i, 1], aim[i, 2] = aim[i, 0] * share, aim[i, 1] * share, aim[i, 2] * share
            counts[i], reaches[i] = 1.0, reaches[i] * share
        if not info[p, 0] + info[p, 3] + info[p, 5] > 0.0:
            for c in range(3):
                aim[p, c] += aim[i, c]
            counts[p] += counts[i]
            reaches[p] += reaches[i] + lengths[i] * lengths[i]
    return hole


@inner_kernel
def bend(point, length, reach, side):  # type: ignore[no-untyped-def]
    """The direction of a bone whose far end lies ``reach`` from a point, to one side; x, y, z each."""
    x, y, z = point
    sx, sy, sz = side
    distance = math.sqrt(x * x + y * y + z * z)
    along = (length * length + distance * distance - reach * reach) / (2.0 * length * distance)
    along = min(max(along, -1.0), 1.0)
    x, y, z = x / distance, y / distance, z / distance
    inside = sx * x + sy * y + sz * z
    sx, sy, sz = sx - inside * x, sy - inside * y, sz - inside * z
    norm = math.sqrt(sx * sx + sy * sy + sz * sz)
    if not norm > 1e-9 * abs(inside):  # s gives no side: any side, and the opposite one for -s
        sx, sy, sz, _, _, _ = tangent_basis(x, y, z)
        norm = math.copysign(1.0, inside)
    aside = math.sqrt(1.0 - along * along) / norm
    return along * x + aside * sx, along * y + aside * sy, along * z + aside * sz


@inner_kernel
def place(parents, order, rest, start, way, work, at):  # type: ignore[no-untyped-def]
    """Writes a feasible skeleton to ``at``: bone directions from a source, then the best translation; returns
    the objective.

    ``FROM_START``: a bone has its direction in ``start``, else in ``rest``. ``FROM_TARGETS``: it points from
    its near end's target, or position, to the point of :func:`aim_at`; as above without one. ``BENT``
    and ``BENT_AWAY``: likewise, but before a hole it leaves space for the bones beyond, on the side of its
    direction in ``start`` or ``rest``, or on the other side.
    """
    target, info, lengths = work.targets, work.information, work.lengths
    aim, counts, reaches = work.aims, work.aim_counts, work.aim_reaches
    root = order[0]
    for c in range(3):
        at[root, c] = start[root, c] if math.isfinite(start[root, c]) else 0.0
    if way != FROM_START:
        aim_at(parents, order, work)
        if info[root, 0] + info[root, 3] + info[root, 5] > 0.0:
            for c in range(3):
                at[root, c] = target[root, c]
    for k in range(1, len(order)):
        i = order[k]
        p = parents[i]
        length = lengths[i]
        norm = 0.0
        x, y, z = start[i, 0] - start[p, 0], start[i, 1] - start[p, 1], start[i, 2] - start[p, 2]
        norm = math.sqrt(x * x + y * y + z * z)
        if not (norm > 1e-9 * length and math.isfinite(norm)):
            x, y, z = rest[i, 0], rest[i, 1], rest[i, 2]
            norm = math.sqrt(x * x + y * y + z * z)
        if way != FROM_START and counts[i] > 0.0:
            source = target if info[p, 0] + info[p, 3] + info[p, 5] > 0.0 else at
            ax, ay, az = aim[i, 0] - source[p, 0], aim[i, 1] - source[p, 1], aim[i, 2] - source[p, 2]
            distance = math.sqrt(ax * ax + ay * ay + az * az)
            if distance > 1e-9 * length:
                if way != FROM_TARGETS and reaches[i] > 0.0:
                    side = 1.0 if way == BENT else -1.0
                    reach = math.sqrt(reaches[i])
                    ax, ay, az = bend((ax, ay, az), length, reach, (side * x, side * y, side * z))
                    distance = math.sqrt(ax * ax + ay * ay + az * az)
                x, y, z, norm = ax, ay, az, distance
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
        objective += misfit(info, target, at, i)
    return objective


@inner_kernel
def copy(source, target):  # type: ignore[no-untyped-def]
    """Copies (J, 3) positions."""
    for i in range(len(source)):
        for c in range(3):
            target[i, c] = source[i, c]


@inner_kernel
def leave_saddle(parents, order, saddle, s1, s2, length, work):  # type: ignore[no-untyped-def]
    """A step along the direction of negative curvature of the joint ``saddle``, not uphill.

    Its own step (s1, s2) has the pivot's negative eigenvalue; every joint below follows from the
    elimination, so that the curvature along the whole step is that eigenvalue. The root's is already in its
    row.
    """
    step, move = work.steps, work.moves
    if saddle != order[0]:
        move[order[0], 0] = move[order[0], 1] = move[order[0], 2] = 0.0
        step[saddle, 0], step[saddle, 1] = s1, s2
    slope, relative, _ = substitute(parents, order, work, saddle)
    scale = length / max(relative, 1e-3)
    if slope > 0.0:
        scale = -scale
    scale_step(work, scale)
    return slope * scale


@inner_kernel
def stretch(parents, order, trial, work):  # type: ignore[no-untyped-def]
    """Doubles a downhill step while the objective falls: a Gauss–Newton step is too short where curvature is
    negative. Returns the objective at the trial point."""
    factor = 2.0
    for _ in range(_DOUBLINGS):
        scale_step(work, factor)
        longer = retract(parents, order, work)
        if not longer < trial:
            scale_step(work, 1.0 / factor)
            return retract(parents, order, work)
        trial = longer
    return trial


@inner_kernel
def scale_step(work, factor):  # type: ignore[no-untyped-def]
    """The step of every joint, times a factor."""
    step, move = work.steps, work.moves
    for i in range(len(step)):
        for c in range(2):
            step[i, c] *= factor
        for c in range(3):
            move[i, c] *= factor
