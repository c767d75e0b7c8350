"""Where the tree solver starts: the data in its workspace, and a skeleton with the right bone lengths."""

from __future__ import annotations

import math

from fusion.kernels import inner_kernel
from fusion.tree_elimination import BONE, INFORMATION, TARGET, misfit


@inner_kernel
def load(targets, weights, lengths, root, work):  # type: ignore[no-untyped-def]
    """Targets and information into the workspace; a joint without a finite target has no information."""
    target, info, bone = work[TARGET], work[INFORMATION], work[BONE]
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
        bone[i, 4] = 0.0
        if i != root and not (lengths[i] > 0.0 and math.isfinite(lengths[i])):
            return False
    return True


@inner_kernel
def place(parents, order, rest, start, from_targets, work, at):  # type: ignore[no-untyped-def]
    """A feasible skeleton into ``at``: directions of bones from a source, then the best translation.

    A bone takes its direction from the targets of its two ends (where asked, and where there are any),
    else from ``start``, else from ``rest``. Where only the far end has a target, the bone points to it.

    Returns:
        The objective.
    """
    target, info, bone = work[TARGET], work[INFORMATION], work[BONE]
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
        objective += misfit(info, target, at, i)
    return objective
