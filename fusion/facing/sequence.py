"""The labels of a whole recording: forwards as live, or forwards and backwards, without delay."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fusion.body import Body
from fusion.compiling.kernels import kernel
from fusion.facing.evidence import measure_view, upright_direction
from fusion.facing.filter import FORGET_SECONDS, decide, label_limbs, remember, update_facing
from fusion.facing.model import FacingModel, new_facing_model, new_facing_state
from fusion.facing.whole_body import make_headings, make_turning, retrodict

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Labels:
    """Which labels each view of a recording has exchanged, and how the person faces.

    Attributes:
        codes: (T, 2) exchange code of A and of B in each pair.
        facing: (T, 3) horizontal unit vector in which the person faces, in K_A's frame.
        doubt: (T, 2) as :class:`fusion.facing.model.FacingState` says.
        probability: (T, 2, 4) of each code of each view: none, arms, legs, whole body.
        mirrored: (T, 2) probability that the whole body of each view is mirrored.
    """

    codes: NDArray[np.int64]
    facing: Floats
    doubt: Floats
    probability: Floats
    mirrored: Floats


def relabel_sequence(
    body: Body,
    a: ArrayLike,
    states_a: ArrayLike,
    b_in_a: ArrayLike,
    states_b: ArrayLike,
    time_ns: ArrayLike,
    sensor_b: ArrayLike,
    *,
    up: ArrayLike | None = None,
    smooth: bool = True,
    model: FacingModel | None = None,
) -> Labels:
    """Finds the exchanged labels of a recording by the hidden Markov model of :mod:`fusion.facing`.

    With ``smooth`` the probability of the whole body's labels uses all pairs (forward-backward algorithm).
    Without it, it uses earlier pairs only, as live.

    Args:
        body: The joints.
        a, b_in_a: (T, J, 3) both views in K_A's frame as reported, metres; NaN where not tracked.
        states_a, states_b: (T, J) tracking states.
        time_ns: (T,) the pairs' times.
        sensor_b: (3,) position of K_B in K_A's frame.
        up: (3,) against gravity; learned from the person where None.
        smooth: Whether later pairs count.
        model: The body's own where None.
    """
    views = [np.ascontiguousarray(view, dtype=np.float64) for view in (a, b_in_a)]
    states = [np.ascontiguousarray(state, dtype=np.uint8) for state in (states_a, states_b)]
    times = np.asarray(time_ns, dtype=np.int64)
    upwards = upright_direction(body, *views) if up is None else np.asarray(up, dtype=np.float64)
    stale = np.zeros((2, len(times)), dtype=np.bool_)
    for which, view in enumerate(views):
        stale[which, 1:] = ((view[1:] == view[:-1]) | np.isnan(view[1:])).all(axis=(1, 2)) & np.isfinite(
            view[1:]
        ).any(axis=(1, 2))
    return run(
        model or new_facing_model(body), body, views, states, times, np.asarray(sensor_b, dtype=np.float64),
        upwards, stale, smooth,
    )  # fmt: skip


def run(
    model: FacingModel,
    body: Body,
    views: list[Floats],
    states: list[NDArray[np.uint8]],
    time_ns: NDArray[np.int64],
    sensor_b: Floats,
    up: Floats,
    stale: NDArray[np.bool_],
    smooth: bool,
) -> Labels:
    """:func:`relabel_sequence` with everything given."""
    state = new_facing_state(body)
    frames, kept = len(time_ns), len(time_ns) if smooth else 0
    result = Labels(
        codes=np.zeros((frames, 2), dtype=np.int64),
        facing=np.zeros((frames, 3)),
        doubt=np.zeros((frames, 2)),
        probability=np.zeros((frames, 2, 4)),
        mirrored=np.zeros((frames, 2)),
    )
    grid = state.belief.shape
    history = (
        np.zeros((kept, *grid), dtype=np.float32),
        np.zeros((kept, *grid), dtype=np.float32),
        np.zeros((kept, *state.shares.shape)),
        np.zeros((kept, 4)),
    )
    seconds = np.diff(time_ns, prepend=time_ns[:1]) * 1e-9
    answers = result.codes, result.facing, result.doubt, result.probability, result.mirrored
    _forward(model, state, seconds, *views, *states, sensor_b, up, stale, *answers, *history)
    if smooth:
        _backward(model, state, seconds, *history)
        _label(model, new_facing_state(body), state, seconds, *views, *states, stale, *answers, history[0])
    return result


@kernel
def _forward(  # type: ignore[no-untyped-def]
    model, state, seconds, a, b, states_a, states_b, sensor_b, up, stale,
    codes, facing, doubt, probability, mirrored, beliefs, likelihoods, shares, chances,
):  # fmt: skip
    for k in range(len(seconds)):
        update_facing(
            model,
            state,
            seconds[k],
            a[k],
            states_a[k],
            b[k],
            states_b[k],
            sensor_b,
            up,
            stale[0, k],
            stale[1, k],
        )
        for view in range(2):
            codes[k, view], doubt[k, view] = state.codes[view], state.doubt[view]
            mirrored[k, view] = state.mirrored[view]
            for code in range(4):
                probability[k, view, code] = state.probability[view, code]
        for c in range(3):
            facing[k, c] = state.facing[c]
        if len(beliefs) > 0:
            for n in range(len(state.headings)):
                for x in range(2):
                    shares[k, x, n] = state.shares[x, n]
                    for y in range(2):
                        beliefs[k, n, x, y] = state.belief[n, x, y]
                        likelihoods[k, n, x, y] = state.likelihood[n, x, y]
            for view in range(2):
                chances[k, view], chances[k, 2 + view] = state.rates[view], state.odds[view]


@kernel
def _backward(model, state, seconds, beliefs, likelihoods, shares, chances):  # type: ignore[no-untyped-def]
    """Replaces each pair's belief by the one given all pairs."""
    later, room, rows = state.predicted, state.belief, len(state.headings)
    for n in range(rows):
        for x in range(2):
            for y in range(2):
                later[n, x, y] = 1.0
    for k in range(len(seconds) - 1, -1, -1):
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
                state.shares[x, n] = shares[k, x, n]
                for y in range(2):
                    beliefs[k, n, x, y] /= total
                    later[n, x, y] *= np.exp(likelihoods[k, n, x, y] - best)
                    top = max(top, later[n, x, y])
        for view in range(2):
            state.rates[view], state.odds[view] = chances[k, view], chances[k, 2 + view]
        for n in range(rows):
            for x in range(2):
                for y in range(2):
                    later[n, x, y] = 1.0 if seconds[k] > FORGET_SECONDS else later[n, x, y] / top
        make_turning(model.scalars, state, max(seconds[k], 1e-3))
        retrodict(state, later, state.likelihood, room)
        for n in range(rows):
            for x in range(2):
                for y in range(2):
                    later[n, x, y] = state.likelihood[n, x, y]


