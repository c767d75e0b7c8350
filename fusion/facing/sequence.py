"""The labels of a whole recording: forwards as live, or forwards and backwards, without delay."""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fusion.body import Body
from fusion.compiling.kernels import inner_kernel, kernel
from fusion.facing.evidence import measure_view
from fusion.facing.filter import decide, forget_facing, update_axis, update_facing
from fusion.facing.labels import Labels
from fusion.facing.model import (
    FORGET_NS,
    HEADINGS,
    FacingModel,
    FacingState,
    ReportedPair,
    new_facing_model,
)
from fusion.facing.whole_body import retrodict, set_turning
from fusion.skeleton import stale_frames
from fusion.support.array_fields import new_arrays

Floats = NDArray[np.float64]


class _History(NamedTuple):
    """What the backward pass needs of each pair; of length 0 where there is none."""

    beliefs: Annotated[NDArray[np.float32], ("T", HEADINGS, 2, 2)]
    likelihoods: Annotated[NDArray[np.float32], ("T", HEADINGS, 2, 2)]
    shares: Annotated[Floats, ("T", 2, HEADINGS)]
    rates: Annotated[Floats, ("T", 2)]
    odds: Annotated[Floats, ("T", 2)]


def relabel_sequence(
    body: Body,
    pairs: ReportedPair,
    time_ns: ArrayLike,
    *,
    smooth: bool = True,
    model: FacingModel | None = None,
) -> Labels:
    """Finds the exchanged labels of a recording by the hidden Markov model of :mod:`fusion.facing`.

    With ``smooth`` the probability of the labels uses all pairs (forward-backward algorithm). Without it, it
    uses earlier pairs only, as live.
    """
    from fusion.compiling.references import by_reference  # it imports numba

    model = by_reference(model or new_facing_model(body))
    state = by_reference(new_arrays(FacingState, J=len(body)))
    times = np.asarray(time_ns, dtype=np.int64)
    labels = Labels.unknown(len(times))
    history = new_arrays(_History, T=len(times) if smooth else 0)
    intervals = np.diff(times, prepend=times[:1]) * 1e-9
    anew = _first_pairs(times, pairs.states)
    _forward(model, state, pairs, intervals, anew, labels, history)
    if smooth:
        _backward(model, state, intervals, anew, history)
        again = by_reference(new_arrays(FacingState, J=len(body)))
        _label(model, again, pairs, intervals, anew, labels, history)
    return labels


