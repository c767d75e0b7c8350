"""Lasting offsets of each view's joints from S*: the views' difference, divided between them.

Two trackers place a joint centimetres apart for as long as the pose lasts. Only the difference is observable;
each view takes a share of it according to its covariance. With the offsets removed the views agree, and S*
does not jump when one view loses the joint or finds it again.

A part of the difference outlasts the pose. Without news, each offset returns to its mean share of the
difference, the usual offset, so that S* stays between the views also where one of them is lost.
"""

from __future__ import annotations

import math

from fusion.compiling.kernels import inner_kernel
from fusion.skeleton import TRACKED
from fusion.solvers.small_matrices import inverse

_FIRST_SECONDS = 3.0  # s of agreement without which a mean says little: poses last about that long
_LARGEST_USUAL = 0.04  # m: trackers differ by up to twice as much for long; more is a wrong calibration
_RECALIBRATED = 1.0, 0.15  # s, s²: for how long after a recalibration the offsets decay at t / 0.15 s²
_UNSEEN_VARIANCE = 2.0  # times the usual one: a joint that the view does not report is probably covered


@inner_kernel
def decay_offsets(model, state, views, dt):  # type: ignore[no-untyped-def]
    """Offsets return to the usual ones like an Ornstein–Uhlenbeck process does:

        b ← b_usual + φ (b - b_usual),    Var b ← φ² Var b + (1 - φ²) C

    C is the mean slow variance of the measurement. They last for ``agreement_seconds`` while both views are
    trusted, for ``alone_seconds`` while only one is. The variance of an offset does not grow for a view that
    is trusted alone, because S* then follows that view.

    After a recalibration the offsets contain the change of the calibration, which is no error of a tracker.
    They then decay faster, within a second, at a rate that grows from 0, and with them what S* lags behind.
    """
    k = model.constants
    state.recalibrated[0] += dt
    since, rate = state.recalibrated[0], 0.0
    if since < _RECALIBRATED[0]:
        rate = since / _RECALIBRATED[1]
    settled = math.exp(-dt * rate)
    together, alone = math.exp(-dt / k.agreement_seconds), math.exp(-dt / k.alone_seconds)
    for i in range(len(model.parents)):
        both = views.states[0, i] != 0 and views.states[1, i] != 0
        agreed = both and state.outlier_probability[0, i] < 0.5 and state.outlier_probability[1, i] < 0.5
        kept = settled * (together if agreed else alone)
        for c in range(3):
            state.lag[i, c] *= kept
        for v in range(2):
            for c in range(3):
                usual = state.usual_offsets[v, i, c]
                state.offsets[v, i, c] = usual + kept * (state.offsets[v, i, c] - usual)
            if views.states[v, i] != 0:
                C = views.slow[v, i]
                slow = (C[0, 0] + C[1, 1] + C[2, 2]) / 3.0
            else:
                slow = _UNSEEN_VARIANCE * (k.slow_scale * model.slow[i]) ** 2
            if both or views.states[v, i] != TRACKED or state.outlier_probability[v, i] > 0.5:
                state.offset_variances[v, i] += (1.0 - together * together) * (
                    slow - state.offset_variances[v, i]
                )


@inner_kernel
def add_lag(state, covariance, sigma):  # type: ignore[no-untyped-def]
    """Adds the square of what S* lags behind to its covariance, (J, 3, 3) m², and to sigma, (J,) metres."""
    for i in range(len(sigma)):
        lag, square = state.lag[i], 0.0
        for r in range(3):
            square += lag[r] * lag[r]
            for c in range(3):
                covariance[i, r, c] += lag[r] * lag[c]
        sigma[i] = math.sqrt(sigma[i] * sigma[i] + square)


