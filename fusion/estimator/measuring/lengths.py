"""The bone lengths of one view as evidence on its joints.

A limb that a tracker puts in the wrong place seldom keeps the lengths of its bones. A view shows this by
itself, before S* or the other view is asked, and also where the other view sees nothing.
"""

from __future__ import annotations

import math

from fusion.compiling.kernels import inner_kernel


@inner_kernel
def weigh_lengths(model, state, views):  # type: ignore[no-untyped-def]
    """Adds the evidence of the bones at each joint to that of the depth image.

        l_vi = - min(max_b |length of b in the view - l_b| / e_b, length_limit),
        e_b² = length_error² + (length_by_speed |u_end - u_parent|)²

    over the bones b at joint i whose ends the view tracks. The positions are those without the view's scale.
    It is a log likelihood ratio that the joint is no outlier: see :func:`robust.prior_outlier`. In a fast
    swing a tracker smears the limb, so a wrong length says less there.

    Args:
        model: Of the body and the calibration.
        state: The joints' velocities u are read.
        views: Positions and states are read; evidence and length errors are written.
    """
    k = model.constants
    still = k.length_error * k.length_error
    for v in range(2):
        at, errors = views.positions[v], views.length_errors[v]
        for i in range(len(model.parents)):
            errors[i] = -1.0
        for i in range(len(model.parents)):
            p = model.parents[i]
            if p < 0 or views.states[v, i] != _TRACKED or views.states[v, p] != _TRACKED:
                continue
            square = fast = 0.0
            for c in range(3):
                square += (at[i, c] - at[p, c]) ** 2
                fast += (state.velocities[i, c] - state.velocities[p, c]) ** 2
            expected = math.sqrt(still + k.length_by_speed * k.length_by_speed * fast)
            error = abs(math.sqrt(square) - model.bone_lengths[i]) / expected
            errors[i], errors[p] = max(errors[i], error), max(errors[p], error)
        for i in range(len(model.parents)):
            if errors[i] > 0.0:
                views.evidence[v, i] -= min(errors[i], k.length_limit)


_TRACKED = 2  # fusion.skeleton.TrackingState.TRACKED
