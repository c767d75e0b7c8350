"""The facing filter against plain numpy references: one frame, smoothing, live and sequence."""

from copy import deepcopy
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.stats import norm

from fusion.body import KINECT_V2
from fusion.facing import whole_body
from fusion.facing.filter import update_facing
from fusion.facing.model import HEADINGS, TAPS, FacingConstants, FacingState, new_facing_model
from fusion.support.array_fields import new_arrays
from tests.helpers.interpreted import interpreted
from tests.helpers.labelled_views import simulated_views, step


def table(values, cosine):
    return np.interp(-cosine, (-1.0, -0.5, 0.0, 0.5, 1.0), values)


def off_line(at, i, j, k):
    line = at[k] - at[i]
    offset = at[j] - at[i]
    return offset - line * (offset @ line) / (line @ line)


def reference_likelihood(c, views, k, state):
    """(N, 2, 2) the equations of ``whole_body.py``: all is tracked; axis and speeds are the state's."""
    body, up, front = views.body, state.memory.axis, state.memory.headings
    speed = np.linalg.norm(state.memory.velocity)
    walks = (1.0 + (np.linalg.norm(state.memory.axis_velocity) / 0.7) ** 2) ** -2
    common = walks * c.motion_weight * min(speed, c.motion_cap) ** 4 * (front @ state.memory.velocity) / speed
    axis = []
    trunk = [body.joint(n + side) for n in ("Shoulder", "Hip") for side in ("Left", "Right")]
    root = 0.5 * (views.a[k] + views.b_in_a[k])[trunk].mean(axis=0)
    for view, at, sensor in ((0, views.a[k], np.zeros(3)), (1, views.b_in_a[k], views.sensor_b)):
        toward = sensor - root - (sensor - root) @ up * up
        cosine = front @ toward / np.linalg.norm(toward)
        cues = []
        for side in ("Left", "Right"):
            hip, knee, ankle, shoulder, elbow, wrist = (
                body.joint(n + side) for n in ("Hip", "Knee", "Ankle", "Shoulder", "Elbow", "Wrist")
            )
            cues.append((0.5, off_line(at, hip, knee, ankle), c.knee_mean, c.knee_sigma))
            cues.append((0.5, -off_line(at, shoulder, elbow, wrist), c.elbow_mean, c.elbow_sigma))
        cues.append((1.0, at[body.joint("Head")] - at[body.joint("Neck")], c.head_mean, c.head_sigma))
        weight = c.cue_weight * max(c.still_weight, min(1.0, state.memory.speed[view] / c.moving_speed))
        for share, vector, mean, sigma in cues:
            off = (front @ vector - table(mean, cosine)) / table(sigma, cosine)
            most = np.where((off > 0.0) & (mean is c.knee_mean), c.bent_floor, c.cue_floor)
            cost = 0.5 * off**2
            log_sigma = table(tuple(np.log(sigma)), cosine)
            common = common - weight * share * (cost / (1.0 + cost / most) + log_sigma)
        kappa = table(tuple(np.array(c.axis_sigma) ** -2.0), cosine)
        reported = np.radians(table(c.reported_angle, cosine))[:, None]
        ahead = toward / np.linalg.norm(toward)
        aside = front - cosine[:, None] * ahead
        aside /= np.linalg.norm(aside, axis=1, keepdims=True)
        shown = np.cos(reported) * ahead + np.sin(reported) * aside
        folded = front - 2.0 * cosine[:, None] * ahead
        both = []
        for mirrored in (False, True):
            total = 0.0
            for name in ("Shoulder", "Hip"):
                left = at[body.joint(name + "Left")] - at[body.joint(name + "Right")]
                flat = np.cross(left, up)
                width = np.linalg.norm(flat)
                nominal = 2.0 * body.nominal_lengths[body.joint(name + "Left")]
                trust = min(1.0, width / (0.7 * nominal)) ** 2
                density = 0.0
                parts = ((1.0 - c.folded, -front), (c.folded, folded)) if mirrored else (
                    (c.unbiased, front), (1.0 - c.unbiased, shown))  # fmt: skip
                for share, expected in parts:
                    cost = kappa * (1.0 - expected @ flat / width)
                    density = density + share * np.exp(-cost / (1.0 + cost / c.axis_floor))
                total = total + trust * (0.5 * np.log(kappa) + np.log(density))
            both.append(c.axis_weight * total)
        axis.append(both)
    (a_right, a_wrong), (b_right, b_wrong) = axis
    limbs = [(body.joint(f"{n}Left"), body.joint(f"{n}Right")) for n in ("Elbow", "Knee")]
    a, b = views.a[k], views.b_in_a[k]
    alike, other = (
        -c.limb_weight * sum(apart(c, a[i] - b[j]) for i, j in pairs)
        for pairs in ([(j, j) for limb in limbs for j in limb], [*limbs, *(limb[::-1] for limb in limbs)])
    )
    return np.array(
        [[common + a_right + b_right + alike, common + a_right + b_wrong + other],
         [common + a_wrong + b_right + other, common + a_wrong + b_wrong + alike]]
    ).transpose(2, 0, 1)  # fmt: skip


def apart(c, difference):
    cost = 0.5 * difference @ difference / c.limb_sigma**2
    return cost / (1.0 + cost / c.limb_floor)


