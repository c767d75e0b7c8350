"""The estimator: one pair of skeletons in, S* out. Each step is one line, computed by its own module."""

from __future__ import annotations

import math

from fusion.compiling.kernels import inner_kernel, kernel
from fusion.estimator.bones import aim, follow_bones, hold_bones, respect_hinges
from fusion.estimator.covariance import cast_rays, find_covers, set_covariances
from fusion.estimator.evidence import ask_images, measure_surface, weigh_lengths
from fusion.estimator.kalman import begin_joints, predict, share_error, take_in
from fusion.estimator.offsets import fade_offsets, learn_offsets, learn_usual_offsets
from fusion.estimator.outliers import be_surprised, judge, remember_doubt
from fusion.estimator.smoother import trace_prediction, trace_result
from fusion.estimator.uncertainty import spread
from fusion.estimator.views import relabel, rescale, take_views

FORGET_NS = 1_000_000_000
"""After this time without a person the filter starts again."""
_SHORTEST_STEP = 1e-3  # s: two pairs with the same time must not give an infinite speed


@kernel
def estimate_pairs(  # type: ignore[no-untyped-def]
    model,
    facing_model,
    state,
    facing,
    views,
    solve,
    output,
    trace,
    time_ns,
    skew_ns,
    codes,
    a,
    states_a,
    witness_a,
    b,
    states_b,
    witness_b,
):
    """:func:`estimate_pair` over consecutive pairs.

    Args:
        model, facing_model: Of the body and the calibration.
        state, facing: Updated.
        views, solve: Workspaces.
        output: Written, T pairs.
        trace: Written, input of the smoother (:mod:`fusion.estimator.smoother`); of length 0 without one.
        codes: (T, 2) exchange codes of A and B with doubt where they are known, -1 where the facing filter
            finds them.
        time_ns, skew_ns: (T,) the pairs' times, and capture time of B minus that of A.
        a, b: (T, J, 3) float32 positions, each in its sensor's frame; NaN where not tracked.
        states_a, states_b: (T, J) uint8 tracking states; all 0 where the sensor sees no one.
        witness_a, witness_b: (T, J, 4) float32 of depth images (:mod:`fusion.witness`); NaN without.
    """
    for k in range(len(time_ns)):
        estimate_pair(
            model, facing_model, state, facing, views, solve, output, trace, k,
            time_ns[k], skew_ns[k], codes[k],
            a[k], states_a[k], witness_a[k], b[k], states_b[k], witness_b[k],
        )  # fmt: skip


@inner_kernel
def estimate_pair(  # type: ignore[no-untyped-def]
    model,
    facing_model,
    state,
    facing,
    views,
    solve,
    output,
    trace,
    k,
    time_ns,
    skew_ns,
    codes,
    a,
    states_a,
    witness_a,
    b,
    states_b,
    witness_b,
):
    """Computes S* of one pair into row k of the output."""
    constants, room, sums = model.constants, solve.room, solve.sums
    dt = elapsed(state, time_ns)
    # transform both views to K_A's frame
    take_views(model, state, views, skew_ns, a, states_a, b, states_b)
    output.counts[k, 0], output.counts[k, 1], output.counts[k, 2] = 0, views.stale[0], views.stale[1]
    if not anyone(states_a, states_b):
        no_one(output, k)
        return
    # correct exchanged left and right
    relabel(model, facing_model, facing, views, dt, codes[0], codes[1])
    # evidence of the depth images about each joint
    ask_images(model, facing_model, views, a, states_a, witness_a, b, states_b, witness_b)
    # remove each view's own scale
    rescale(model, state, views, dt)
    # evidence of the bones' lengths within each view
    weigh_lengths(model, state, views)
    # predict positions, velocities and variances
    predict(model, state, dt)
    trace_prediction(model, state, trace, k, dt)
    # covariance of each measurement
    cast_rays(model, views)
    find_covers(model, views)
    set_covariances(model, state, views)
    # the surface in the depth image as a measurement
    measure_surface(model, views, room)
    # decay of each view's offsets
    fade_offsets(model, state, views, dt)
    # probability that a measurement is an outlier
    judge(model, state, views)
    be_surprised(model, state, views, dt)
    # Kalman update with both views
    take_in(model, state, views)
    # divide the remaining difference of the views between their offsets
    learn_offsets(model, state, views, room)
    learn_usual_offsets(model, state, views, dt)
    together, alone = math.exp(-dt / constants.agreement_seconds), math.exp(-dt / constants.alone_seconds)
    share_error(model, state, views, together, alone, sums, room)
    # start joints that are seen for the first time
    begin_joints(model, state, views, sums, room)
    remember_doubt(model, state, views)
    # knees and elbows bend in one direction only
    respect_hinges(model, state, views)
    # the best skeleton with exact bone lengths
    aim(model, state, solve)
    output.counts[k, 0] = hold_bones(model, state, solve)
    # set the filter's state to it
    follow_bones(model, state, solve)
    trace_result(model, state, trace, k)
    state.clock[0], state.clock[1] = time_ns, 1
    # covariance of S*
    spread(model, solve, output.covariance[k], output.sigma[k], room)
    report(state, views, solve, output, k)


