"""Skeletons that a sensor reports twice."""

from __future__ import annotations

import math

from fusion.compiling.kernels import inner_kernel


@inner_kernel
def repeats(positions, states, last, last_states):  # type: ignore[no-untyped-def]
    """Whether a sensor repeats its last skeleton; stores the new one. An empty skeleton is no repetition."""
    same, anyone = True, False
    for i in range(len(states)):
        anyone = anyone or states[i] != 0
        same = same and states[i] == last_states[i]
        last_states[i] = states[i]
        for c in range(3):
            both_nan = math.isnan(positions[i, c]) and math.isnan(last[i, c])
            same = same and (both_nan or positions[i, c] == last[i, c])
            last[i, c] = positions[i, c]
    return same and anyone
