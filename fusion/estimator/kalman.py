"""The Kalman filter of each joint: prediction, update with both views, and the slow error of S*.

How the variances grow is in :mod:`fusion.estimator.process`.
"""

from __future__ import annotations

import math

from fusion.compiling.kernels import inner_kernel
from fusion.estimator.constants import FRAME_SECONDS
from fusion.estimator.measurements.outliers import innovation
from fusion.estimator.process import process
from fusion.solvers.small_matrices import add_inverse, inverse

_LARGEST_VARIANCE = 0.25  # m²: its bones keep a joint within this variance
_LEAST_TRUST = 1e-3  # a measurement with less trust has no visible effect
_LEAST_SUM = 0.05  # trust of both views together
_FIRST_SPEED = 1.0  # m/s, standard deviation along an axis
_ALIKE = 1.0 / 3.0  # how much more variance two views of one direction leave than those at a right angle


@inner_kernel
def predict(model, state, views, trace, k, dt):  # type: ignore[no-untyped-def]
    """Positions, velocities and variances after dt seconds, parents first.

    A joint moves with its velocity. The difference between its velocity and its parent's decays in
    ``velocity_seconds``, so that an unseen joint moves with the trunk. White acceleration makes the
    uncertainty grow (:func:`fusion.estimator.process.process`), and is larger for a fast joint; its density
    is that of a mean acceleration over 1/30 s with the deviation

        σ_a = share (acceleration + acceleration_by_speed |v|) √calmness

    times ``unseen_acceleration`` for a joint that is unseen: no view reports it in this pair, or none did in
    the last. The speed of a joint of an arm or leg is relative to the root. If the joint is seen, the root's
    velocity counts by the trust of the last pair, because a doubted joint may be elsewhere.

    One 2×2 matrix P per joint holds for all three axes. Its bones keep a joint within ``_LARGEST_VARIANCE``,
    which is knowledge, and so no part of the prediction in the trace.

    Args:
        views: The states of this pair; the trust of the last one.
        trace, k: Pair k of the smoother's input.
    """
    of = model.constants
    kept = math.exp(-dt / of.velocity_seconds)
    root = model.order[0]
    x, v, P = state.positions, state.velocities, state.variances
    if len(trace.seconds) > 0:
        trace.seconds[k] = dt if state.last_time[1] == 1 else -1.0
    for n in range(len(model.order)):
        i = model.order[n]
        if not state.known[i]:
            continue
        p = model.parents[i]
        if p >= 0 and state.known[p]:
            for c in range(3):
                v[i, c] = v[p, c] + kept * (v[i, c] - v[p, c])
        missing = views.states[0, i] == 0 and views.states[1, i] == 0
        trust = views.trust[0, i] + views.trust[1, i]
        unseen = missing or trust == 0.0
        share = (1.0 if unseen else min(trust, 1.0)) if model.limb[i] and state.known[root] else 0.0
        square = 0.0
        for c in range(3):
            square += (v[i, c] - share * v[root, c]) ** 2
        sd = model.acceleration[i] * (of.acceleration + of.acceleration_by_speed * math.sqrt(square))
        sd *= of.unseen_acceleration if unseen else 1.0
        for c in range(3):
            x[i, c] += v[i, c] * dt
        own = kept if p >= 0 and state.known[p] else 1.0
        process(state, trace, k, i, own, dt, sd * sd * model.calmness * FRAME_SECONDS)
        if P[i, 0] > _LARGEST_VARIANCE:
            shrink = _LARGEST_VARIANCE / P[i, 0]
            P[i, 0] *= shrink
            P[i, 1] *= shrink
            P[i, 2] *= shrink


@inner_kernel
def kalman_update(model, state, views):  # type: ignore[no-untyped-def]
    """Updates with both views' measurements at once, each with its noise divided by its trust.

        1/N = Σ_v β_v / (fast_v + offset variance_v),    e = N Σ_v e_v β_v / (fast_v + offset variance_v)
        S = P + N,    x ← x + (P/S) e,    v ← v + (P_xv/S) e

    e_v is the innovation; all axes have the same gain.
    """
    x, v, P = state.positions, state.velocities, state.variances
    for i in range(len(model.parents)):
        a = _information(state, views, 0, i)
        b = _information(state, views, 1, i)
        if not state.known[i] or a + b == 0.0:
            continue
        S = P[i, 0] + 1.0 / (a + b)
        gain, gain_v = P[i, 0] / S, P[i, 1] / S
        for c in range(3):
            e = 0.0
            if a > 0.0:
                e += a / (a + b) * innovation(state, views, 0, i, c)
            if b > 0.0:
                e += b / (a + b) * innovation(state, views, 1, i, c)
            x[i, c] += gain * e
            v[i, c] += gain_v * e
        P[i, 2] -= gain_v * P[i, 1]
        P[i, 1] *= 1.0 - gain
        P[i, 0] *= 1.0 - gain


@inner_kernel
def _information(state, views, s, i):  # type: ignore[no-untyped-def]
    """Of view s on the place of joint i, 1/m²; 0 where its trust has no visible effect."""
    trust = views.trust[s, i]
    return trust / (views.fast[s, i] + state.offset_variances[s, i]) if trust >= _LEAST_TRUST else 0.0