def _first_pairs(times: NDArray[np.int64], states: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """(T,) the pairs with which somebody may come: after ``FORGET_NS`` without a person, and the first."""
    anew = np.zeros(len(times), dtype=np.bool_)
    seen = np.flatnonzero(states.any(axis=(1, 2)))
    away = np.diff(times[seen])
    anew[seen[:1]] = True
    anew[seen[1:]] = (away > FORGET_NS) | (away < 0)
    return anew


def reported_pairs(
    views: tuple[ArrayLike, ArrayLike],
    states: tuple[ArrayLike, ArrayLike],
    sensor_b: ArrayLike,
) -> ReportedPair:
    """T pairs of a recording for :func:`relabel_sequence`; the view is the second axis.

    Args:
        views: A and B, (T, J, 3) in K_A's frame as reported, metres; NaN where not tracked.
        states: (T, J) tracking states of A and of B.
        sensor_b: (3,) position of K_B in K_A's frame, or (T, 3) of each pair.
    """
    positions = np.stack([np.asarray(view, dtype=np.float64) for view in views], axis=1)
    state = np.stack([np.asarray(each, dtype=np.uint8) for each in states], axis=1)
    stale = np.asarray(~state.any(axis=2))  # (T, 2); nobody is no evidence, either
    for view in range(2):
        stale[:, view] |= stale_frames(positions[:, view], state[:, view])
    return ReportedPair(
        positions=positions,
        states=state,
        stale=stale,
        sensor_b=np.array(np.broadcast_to(sensor_b, (len(state), 3)), dtype=np.float64, order="C"),
    )


@inner_kernel
def _store_labels(state, labels, k):  # type: ignore[no-untyped-def]
    for view in range(2):
        labels.codes[k, view], labels.doubt[k, view] = state.result.codes[view], state.result.doubt[view]
        labels.mirrored[k, view] = state.result.mirrored[view]
    for c in range(3):
        labels.heading[k, c] = state.result.confidence[0] * state.result.facing[c]


@kernel
def _forward(model, state, pairs, intervals, anew, labels, history):  # type: ignore[no-untyped-def]
    for k in range(len(intervals)):
        if anew[k]:
            forget_facing(state)
        pair = ReportedPair(pairs.positions[k], pairs.states[k], pairs.stale[k], pairs.sensor_b[k])
        update_facing(model, state, pair, intervals[k])
        _store_labels(state, labels, k)
        if len(history.beliefs) > 0:
            for n in range(len(state.memory.headings)):
                for x in range(2):
                    history.shares[k, x, n] = state.evidence.shares[x, n]
                    for y in range(2):
                        history.beliefs[k, n, x, y] = state.belief.probabilities[n, x, y]
                        history.likelihoods[k, n, x, y] = state.evidence.likelihood[n, x, y]
            for view in range(2):
                history.rates[k, view] = state.evidence.rates[view]
                history.odds[k, view] = state.evidence.odds[view]


@kernel
def _backward(model, state, intervals, anew, history):  # type: ignore[no-untyped-def]
    """Replaces each pair's belief by the one given all pairs."""
    beliefs, likelihoods = history.beliefs, history.likelihoods
    rows = beliefs.shape[1]
    later, message, scratch = np.ones((rows, 2, 2)), np.ones((rows, 2, 2)), np.ones((rows, 2, 2))
    for k in range(len(intervals) - 1, -1, -1):
        total = top = 0.0
        best = -np.inf
        for n in range(rows):
            for x in range(2):
                for y in range(2):
                    beliefs[k, n, x, y] *= later[n, x, y]
                    total += beliefs[k, n, x, y]
                    best = max(best, likelihoods[k, n, x, y])
        for n in range(rows):
            for x in range(2):
                state.evidence.shares[x, n] = history.shares[k, x, n]
                for y in range(2):
                    beliefs[k, n, x, y] /= total
                    later[n, x, y] *= np.exp(likelihoods[k, n, x, y] - best)
                    top = max(top, later[n, x, y])
        for view in range(2):
            state.evidence.rates[view] = history.rates[k, view]
            state.evidence.odds[view] = history.odds[k, view]
        for n in range(rows):
            for x in range(2):
                for y in range(2):
                    later[n, x, y] = 1.0 if anew[k] else later[n, x, y] / top
        set_turning(model.constants, state, max(intervals[k], 1e-3))
        retrodict(state, later, message, scratch)
        later, message = message, later


@kernel
def _label(model, state, pairs, intervals, anew, labels, history):  # type: ignore[no-untyped-def]
    """Computes the results of a recording from the smoothed beliefs."""
    for k in range(len(intervals)):
        if anew[k]:
            forget_facing(state)
        pair = ReportedPair(pairs.positions[k], pairs.states[k], pairs.stale[k], pairs.sensor_b[k])
        update_axis(model, state, pair, intervals[k])
        for view in range(2):
            state.memory.since[view] += intervals[k]
            if not pairs.stale[k, view]:
                state.memory.since[view] = 0.0
                measure_view(model, state, view, pairs.positions[k, view], pairs.states[k, view])
        for n in range(len(state.memory.headings)):
            for x in range(2):
                for y in range(2):
                    state.belief.probabilities[n, x, y] = history.beliefs[k, n, x, y]
        decide(model, state, state.belief.probabilities)
        _store_labels(state, labels, k)


KERNELS = _forward, _backward, _label
"""What Python calls."""
