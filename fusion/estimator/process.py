"""Time and doubt: what is forgotten and when, and where the uncertainty of the joints grows.

:func:`process` and :func:`grow` are the only functions that add variance to a joint that the filter knows.
Both write to the smoother's trace (:mod:`fusion.estimator.smoother`), so that its model is the filter's.
"""

from __future__ import annotations

import math

from fusion.compiling.kernels import inner_kernel
from fusion.estimator.measurements.outliers import innovation
from fusion.facing.filter import forget_facing
from fusion.facing.model import FORGET_NS

_LOST_SECONDS = 0.3  # a tracker that is wrong in all joints seldom stays so for longer
_LARGEST_STEP = 0.15  # m, largest standard deviation that acceleration adds in one step
_LEAST_STEP_SECONDS = 1.0 / 60.0  # half a frame: a movement that surprises takes at least so long
_LEAST_SURPRISE = 1e-3  # a smaller surprise has no visible effect
_TOLD_APART = 0.12  # m between a joint and its counterpart
_ASTRAY = 0.08  # m from where the views see a point of the body
_ASTRAY_SECONDS = 0.1  # in which the square of that distance is added to the variance
_IMPOSSIBLE = 0.3, 6.0  # m and m/s: nobody moves farther between two frames


@inner_kernel
def elapsed(state, time_ns):  # type: ignore[no-untyped-def]
    """Seconds since the last pair with a person, and whether S* starts anew.

    It does with the first person, after ``FORGET_NS`` without one, where time goes back, and where S* has
    been astray for too long (:func:`inflate_where_astray`).
    """
    since = time_ns - state.last_time[0]
    anew = state.last_time[1] == 0 or since < 0 or since > FORGET_NS or state.astray[0] > _LOST_SECONDS
    return 0.0 if anew else 1e-9 * since, anew


@inner_kernel
def forget(model, state, facing):  # type: ignore[no-untyped-def]
    """Resets all that is known of the person: the filter, the sides and heading, and the views' scales."""
    state.last_time[1] = 0
    state.astray[0], state.recalibrated[0], state.compared[0] = 0.0, math.inf, math.inf
    for v in range(2):
        for c in range(3):
            state.displacements[v, c] = 0.0
        state.view_outlier_probability[v] = state.scales[v] = 0.0
        state.scale_variances[v] = model.constants.scale_sd**2
    for i in range(len(state.known)):
        state.known[i] = False
        state.agreed[i] = state.from_b[i] = 0.0
        for v in range(2):
            state.outlier_probability[v, i] = state.offset_variances[v, i] = state.alone[v, i] = 0.0
        for c in range(3):
            state.velocities[i, c] = state.lag[i, c] = 0.0
            for v in range(2):
                state.offsets[v, i, c] = state.usual_offsets[v, i, c] = 0.0
    forget_facing(facing)


@inner_kernel
def process(state, trace, k, i, kept, dt, density):  # type: ignore[no-untyped-def]
    """The variance of joint i after dt seconds of white acceleration, ``density`` limited by _LARGEST_STEP.

    Call it after position and velocity are predicted: it writes all of them to the trace.

        P ← F P Fᵀ + density [dt³/3, dt²/2; dt²/2, dt],    F = [1, κ dt; 0, κ]

    Args:
        kept: κ, the share of its own velocity that the joint keeps.
        density: Spectral density of the acceleration, m²/s³.
    """
    P = state.variances[i]
    q = min(density, 3.0 * _LARGEST_STEP**2 / max(dt, 1e-3) ** 3)
    P[1] *= kept
    P[2] *= kept * kept
    P[0] += 2.0 * dt * P[1] + dt * dt * P[2] + q * dt**3 / 3.0
    P[1] += dt * P[2] + 0.5 * q * dt * dt
    P[2] += q * dt
    if len(trace.seconds) > 0:
        for c in range(3):
            trace.predicted[k, i, c] = state.positions[i, c]
            trace.predicted[k, i, 3 + c] = state.velocities[i, c]
            trace.predicted_variances[k, i, c] = P[c]


@inner_kernel
def grow(state, trace, k, i, square, slope):  # type: ignore[no-untyped-def]
    """P ← P + square h hᵀ with h = (1, slope): a movement that the prediction of pair k does not cover."""
    for c in range(3):
        by = square * slope**c
        state.variances[i, c] += by
        if len(trace.seconds) > 0:
            trace.predicted_variances[k, i, c] += by


