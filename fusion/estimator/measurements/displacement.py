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
_STAYS = 0.5  # share of the jump: nearer than that counts as equal
_MOST = 2.0 / 3.0  # share of the points that have jumped alike
_FEWEST = 6  # points
_RECENT_SECONDS = 0.5  # of the mean difference of the views, which a jump changes
_SECONDS = 3.0  # in which a displacement fades, because it may be the view that is right


@inner_kernel
def remove_displacements(model, state, views, dt):  # type: ignore[no-untyped-def]
    """Removes each view's displacement D from its joints, and finds the jumps that change it.

    Over the points that both views track, let m_v be the median innovation of view v, and d what the mean
    difference of the views has changed from its mean over the last 0.5 s. View v has jumped if |m_v| > 0.1 m,
    |m_w| < |m_v|/2 for the other view w, |d| > |m_v|/2, and two thirds of its points lie within |m_v|/2 of
    m_v. Then

        D_v ← 0          if v is back, |m_v + D_v| < |m_v|/2
        D_v ← D_v + m_v  if the jump takes the views apart

    and otherwise D_v stays: a jump towards the other view corrects an error. D fades within 3 s.
    """
    faded = math.exp(-dt / _SECONDS)
    state.compared[0] += dt
    for v in range(2):
        for c in range(3):
            state.displacements[v, c] *= faded
        _move(views, v, state.displacements[v], -1.0)
        for c in range(3):
            views.medians[v, c] = _median_innovation(model, state, views, v, c)
    if math.isnan(views.medians[0, 0]):
        return
    if state.compared[0] < _RECENT_SECONDS:
        for v in range(2):
            if _has_jumped(model, state, views, v):
                _absorb(model, state, views, v)
    share = 1.0 - math.exp(-state.compared[0] / _RECENT_SECONDS)
    state.compared[0] = 0.0
    for c in range(3):
        state.difference[c] += share * (_difference(model, state, views, c) - state.difference[c])


@inner_kernel
def _has_jumped(model, state, views, v):  # type: ignore[no-untyped-def]
    """Whether view v has."""
    size = _norm(views.medians[v])
    if size < _JUMP or _norm(views.medians[1 - v]) > _STAYS * size:
        return False
    changed = 0.0
    for c in range(3):
        changed += (_difference(model, state, views, c) - state.difference[c]) ** 2
    return changed > (_STAYS * size) ** 2 and _alike(model, state, views, v, _STAYS * size) > _MOST


@inner_kernel
def _absorb(model, state, views, v):  # type: ignore[no-untyped-def]
    """Changes the displacement of a view that has jumped, and its joints."""
    D, jump, sign = state.displacements[v], views.medians[v], 1.0 - 2.0 * v
    before = apart = returned = 0.0
    for c in range(3):
        reported = _difference(model, state, views, c) + state.displacements[0, c] - state.displacements[1, c]
        apart += reported * reported
        before += (reported - sign * jump[c]) ** 2
        returned += (jump[c] + D[c]) ** 2
    _move(views, v, D, 1.0)
    if returned < (_STAYS * _norm(jump)) ** 2:
        for c in range(3):
            D[c] = 0.0
    elif apart > before:
        for c in range(3):
            D[c] += jump[c]
    _move(views, v, D, -1.0)


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
def _of_point(model, state, views, v, i, c):  # type: ignore[no-untyped-def]
    """Innovation of the middle of joint i and its counterpart along axis c."""
    return 0.5 * (innovation(state, views, v, i, c) + innovation(state, views, v, model.mirror[i], c))


@inner_kernel
def _norm(x):  # type: ignore[no-untyped-def]
    return math.sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2])


@inner_kernel
def _median_innovation(model, state, views, v, c):  # type: ignore[no-untyped-def]
    """The lower median of the points' innovations along axis c; NaN with fewer than 6 points."""
    joints = views.positions.shape[1]
    count = 0
    for i in range(joints):
        count += _is_point(model, state, views, i)
    if count < _FEWEST:
        return math.nan
    for i in range(joints):
        if not _is_point(model, state, views, i):
            continue
        e, smaller, equal = _of_point(model, state, views, v, i, c), 0, 0
        for j in range(joints):
            if _is_point(model, state, views, j):
                other = _of_point(model, state, views, v, j, c)
                smaller += other < e
                equal += other == e
        if smaller <= (count - 1) // 2 < smaller + equal:
            return e
    return math.nan


@inner_kernel
def _alike(model, state, views, v, radius):  # type: ignore[no-untyped-def]
    """Share of the points whose innovation lies within the radius, metres, of the median."""
    count = near = 0
    for i in range(views.positions.shape[1]):
        if not _is_point(model, state, views, i):
            continue
        square = 0.0
        for c in range(3):
            square += (_of_point(model, state, views, v, i, c) - views.medians[v, c]) ** 2
        count += 1
        near += square < radius * radius
    return near / count


@inner_kernel
def _difference(model, state, views, c):  # type: ignore[no-untyped-def]
    """Mean of A's points less those of B along axis c, metres."""
    total, count = 0.0, 0
    for i in range(views.positions.shape[1]):
        if _is_point(model, state, views, i):
            m = model.mirror[i]
            a = views.positions[0, i, c] + views.positions[0, m, c]
            total += 0.5 * (a - views.positions[1, i, c] - views.positions[1, m, c])
            count += 1
    return total / count
