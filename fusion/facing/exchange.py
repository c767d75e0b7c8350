"""Exchanges the labels of one view, before fusion and before registration uses it."""

from __future__ import annotations

import math

from fusion.compiling.kernels import inner_kernel, kernel
from fusion.facing.model import HIP, SHOULDER, TRUNK, WHOLE
from fusion.skeleton import INFERRED, TRACKED


@kernel
def exchange(model, positions, states, code, out_positions, out_states):  # type: ignore[no-untyped-def]
    """Writes a skeleton with left and right exchanged according to the code.

    With the whole body exchanged, feet, thumbs and face become inferred: a tracker places them by the
    direction that it assumes the person to face, so they are on the wrong side. Where arms or legs are
    exchanged alone, as in sessions of version 1.0, shoulders (hips) go with the limb only if shoulders and
    hips contradict each other.

    Args:
        model: Of the body.
        positions, states: (J, 3), (J,) as reported.
        code: 0, or a sum of ARMS, LEGS and TRUNK (see :mod:`fusion.facing.model`).
        out_positions, out_states: Written; not the same arrays as the inputs.
    """
    opposed = _opposed(model, positions)
    trunk = _trunk_exchanged(code)
    for j in range(len(positions)):
        source = _source(model, code, opposed, j)
        for c in range(3):
            out_positions[j, c] = positions[source, c]
        state = states[source]
        if trunk and model.heading_placed[j] and state == TRACKED:
            state = INFERRED
        out_states[j] = state


@inner_kernel
def find_sources(model, positions, code, sources):  # type: ignore[no-untyped-def]
    """Writes the reported joint ``sources[j]`` that :func:`exchange` labels j."""
    opposed = _opposed(model, positions)
    for j in range(len(positions)):
        sources[j] = _source(model, code, opposed, j)


@inner_kernel
def _opposed(model, positions):  # type: ignore[no-untyped-def]
    """Whether shoulders and hips contradict each other."""
    along = 0.0
    for c in range(3):
        shoulders = positions[model.pairs[SHOULDER, 0], c] - positions[model.pairs[SHOULDER, 1], c]
        hips = positions[model.pairs[HIP, 0], c] - positions[model.pairs[HIP, 1], c]
        along += shoulders * hips
    return math.isfinite(along) and along < 0.0


@inner_kernel
def _trunk_exchanged(code):  # type: ignore[no-untyped-def]
    return ((code & WHOLE) == WHOLE) != ((code & TRUNK) != 0)


@inner_kernel
def _source(model, code, opposed, j):  # type: ignore[no-untyped-def]
    exchanged = (code & model.limb[j]) != 0
    if model.face[j] or (model.girdle[j] and not opposed):
        exchanged = _trunk_exchanged(code)
    return model.mirror[j] if exchanged else j
