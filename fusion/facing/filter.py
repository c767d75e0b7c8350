"""The facing filter: the person's heading and the labels that each view has exchanged, pair by pair."""

from __future__ import annotations

import math

from fusion.compiling.kernels import inner_kernel, kernel
from fusion.facing.evidence import exchange_odds, follow_motion, learn_up, measure_view
from fusion.facing.limbs import follow_limb
from fusion.facing.model import ARMS, LEGS, TRUNK, WHOLE
from fusion.facing.whole_body import correct, make_headings, make_turning, predict, start, weigh_evidence

FORGET_SECONDS = 1.0
"""After this time without a pair the filter starts again."""
_SHORTEST = 1e-3  # seconds between two pairs
_ABANDONED = 0.2  # labels with a smaller probability are given up


@kernel
def update_facing(model, state, dt, a, states_a, b_in_a, states_b, sensor_b, up, stale_a, stale_b):  # type: ignore[no-untyped-def]
    """Updates the filter with one pair; the result is in ``state`` (see :class:`FacingState`).

    Args:
        model: Of the body.
        state: Updated.
        dt: Seconds since the previous pair.
        a, b_in_a: (J, 3) float64 the views in K_A's frame, as reported; NaN where not tracked.
        states_a, states_b: (J,) uint8 tracking states.
        sensor_b: (3,) position of K_B in K_A's frame: t of the registration.
        up: (3,) unit vector against gravity in K_A's frame; NaN where it is unknown: then it is learned from
            the person (see :mod:`fusion.facing.evidence`).
        stale_a, stale_b: Whether the view repeats its last skeleton, which is then no evidence.
    """
    if dt > FORGET_SECONDS:
        state.started[0] = 0
    step = max(dt, _SHORTEST)
    take_evidence(model, state, step, a, states_a, b_in_a, states_b, sensor_b, up, stale_a, stale_b)
    if state.started[0] == 0:
        start(state)
    else:
        predict(state, state.belief, state.predicted)
    correct(state, model.scalars.leak)
    old_a, old_b = state.whole[0], state.whole[1]
    decide(model, state, state.belief, state.started[0] == 0)
    label_limbs(model, state, step, old_a, old_b, not stale_a, not stale_b)
    remember(state, not stale_a, not stale_b)


@inner_kernel
def take_evidence(model, state, dt, a, states_a, b_in_a, states_b, sensor_b, up, stale_a, stale_b):  # type: ignore[no-untyped-def]
    """Computes the evidence of the pair: log-likelihood, probabilities of exchanges and turns."""
    state.since[0] += dt
    state.since[1] += dt
    known = math.isfinite(up[0])
    if not known and not stale_a:
        learn_up(model, state, a)
    if not known and not stale_b:
        learn_up(model, state, b_in_a)
    make_headings(state, up if known else state.up)
    for view in range(2):
        positions, states, stale = (b_in_a, states_b, stale_b) if view == 1 else (a, states_a, stale_a)
        state.odds[view] = 1.0
        state.pull[view, 0] = state.pull[view, 1] = state.pull[view, 2] = 0.0
        state.rates[view] = 0.0  # a stale skeleton keeps its labels
        if not stale:
            measure_view(model, state, view, positions, states)
            follow_motion(model, state, view, positions)
            state.odds[view] = exchange_odds(model, state, view)
            state.rates[view] = 1.0 - math.exp(-dt / model.scalars.mirrored_seconds)
    for c in range(3):
        state.velocity[c] += state.pull[0, c] + state.pull[1, c]
    _look_towards_sensors(state, sensor_b)
    make_turning(model.scalars, state, dt)
    weigh_evidence(model, state, not stale_a, not stale_b)


@inner_kernel
def _look_towards_sensors(state, sensor_b):  # type: ignore[no-untyped-def]
    """The horizontal directions from the person to the sensors; kept where no person is seen."""
    for view in range(2):
        x = y = z = 0.0
        count = 0
        for other in range(2):
            root = state.last_root[other]
            if math.isfinite(root[0]):
                x, y, z = x + root[0], y + root[1], z + root[2]
                count += 1
        if count == 0:
            return
        x, y, z = -x / count, -y / count, -z / count
        if view == 1:
            x, y, z = x + sensor_b[0], y + sensor_b[1], z + sensor_b[2]
        u = state.frame_up
        height = x * u[0] + y * u[1] + z * u[2]
        x, y, z = x - height * u[0], y - height * u[1], z - height * u[2]
        length = math.sqrt(x * x + y * y + z * z)
        if length > 1e-6:
            state.toward[view, 0], state.toward[view, 1], state.toward[view, 2] = (
                x / length,
                y / length,
                z / length,
            )


