"""A view's displacement: its tracker jumps as a whole to another place, and the skeleton keeps its shape.

A displaced view still shows how the person moves. What is removed is the jump, until the view jumps back.
Points that no exchange of labels moves are compared: joints on the middle line, and the middles of pairs.
"""

from __future__ import annotations

import math

from fusion.compiling.kernels import inner_kernel
from fusion.estimator.measurements.outliers import innovation
from fusion.skeleton import TRACKED

_JUMP = 0.10  # m: smaller jumps are left to the offsets of the joints
_SPEED = 6.0  # m/s: so far a person who starts or stops moves between the times of both views
_STAYS = 0.5  # share of the jump: nearer than that counts as equal
_MOST = 2.0 / 3.0  # share of the points that have jumped alike
_FEWEST = 6  # points
_RECENT_SECONDS = 0.5  # of the mean difference of the views, which a jump changes
_SECONDS = 10.0  # in which a displacement fades, because it may be the view that is right
_ROUNDS = 12  # of Weiszfeld's algorithm
_NEAREST = 1e-4  # m: no point weighs more than one as near to the median as that


@inner_kernel
def remove_displacements(model, state, views, dt):  # type: ignore[no-untyped-def]
    """Removes each view's displacement D from its joints, and finds the jumps that change it.

    Over the points that both views track, let m_v be the geometric median of view v's innovations, and d what
    the mean difference of the views has changed from its mean over the last 0.5 s. View v has jumped if
    |m_v| > 0.1 m, |m_w| < |m_v|/2 for the other view w, |d| > |m_v|/2, and two thirds of its points lie
    within |m_v|/2 of m_v. If the jump takes the views apart, D_v ← D_v + m_v; a jump towards the other view
    corrects an error, or part of D_v.

    Both D are 0 as soon as the views are less than half as far apart without them: a view is back, or the
    other one has followed it. D fades within 10 s. Views of different times, δ apart, jump by 6 m/s δ more.
    """
    faded = math.exp(-dt / _SECONDS)
    state.compared[0] += dt
    for v in range(2):
        for c in range(3):
            state.displacements[v, c] *= faded
        _move(views, v, state.displacements[v], -1.0)
    if _set_difference(model, state, views) < _FEWEST:
        return
    displaced = _norm(state.displacements[0]) + _norm(state.displacements[1]) > 0.0
    if displaced and _agree_without(state, views):
        for v in range(2):
            _move(views, v, state.displacements[v], 1.0)
            for c in range(3):
                state.displacements[v, c] = 0.0
        _set_difference(model, state, views)
    # a smaller change is no jump of either view, whatever the medians, which take longer than all other steps
    if state.compared[0] < _RECENT_SECONDS and _changed(state, views) > _STAYS * _JUMP:
        _set_medians(model, state, views)
        for v in range(2):
            if _has_jumped(model, state, views, v):
                _absorb(state, views, v)
                _set_difference(model, state, views)
    share = 1.0 - math.exp(-state.compared[0] / _RECENT_SECONDS)
    state.compared[0] = 0.0
    for c in range(3):
        state.difference[c] += share * (views.between[c] - state.difference[c])


@inner_kernel
def add_displacements(model, state, covariance, sigma):  # type: ignore[no-untyped-def]
    """Adds what S* is off if a displaced view is right: Σ ← Σ + p Σ_v D_v D_vᵀ, p the prior of an outlier.

    Args:
        covariance, sigma: (J, 3, 3) m², (J,) metres; changed.
    """
    p = model.constants.outlier
    for v in range(2):
        D = state.displacements[v]
        square = D[0] * D[0] + D[1] * D[1] + D[2] * D[2]
        if square == 0.0:
            continue
        for i in range(len(sigma)):
            for r in range(3):
                for c in range(3):
                    covariance[i, r, c] += p * D[r] * D[c]
            sigma[i] = math.sqrt(sigma[i] * sigma[i] + p * square)


@inner_kernel
def _agree_without(state, views):  # type: ignore[no-untyped-def]
    """Whether the views are less than half as far apart as they were without their displacements."""
    apart = removed = 0.0
    for c in range(3):
        d = views.between[c]
        removed += d * d
        apart += (d + state.displacements[0, c] - state.displacements[1, c]) ** 2
    return apart < _STAYS * _STAYS * removed


@inner_kernel
def _changed(state, views):  # type: ignore[no-untyped-def]
    """How far the views' mean difference is from its recent mean, metres."""
    square = 0.0
    for c in range(3):
        square += (views.between[c] - state.difference[c]) ** 2
    return math.sqrt(square)


