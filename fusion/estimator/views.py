"""Both skeletons as measurements in K_A's frame: no stale ones, re-labelled, at each view's own time."""

from __future__ import annotations

import math

from fusion.compiling.kernels import inner_kernel
from fusion.facing.exchange import exchange
from fusion.facing.filter import update_facing
from fusion.facing.model import DOUBT_BIT, DOUBT_STEPS
from fusion.repetition import repeats


@inner_kernel
def take_views(model, state, views, skew_ns, a, states_a, b, states_b):  # type: ignore[no-untyped-def]
    """Transforms both views to K_A's frame: p, and q' = R q + t.

    Args:
        model, state: Of the fuser; the state stores the sensors' last skeletons.
        views: Written: what the sensors reported, whether it is stale, and its delay.
        skew_ns: Capture time of B minus that of A, which is the pair's time.
        a, b: (J, 3) float32 metres, each in its sensor's frame; NaN where not tracked.
        states_a, states_b: (J,) tracking states.
    """
    R, t = model.rotation, model.translation
    views.stale[0] = repeats(a, states_a, state.last_positions[0], state.last_states[0])
    views.stale[1] = repeats(b, states_b, state.last_positions[1], state.last_states[1])
    views.delays[0], views.delays[1] = 0.0, 1e-9 * skew_ns
    for i in range(len(states_a)):
        views.reported_states[0, i], views.reported_states[1, i] = states_a[i], states_b[i]
        x, y, z = float(b[i, 0]), float(b[i, 1]), float(b[i, 2])
        for c in range(3):
            views.reported[0, i, c] = a[i, c]
            views.reported[1, i, c] = R[c, 0] * x + R[c, 1] * y + R[c, 2] * z + t[c]


@inner_kernel
def relabel(model, facing_model, facing, views, dt, code_a, code_b):  # type: ignore[no-untyped-def]
    """Corrects exchanged sides, and removes the measurements of a stale skeleton.

    Args:
        model, facing_model: Of the body.
        facing: State of the facing filter (:mod:`fusion.facing.filter`); updated unless codes are given.
        views: Positions and states are written.
        dt: Seconds since the previous pair.
        code_a, code_b: Known labels, as from a pass over a whole recording: exchange codes with doubt
            (:func:`fusion.facing.exchange.with_doubt`); -1 where unknown.
    """
    if code_a < 0 or code_b < 0:
        update_facing(
            facing_model, facing, dt, views.reported[0], views.reported_states[0], views.reported[1],
            views.reported_states[1], model.translation, model.up, views.stale[0], views.stale[1],
        )  # fmt: skip
        views.codes[0], views.codes[1] = facing.codes[0], facing.codes[1]
        views.side_doubt[0], views.side_doubt[1] = facing.doubt[0], facing.doubt[1]
    else:
        views.codes[0], views.codes[1] = code_a & _CODE, code_b & _CODE
        views.side_doubt[0] = (code_a >> DOUBT_BIT) / DOUBT_STEPS
        views.side_doubt[1] = (code_b >> DOUBT_BIT) / DOUBT_STEPS
    for v in range(2):
        exchange(
            facing_model, views.reported[v], views.reported_states[v], views.codes[v], views.positions[v],
            views.states[v],
        )  # fmt: skip
        if views.stale[v]:
            for i in range(len(model.parents)):
                views.states[v, i] = 0


@inner_kernel
def rescale(model, state, views, dt):  # type: ignore[no-untyped-def]
    """Estimates the scale error of each view's skeleton and removes it about the root.

    A tracker's whole skeleton grows and shrinks by some per cent within a second. The scale 1 + s is
    filtered: s is an Ornstein–Uhlenbeck process with standard deviation ``scale_sd`` and correlation
    time ``scale_seconds``. A pair measures it by Σ w² r / Σ w² over the relative errors r of the bones, with
    w = l / (1 + (r - s)² / 0.15²): a bone that is far off hardly counts.
    """
    k = model.constants
    kept = math.exp(-dt / k.scale_seconds)
    root = model.order[0]
    for v in range(2):
        at = views.positions[v]
        state.scales[v] *= kept
        state.scale_variances[v] += (1.0 - kept * kept) * (k.scale_sd**2 - state.scale_variances[v])
        total = weights = 0.0
        bones = 0
        for n in range(1, len(model.order)):
            i = model.order[n]
            p = model.parents[i]
            length = model.bone_lengths[i]
            if views.states[v, i] != 2 or views.states[v, p] != 2 or length < _SHORTEST:
                continue
            dx, dy, dz = at[i, 0] - at[p, 0], at[i, 1] - at[p, 1], at[i, 2] - at[p, 2]
            error = math.sqrt(dx * dx + dy * dy + dz * dz) / length - 1.0
            unusual = (error - state.scales[v]) / _USUAL
            w = length / (1.0 + unusual * unusual)
            total += w * w * error
            weights += w * w
            bones += 1
        if bones < _FEWEST or views.states[v, root] == 0:
            continue
        noise = _SHARED * k.bone_sd**2 / bones
        gain = state.scale_variances[v] / (state.scale_variances[v] + noise)
        state.scales[v] += gain * (total / weights - state.scales[v])
        state.scale_variances[v] *= 1.0 - gain
        shrink = 1.0 / (1.0 + state.scales[v])
        for i in range(len(at)):
            if i != root and views.states[v, i] != 0:
                for c in range(3):
                    at[i, c] = at[root, c] + (at[i, c] - at[root, c]) * shrink


_CODE = (1 << DOUBT_BIT) - 1  # the exchange code of a label
_SHORTEST = 0.12  # metres: shorter bones carry little information on the scale
_USUAL = 0.15  # a relative error at which a bone's weight is a quarter
_FEWEST = 4  # bones
_SHARED = 2.0  # neighbouring bones share joints, so their errors are correlated
