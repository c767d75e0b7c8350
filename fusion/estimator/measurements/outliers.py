"""The probability that each measurement is an outlier, given the prediction and the other view."""

from __future__ import annotations

import math

from fusion.compiling.kernels import inner_kernel
from fusion.estimator.constants import FRAME_SECONDS
from fusion.skeleton import TRACKED

_TWO_PI = 2.0 * math.pi

_DOUBT_LASTS = 0.9  # share of the doubt about a joint without measurement that lasts for 1/30 s
_LARGEST_PRIOR = 0.99  # no measurement is an outlier for certain
_ALONE_SECONDS, _TOGETHER_SECONDS = 0.3, 0.05  # in which S* comes to follow one view alone, and both
_LEAST_ALONE = 1e-9
_LEAST_MISLED = 1e-3  # a smaller probability has no visible effect
_LEAST_CHANCE = 1e-4  # of a surprise between two pairs of nearly the same time


@inner_kernel
def outlier_probabilities(model, state, views, dt):  # type: ignore[no-untyped-def]
    """The trust β of each measurement: the probability that it is no outlier, given both views.

    A measurement y (less its view's offset) is the predicted x plus Gaussian noise of variance
    S = P + fast + offset variance along each axis, or an outlier, spread evenly over a cube of side
    ``outlier_side``. With both views there are four hypotheses. The likelihood that both are good is
    N(y_A; x, S_A) N(y_B; x', S'), where x' and S' are predicted after the update with y_A: so two views that
    agree with each other need not agree with the prediction. β sums the posterior over the hypotheses.

    A fifth hypothesis says that both are good and the prediction is wrong, because the person moved
    unexpectedly. Then the two agree with each other and may be anywhere: N(y_A - y_B; 0, noise_A + noise_B)
    over the cube. Earlier doubts do not count where the prediction itself is as uncertain as it is off. Its
    posterior is the surprise, which :func:`fusion.estimator.process.inflate_on_surprise` acts on.

    Where S* has followed one view alone, its prediction is no witness for that view: that the other one alone
    is right then has the probability of the priors. It changes no trust, and is in the covariance of S*
    (:func:`add_other_place`).

    An outlier lasts for 1/30 s with probability ``outlier_lasts``; β is 0 without a measurement.
    """
    k = model.constants
    frames = dt / FRAME_SECONDS
    lasts = k.outlier_lasts**frames
    surprising = math.log(max(1.0 - (1.0 - k.surprise) ** frames, _LEAST_CHANCE))
    uniform = -3.0 * math.log(k.outlier_side)
    for i in range(len(model.parents)):
        has_a, has_b = views.states[0, i] != 0, views.states[1, i] != 0
        if not state.known[i]:
            views.trust[0, i], views.trust[1, i] = 1.0 if has_a else 0.0, 1.0 if has_b else 0.0
            views.misled[0, i] = views.misled[1, i] = 0.0
            continue
        views.trust[0, i] = views.trust[1, i] = views.surprise[i] = 0.0
        views.misled[0, i] = views.misled[1, i] = 0.0
        P = state.variances[i, 0]
        if has_a and has_b:
            a = prior_outlier(model, state, views, 0, i, lasts)
            b = prior_outlier(model, state, views, 1, i, lasts)
            Sa = P + views.fast[0, i] + state.offset_variances[0, i]
            Sb = P + views.fast[1, i] + state.offset_variances[1, i]
            gain = P / Sa
            Sab = P * (1.0 - gain) + views.fast[1, i] + state.offset_variances[1, i]
            square_a = square_b = square_ab = apart = off = 0.0
            for c in range(3):
                ea, eb = innovation(state, views, 0, i, c), innovation(state, views, 1, i, c)
                square_a += ea * ea
                square_b += eb * eb
                square_ab += (eb - gain * ea) ** 2
                apart += (eb - ea) ** 2
                off += 0.25 * (ea + eb) ** 2
            good_a, good_b = normal(square_a, Sa), normal(square_b, Sb)
            right = math.log((1.0 - a) * (1.0 - b))
            both = good_a + normal(square_ab, Sab) + right
            turn = uniform + normal(apart, Sa + Sb - 2.0 * P) + surprising
            if off >= 3.0 * P:  # else earlier doubts may have come from this prediction
                turn += right
            only_a = good_a + uniform + math.log((1.0 - a) * b)
            only_b = good_b + uniform + math.log(a * (1.0 - b))
            none = 2.0 * uniform + math.log(a * b)
            misled_a = only_a - good_a + good_b + math.log(max(state.alone[1, i], _LEAST_ALONE))
            misled_b = only_b - good_b + good_a + math.log(max(state.alone[0, i], _LEAST_ALONE))
            top = max(max(both, turn), max(max(only_a, only_b), none))
            top = max(top, max(misled_a, misled_b))
            both, only_a = math.exp(both - top), math.exp(only_a - top)
            only_b, none, turn = math.exp(only_b - top), math.exp(none - top), math.exp(turn - top)
            total = both + only_a + only_b + none + turn
            views.trust[0, i] = (both + turn + only_a) / total
            views.trust[1, i] = (both + turn + only_b) / total
            views.surprise[i] = turn / total
            misled_a, misled_b = math.exp(misled_a - top), math.exp(misled_b - top)
            total += misled_a + misled_b
            views.misled[0, i], views.misled[1, i] = misled_a / total, misled_b / total
        elif has_a or has_b:
            s = 0 if has_a else 1
            outlier = prior_outlier(model, state, views, s, i, lasts)
            S = P + views.fast[s, i] + state.offset_variances[s, i]
            square = 0.0
            for c in range(3):
                square += innovation(state, views, s, i, c) ** 2
            odds = uniform + math.log(outlier) - normal(square, S) - math.log(1.0 - outlier)
            views.trust[s, i] = 1.0 / (1.0 + math.exp(min(odds, 50.0)))


