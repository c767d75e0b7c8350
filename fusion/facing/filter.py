"""The facing filter: the person's heading and the labels that each view has exchanged, pair by pair."""

from __future__ import annotations

import math

from fusion.compiling.kernels import inner_kernel, kernel
from fusion.facing.evidence import CONTINUOUS_SECONDS, add_axis, exchange_odds, measure_view, update_motion
from fusion.facing.model import FRAME_SECONDS, WHOLE
from fusion.facing.whole_body import correct, log_likelihood, predict, prior_belief, set_turning

_SHORTEST = 1e-3  # seconds between two pairs
_AXIS_SECONDS = 0.3  # over which the body's axis is averaged
_LEAST_AXIS = 0.2  # length of the sum of the views' unit vectors along the body
_LEAST_ACROSS = 0.7  # sine: a sensor that looks more along the body sees less of its front or back
_HALF_TURN = 1e-6  # least 1 + cosine: an axis that reverses between two frames has no smallest rotation
_CERTAIN = 0.9  # probability of labels that change without the sight of shoulders and hips
_ABANDONED = 0.2  # labels with a smaller probability are given up


@kernel
def update_facing(model, state, pair, dt):  # type: ignore[no-untyped-def]
    """Updates the filter with one pair, dt seconds after the last one; see :class:`FacingState`.

    For another person call :func:`forget_facing` before.
    """
    update_evidence(model, state, pair, max(dt, _SHORTEST))
    if state.belief.started[0] == 0:
        prior_belief(state)
    else:
        predict(state, state.belief.probabilities, state.belief.predicted)
    correct(state, model.constants.leak)
    decide(model, state, state.belief.probabilities)
    store_spans(state, pair.stale)


@inner_kernel
def update_evidence(model, state, pair, dt):  # type: ignore[no-untyped-def]
    """Computes the evidence of the pair: log-likelihood, probabilities of exchanges and turns."""
    update_axis(model, state, pair, dt)
    state.evidence.frames[2] = dt / FRAME_SECONDS if state.belief.started[0] == 1 else 1.0
    for view in range(2):
        change = state.evidence.velocity_change[view]
        state.memory.since[view] += dt
        state.evidence.odds[view] = 1.0
        change[0] = change[1] = change[2] = 0.0
        state.evidence.rates[view] = 0.0  # a stale skeleton keeps its labels
        if not pair.stale[view]:
            state.evidence.frames[view] = state.memory.since[view] / FRAME_SECONDS
            measure_view(model, state, view, pair.positions[view], pair.states[view])
            state.evidence.odds[view] = exchange_odds(model, state, view)
            update_motion(model, state, view, pair.positions[view])
            state.evidence.rates[view] = 1.0 - math.exp(-dt / model.constants.mirrored_seconds)
    for c in range(3):
        changes = state.evidence.velocity_change
        state.memory.velocity[c] += changes[0, c] + changes[1, c]
    set_sensor_directions(state, pair.sensor_b)
    set_turning(model.constants, state, dt)
    log_likelihood(model, state, pair)


@inner_kernel
def update_axis(model, state, pair, dt):  # type: ignore[no-untyped-def]
    """Updates the body's axis, and turns the frame of the headings with it."""
    memory, seen = state.memory, state.evidence.axis_seen
    seen[0] = seen[1] = seen[2] = 0.0
    for view in range(2):
        if not pair.stale[view]:
            add_axis(model.pairs, pair.positions[view], seen)
    length = math.sqrt(seen[0] ** 2 + seen[1] ** 2 + seen[2] ** 2)
    if length < _LEAST_AXIS:  # none is seen, or the views contradict each other
        return
    off = 0.0
    for c in range(3):
        seen[c] /= length
        off += (seen[c] - memory.axis[c]) ** 2
    dt, known = max(dt, _SHORTEST), not math.isnan(off)
    usual = 1.0 - math.exp(-dt / _AXIS_SECONDS)
    share = min(usual + math.sqrt(off), 1.0)  # what is far off is a movement, no error
    for c in range(3):
        step = share * (seen[c] - memory.axis[c]) if known else 0.0
        memory.axis_velocity[c] += usual * (step / dt - memory.axis_velocity[c])
        seen[c] = memory.axis[c] + step if known else seen[c]
    set_headings(state, seen)


