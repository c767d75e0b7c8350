"""Steps other than Newton's: away from a saddle, or longer where the curvature is negative."""

from __future__ import annotations

from fusion.compiling.kernels import inner_kernel
from fusion.solvers.tree_elimination import retract, substitute

_DOUBLINGS = 6


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