@inner_kernel
def inflate_on_other_limb(model, state, views, trace, k):  # type: ignore[no-untyped-def]
    """Enlarges the variance of a joint that is predicted on the other limb, where neither view has it.

        P ← P + min_v |e_v|² / 3

    In both views the joint and its counterpart are more than 12 cm apart, and the predictions of both are
    nearer than half of that to the counterpart. The views need not agree on where the joint is. Their earlier
    doubts came from this prediction, and are forgotten.
    """
    for i in range(len(model.parents)):
        m = model.mirror[i]
        if not (model.limb[i] and state.known[i] and state.known[m]):
            continue
        least = math.inf
        for v in range(2):
            if views.states[v, i] == 0 or views.states[v, m] == 0:
                least = 0.0
                break
            apart = mine = others = square = 0.0
            for c in range(3):
                place = views.positions[v, m, c]
                apart += (views.positions[v, i, c] - place) ** 2
                mine += (state.positions[i, c] - place) ** 2
                others += (state.positions[m, c] - place) ** 2
                square += innovation(state, views, v, i, c) ** 2
            far = apart > _TOLD_APART**2 and max(mine, others) < 0.25 * apart
            least = min(least, square if far else 0.0)
        if least > 0.0:
            grow(state, trace, k, i, least / 3.0, 0.0)
            state.outlier_probability[0, i] = state.outlier_probability[1, i] = 0.0


@inner_kernel
def inflate_on_surprise(model, state, views, trace, k, dt):  # type: ignore[no-untyped-def]
    """Enlarges the variance of the prediction where both views agree that it is wrong.

        P ← P + surprise (|e|²/3) h hᵀ,    h = (1, 1/(2 dt))

    with e the views' mean innovation, and dt at least half a frame. The velocity changes by e / (2 dt).
    """
    slope = 0.5 / max(dt, _LEAST_STEP_SECONDS)
    for i in range(len(model.parents)):
        if not state.known[i] or views.surprise[i] < _LEAST_SURPRISE:
            continue
        square = 0.0
        for c in range(3):
            e = 0.5 * (innovation(state, views, 0, i, c) + innovation(state, views, 1, i, c))
            square += e * e
        grow(state, trace, k, i, views.surprise[i] * square / 3.0, slope)


@inner_kernel
def inflate_where_astray(model, state, views, trace, k, dt):  # type: ignore[no-untyped-def]
    """Notices that S* is where no view sees the person, and tells it by the variance.

    Points that no exchange of labels moves are compared: joints on the middle line, and the middles of pairs.
    A point is astray if every view that measures it is farther away than half of the views' distance and
    8 cm; the offset of a view alone counts as right. S* is astray while more than half of the points are.
    Each pair then adds to the variance the mean square of that distance, a third per axis, times dt over a
    tenth of a second, at most once. After 0.3 s, and at once where both views show a jump that nobody can
    make, S* starts anew with the next pair (:func:`elapsed`). Where too little is seen, nothing changes.
    """
    seen = far = jumped = every = 0
    total = 0.0
    for i in range(len(model.parents)):
        m = model.mirror[i]
        if m < i:
            continue
        every += 1
        if not (state.known[i] and state.known[m]):
            continue
        nearest, apart, count = _distances(state, views, i, m)
        if count == 0:
            continue
        seen += 1
        if nearest > _ASTRAY + 0.5 * apart:
            far += 1
            total += nearest * nearest
        jump = _IMPOSSIBLE[0] + _IMPOSSIBLE[1] * dt
        if count == 2 and nearest > jump and apart < nearest and views.surprise[i] > 0.5:
            jumped += 1
    if 4 * seen < every:  # too little to say where the person is
        return
    if 2 * far <= seen:
        state.astray[0] = 0.0
        return
    state.astray[0] += math.inf if 2 * jumped > seen else dt
    grown = total / far / 3.0 * min(dt / _ASTRAY_SECONDS, 1.0)
    for i in range(len(model.parents)):
        if state.known[i]:
            grow(state, trace, k, i, grown, 0.0)


@inner_kernel
def _distances(state, views, i, m):  # type: ignore[no-untyped-def]
    """Distance of the middle of joints i and m from the nearest view that measures it, and of the views.

    Returns:
        Both in metres, and the number of these views.
    """
    has_a = views.states[0, i] != 0 and views.states[0, m] != 0
    has_b = views.states[1, i] != 0 and views.states[1, m] != 0
    both = 1.0 if has_a and has_b else 0.0
    square_a = square_b = apart = 0.0
    for c in range(3):
        a = b = 0.0
        if has_a:
            offset = 0.5 * (state.offsets[0, i, c] + state.offsets[0, m, c])
            a = 0.5 * (innovation(state, views, 0, i, c) + innovation(state, views, 0, m, c)) + both * offset
        if has_b:
            offset = 0.5 * (state.offsets[1, i, c] + state.offsets[1, m, c])
            b = 0.5 * (innovation(state, views, 1, i, c) + innovation(state, views, 1, m, c)) + both * offset
        square_a += a * a
        square_b += b * b
        apart += (a - b) ** 2
    if has_a and has_b:
        return math.sqrt(min(square_a, square_b)), math.sqrt(apart), 2
    return math.sqrt(square_a + square_b), 0.0, 1 if has_a or has_b else 0
