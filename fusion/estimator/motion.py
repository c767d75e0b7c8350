"""The prediction: motion of the joints from one pair to the next."""

from __future__ import annotations

import math

from fusion.compiling.kernels import inner_kernel


@inner_kernel
def predict(model, state, dt):  # type: ignore[no-untyped-def]
    """Positions, velocities and variances after dt seconds, parents first.

    A joint moves with its velocity. The difference between its velocity and its parent's decays in
    ``velocity_seconds``, so that an unseen joint moves with the trunk. White acceleration makes the
    uncertainty grow, and is larger for a fast joint:

        σ_a = share (acceleration + acceleration_by_speed |v|) √calmness
        P ← F P Fᵀ + σ_a² [dt⁴/4, dt³/2; dt³/2, dt²],    F = [1, dt; 0, 1]

    One 2×2 matrix P per joint holds for all three axes.
    """
    k = model.constants
    kept = math.exp(-dt / k.velocity_seconds)
    x, v, P = state.positions, state.velocities, state.variances
    for n in range(len(model.order)):
        i = model.order[n]
        if not state.known[i]:
            continue
        p = model.parents[i]
        if p >= 0 and state.known[p]:
            for c in range(3):
                v[i, c] = v[p, c] + kept * (v[i, c] - v[p, c])
            P[i, 1] *= kept
            P[i, 2] *= kept * kept
        speed = math.sqrt(v[i, 0] * v[i, 0] + v[i, 1] * v[i, 1] + v[i, 2] * v[i, 2])
        sd = model.acceleration[i] * (k.acceleration + k.acceleration_by_speed * speed)
        q = min(sd * sd * model.calmness, (_FARTHEST / (dt * dt)) ** 2)
        for c in range(3):
            x[i, c] += v[i, c] * dt
        P[i, 0] += 2.0 * dt * P[i, 1] + dt * dt * P[i, 2] + 0.25 * q * dt**4
        P[i, 1] += dt * P[i, 2] + 0.5 * q * dt**3
        P[i, 2] += q * dt * dt
        if P[i, 0] > _LARGEST:
            shrink = _LARGEST / P[i, 0]
            P[i, 0] *= shrink
            P[i, 1] *= shrink
            P[i, 2] *= shrink


_FARTHEST = 0.3  # m, largest standard deviation that acceleration adds in one step
_LARGEST = 0.25  # m²: its bones keep a joint within this variance