def reference_prediction(before, state):
    """(N, 2, 2) by dense matrices: turning, then each view's probability of an exchange."""
    n = np.arange(HEADINGS)
    difference = (n[:, None] - n[None] + HEADINGS // 2) % HEADINGS - HEADINGS // 2
    reach = int(state.evidence.reach[0])
    turning = np.where(
        np.abs(difference) <= reach, state.evidence.turning[np.clip(difference, -TAPS, TAPS) + TAPS], 0.0
    )
    turned = np.einsum("nm,mxy->nxy", turning, before)
    matrices = []
    for view in range(2):
        to, fro = (
            state.evidence.rates[view] * state.evidence.shares[view],
            state.evidence.rates[view] * (1.0 - state.evidence.shares[view]),
        )
        odds = state.evidence.odds[view]
        to, fro = (p * odds / (1.0 - p + p * odds) for p in (to, fro))
        matrices.append(np.array([[1.0 - to, fro], [to, 1.0 - fro]]))  # (after, before, heading)
    return np.einsum("xpn,yqn,npq->nxy", *matrices, turned)


def test_a_frame_is_what_the_equations_say():
    views = simulated_views("walk", tracker="perfect", seconds=8.0)
    constants = FacingConstants.of(KINECT_V2)
    model, state = new_facing_model(KINECT_V2, constants), new_arrays(FacingState, J=len(KINECT_V2))
    for k in range(240):
        before = state.belief.probabilities.copy()
        step(model, state, views, k)
        if k < 110 or k % 5:
            continue
        predicted = reference_prediction(before, state)
        np.testing.assert_allclose(state.belief.predicted, predicted, atol=1e-14)
        likelihood = reference_likelihood(constants, views, k, state)
        np.testing.assert_allclose(state.evidence.likelihood, likelihood, atol=1e-9)
        belief = predicted * np.exp(likelihood - likelihood.max())
        belief /= belief.sum()
        np.testing.assert_allclose(state.belief.probabilities, np.maximum(belief, constants.leak), atol=1e-11)
        assert state.belief.predicted.sum() == pytest.approx(1.0, abs=1e-6)  # leaks: 144 · 1e-9


def test_people_turn_as_the_page_of_the_method_says():
    """Straight on by 3° in 1/30 s, while turning by 13°; in 0.1 s √3 times as far. Taps are 10° apart."""
    constants, state = FacingConstants(), new_arrays(FacingState, J=len(KINECT_V2))
    interpreted(whole_body.set_turning)(constants, state, 0.1)
    angles = 10.0 * np.arange(-TAPS, TAPS + 1)
    straight, turns = (norm.pdf(angles, scale=np.sqrt(3.0) * degrees) for degrees in (3.0, 13.0))
    share = constants.turning_share
    expected = (1.0 - share) * straight / straight.sum() + share * turns / turns.sum()
    np.testing.assert_allclose(
        state.evidence.turning, expected, atol=0.01
    )  # the page rounds to whole degrees


def test_smoothing_is_the_forward_backward_algorithm():
    views = simulated_views("turn", seconds=6.0)
    model, state = new_facing_model(KINECT_V2), new_arrays(FacingState, J=len(KINECT_V2))
    kept = []
    count = 24
    part = replace(views, **{name: getattr(views, name)[60 : 60 + count] for name in (
        "time_ns", "a", "states_a", "b_in_a", "states_b", "truth")})  # fmt: skip
    labels = part.relabel()
    seconds = np.diff(part.time_ns, prepend=part.time_ns[0]) * 1e-9
    stale = [np.r_[False, (np.diff(x, axis=0) == 0.0).all(axis=(1, 2))] for x in (part.a, part.b_in_a)]
    for k in range(count):
        update_facing(model, state, part.reported_at(k, (stale[0][k], stale[1][k])), seconds[k])
        kept.append(deepcopy((state.belief.probabilities, state.evidence.likelihood, state)))
    beta = np.ones((HEADINGS, 2, 2))
    for k in range(count - 1, -1, -1):
        smoothed = kept[k][0] * beta
        smoothed /= smoothed.sum()
        expected = smoothed[:, 1, :].sum(), smoothed[:, :, 1].sum()
        np.testing.assert_allclose(labels.mirrored[k], expected, atol=1e-4)  # float32 history over 24 frames
        weighted = beta * np.exp(kept[k][1] - kept[k][1].max())
        # The transpose of the prediction: the message to each earlier state.
        beta = np.zeros_like(beta)
        if k:
            for n in range(HEADINGS):
                for x in range(2):
                    for y in range(2):
                        one = np.zeros_like(beta)
                        one[n, x, y] = 1.0
                        beta[n, x, y] = np.sum(reference_prediction(one, kept[k][2]) * weighted)
            beta /= beta.max()


def test_live_and_sequence_agree_bit_for_bit_and_repeat():
    views = simulated_views("walk", seconds=8.0)
    one, other = views.relabel(smooth=False), views.relabel(smooth=False)
    model, state = new_facing_model(KINECT_V2), new_arrays(FacingState, J=len(KINECT_V2))
    for name in ("codes", "heading", "doubt", "mirrored"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    seconds = np.diff(views.time_ns, prepend=views.time_ns[0]) * 1e-9
    stale = [
        np.r_[False, [np.array_equal(*two, equal_nan=True) for two in pairwise(x)]]
        for x in (views.a, views.b_in_a)
    ]
    for k in range(len(seconds)):
        update_facing(model, state, views.reported_at(k, (stale[0][k], stale[1][k])), seconds[k])
        np.testing.assert_array_equal(state.result.codes, one.codes[k])
        heading = (state.result.confidence[0] * state.result.facing).astype(np.float32)
        np.testing.assert_array_equal(heading, one.heading[k])
        np.testing.assert_array_equal(state.result.mirrored.astype(np.float32), one.mirrored[k])
