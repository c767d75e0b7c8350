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
    state.compared[0] += dt
    displaced = _norm(state.displacements[0]) + _norm(state.displacements[1]) > 0.0
    if displaced:
        faded = math.exp(-dt / _SECONDS)
        for v in range(2):
            for c in range(3):
                state.displacements[v, c] *= faded
            _move(views.positions[v], state.displacements[v], -1.0)
    if _find_points(model.mirror, state.known, views.states, views.points) < _FEWEST:
        return
    between, medians = views.between, views.medians
    _set_difference(model.mirror, views.points, views.positions, between)
    if displaced and _agree_without(state.displacements, between):
        for v in range(2):
            _move(views.positions[v], state.displacements[v], 1.0)
            for c in range(3):
                state.displacements[v, c] = 0.0
        _set_difference(model.mirror, views.points, views.positions, between)
    # a smaller change is no jump of either view, whatever the medians, which take longer than all other steps
    changed = _distance(between, state.difference)
    if state.compared[0] < _RECENT_SECONDS and changed > _STAYS * _JUMP:
        least = _JUMP + _SPEED * abs(views.delays[0] - views.delays[1])
        for v in range(2):
            _set_innovations(model, state, views, v)
            _set_median(views.innovations[v], views.points, medians[v])
        v = 0 if _norm(medians[0]) > _norm(medians[1]) else 1
        near = _STAYS * _norm(medians[v])
        jumped = _norm(medians[v]) >= least and _norm(medians[1 - v]) <= near and changed > near
        if jumped and _alike(views.innovations[v], views.points, medians[v], near) > _MOST:
            _absorb(state.displacements, between, v, medians[v], views.positions[v])
            _set_difference(model.mirror, views.points, views.positions, between)
    share = 1.0 - math.exp(-state.compared[0] / _RECENT_SECONDS)
    state.compared[0] = 0.0
    for c in range(3):
        state.difference[c] += share * (between[c] - state.difference[c])


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
def _find_points(mirror, known, states, points):  # type: ignore[no-untyped-def]
    """Writes (J,) whether the middle of a joint and its counterpart is a known point that both views track.

    Each middle is marked at the first of its two joints. Returns the number of points.
    """
    count = 0
    for i in range(len(mirror)):
        m = mirror[i]
        points[i] = m >= i and known[i] and known[m]
        for v in range(2):
            points[i] = points[i] and states[v, i] == TRACKED and states[v, m] == TRACKED
        count += points[i]
    return count


@inner_kernel
def _set_difference(mirror, points, positions, between):  # type: ignore[no-untyped-def]
    """Writes (3,) the mean of A's points less those of B, metres."""
    x = y = z = 0.0
    count = 0
    a, b = positions[0], positions[1]
    for i in range(len(mirror)):
        if points[i]:
            m = mirror[i]
            x += 0.5 * (a[i, 0] + a[m, 0] - b[i, 0] - b[m, 0])
            y += 0.5 * (a[i, 1] + a[m, 1] - b[i, 1] - b[m, 1])
            z += 0.5 * (a[i, 2] + a[m, 2] - b[i, 2] - b[m, 2])
            count += 1
    between[0], between[1], between[2] = x / count, y / count, z / count


@inner_kernel
def _agree_without(displacements, between):  # type: ignore[no-untyped-def]
    """Whether the views are less than half as far apart as they were without their displacements."""
    apart = removed = 0.0
    for c in range(3):
        removed += between[c] * between[c]
        apart += (between[c] + displacements[0, c] - displacements[1, c]) ** 2
    return apart < _STAYS * _STAYS * removed


@inner_kernel
def _absorb(displacements, between, v, jump, positions):  # type: ignore[no-untyped-def]
    """Changes the displacement of view v, which has jumped, and its joints."""
    D, sign = displacements[v], 1.0 - 2.0 * v
    before = apart = displaced = left = 0.0
    for c in range(3):
        reported = between[c] + displacements[0, c] - displacements[1, c]
        apart += reported * reported
        before += (reported - sign * jump[c]) ** 2
        displaced += D[c] * D[c]
        left += (D[c] + jump[c]) ** 2
    if apart > before or left < displaced:
        _move(positions, jump, -1.0)
        for c in range(3):
            D[c] += jump[c]


@inner_kernel
def _move(positions, by, sign):  # type: ignore[no-untyped-def]
    """Moves all joints, (J, 3)."""
    for i in range(len(positions)):
        for c in range(3):
            positions[i, c] += sign * by[c]


@inner_kernel
def _set_innovations(model, state, views, v):  # type: ignore[no-untyped-def]
    """Writes (J, 3) the innovation of each point, metres."""
    for i in range(len(model.mirror)):
        if views.points[i]:
            for c in range(3):
                other = innovation(state, views, v, model.mirror[i], c)
                views.innovations[v, i, c] = 0.5 * (innovation(state, views, v, i, c) + other)


@inner_kernel
def _set_median(innovations, points, median):  # type: ignore[no-untyped-def]
    """Writes (3,) the geometric median of the points' innovations; see Weiszfeld (1937)."""
    for step in range(_ROUNDS):
        x = y = z = total = 0.0
        for i in range(len(points)):
            if points[i]:
                e = innovations[i]
                w = 1.0 if step == 0 else 1.0 / max(_distance(e, median), _NEAREST)
                x, y, z, total = x + w * e[0], y + w * e[1], z + w * e[2], total + w
        median[0], median[1], median[2] = x / total, y / total, z / total


@inner_kernel
def _alike(innovations, points, median, radius):  # type: ignore[no-untyped-def]
    """Computes the share of points whose innovation lies within ``radius``, metres, of the median."""
    near = count = 0
    for i in range(len(points)):
        if points[i]:
            near += _distance(innovations[i], median) < radius
            count += 1
    return near / count


@inner_kernel
def _distance(x, y):  # type: ignore[no-untyped-def]
    return math.sqrt((x[0] - y[0]) ** 2 + (x[1] - y[1]) ** 2 + (x[2] - y[2]) ** 2)


@inner_kernel
def _norm(x):  # type: ignore[no-untyped-def]
    return math.sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2])