@inner_kernel
def set_headings(state, axis):  # type: ignore[no-untyped-def]
    """Sets the body's axis u, and the unit vectors of the headings, normal to it.

    They turn by the smallest rotation from the last axis u' to u: v ← v - (v · u) / (1 + u' · u) (u' + u).
    The first one of a person has no heading that means anything.
    """
    u, first = state.memory.axis, state.memory.headings[0]
    norm = math.sqrt(axis[0] ** 2 + axis[1] ** 2 + axis[2] ** 2)
    along = cosine = 0.0
    for c in range(3):
        along += first[c] * axis[c] / norm
        cosine += u[c] * axis[c] / norm
    if math.isnan(cosine):  # along the coordinate axis that is farthest from u
        u[0] = u[1] = u[2] = along = 0.0
        first[0] = first[1] = first[2] = cosine = 0.0
        x, y, z = abs(axis[0]), abs(axis[1]), abs(axis[2])
        first[0 if x <= min(y, z) else (1 if y <= z else 2)] = 1.0
    share, along_new = along / max(1.0 + cosine, _HALF_TURN), 0.0
    for c in range(3):
        first[c] -= share * (u[c] + axis[c] / norm)
        u[c] = axis[c] / norm
        along_new += first[c] * u[c]
    length = 0.0
    for c in range(3):
        first[c] -= along_new * u[c]
        length += first[c] ** 2
    length = math.sqrt(length)
    x0, x1, x2 = first[0] / length, first[1] / length, first[2] / length
    z0, z1, z2 = u[1] * x2 - u[2] * x1, u[2] * x0 - u[0] * x2, u[0] * x1 - u[1] * x0
    count = len(state.memory.headings)
    for n in range(count):
        angle = 2.0 * math.pi * n / count
        cosine, sine = math.cos(angle), math.sin(angle)
        state.memory.headings[n, 0] = cosine * x0 + sine * z0
        state.memory.headings[n, 1] = cosine * x1 + sine * z1
        state.memory.headings[n, 2] = cosine * x2 + sine * z2


@inner_kernel
def set_sensor_directions(state, sensor_b):  # type: ignore[no-untyped-def]
    """The directions from the person to the sensors, normal to the body's axis; kept where one is unknown."""
    u = state.memory.axis
    for view in range(2):
        x = y = z = 0.0
        count = 0
        for other in range(2):
            root = state.memory.last_root[other]
            if math.isfinite(root[0]):
                x, y, z = x + root[0], y + root[1], z + root[2]
                count += 1
        if count == 0 or math.isnan(u[0]):
            return
        x, y, z = -x / count, -y / count, -z / count
        if view == 1:
            x, y, z = x + sensor_b[0], y + sensor_b[1], z + sensor_b[2]
        height, distance = x * u[0] + y * u[1] + z * u[2], math.sqrt(x * x + y * y + z * z)
        x, y, z = x - height * u[0], y - height * u[1], z - height * u[2]
        length = max(math.sqrt(x * x + y * y + z * z), _LEAST_ACROSS * distance)
        toward = state.evidence.toward[view]
        toward[0], toward[1], toward[2] = x / length, y / length, z / length


