"""Both skeletons as measurements in K_A's frame: no stale ones, re-labelled, at each view's own time."""

from __future__ import annotations

import math

from fusion.compiling.kernels import inner_kernel
from fusion.facing.exchange import exchange
from fusion.facing.filter import update_axis, update_facing
from fusion.facing.model import ReportedPair
from fusion.pair_arrays import repeats
from fusion.skeleton import TRACKED

_SHORTEST_BONE = 0.12  # metres: shorter bones carry little information on the scale
_USUAL_ERROR = 0.15  # a relative error at which a bone's weight is a quarter
_FEWEST_BONES = 4  # bones
_CORRELATION = 2.0  # neighbouring bones share joints, so their errors are correlated


@inner_kernel
def transform_views(model, last, views, pairs, k):  # type: ignore[no-untyped-def]
    """Transforms both views to K_A's frame: p, and q' = R q + t.

    Args:
        last: The sensors' last skeletons, which are replaced.
        views: Written: what the sensors reported, whether it is stale, and its delay.
        pairs, k: Pair k of :class:`fusion.pair_arrays.PairArrays`. Its time is that of A.
    """
    a, states_a, b, states_b = pairs.a[k], pairs.states_a[k], pairs.b[k], pairs.states_b[k]
    R, t = model.rotation, model.translation
    # a sensor without a person, or without a frame, repeats nothing, and its last skeleton stays the last one
    views.stale[0] = views.stale[1] = False
    if _anyone(states_a):
        views.stale[0] = repeats(a, states_a, last.positions[0], last.states[0])
    if _anyone(states_b):
        views.stale[1] = repeats(b, states_b, last.positions[1], last.states[1])
    views.delays[0], views.delays[1] = 0.0, 1e-9 * pairs.skew_ns[k]
    for i in range(len(states_a)):
        views.reported_states[0, i], views.reported_states[1, i] = states_a[i], states_b[i]
        x, y, z = float(b[i, 0]), float(b[i, 1]), float(b[i, 2])
        for c in range(3):
            views.reported[0, i, c] = a[i, c]
            views.reported[1, i, c] = R[c, 0] * x + R[c, 1] * y + R[c, 2] * z + t[c]


@inner_kernel
def _anyone(states):  # type: ignore[no-untyped-def]
    some = False
    for i in range(len(states)):
        some = some or states[i] != 0
    return some


@inner_kernel
def relabel(model, facing_model, facing, views, labels, k, dt):  # type: ignore[no-untyped-def]
    """Corrects exchanged sides, and removes the measurements of a stale skeleton.

    Args:
        facing: State of the facing filter (:mod:`fusion.facing.filter`); updated where a label is missing.
        views: Positions, states and heading are written.
        labels, k: Pair k of :class:`fusion.facing.labels.Labels`.
    """
    codes, doubt, heading = labels.codes[k], labels.doubt[k], labels.heading[k]
    biased = facing_model.constants.folded > 0.0  # then the heading is needed, too
    for v in range(2):  # neither is evidence of the heading
        views.stale[v] = views.stale[v] or not _anyone(views.reported_states[v])
    pair = ReportedPair(views.reported, views.reported_states, views.stale, model.translation)
    missing = codes[0] < 0 or codes[1] < 0 or math.isnan(doubt[0]) or math.isnan(doubt[1])
    if missing or (biased and math.isnan(heading[0])):
        update_facing(facing_model, facing, pair, dt)
    elif biased:
        update_axis(facing_model, facing, pair, dt)
    for v in range(2):
        views.codes[v] = codes[v] if codes[v] >= 0 else facing.result.codes[v]
        views.side_doubt[v] = facing.result.doubt[v] if math.isnan(doubt[v]) else doubt[v]
    # the filter's heading belongs to the labels that it finds
    result = facing.result
    agreed = views.codes[0] == result.codes[0] and views.codes[1] == result.codes[1]
    for c in range(3):
        found = result.confidence[0] * result.facing[c] if agreed else math.nan
        views.heading[c] = found if math.isnan(heading[c]) else heading[c]
    for v in range(2):
        exchange(
            facing_model, views.reported[v], views.reported_states[v], views.codes[v], views.positions[v],
            views.states[v],
        )  # fmt: skip
        if views.stale[v]:
            for i in range(len(model.parents)):
                views.states[v, i] = 0


@inner_kernel
def remove_scales(model, state, views, dt):  # type: ignore[no-untyped-def]
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
        x = views.positions[v]
        state.scales[v] *= kept
        state.scale_variances[v] += (1.0 - kept * kept) * (k.scale_sd**2 - state.scale_variances[v])
        total = weights = 0.0
        bones = 0
        for n in range(1, len(model.order)):
            i = model.order[n]
            p = model.parents[i]
            length = model.bone_lengths[i]
            if views.states[v, i] != TRACKED or views.states[v, p] != TRACKED or length < _SHORTEST_BONE:
                continue
            dx, dy, dz = x[i, 0] - x[p, 0], x[i, 1] - x[p, 1], x[i, 2] - x[p, 2]
            error = math.sqrt(dx * dx + dy * dy + dz * dz) / length - 1.0
            unusual = (error - state.scales[v]) / _USUAL_ERROR
            w = length / (1.0 + unusual * unusual)
            total += w * w * error
            weights += w * w
            bones += 1
        if views.states[v, root] == 0:
            continue
        if bones >= _FEWEST_BONES:
            noise = _CORRELATION * k.bone_sd**2 / bones
            gain = state.scale_variances[v] / (state.scale_variances[v] + noise)
            state.scales[v] += gain * (total / weights - state.scales[v])
            state.scale_variances[v] *= 1.0 - gain
        shrink = 1.0 / (1.0 + state.scales[v])
        for i in range(len(x)):
            if i != root and views.states[v, i] != 0:
                for c in range(3):
                    x[i, c] = x[root, c] + (x[i, c] - x[root, c]) * shrink