@inner_kernel
def _has_jumped(model, state, views, v):  # type: ignore[no-untyped-def]
    """Whether view v has."""
    size = _norm(views.medians[v])
    least = _JUMP + _SPEED * abs(views.delays[0] - views.delays[1])
    if size < least or _norm(views.medians[1 - v]) > _STAYS * size:
        return False
    near = _STAYS * size
    return _changed(state, views) > near and _alike(model, state, views, v, near) > _MOST


@inner_kernel
def _absorb(state, views, v):  # type: ignore[no-untyped-def]
    """Changes the displacement of a view that has jumped, and its joints."""
    D, jump, sign = state.displacements[v], views.medians[v], 1.0 - 2.0 * v
    before = apart = displaced = left = 0.0
    for c in range(3):
        reported = views.between[c] + state.displacements[0, c] - state.displacements[1, c]
        apart += reported * reported
        before += (reported - sign * jump[c]) ** 2
        displaced += D[c] * D[c]
        left += (D[c] + jump[c]) ** 2
    if apart > before or left < displaced:
        _move(views, v, jump, -1.0)
        for c in range(3):
            D[c] += jump[c]


@inner_kernel
def _move(views, v, by, sign):  # type: ignore[no-untyped-def]
    """Moves all joints of a view."""
    for i in range(views.positions.shape[1]):
        for c in range(3):
            views.positions[v, i, c] += sign * by[c]


@inner_kernel
def _is_point(model, state, views, i):  # type: ignore[no-untyped-def]
    """Whether the middle of joint i and its counterpart is a known point that both views track."""
    m = model.mirror[i]
    tracked = m >= i and state.known[i] and state.known[m]
    for v in range(2):
        tracked = tracked and views.states[v, i] == TRACKED and views.states[v, m] == TRACKED
    return tracked


@inner_kernel
def _count(model, state, views):  # type: ignore[no-untyped-def]
    count = 0
    for i in range(views.positions.shape[1]):
        count += _is_point(model, state, views, i)
    return count


@inner_kernel
def _of_point(model, state, views, v, i, c):  # type: ignore[no-untyped-def]
    """Innovation of the middle of joint i and its counterpart along axis c."""
    return 0.5 * (innovation(state, views, v, i, c) + innovation(state, views, v, model.mirror[i], c))


@inner_kernel
def _norm(x):  # type: ignore[no-untyped-def]
    return math.sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2])


@inner_kernel
def _distance(model, state, views, v, i):  # type: ignore[no-untyped-def]
    """Distance of a point's innovation from the median, metres."""
    square = 0.0
    for c in range(3):
        square += (_of_point(model, state, views, v, i, c) - views.medians[v, c]) ** 2
    return math.sqrt(square)


@inner_kernel
def _set_medians(model, state, views):  # type: ignore[no-untyped-def]
    """Writes the geometric median of each view's innovations; see Weiszfeld (1937)."""
    for v in range(2):
        for step in range(_ROUNDS):
            x = y = z = total = 0.0
            for i in range(views.positions.shape[1]):
                if _is_point(model, state, views, i):
                    w = 1.0 if step == 0 else 1.0 / max(_distance(model, state, views, v, i), _NEAREST)
                    x += w * _of_point(model, state, views, v, i, 0)
                    y += w * _of_point(model, state, views, v, i, 1)
                    z += w * _of_point(model, state, views, v, i, 2)
                    total += w
            views.medians[v, 0], views.medians[v, 1], views.medians[v, 2] = x / total, y / total, z / total


@inner_kernel
def _alike(model, state, views, v, radius):  # type: ignore[no-untyped-def]
    """Share of the points whose innovation lies within the radius, metres, of the median."""
    near = 0
    for i in range(views.positions.shape[1]):
        if _is_point(model, state, views, i):
            near += _distance(model, state, views, v, i) < radius
    return near / _count(model, state, views)


@inner_kernel
def _set_difference(model, state, views):  # type: ignore[no-untyped-def]
    """Writes the mean of A's points less those of B, metres; returns the number of points."""
    x = y = z = 0.0
    count = 0
    a, b = views.positions[0], views.positions[1]
    for i in range(views.positions.shape[1]):
        if _is_point(model, state, views, i):
            m = model.mirror[i]
            x += 0.5 * (a[i, 0] + a[m, 0] - b[i, 0] - b[m, 0])
            y += 0.5 * (a[i, 1] + a[m, 1] - b[i, 1] - b[m, 1])
            z += 0.5 * (a[i, 2] + a[m, 2] - b[i, 2] - b[m, 2])
            count += 1
    n = max(count, 1)
    views.between[0], views.between[1], views.between[2] = x / n, y / n, z / n
    return count
