"""Knees and elbows that no view tracks do not bend backwards."""

from __future__ import annotations

import math

from fusion.compiling.kernels import inner_kernel


@inner_kernel
def respect_hinges(model, state, views):  # type: ignore[no-untyped-def]
    """Moves a hinge that neither view tracks onto the straight line, where it bends to the wrong side.

    A knee lies before the line from hip to ankle, an elbow behind the line from shoulder to wrist of an arm
    that hangs down. The trunk faces forwards: (left - right) × (shoulders - hips). The hinge is moved
    along the part of that direction that is normal to its line.
    """
    x = state.positions
    lh, rh, ls, rs = model.sides[0], model.sides[1], model.sides[2], model.sides[3]
    if not (state.known[lh] and state.known[rh] and state.known[ls] and state.known[rs]):
        return
    ax, ux = x[lh, 0] - x[rh, 0] + x[ls, 0] - x[rs, 0], x[ls, 0] + x[rs, 0] - x[lh, 0] - x[rh, 0]
    ay, uy = x[lh, 1] - x[rh, 1] + x[ls, 1] - x[rs, 1], x[ls, 1] + x[rs, 1] - x[lh, 1] - x[rh, 1]
    az, uz = x[lh, 2] - x[rh, 2] + x[ls, 2] - x[rs, 2], x[ls, 2] + x[rs, 2] - x[lh, 2] - x[rh, 2]
    fx, fy, fz = ay * uz - az * uy, az * ux - ax * uz, ax * uy - ay * ux
    for h in range(len(model.hinges)):
        near, hinge, far = model.hinges[h, 0], model.hinges[h, 1], model.hinges[h, 2]
        if not (state.known[near] and state.known[hinge] and state.known[far]):
            continue
        seen = 0.0
        for v in range(2):
            if views.states[v, hinge] == 2:
                seen += views.trust[v, hinge]
        if seen > 0.5:
            continue
        lx, ly, lz = x[far, 0] - x[near, 0], x[far, 1] - x[near, 1], x[far, 2] - x[near, 2]
        square = lx * lx + ly * ly + lz * lz
        if square < 1e-4:
            continue
        sign = model.bends[h]
        if sign < 0.0 and lx * ux + ly * uy + lz * uz > 0.0:  # a raised arm bends either way
            continue
        along = (fx * lx + fy * ly + fz * lz) / square
        nx, ny, nz = fx - along * lx, fy - along * ly, fz - along * lz
        size = math.sqrt(nx * nx + ny * ny + nz * nz)
        if size < 1e-6:
            continue
        nx, ny, nz = nx / size, ny / size, nz / size
        bend = (
            (x[hinge, 0] - x[near, 0]) * nx
            + (x[hinge, 1] - x[near, 1]) * ny
            + (x[hinge, 2] - x[near, 2]) * nz
        )
        if sign * bend < 0.0:
            x[hinge, 0] -= bend * nx
            x[hinge, 1] -= bend * ny
            x[hinge, 2] -= bend * nz