@inner_kernel
def decide(model, state, belief):  # type: ignore[no-untyped-def]
    """Chooses the labels from (N, 2, 2) probabilities, with hysteresis; codes, heading, confidence and doubt.

    Needs the pair's axes (:func:`fusion.facing.evidence.measure_view`) and ``memory.since``, which
    :func:`fusion.facing.evidence.update_motion` resets, before.
    """
    for x in range(2):
        for y in range(2):
            total = 0.0
            for n in range(len(belief)):
                total += belief[n, x, y]
            state.belief.labels[x, y] = total
    labels, whole = state.belief.labels, state.belief.whole
    state.result.mirrored[0] = labels[1, 0] + labels[1, 1]
    state.result.mirrored[1] = labels[0, 1] + labels[1, 1]
    best, a, b = -1.0, 0, 0
    for x in range(2):
        for y in range(2):
            # without shoulders and hips nothing shows an exchange: the labels are held until it is certain
            kept = (x == whole[0] or _may_change(state, 0)) and (y == whole[1] or _may_change(state, 1))
            if kept and labels[x, y] > best:
                best, a, b = labels[x, y], x, y
    held = labels[whole[0], whole[1]]
    if state.belief.started[0] == 0 or best >= model.constants.change_from or held < _ABANDONED:
        state.belief.whole[0], state.belief.whole[1] = a, b
    state.belief.started[0] = 1
    average_heading(state, belief)
    for view in range(2):
        sign = 1.0 - 2.0 * state.belief.whole[view]
        wrong = state.result.mirrored[view] if sign > 0.0 else 1.0 - state.result.mirrored[view]
        along = trust = 0.0
        for girdle in range(2):
            if state.evidence.axis_trust[view, girdle] > 0.0:
                trust += 1.0
                for c in range(3):
                    along += sign * state.evidence.axes[view, girdle, c] * state.result.facing[c]
        if trust == 0.0:
            wrong = min(wrong, 0.5)  # unknown
        contradicted = max(0.0, min(1.0, 0.5 - along / trust)) if trust > 0.0 else 0.0
        state.result.doubt[view] = max(wrong, contradicted)
        # without a fresh skeleton nothing is exchanged; without shoulders and hips the held labels apply
        gone = state.memory.since[view] > CONTINUOUS_SECONDS
        state.result.codes[view] = 0 if gone else WHOLE * state.belief.whole[view]


@inner_kernel
def _may_change(state, view):  # type: ignore[no-untyped-def]
    """Whether a view's labels may change: its shoulders or hips are seen, or the belief is certain."""
    trust = state.evidence.axis_trust
    seen = trust[view, 0] > 0.0 or trust[view, 1] > 0.0
    mirrored = state.result.mirrored[view]
    certain = max(mirrored, 1.0 - mirrored) > _CERTAIN
    return seen or certain or state.belief.started[0] == 0


@inner_kernel
def average_heading(state, belief):  # type: ignore[no-untyped-def]
    """The mean heading given the labels chosen; the confidence is over all labels."""
    a, b = state.belief.whole[0], state.belief.whole[1]
    squared = confidence = 0.0
    for c in range(3):
        mean = every = 0.0
        for n in range(len(belief)):
            heading = state.memory.headings[n, c]
            mean += belief[n, a, b] * heading
            every += (belief[n, 0, 0] + belief[n, 0, 1] + belief[n, 1, 0] + belief[n, 1, 1]) * heading
        state.result.facing[c] = mean
        squared += mean * mean
        confidence += every * every
    state.result.confidence[0] = math.sqrt(confidence)
    length = math.sqrt(squared)
    for c in range(3):
        state.result.facing[c] = state.result.facing[c] / length if length > 1e-12 else math.nan


@inner_kernel
def store_spans(state, stale):  # type: ignore[no-untyped-def]
    """Keeps the spans of fresh views for continuity."""
    for view in range(2):
        if not stale[view]:
            for pair in range(6):
                for c in range(3):
                    state.memory.last_spans[view, pair, c] = state.evidence.spans[view, pair, c]


@inner_kernel
def forget_facing(state):  # type: ignore[no-untyped-def]
    """Resets what is known of the person."""
    evidence, memory, result = state.evidence, state.memory, state.result
    state.belief.started[0] = 0
    for view in range(2):
        state.belief.whole[view] = result.codes[view] = 0
        result.doubt[view] = result.mirrored[view] = memory.speed[view] = 0.0
        memory.since[view] = FRAME_SECONDS
        for girdle in range(2):
            evidence.axis_trust[view, girdle] = 0.0
        for row in range(5):
            evidence.cue_trust[view, row] = 0.0
        for c in range(3):
            evidence.toward[view, c] = 0.0
            memory.last_root[view, c] = math.nan
            for pair in range(6):
                memory.last_spans[view, pair, c] = math.nan
            for j in range(memory.last_joints.shape[1]):
                memory.last_joints[view, j, c] = math.nan
    result.confidence[0] = 0.0
    for c in range(3):
        memory.velocity[c] = 0.0
        memory.axis_velocity[c] = 0.0
        memory.axis[c] = result.facing[c] = math.nan
