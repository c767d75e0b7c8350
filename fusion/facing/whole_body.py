"""The hidden Markov model of the whole body: heading, A mirrored, B mirrored.

The state is (θ, m_A, m_B) with θ one of N headings in the plane normal to the body's axis
(:mod:`fusion.facing.evidence`) and m_v whether view v reports the person with left and right exchanged. One
step is

    p(θ', m') ∝ L(θ', m'_A, m'_B) Σ P(m'_A | m_A, θ') P(m'_B | m_B, θ') P(θ' | θ) p(θ, m_A, m_B).

**Turning**, P(θ' | θ): a mixture of two wrapped normal distributions, one for a person who walks straight
ahead and one for a person who turns. It is the prior on turning speed.

**Exchanging**, P(m' | m, θ): a tracker that takes a back for a front exchanges the labels of a person whose
back is turned. The share of mirrored frames s is a function of the cosine between the heading and the
direction to the sensor, and is reached with the time constant τ: the probability of becoming mirrored in dt
is r s, that of ceasing is r (1 − s), with r = 1 − exp(−dt/τ). That is the price of an exchange. If both views
are exchanged at once, both prices count. Continuity of the labels changes the odds
(:func:`fusion.facing.evidence.exchange_odds`).

**Evidence**, log L, with f the heading's unit vector; every term has a weight, because successive frames are
correlated. It is in proportion to the time since the last frame, and at most 1:

* axes (only these depend on m): −β(κ (1 − cos)) + ½ log κ, a von Mises density of the angle between the axis
  and the one that the tracker reports for f; κ = 1/σ² from the table. A Kinect v2 reports an angle to the
  sensor that is smaller than the true one (``reported_angle``), with probability 1 − ``unbiased``. A mirrored
  view reports −f, or, with probability ``folded``, f with its component towards the sensor reversed. Both
  densities are mixtures;
* cues: −β(½ ((x − μ)/σ)²) − log σ, a normal density of x = cue · f, with μ and σ by the cosine to the sensor;
  β(c) = c / (1 + c / most) limits the effect of a single outlier, and more so that of a bent knee;
* agreement: elbows and knees of both views, as labelled and with one view exchanged
  (:func:`fusion.facing.evidence.agreement`);
* motion: w |v|⁴ cos(v, f), with |v| capped: people walk backwards slowly, hardly ever fast.
"""

from __future__ import annotations

import math

from fusion.compiling.kernels import inner_kernel
from fusion.facing.evidence import agreement, bounded
from fusion.facing.model import FRAME_SECONDS, TAPS

_INTERVALS = 4  # of the tables over the cosine
_TURNING_RATE = 0.7  # rad/s of the body's axis: a person who falls or bows faster does not walk
_MOST_FRAMES = 6.0  # a longer time than 0.2 s without evidence of motion gives a frame no larger weight


@inner_kernel
def mirrored_probability(constants, cosine):  # type: ignore[no-untyped-def]
    """Share of frames that a tracker reports mirrored: a logistic step from front to back."""
    rise = 1.0 + math.exp((cosine - constants.mirrored_centre) / constants.mirrored_width)
    return constants.mirrored_front + (constants.mirrored_back - constants.mirrored_front) / rise


@inner_kernel
def prior_belief(state):  # type: ignore[no-untyped-def]
    """The prediction for a new person: any heading, each view mirrored with its share there."""
    count = len(state.memory.headings)
    for n in range(count):
        a, b = state.evidence.shares[0, n], state.evidence.shares[1, n]
        state.belief.predicted[n, 0, 0] = (1.0 - a) * (1.0 - b) / count
        state.belief.predicted[n, 0, 1] = (1.0 - a) * b / count
        state.belief.predicted[n, 1, 0] = a * (1.0 - b) / count
        state.belief.predicted[n, 1, 1] = a * b / count


@inner_kernel
def cosine_to_sensor(state, view, f):  # type: ignore[no-untyped-def]
    """Cosine between a unit vector normal to the body's axis and the direction to the sensor."""
    s = state.evidence.toward[view]
    return f[0] * s[0] + f[1] * s[1] + f[2] * s[2]


@inner_kernel
def set_turning(constants, state, dt):  # type: ignore[no-untyped-def]
    """P(θ' | θ) for differences of up to ``reach`` headings: three deviations of a turning person."""
    step = 2.0 * math.pi / len(state.memory.headings)
    slow = constants.turning_sigma * math.sqrt(dt / FRAME_SECONDS) / step
    fast = constants.turning_sigma_fast * math.sqrt(dt / FRAME_SECONDS) / step
    reach = min(TAPS, math.ceil(3.0 * fast))
    state.evidence.reach[0] = reach
    slow_sum = fast_sum = 0.0
    for k in range(-reach, reach + 1):
        slow_sum += math.exp(-0.5 * (k / slow) ** 2)
        fast_sum += math.exp(-0.5 * (k / fast) ** 2)
    for k in range(-reach, reach + 1):
        straight = math.exp(-0.5 * (k / slow) ** 2) / slow_sum
        turns = math.exp(-0.5 * (k / fast) ** 2) / fast_sum
        share = constants.turning_share
        state.evidence.turning[k + TAPS] = (1.0 - share) * straight + share * turns


