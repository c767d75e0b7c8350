"""Whether a view's labels continue from their positions in the previous frame.

Let d be the vectors from the right joint to the left one of shoulders, hips, elbows and knees. Labels that
are exchanged between two frames reverse every d, so that Σ d · d_before turns from positive to negative. The
odds of an exchange are multiplied by exp(−k Σ d · d_before), between limits: a tracker that changes over
smoothly passes through d ≈ 0, so that continuity alone must not exclude an exchange.
"""

from __future__ import annotations

import math

from fusion.compiling.kernels import inner_kernel
from fusion.facing.model import ELBOW, HIP, KNEE, SHOULDER

_LEAST, _MOST = math.log(0.3), math.log(3000.0)


@inner_kernel
def exchange_odds(model, state, view):  # type: ignore[no-untyped-def]
    """Factor on the odds that the whole body's labels were exchanged since the previous frame."""
    total = 0.0
    for pair in (SHOULDER, HIP, ELBOW, KNEE):
        dot = 0.0
        for c in range(3):
            dot += state.spans[view, pair, c] * state.last_spans[view, pair, c]
        if math.isfinite(dot):
            total += dot
    return math.exp(max(_LEAST, min(_MOST, -model.scalars.continuity * total)))