@inner_kernel
def elapsed(state, time_ns):  # type: ignore[no-untyped-def]
    """Seconds since the last pair with a person; after too long a time, the state is reset."""
    if state.clock[1] == 1 and time_ns - state.clock[0] > FORGET_NS:
        state.clock[1] = 0
        for i in range(len(state.known)):
            state.known[i] = False
        state.view_doubt[0] = state.view_doubt[1] = 0.0
    if state.clock[1] == 0:
        return _SHORTEST_STEP
    return max(1e-9 * (time_ns - state.clock[0]), _SHORTEST_STEP)


@inner_kernel
def anyone(states_a, states_b):  # type: ignore[no-untyped-def]
    """Whether a sensor reports a person."""
    some = False
    for i in range(len(states_a)):
        some = some or states_a[i] != 0 or states_b[i] != 0
    return some


@inner_kernel
def no_one(output, k):  # type: ignore[no-untyped-def]
    """Writes row k of the output for a pair in which neither sensor sees a person."""
    for i in range(output.positions.shape[1]):
        output.predicted[k, i] = True
        output.weights_a[k, i] = output.weights_b[k, i] = 0.0
        output.misleading[k, i] = -1
        output.sigma[k, i] = math.nan
        for r in range(3):
            output.positions[k, i, r] = output.velocities[k, i, r] = math.nan
            for c in range(3):
                output.covariance[k, i, r, c] = math.nan


@inner_kernel
def report(state, views, solve, output, k):  # type: ignore[no-untyped-def]
    """Writes row k of the output: S*, and each view's share of the information on each joint."""
    output.codes[k, 0], output.codes[k, 1] = views.codes[0], views.codes[1]
    output.side_doubt[k, 0], output.side_doubt[k, 1] = views.side_doubt[0], views.side_doubt[1]
    for i in range(output.positions.shape[1]):
        says_a = _information(views, 0, i)
        says_b = _information(views, 1, i)
        total = says_a + says_b
        output.predicted[k, i] = total == 0.0
        output.weights_a[k, i] = says_a / total if total > 0.0 else 0.0
        output.weights_b[k, i] = says_b / total if total > 0.0 else 0.0
        nearer_b = views.cover_distances[1, i] < views.cover_distances[0, i]
        output.misleading[k, i] = views.covers[1, i] if nearer_b else views.covers[0, i]
        for c in range(3):
            output.positions[k, i, c] = solve.positions[i, c]
            output.velocities[k, i, c] = state.velocities[i, c]


@inner_kernel
def _information(views, v, i):  # type: ignore[no-untyped-def]
    """Information of a view on a joint: its trust over the mean variance of its measurement, 1/m²."""
    if views.states[v, i] == 0 or views.trust[v, i] < _HARDLY:
        return 0.0
    C = views.slow[v, i]
    return views.trust[v, i] / ((C[0, 0] + C[1, 1] + C[2, 2]) / 3.0 + views.fast[v, i])


_HARDLY = 0.01  # a joint with less trust counts as predicted