@inner_kernel
def exchanging(state, view, n):  # type: ignore[no-untyped-def]
    """The probabilities that a view becomes mirrored and that it ceases to be, with continuity."""
    rate, odds, share = state.evidence.rates[view], state.evidence.odds[view], state.evidence.shares[view, n]
    to, fro = rate * share, rate * (1.0 - share)
    return to * odds / (1.0 - to + to * odds), fro * odds / (1.0 - fro + fro * odds)


@inner_kernel
def predict(state, before, after):  # type: ignore[no-untyped-def]
    """Computes p(θ', m') before the frame's evidence, from ``before`` into ``after``."""
    count, reach = len(before), state.evidence.reach[0]
    for n in range(count):
        p00 = p01 = p10 = p11 = 0.0
        for k in range(TAPS - reach, TAPS + reach + 1):
            w, m = state.evidence.turning[k], n + k - TAPS
            m = m + count if m < 0 else (m - count if m >= count else m)
            p00 += w * before[m, 0, 0]
            p01 += w * before[m, 0, 1]
            p10 += w * before[m, 1, 0]
            p11 += w * before[m, 1, 1]
        to, fro = exchanging(state, 0, n)
        p00, p10 = p00 * (1.0 - to) + p10 * fro, p00 * to + p10 * (1.0 - fro)
        p01, p11 = p01 * (1.0 - to) + p11 * fro, p01 * to + p11 * (1.0 - fro)
        to, fro = exchanging(state, 1, n)
        after[n, 0, 0] = p00 * (1.0 - to) + p01 * fro
        after[n, 0, 1] = p00 * to + p01 * (1.0 - fro)
        after[n, 1, 0] = p10 * (1.0 - to) + p11 * fro
        after[n, 1, 1] = p10 * to + p11 * (1.0 - fro)


@inner_kernel
def retrodict(state, after, before, scratch):  # type: ignore[no-untyped-def]
    """The transpose of :func:`predict`, for smoothing: the evidence of later frames on the state before."""
    count, reach = len(after), state.evidence.reach[0]
    for n in range(count):
        to, fro = exchanging(state, 1, n)
        p00 = after[n, 0, 0] * (1.0 - to) + after[n, 0, 1] * to
        p01 = after[n, 0, 0] * fro + after[n, 0, 1] * (1.0 - fro)
        p10 = after[n, 1, 0] * (1.0 - to) + after[n, 1, 1] * to
        p11 = after[n, 1, 0] * fro + after[n, 1, 1] * (1.0 - fro)
        to, fro = exchanging(state, 0, n)
        scratch[n, 0, 0], scratch[n, 1, 0] = p00 * (1.0 - to) + p10 * to, p00 * fro + p10 * (1.0 - fro)
        scratch[n, 0, 1], scratch[n, 1, 1] = p01 * (1.0 - to) + p11 * to, p01 * fro + p11 * (1.0 - fro)
    for n in range(count):
        p00 = p01 = p10 = p11 = 0.0
        for k in range(TAPS - reach, TAPS + reach + 1):
            w, m = state.evidence.turning[k], n - k + TAPS
            m = m + count if m < 0 else (m - count if m >= count else m)
            p00 += w * scratch[m, 0, 0]
            p01 += w * scratch[m, 0, 1]
            p10 += w * scratch[m, 1, 0]
            p11 += w * scratch[m, 1, 1]
        before[n, 0, 0], before[n, 0, 1] = p00, p01
        before[n, 1, 0], before[n, 1, 1] = p10, p11


@inner_kernel
def log_likelihood(model, state, pair):  # type: ignore[no-untyped-def]
    """Writes the log-likelihood of the frame for every state; a stale view is no evidence."""
    k, stale = model.constants, pair.stale
    v, likelihood = state.memory.velocity, state.evidence.likelihood
    speed = math.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2)
    weight = k.motion_weight * min(state.evidence.frames[2], _MOST_FRAMES)
    turning = state.memory.axis_velocity
    rate = math.sqrt(turning[0] ** 2 + turning[1] ** 2 + turning[2] ** 2)
    weight /= (1.0 + (rate / _TURNING_RATE) ** 2) ** 2
    pace = weight * min(speed, k.motion_cap) ** 4 / max(speed, 1e-9)
    if stale[0] and stale[1]:
        pace = 0.0
    equal, other = agreement(model, state, pair) if not (stale[0] or stale[1]) else (0.0, 0.0)
    for n in range(len(state.memory.headings)):
        f = state.memory.headings[n]
        common = pace * (v[0] * f[0] + v[1] * f[1] + v[2] * f[2])
        axis_a = axis_b = 0.0
        for view in range(2):
            cosine = cosine_to_sensor(state, view, f)
            state.evidence.shares[view, n] = mirrored_probability(k, cosine)
            if stale[view]:
                continue
            common += _cue_evidence(model, state, view, f, cosine)
            straight, back = _axis_evidence(model, state, view, f, cosine)
            common += 0.5 * (straight + back)
            if view == 0:
                axis_a = 0.5 * (straight - back)
            else:
                axis_b = 0.5 * (straight - back)
        likelihood[n, 0, 0] = common + axis_a + axis_b + equal
        likelihood[n, 0, 1] = common + axis_a - axis_b + other
        likelihood[n, 1, 0] = common - axis_a + axis_b + other
        likelihood[n, 1, 1] = common - axis_a - axis_b + equal


