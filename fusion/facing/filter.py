"""The facing filter: the person's heading and the labels that each view has exchanged, pair by pair."""

from __future__ import annotations

import math

from fusion.compiling.kernels import inner_kernel, kernel
from fusion.facing.evidence import CONTINUOUS_SECONDS, exchange_odds, learn_up, measure_view, update_motion
from fusion.facing.model import WHOLE
from fusion.facing.whole_body import correct, log_likelihood, predict, prior_belief, set_headings, set_turning

FORGET_SECONDS = 1.0
"""After this time without a pair the filter starts again."""
_SHORTEST = 1e-3  # seconds between two pairs
_ABANDONED = 0.2  # labels with a smaller probability are given up


@kernel
def update_facing(model, state, pair, dt):  # type: ignore[no-untyped-def]
    """Updates the filter with one pair; the result is in ``state`` (see :class:`FacingState`)."""
    if dt > FORGET_SECONDS:
        state.started[0] = 0
    update_evidence(model, state, pair, max(dt, _SHORTEST))
    if state.started[0] == 0:
        prior_belief(state)
    else:
        predict(state, state.belief, state.predicted)
    correct(state, model.constants.leak)
    decide(model, state, state.belief)
    store_spans(state, pair.stale)


@inner_kernel
def update_evidence(model, state, pair, dt):  # type: ignore[no-untyped-def]
    """Computes the evidence of the pair: log-likelihood, probabilities of exchanges and turns."""
    update_up(model, state, pair)
    for view in range(2):
        state.since[view] += dt
        state.odds[view] = 1.0
        state.velocity_change[view, 0] = state.velocity_change[view, 1] = state.velocity_change[view, 2] = 0.0
        state.rates[view] = 0.0  # a stale skeleton keeps its labels
        if not pair.stale[view]:
            measure_view(model, state, view, pair.positions[view], pair.states[view])
            state.odds[view] = exchange_odds(model, state, view)
            update_motion(model, state, view, pair.positions[view])
            state.rates[view] = 1.0 - math.exp(-dt / model.constants.mirrored_seconds)
    for c in range(3):
        state.velocity[c] += state.velocity_change[0, c] + state.velocity_change[1, c]
    set_sensor_directions(state, pair.sensor_b)
    set_turning(model.constants, state, dt)
    log_likelihood(model, state, pair.stale)


@inner_kernel
def update_up(model, state, pair):  # type: ignore[no-untyped-def]
    """Updates the upward direction, which is learned from the person where it is unknown."""
    known = math.isfinite(pair.up[0])
    for view in range(2):
        if not known and not pair.stale[view]:
            learn_up(model, state, pair.positions[view])
    set_headings(state, pair.up if known else state.up)


@inner_kernel
def set_sensor_directions(state, sensor_b):  # type: ignore[no-untyped-def]
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
            toward = state.toward[view]
            toward[0], toward[1], toward[2] = x / length, y / length, z / length


@inner_kernel
def decide(model, state, belief):  # type: ignore[no-untyped-def]
    """Chooses the labels from a belief, with hysteresis; codes, heading, confidence and doubt."""
    best, a, b = -1.0, 0, 0
    for x in range(2):
        for y in range(2):
            total = 0.0
            for n in range(len(belief)):
                total += belief[n, x, y]
            state.label_probabilities[x, y] = total
            if total > best:
                best, a, b = total, x, y
    held = state.label_probabilities[state.whole[0], state.whole[1]]
    if state.started[0] == 0 or best >= model.constants.change_from or held < _ABANDONED:
        state.whole[0], state.whole[1] = a, b
    state.started[0] = 1
    state.mirrored[0] = state.label_probabilities[1, 0] + state.label_probabilities[1, 1]
    state.mirrored[1] = state.label_probabilities[0, 1] + state.label_probabilities[1, 1]
    average_heading(state, belief)
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
        gone = state.since[view] > CONTINUOUS_SECONDS
        state.codes[view] = WHOLE * state.whole[view] if trust > 0.0 and not gone else 0


@inner_kernel
def average_heading(state, belief):  # type: ignore[no-untyped-def]
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
def store_spans(state, stale):  # type: ignore[no-untyped-def]
    """Keeps the spans of fresh views for continuity."""
    for view in range(2):
        if not stale[view]:
            for pair in range(6):
                for c in range(3):
                    state.last_spans[view, pair, c] = state.spans[view, pair, c]