@inner_kernel
def start_joints(model, state, views, solve):  # type: ignore[no-untyped-def]
    """Starts joints seen for the first time: the information-weighted mean of the views, at rest."""
    sums, scratch = solve.sums, solve.scratch
    for i in range(len(model.parents)):
        if state.known[i] or (views.states[0, i] == 0 and views.states[1, i] == 0):
            continue
        state.known[i] = True
        both = views.states[0, i] != 0 and views.states[1, i] != 0
        x = y = z = information = 0.0
        for r in range(3):
            for c in range(3):
                sums[r, c] = 0.0
        for s in range(2):
            if views.states[s, i] == 0:
                continue
            add_inverse(views.slow[s, i], 1.0, sums, scratch)
            z_s = views.positions[s, i]
            x += scratch[0, 0] * z_s[0] + scratch[0, 1] * z_s[1] + scratch[0, 2] * z_s[2]
            y += scratch[1, 0] * z_s[0] + scratch[1, 1] * z_s[1] + scratch[1, 2] * z_s[2]
            z += scratch[2, 0] * z_s[0] + scratch[2, 1] * z_s[1] + scratch[2, 2] * z_s[2]
            information += 1.0 / views.fast[s, i]
        inverse(sums, scratch)
        for r in range(3):
            state.positions[i, r] = scratch[r, 0] * x + scratch[r, 1] * y + scratch[r, 2] * z
            state.velocities[i, r] = state.lag[i, r] = 0.0
            for c in range(3):
                state.shared_error[i, r, c] = scratch[r, c]
            state.usual_offsets[0, i, r] = state.usual_offsets[1, i, r] = 0.0
        state.agreed[i] = 0.0
        state.error_size[i] = 1.0
        state.variances[i, 0] = 1.0 / information
        state.variances[i, 1], state.variances[i, 2] = 0.0, _FIRST_SPEED**2
        for s in range(2):
            seen = views.states[s, i] != 0
            state.outlier_probability[s, i] = 0.0
            state.alone[s, i] = 1.0 if seen and not both else 0.0
            own = (model.constants.slow_scale * model.slow[i]) ** 2
            state.offset_variances[s, i] = views.fast[s, i] if seen else own
            for c in range(3):
                state.offsets[s, i, c] = (
                    views.positions[s, i, c] - state.positions[i, c] if seen and both else 0.0
                )
            views.trust[s, i] = 1.0 if seen else 0.0


@inner_kernel
def update_common_error(model, state, views, solve, dt):  # type: ignore[no-untyped-def]
    """Updates the slow error of S*: M ← M + (1 - φ) (λ μ (Σ_v β_v C_v⁻¹)⁻¹ - M), at the pace of the offsets.

    No measurement shows this error: it is common to the views once their difference d is known. But slow
    errors are large together and small together, so that d tells of their size. With a t distribution of ν
    degrees of freedom their variance given d is C times

        λ = (ν + 3 |d|² / tr(C_A + C_B)) / (ν + 3)

    averaged over the time that offsets last; with one view it is kept. A view's error is a constant and a
    wave of the direction that the person is seen from, of equal variances. So views of one direction have it
    in common: μ = 1 + β_A β_B c / 3, with c the cosine between the rays. Without a measurement M is kept, and
    only the uncertainty of the prediction grows.
    """
    k, sums, scratch = model.constants, solve.sums, solve.scratch
    kept_together, kept_alone = math.exp(-dt / k.agreement_seconds), math.exp(-dt / k.alone_seconds)
    for i in range(len(model.parents)):
        total = views.trust[0, i] + views.trust[1, i]
        if not state.known[i] or total < _LEAST_SUM:
            continue
        for r in range(3):
            for c in range(3):
                sums[r, c] = 0.0
        for s in range(2):
            if views.states[s, i] != 0 and views.trust[s, i] > 0.0:
                add_inverse(views.slow[s, i], views.trust[s, i], sums, scratch)
        inverse(sums, scratch)
        agreed = views.trust[0, i] * views.trust[1, i] > 0.25
        kept = kept_together if agreed else kept_alone
        if agreed:
            size = _error_size(model, state, views, i)
            state.error_size[i] = size + kept * (state.error_size[i] - size)
        pace = (1.0 - kept) * min(total, 1.0)
        cosine = 0.0
        for c in range(3):
            cosine += views.rays[0, i, c] * views.rays[1, i, c]
        size = state.error_size[i] * (1.0 + _ALIKE * views.trust[0, i] * views.trust[1, i] * cosine)
        for r in range(3):
            for c in range(3):
                target = size * scratch[r, c]
                state.shared_error[i, r, c] += pace * (target - state.shared_error[i, r, c])


@inner_kernel
def _error_size(model, state, views, i):  # type: ignore[no-untyped-def]
    """λ of one pair."""
    A, B, freedom = views.slow[0, i], views.slow[1, i], model.constants.freedom
    later = views.delays[0] - views.delays[1]
    square = 0.0
    for c in range(3):
        square += (views.positions[0, i, c] - views.positions[1, i, c] - state.velocities[i, c] * later) ** 2
    expected = A[0, 0] + A[1, 1] + A[2, 2] + B[0, 0] + B[1, 1] + B[2, 2]
    return (freedom + 3.0 * square / expected) / (freedom + 3.0)