@inner_kernel
def in_table(table, cosine):  # type: ignore[no-untyped-def]
    """A value of a table of :class:`fusion.facing.model.FacingConstants`."""
    node = 2.0 * (1.0 - max(-1.0, min(1.0, cosine)))
    i = min(int(node), _INTERVALS - 1)
    return table[i] + (node - i) * (table[i + 1] - table[i])


@inner_kernel
def _cue_evidence(model, state, view, f, cosine):  # type: ignore[no-untyped-def]
    """Sum over the view's cues of their log densities, if the person faces f."""
    total, k = 0.0, model.constants
    for row in range(5):
        trust = state.evidence.cue_trust[view, row]
        if trust > 0.0:
            kind = row // 2
            sigma = in_table(model.cue_sigma[kind], cosine)
            d = state.evidence.cues[view, row]
            z = (d[0] * f[0] + d[1] * f[1] + d[2] * f[2] - in_table(model.cue_mean[kind], cosine)) / sigma
            most = k.bent_floor if kind == 0 and z > 0.0 else k.cue_floor
            total -= trust * (bounded(0.5 * z * z, most) + in_table(model.cue_log[kind], cosine))
    still = max(k.still_weight, min(1.0, state.memory.speed[view] / k.moving_speed))
    return min(k.cue_weight * still * state.evidence.frames[view], 1.0) * total


@inner_kernel
def _axis_evidence(model, state, view, f, cosine):  # type: ignore[no-untyped-def]
    """Sum of the log densities of shoulder and hip axis if the person faces f: as they are, and mirrored."""
    straight = back = 0.0
    kappa, s = in_table(model.axis_kappa, cosine), state.evidence.toward[view]
    folded, most = model.constants.folded, model.constants.axis_floor
    beside = s[0] * s[0] + s[1] * s[1] + s[2] * s[2]  # 1 but where the sensor looks along the body
    # the reported direction for f is toward s + across f
    toward, across = 0.0, 1.0
    if folded > 0.0:
        angle = in_table(model.reported_angle, cosine)
        across = math.sin(angle) / math.sqrt(max(1.0 - cosine * cosine, 1e-12))
        toward = math.cos(angle) - across * cosine
    for girdle in range(2):
        trust = state.evidence.axis_trust[view, girdle]
        if trust > 0.0:
            g = state.evidence.axes[view, girdle]
            along = g[0] * f[0] + g[1] * f[1] + g[2] * f[2]
            nearing = g[0] * s[0] + g[1] * s[1] + g[2] * s[2]
            peak = 0.5 * math.log(kappa)
            as_shown, mirrored = bounded(kappa * (1.0 - along), most), bounded(kappa * (1.0 + along), most)
            if folded > 0.0:
                other = bounded(kappa * (1.0 - toward * nearing - across * along), most)
                as_shown = _mixture(as_shown, other, beside * (1.0 - model.constants.unbiased))
                other = bounded(kappa * (1.0 - along + 2.0 * cosine * nearing), most)
                mirrored = _mixture(mirrored, other, beside * folded)
            straight += trust * (peak - as_shown)
            back += trust * (peak - mirrored)
    weight = min(model.constants.axis_weight * state.evidence.frames[view], 1.0)
    return weight * straight, weight * back


@inner_kernel
def _mixture(cost, other, share):  # type: ignore[no-untyped-def]
    """The cost of a mixture of two densities; ``share`` is that of the other."""
    return -math.log((1.0 - share) * math.exp(-cost) + share * math.exp(-other))


@inner_kernel
def correct(state, leak):  # type: ignore[no-untyped-def]
    """Multiplies the prediction by the likelihood and normalises; no state falls below the leak."""
    best = -math.inf
    count = len(state.memory.headings)
    for n in range(count):
        for x in range(2):
            for y in range(2):
                best = max(best, state.evidence.likelihood[n, x, y])
    total = 0.0
    for n in range(count):
        for x in range(2):
            for y in range(2):
                p = state.belief.predicted[n, x, y] * math.exp(state.evidence.likelihood[n, x, y] - best)
                state.belief.probabilities[n, x, y] = p
                total += p
    for n in range(count):
        for x in range(2):
            for y in range(2):
                state.belief.probabilities[n, x, y] = max(state.belief.probabilities[n, x, y] / total, leak)