@inner_kernel
def innovation(state, views, v, i, c):  # type: ignore[no-untyped-def]
    """Measurement minus prediction along axis c, without the view's offset, at the view's own time."""
    expected = state.positions[i, c] + state.velocities[i, c] * views.delays[v]
    return views.positions[v, i, c] - state.offsets[v, i, c] - expected


@inner_kernel
def normal(square, variance):  # type: ignore[no-untyped-def]
    """log N(e; 0, variance I) in three dimensions, with |e|² = square."""
    return -1.5 * math.log(_TWO_PI * variance) - 0.5 * square / variance


@inner_kernel
def prior_outlier(model, state, views, v, i, lasts):  # type: ignore[no-untyped-def]
    """Prior probability of an outlier: a Markov chain, or the doubt about the sides.

    ``lasts`` is the probability that an outlier has lasted since the last pair.

    Errors of one view come together, so the chain goes on from the joint's last doubt or from the mean doubt
    about its view, whichever is larger. The evidence of depth image and bone lengths, a log likelihood ratio,
    multiplies the odds.
    """
    k = model.constants
    rare = k.outlier if views.states[v, i] == TRACKED else k.inferred_outlier
    before = max(state.outlier_probability[v, i], state.view_outlier_probability[v])
    prior = min(rare + max(lasts - rare, 0.0) * before, _LARGEST_PRIOR)
    if model.mirror[i] != i:
        prior = max(prior, min(views.side_doubt[v], _LARGEST_PRIOR))
    if views.log_odds[v, i] != 0.0:
        odds = prior / (1.0 - prior) * math.exp(-views.log_odds[v, i])
        prior = odds / (1.0 + odds)
    return prior


@inner_kernel
def store_outlier_state(model, state, views, dt):  # type: ignore[no-untyped-def]
    """Stores 1 - β for the next pair, and its mean; without a measurement, doubt decays towards its mean."""
    rare, lasts = model.constants.outlier, _DOUBT_LASTS ** (dt / FRAME_SECONDS)
    for v in range(2):
        outlier, total, count = state.outlier_probability[v], 0.0, 0
        for i in range(len(model.parents)):
            if views.states[v, i] != 0:
                outlier[i] = 1.0 - views.trust[v, i]
                total, count = total + outlier[i], count + 1
            else:
                outlier[i] = rare + lasts * (outlier[i] - rare)
        faded = lasts * state.view_outlier_probability[v]
        state.view_outlier_probability[v] = total / count if count > 0 else faded


@inner_kernel
def update_followed_views(state, views, dt):  # type: ignore[no-untyped-def]
    """The probability that a joint of S* follows view v alone tends to β_v (1 - β_w), w the other view."""
    sooner, later = 1.0 - math.exp(-dt / _TOGETHER_SECONDS), 1.0 - math.exp(-dt / _ALONE_SECONDS)
    for i in range(len(state.known)):
        if views.trust[0, i] + views.trust[1, i] == 0.0:
            continue
        for v in range(2):
            alone = views.trust[v, i] * (1.0 - views.trust[1 - v, i])
            pace = later if alone > state.alone[v, i] else sooner
            state.alone[v, i] += pace * (alone - state.alone[v, i])


@inner_kernel
def add_other_place(state, views, positions, covariance, sigma):  # type: ignore[no-untyped-def]
    """Adds what the joints would be off if the view that S* does not follow were right.

        Σ ← Σ + Σ_v p_v d dᵀ,    d = y_v - b_v - S*

    with p_v the probability that view v alone is right and the prediction followed the other.

    Args:
        positions: (J, 3) S*, metres.
        covariance, sigma: (J, 3, 3) m², (J,) metres; changed.
    """
    for i in range(len(sigma)):
        for v in range(2):
            p = views.misled[v, i]
            if p < _LEAST_MISLED:
                continue
            measured, offset, square = views.positions[v, i], state.offsets[v, i], 0.0
            for r in range(3):
                d = measured[r] - offset[r] - positions[i, r]
                square += d * d
                for c in range(3):
                    covariance[i, r, c] += p * d * (measured[c] - offset[c] - positions[i, c])
            sigma[i] = math.sqrt(sigma[i] * sigma[i] + p * square)
