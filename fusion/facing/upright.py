"""The up direction, learned from the person.

A tilted sensor's −y axis is not up, and skeletons do not contain gravity. While a person stands, trunk and
legs are in line and point up. The mean of both over such frames is within a few degrees of the vertical.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fusion.body import Body
from fusion.compiling.kernels import inner_kernel
from fusion.facing.model import ANKLE, HIP, SHOULDER

IN_LINE = math.cos(math.radians(20.0))
"""The person counts as standing if the cosine between trunk and legs is above this."""
_LEARNING_FRAMES = 300.0  # 10 s: the mean forgets older frames, because a sensor may be moved


@inner_kernel
def learn_up(model, state, positions):  # type: ignore[no-untyped-def]
    """Updates ``state.up`` with one view in which the person stands."""
    trunk_trunk = legs_legs = trunk_legs = 0.0
    for c in range(3):
        trunk, legs = _trunk_and_legs(model.pairs, positions, c)
        trunk_trunk += trunk * trunk
        legs_legs += legs * legs
        trunk_legs += trunk * legs
    length = math.sqrt(trunk_trunk * legs_legs)
    if not (length > 0.05 and trunk_legs > IN_LINE * length):  # also false where a joint is missing
        return
    state.up_frames[0] = min(state.up_frames[0] + 1.0, _LEARNING_FRAMES)
    share, squared = 1.0 / state.up_frames[0], 0.0
    for c in range(3):
        trunk, legs = _trunk_and_legs(model.pairs, positions, c)
        seen = trunk / math.sqrt(trunk_trunk) + legs / math.sqrt(legs_legs)
        state.up[c] += share * (0.5 * seen - state.up[c])
        squared += state.up[c] ** 2
    for c in range(3):
        state.up[c] /= math.sqrt(squared)


@inner_kernel
def _trunk_and_legs(pairs, positions, c):  # type: ignore[no-untyped-def]
    shoulders = positions[pairs[SHOULDER, 0], c] + positions[pairs[SHOULDER, 1], c]
    hips = positions[pairs[HIP, 0], c] + positions[pairs[HIP, 1], c]
    ankles = positions[pairs[ANKLE, 0], c] + positions[pairs[ANKLE, 1], c]
    return 0.5 * (shoulders - hips), 0.5 * (hips - ankles)


def upright_direction(body: Body, *views: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3,) unit vector against gravity: the median direction of trunk and legs while the person stands.

    Args:
        body: The joints.
        views: (T, J, 3) positions in one frame; NaN where not tracked.

    Returns:
        −y of that frame where the person never stands.
    """
    found = []
    for view in views:
        middle = [
            0.5 * (view[:, body.joint(f"{name}Left")] + view[:, body.joint(f"{name}Right")])
            for name in ("Shoulder", "Hip", "Ankle")
        ]
        trunk, legs = middle[0] - middle[1], middle[1] - middle[2]
        with np.errstate(invalid="ignore", divide="ignore"):
            trunk = trunk / np.linalg.norm(trunk, axis=1, keepdims=True)
            legs = legs / np.linalg.norm(legs, axis=1, keepdims=True)
        stands = np.sum(trunk * legs, axis=1) > IN_LINE  # False where NaN
        found.append(trunk[stands] + legs[stands])
    every = np.concatenate(found)
    if len(every) == 0:
        return np.array((0.0, -1.0, 0.0))
    up = np.median(every, axis=0)
    return np.asarray(up / np.linalg.norm(up))
