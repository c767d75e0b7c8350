"""Exchanges of only the arms or only the legs: one small hidden Markov model for each limb pair.

Given the whole body's labels, the state is (e_A, e_B), whether the limb's labels in view v contradict those
of its trunk. Evidence, with d the vector from the right joint to the left one in the labels of the whole
body:

* **side**: x = d · left, with left = u × f and f the heading; log(N(x; μ, σ) + floor), x reversed where
  exchanged. Only the elbow and the knee: wrists and ankles cross in folded arms and crossed legs.
* **agreement**: log(exp(−‖d_A ∓ d_B‖² / 2σ²) + floor), − where e_A = e_B: both views see the same limbs.
* **continuity**: as of the whole body, for the limb's own joints.
"""

from __future__ import annotations

import math

from fusion.compiling.kernels import inner_kernel
from fusion.facing.model import ANKLE, ELBOW, KNEE, WRIST

_FLOOR = math.exp(-4.0)
_LEAST, _MOST = math.log(0.3), math.log(3000.0)
_PAIRS = ((ELBOW, WRIST), (KNEE, ANKLE))


@inner_kernel
def follow_limb(model, state, limb, signs, old_signs, rate, fresh):  # type: ignore[no-untyped-def]
    """One step of a limb's filter: predicts, weighs the evidence, normalises.

    Args:
        limb: 0 arms, 1 legs.
        signs, old_signs: For each view, −1 where the whole body is (was) mirrored, else 1.
        rate: Probability of reaching the equilibrium in this frame.
        fresh: For each view, whether its skeleton is a new one.
    """
    belief, room = state.limb_belief[limb], state.limb_room
    near, far = (ELBOW, WRIST) if limb == 0 else (KNEE, ANKLE)
    share = model.scalars.limb_share
    for view in range(2):
        if not fresh[view]:
            continue
        total = 0.0
        for pair in (near, far):
            dot = 0.0
            for c in range(3):
                dot += state.spans[view, pair, c] * state.last_spans[view, pair, c]
            if math.isfinite(dot):
                total += dot * signs[view] * old_signs[view]
        odds = math.exp(max(_LEAST, min(_MOST, -model.scalars.continuity * total)))
        to, fro = rate * share, rate * (1.0 - share)
        to, fro = to * odds / (1.0 - to + to * odds), fro * odds / (1.0 - fro + fro * odds)
        for other in range(2):
            if view == 0:
                zero, one = belief[0, other], belief[1, other]
                belief[0, other], belief[1, other] = (
                    zero * (1.0 - to) + one * fro,
                    zero * to + one * (1.0 - fro),
                )
            else:
                zero, one = belief[other, 0], belief[other, 1]
                belief[other, 0], belief[other, 1] = (
                    zero * (1.0 - to) + one * fro,
                    zero * to + one * (1.0 - fro),
                )
    _weigh(model, state, limb, near, far, signs, fresh, room)
    best = max(max(room[0, 0], room[0, 1]), max(room[1, 0], room[1, 1]))
    total = 0.0
    for x in range(2):
        for y in range(2):
            belief[x, y] *= math.exp(room[x, y] - best)
            total += belief[x, y]
    for x in range(2):
        for y in range(2):
            belief[x, y] = max(belief[x, y] / total, model.scalars.leak)


@inner_kernel
def _weigh(model, state, limb, near, far, signs, fresh, room):  # type: ignore[no-untyped-def]
    """Writes the log-likelihood of (e_A, e_B)."""
    f, u = state.facing, state.frame_up
    left0, left1, left2 = u[1] * f[2] - u[2] * f[1], u[2] * f[0] - u[0] * f[2], u[0] * f[1] - u[1] * f[0]
    weight = model.scalars.limb_weight
    mean, sigma = model.apart[limb, 0], model.apart[limb, 1]
    room[0, 0] = room[0, 1] = room[1, 0] = room[1, 1] = 0.0
    known = state.confidence[0] ** 2 * weight
    for view in range(2):
        d = state.spans[view, near]
        x = signs[view] * (d[0] * left0 + d[1] * left1 + d[2] * left2)
        if not fresh[view] or not math.isfinite(x):
            continue
        # While a tracker changes over, neither label describes the limbs.
        trust = known * (1.0 - state.doubt[view])
        zero = trust * math.log(math.exp(-0.5 * ((x - mean) / sigma) ** 2) + _FLOOR)
        one = trust * math.log(math.exp(-0.5 * ((-x - mean) / sigma) ** 2) + _FLOOR)
        for other in range(2):
            if view == 0:
                room[0, other] += zero
                room[1, other] += one
            else:
                room[other, 0] += zero
                room[other, 1] += one
    if not (fresh[0] and fresh[1]):
        return
    trust = weight * (1.0 - state.doubt[0]) * (1.0 - state.doubt[1])
    scale = 0.5 / model.scalars.span_sigma**2
    for pair in (near, far):
        same = opposite = 0.0
        for c in range(3):
            a, b = signs[0] * state.spans[0, pair, c], signs[1] * state.spans[1, pair, c]
            same += (a - b) ** 2
            opposite += (a + b) ** 2
        if math.isfinite(same):
            agree = trust * math.log(math.exp(-scale * same) + _FLOOR)
            differ = trust * math.log(math.exp(-scale * opposite) + _FLOOR)
            room[0, 0] += agree
            room[1, 1] += agree
            room[0, 1] += differ
            room[1, 0] += differ