@kernel
def _label(  # type: ignore[no-untyped-def]
    model, state, old, seconds, a, b, states_a, states_b, stale,
    codes, facing, doubt, probability, mirrored, beliefs,
):  # fmt: skip
    """Computes the results of a recording from the smoothed beliefs of the whole body."""
    make_headings(state, old.frame_up)
    for k in range(len(seconds)):
        if seconds[k] > FORGET_SECONDS:
            state.started[0] = 0
        for view in range(2):
            if not stale[view, k]:
                measure_view(
                    model, state, view, b[k] if view == 1 else a[k], states_b[k] if view == 1 else states_a[k]
                )
        for n in range(len(state.headings)):
            for x in range(2):
                for y in range(2):
                    state.belief[n, x, y] = beliefs[k, n, x, y]
        old_a, old_b = state.whole[0], state.whole[1]
        decide(model, state, state.belief, state.started[0] == 0)
        label_limbs(model, state, max(seconds[k], 1e-3), old_a, old_b, not stale[0, k], not stale[1, k])
        remember(state, not stale[0, k], not stale[1, k])
        for view in range(2):
            codes[k, view], doubt[k, view] = state.codes[view], state.doubt[view]
            mirrored[k, view] = state.mirrored[view]
            for code in range(4):
                probability[k, view, code] = state.probability[view, code]
        for c in range(3):
            facing[k, c] = state.facing[c]
