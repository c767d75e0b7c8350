"""The estimator: one pair of skeletons in, S* out. Each step is one line, computed by its own module."""

from __future__ import annotations

import math

from fusion.compiling.kernels import inner_kernel, kernel
from fusion.estimator.bones import (
    add_registration_error,
    correct_state,
    joint_covariances,
    set_solver_targets,
    solve_bones,
)
from fusion.estimator.covariance import find_covers, set_covariances, set_rays
from fusion.estimator.kalman import kalman_update, predict, start_joints, update_common_error
from fusion.estimator.measurements.displacement import add_displacements, remove_displacements
from fusion.estimator.measurements.evidence import (
    depth_evidence,
    length_evidence,
    measure_surface,
    other_limb_evidence,
)
from fusion.estimator.measurements.heading import turn_girdles
from fusion.estimator.measurements.offsets import add_lag, decay_offsets, update_offsets, update_usual_offsets
from fusion.estimator.measurements.outliers import (
    add_other_place,
    outlier_probabilities,
    store_outlier_state,
    update_followed_views,
)
from fusion.estimator.measurements.views import relabel, remove_scales, transform_views
from fusion.estimator.process import (
    elapsed,
    forget,
    inflate_on_other_limb,
    inflate_on_surprise,
    inflate_where_astray,
)
from fusion.estimator.smoother import trace_covariance, trace_result
from fusion.pair_arrays import anyone_seen

_LEAST_TRUST = 0.01  # a joint with less trust counts as predicted


@kernel
def estimate_pairs(filter, trace, pairs, output):  # type: ignore[no-untyped-def]
    """Computes S* of consecutive pairs; each step is one line.

    Args:
        filter: A :class:`fusion.estimator.arrays.Filter`, whose states are updated.
        trace: The input of the smoother (:mod:`fusion.estimator.smoother`), which is written; of length 0
            without one.
        pairs: T pairs, :class:`fusion.pair_arrays.PairArrays`.
        output: Written, T pairs.
    """
    model, state, views, solve = filter.model, filter.state, filter.views, filter.solve
    for k in range(len(pairs.time_ns)):
        dt, anew = elapsed(state, pairs.time_ns[k])
        if anew:
            forget(model, state, filter.facing)
        # transform both views to K_A's frame
        transform_views(model, filter.last, views, pairs, k)
        output.stale_a[k], output.stale_b[k] = views.stale[0], views.stale[1]
        if not anyone_seen(pairs, k):
            write_empty_row(output, k)
            continue
        # find the heading, and correct exchanged left and right
        relabel(model, filter.facing_model, filter.facing, views, pairs.labels, k, dt)
        # evidence of the depth images about each joint
        depth_evidence(model, filter.facing_model, views, pairs, k)
        # remove each view's own scale
        remove_scales(model, state, views, dt)
        # evidence of the bones' lengths within each view
        length_evidence(model, views)
        # evidence of joints that lie on the other limb
        other_limb_evidence(model, views)
        # shoulders and hips towards the heading
        if model.constants.heading:
            turn_girdles(filter.facing_model, filter.facing.memory.axis, model.translations, views)
        # predict positions, velocities and variances
        predict(model, state, views, trace, k, dt)
        # the displacement of a view's whole skeleton
        remove_displacements(model, state, views, dt)
        # covariance of each measurement
        set_rays(model, views)
        find_covers(model, views)
        set_covariances(model, state, views)
        # the surface in the depth image as a measurement
        measure_surface(model, views, solve)
        # decay of each view's offsets
        decay_offsets(model, state, views, dt)
        # a joint that is predicted on the other limb
        inflate_on_other_limb(model, state, views, trace, k)
        # probability that a measurement is an outlier
        outlier_probabilities(model, state, views, dt)
        # the prediction is wrong: both views agree on a movement, or S* is where no view sees the person
        inflate_on_surprise(model, state, views, trace, k, dt)
        inflate_where_astray(model, state, views, trace, k, dt)
        # Kalman update with both views
        kalman_update(model, state, views)
        # divide the remaining difference of the views between their offsets
        update_offsets(model, state, views, solve)
        update_usual_offsets(model, state, views, dt)
        update_common_error(model, state, views, solve, dt)
        # start joints that are seen for the first time
        start_joints(model, state, views, solve)
        store_outlier_state(model, state, views, dt)
        update_followed_views(state, views, dt)
        # the best skeleton with exact bone lengths
        set_solver_targets(model, state, solve)
        output.iterations[k] = solve_bones(model, state, solve)
        # set the filter's state to it
        correct_state(model, state, solve)
        trace_result(model, state, trace, k)
        state.last_time[0], state.last_time[1] = pairs.time_ns[k], 1
        # covariance of S*
        joint_covariances(model, solve, output.covariance[k], output.sigma[k])
        trace_covariance(trace, output, k, -1.0)
        add_lag(state, output.covariance[k], output.sigma[k])
        add_displacements(model, state, output.covariance[k], output.sigma[k])
        write_row(state, views, solve, output, k)
        add_other_place(state, views, output.positions[k], output.covariance[k], output.sigma[k])
        add_registration_error(model, state.from_b, output, k)
        trace_covariance(trace, output, k, 1.0)


@inner_kernel
def write_empty_row(output, k):  # type: ignore[no-untyped-def]
    """Writes row k of the output for a pair in which neither sensor sees a person."""
    for c in range(3):
        output.heading[k, c] = math.nan
    for i in range(output.positions.shape[1]):
        output.predicted[k, i] = True
        output.weights_a[k, i] = output.weights_b[k, i] = 0.0
        output.misleading_joint[k, i] = -1
        output.sigma[k, i] = math.nan
        for r in range(3):
            output.positions[k, i, r] = output.velocities[k, i, r] = math.nan
            for c in range(3):
                output.covariance[k, i, r, c] = math.nan


@inner_kernel
def write_row(state, views, solve, output, k):  # type: ignore[no-untyped-def]
    """Writes row k of the output: S*, and each view's share of the information on each joint."""
    output.exchanged_a[k], output.exchanged_b[k] = views.codes[0], views.codes[1]
    output.doubt_a[k], output.doubt_b[k] = views.side_doubt[0], views.side_doubt[1]
    for c in range(3):
        output.heading[k, c] = views.heading[c]
    for i in range(output.positions.shape[1]):
        information_a = _information(views, 0, i)
        information_b = _information(views, 1, i)
        total = information_a + information_b
        output.predicted[k, i] = total == 0.0
        if total > 0.0:
            state.from_b[i] = information_b / total
        output.weights_a[k, i] = information_a / total if total > 0.0 else 0.0
        output.weights_b[k, i] = information_b / total if total > 0.0 else 0.0
        nearer_b = views.cover_distances[1, i] < views.cover_distances[0, i]
        output.misleading_joint[k, i] = views.covers[1, i] if nearer_b else views.covers[0, i]
        for c in range(3):
            output.positions[k, i, c] = solve.positions[i, c]
            output.velocities[k, i, c] = state.velocities[i, c]


@inner_kernel
def _information(views, v, i):  # type: ignore[no-untyped-def]
    """Information of a view on a joint: its trust over the mean variance of its measurement, 1/m²."""
    if views.states[v, i] == 0 or views.trust[v, i] < _LEAST_TRUST:
        return 0.0
    C = views.slow[v, i]
    return views.trust[v, i] / ((C[0, 0] + C[1, 1] + C[2, 2]) / 3.0 + views.fast[v, i])