@inner_kernel
def decide(model, state, belief, afresh):  # type: ignore[no-untyped-def]
    """Chooses the whole-body labels from a belief, with hysteresis; heading, confidence and doubt."""
    best, a, b = -1.0, 0, 0
    for x in range(2):
        for y in range(2):
            total = 0.0
            for n in range(len(belief)):
                total += belief[n, x, y]
            state.limb_room[x, y] = total
            if total > best:
                best, a, b = total, x, y
    held = state.limb_room[state.whole[0], state.whole[1]]
    if afresh or best >= model.scalars.change_from or held < _ABANDONED:
        state.whole[0], state.whole[1] = a, b
    state.mirrored[0] = state.limb_room[1, 0] + state.limb_room[1, 1]
    state.mirrored[1] = state.limb_room[0, 1] + state.limb_room[1, 1]
    _average_heading(state, belief)
    for view in range(2):
        sign = 1.0 - 2.0 * state.whole[view]
        wrong = state.mirrored[view] if sign > 0.0 else 1.0 - state.mirrored[view]
        along = trust = 0.0
        for girdle in range(2):
            if state.axis_trust[view, girdle] > 0.0:
                trust += 1.0
                for c in range(3):
                    along += sign * state.axes[view, girdle, c] * state.facing[c]
        contradicted = max(0.0, min(1.0, 0.5 - along / trust)) if trust > 0.0 else 0.0
        state.doubt[view] = max(wrong, contradicted)


@inner_kernel
def _average_heading(state, belief):  # type: ignore[no-untyped-def]
    """The mean heading given the labels chosen; the confidence is over all labels."""
    a, b = state.whole[0], state.whole[1]
    squared = confidence = 0.0
    for c in range(3):
        mean = every = 0.0
        for n in range(len(belief)):
            mean += belief[n, a, b] * state.headings[n, c]
            every += (belief[n, 0, 0] + belief[n, 0, 1] + belief[n, 1, 0] + belief[n, 1, 1]) * state.headings[
                n, c
            ]
        state.facing[c] = mean
        squared += mean * mean
        confidence += every * every
    state.confidence[0] = math.sqrt(confidence)
    length = math.sqrt(squared)
    for c in range(3):
        state.facing[c] = state.facing[c] / length if length > 1e-12 else math.nan


@inner_kernel
def label_limbs(model, state, dt, old_a, old_b, fresh_a, fresh_b):  # type: ignore[no-untyped-def]
    """Labels arms and legs; writes the codes and probabilities of both views."""
    signs = (1.0 - 2.0 * state.whole[0], 1.0 - 2.0 * state.whole[1])
    old_signs = (1.0 - 2.0 * old_a, 1.0 - 2.0 * old_b)
    rate = 1.0 - math.exp(-dt / model.scalars.limb_seconds)
    if state.started[0] == 0:
        state.started[0] = 1
        share = model.scalars.limb_share
        for limb in range(2):
            belief = state.limb_belief[limb]
            belief[0, 0], belief[1, 1] = (1.0 - share) ** 2, share**2
            belief[0, 1] = belief[1, 0] = share * (1.0 - share)
    for limb in range(2):
        follow_limb(model, state, limb, signs, old_signs, rate, (fresh_a, fresh_b))
    for view in range(2):
        code = WHOLE * state.whole[view]
        arms, legs = _alone(state.limb_belief[0], view), _alone(state.limb_belief[1], view)
        if arms > 0.5:
            code ^= ARMS
        if legs > 0.5:
            code ^= LEGS
        if (code == WHOLE) != (state.whole[view] == 1):
            code += TRUNK
        seen = state.axis_trust[view, 0] + state.axis_trust[view, 1] > 0.0
        state.codes[view] = code if seen else 0
        for bits in range(4):
            other = bits ^ WHOLE
            p_bits = (arms if bits & ARMS else 1.0 - arms) * (legs if bits & LEGS else 1.0 - legs)
            p_other = (arms if other & ARMS else 1.0 - arms) * (legs if other & LEGS else 1.0 - legs)
            mirrored = state.mirrored[view]
            state.probability[view, bits] = (1.0 - mirrored) * p_bits + mirrored * p_other


@inner_kernel
def _alone(belief, view):  # type: ignore[no-untyped-def]
    if view == 0:
        return belief[1, 0] + belief[1, 1]
    return belief[0, 1] + belief[1, 1]


@inner_kernel
def remember(state, fresh_a, fresh_b):  # type: ignore[no-untyped-def]
    """Keeps the spans of fresh views for continuity."""
    for view in range(2):
        if fresh_b if view == 1 else fresh_a:
            for pair in range(6):
                for c in range(3):
                    state.last_spans[view, pair, c] = state.spans[view, pair, c]
