"""Kalman updates of positions and velocities with the measurements of both views."""

from __future__ import annotations

from fusion.compiling.kernels import inner_kernel
from fusion.estimator.measuring.robust import innovation
from fusion.estimator.three import add_inverse, inverse


@inner_kernel
def take_in(model, state, views):  # type: ignore[no-untyped-def]
    """Updates with each view's measurement, A then B, with its noise divided by its trust.

        S = P + (fast + offset variance) / β,    x ← x + (P/S) e,    v ← v + (P_xv/S) e

    e is the innovation; all axes have the same gain.
    """
    x, v, P = state.positions, state.velocities, state.variances
    for i in range(len(model.parents)):
        if not state.known[i]:
            continue
        for s in range(2):
            trust = views.trust[s, i]
            if trust < _NOTHING:
                continue
            S = P[i, 0] + (views.fast[s, i] + state.offset_variances[s, i]) / trust
            gain, gain_v = P[i, 0] / S, P[i, 1] / S
            for c in range(3):
                e = innovation(state, views, s, i, c)
                x[i, c] += gain * e
                v[i, c] += gain_v * e
            P[i, 2] -= gain_v * P[i, 1]
            P[i, 1] *= 1.0 - gain
            P[i, 0] *= 1.0 - gain


@inner_kernel
def begin_joints(model, state, views, sum_, room):  # type: ignore[no-untyped-def]
    """Starts joints seen for the first time: the information-weighted mean of the views, at rest.

    Args:
        model, state, views: Of the pair.
        sum_, room: (3, 3) scratch.
    """
    for i in range(len(model.parents)):
        if state.known[i] or (views.states[0, i] == 0 and views.states[1, i] == 0):
            continue
        state.known[i] = True
        both = views.states[0, i] != 0 and views.states[1, i] != 0
        x = y = z = 0.0
        for r in range(3):
            for c in range(3):
                sum_[r, c] = 0.0
        for s in range(2):
            if views.states[s, i] == 0:
                continue
            add_inverse(views.slow[s, i], 1.0, sum_, room)
            at = views.positions[s, i]
            x += room[0, 0] * at[0] + room[0, 1] * at[1] + room[0, 2] * at[2]
            y += room[1, 0] * at[0] + room[1, 1] * at[1] + room[1, 2] * at[2]
            z += room[2, 0] * at[0] + room[2, 1] * at[1] + room[2, 2] * at[2]
            state.variances[i, 0] = views.fast[s, i]
        inverse(sum_, room)
        for r in range(3):
            state.positions[i, r] = room[r, 0] * x + room[r, 1] * y + room[r, 2] * z
            state.velocities[i, r] = 0.0
            for c in range(3):
                state.shared_error[i, r, c] = room[r, c]
            state.usual_offsets[0, i, r] = state.usual_offsets[1, i, r] = 0.0
        state.agreed[i] = 0.0
        state.variances[i, 1], state.variances[i, 2] = 0.0, _FIRST_SPEED**2
        for s in range(2):
            seen = views.states[s, i] != 0
            state.doubt[s, i] = 0.0
            own = (model.constants.slow_scale * model.slow[i]) ** 2
            state.offset_variances[s, i] = views.fast[s, i] if seen else own
            for c in range(3):
                state.offsets[s, i, c] = (
                    views.positions[s, i, c] - state.positions[i, c] if seen and both else 0.0
                )
            views.trust[s, i] = 1.0 if seen else 0.0


@inner_kernel
def share_error(model, state, views, kept_together, kept_alone, sum_, room):  # type: ignore[no-untyped-def]
    """Updates the slow error of S*: M ← M + (1 - φ) ((Σ_v β_v C_v⁻¹)⁻¹ - M), at the pace of the offsets.

    No measurement shows this error: it is common to the views once their difference is known. Without a
    measurement it is kept, and only the uncertainty of the prediction grows.
    """
    for i in range(len(model.parents)):
        total = views.trust[0, i] + views.trust[1, i]
        if not state.known[i] or total < _LITTLE:
            continue
        for r in range(3):
            for c in range(3):
                sum_[r, c] = 0.0
        for s in range(2):
            if views.states[s, i] != 0 and views.trust[s, i] > 0.0:
                add_inverse(views.slow[s, i], views.trust[s, i], sum_, room)
        inverse(sum_, room)
        agreed = views.trust[0, i] * views.trust[1, i] > 0.25
        pace = (1.0 - (kept_together if agreed else kept_alone)) * min(total, 1.0)
        for r in range(3):
            for c in range(3):
                state.shared_error[i, r, c] += pace * (room[r, c] - state.shared_error[i, r, c])


_NOTHING = 1e-3  # a measurement with less trust has no visible effect
_LITTLE = 0.05  # trust of both together
_FIRST_SPEED = 1.0  # m/s, standard deviation along an axis