@inner_kernel
def update_offsets(model, state, views, solve):  # type: ignore[no-untyped-def]
    """Gives each view its share of the remaining difference d = y_A - y_B.

    With V_v the covariance of view v's offset, the slow covariance of its measurement in the size of the
    offset's variance:

        b_A ← b_A + g V_A (V_A + V_B)⁻¹ d,    b_B ← b_B - g V_B (V_A + V_B)⁻¹ d

    where g = β_A β_B (Var b_A + Var b_B) / (Var b_A + Var b_B + fast_A + fast_B). So a view that returns
    takes nearly all of the difference.
    """
    scratch = solve.scratch
    for i in range(len(model.parents)):
        trust = views.trust[0, i] * views.trust[1, i]
        if not state.known[i] or trust == 0.0:
            continue
        A, B = views.slow[0, i], views.slow[1, i]
        Va, Vb = state.offset_variances[0, i], state.offset_variances[1, i]
        sa, sb = Va / (A[0, 0] + A[1, 1] + A[2, 2]), Vb / (B[0, 0] + B[1, 1] + B[2, 2])
        gain = trust * (Va + Vb) / (Va + Vb + views.fast[0, i] + views.fast[1, i])
        for r in range(3):
            for c in range(3):
                scratch[r, c] = sa * A[r, c] + sb * B[r, c]
        inverse(scratch, scratch)
        later = views.delays[0] - views.delays[1]
        x = (
            views.positions[0, i, 0]
            - state.offsets[0, i, 0]
            - views.positions[1, i, 0]
            + state.offsets[1, i, 0]
        )
        y = (
            views.positions[0, i, 1]
            - state.offsets[0, i, 1]
            - views.positions[1, i, 1]
            + state.offsets[1, i, 1]
        )
        z = (
            views.positions[0, i, 2]
            - state.offsets[0, i, 2]
            - views.positions[1, i, 2]
            + state.offsets[1, i, 2]
        )
        x -= state.velocities[i, 0] * later
        y -= state.velocities[i, 1] * later
        z -= state.velocities[i, 2] * later
        u = scratch[0, 0] * x + scratch[0, 1] * y + scratch[0, 2] * z
        v = scratch[1, 0] * x + scratch[1, 1] * y + scratch[1, 2] * z
        w = scratch[2, 0] * x + scratch[2, 1] * y + scratch[2, 2] * z
        for r in range(3):
            state.offsets[0, i, r] += gain * sa * (A[r, 0] * u + A[r, 1] * v + A[r, 2] * w)
            state.offsets[1, i, r] -= gain * sb * (B[r, 0] * u + B[r, 1] * v + B[r, 2] * w)
        state.offset_variances[0, i] *= 1.0 - gain
        state.offset_variances[1, i] *= 1.0 - gain


@inner_kernel
def update_usual_offsets(model, state, views, dt):  # type: ignore[no-untyped-def]
    """Averages each view's share of the difference d = y_A - y_B, while both views track a joint.

        n ← min(n + β_A β_B dt, usual_seconds),    g = β_A β_B dt / (n + _FIRST_SECONDS)
        b_usual,A ← b_usual,A + g (w d - b_usual,A),    b_usual,B ← b_usual,B + g ((w - 1) d - b_usual,B)

    with w = tr C_A / (tr C_A + tr C_B), and n the seconds that the mean is of. So it is 0 at first, and a
    running mean later. Neither becomes larger than 4 cm.
    """
    later = views.delays[0] - views.delays[1]
    for i in range(len(model.parents)):
        if views.states[0, i] != TRACKED or views.states[1, i] != TRACKED or not state.known[i]:
            continue
        seconds = views.trust[0, i] * views.trust[1, i] * dt
        state.agreed[i] = min(state.agreed[i] + seconds, model.constants.usual_seconds)
        pace = min(seconds / (state.agreed[i] + _FIRST_SECONDS), 1.0)
        A, B = views.slow[0, i], views.slow[1, i]
        a, b = A[0, 0] + A[1, 1] + A[2, 2], B[0, 0] + B[1, 1] + B[2, 2]
        share = a / (a + b)
        for c in range(3):
            d = views.positions[0, i, c] - views.positions[1, i, c] - state.velocities[i, c] * later
            state.usual_offsets[0, i, c] += pace * (share * d - state.usual_offsets[0, i, c])
            state.usual_offsets[1, i, c] += pace * ((share - 1.0) * d - state.usual_offsets[1, i, c])
        for v in range(2):
            usual = state.usual_offsets[v, i]
            size = math.sqrt(usual[0] * usual[0] + usual[1] * usual[1] + usual[2] * usual[2])
            if size > _LARGEST_USUAL:
                for c in range(3):
                    usual[c] *= _LARGEST_USUAL / size
