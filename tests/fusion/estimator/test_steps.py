"""Each step of the estimator against a plain reference: matrices, enumeration, dense solutions."""

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.linalg import null_space
from scipy.stats import multivariate_normal

from devices.simulated.tracking.tracker_errors import TrackerErrors
from fusion import joint_kinds
from fusion.body import AZURE_KINECT, KINECT_V2
from fusion.estimator import covariance, kalman, process, smoother
from fusion.estimator.arrays import Model, Solve, State, Views, new_model
from fusion.estimator.bones import joint_covariances
from fusion.estimator.constants import Constants
from fusion.estimator.measurements import evidence, offsets, outliers, views
from fusion.facing.model import new_facing_model
from fusion.joint_kinds import KINDS, by_joint, kind_of, limbs, of_kind
from fusion.support.array_fields import new_arrays
from recordings.fusing.view_events import ViewEvents
from tests.helpers.interpreted import interpreted
from tests.helpers.two_views import A_FROM_B, standing

BODY = KINECT_V2
J = len(BODY)
DT = 1.0 / 30.0
NO_TRACE = new_arrays(smoother.Trace, T=0, J=J)
ROUNDING = 1e-10  # of quantities of the order of 1 after some hundred operations in double precision


@dataclass(frozen=True)
class Scene:
    model: Model
    state: State
    views: Views
    solve: Solve
    random: np.random.Generator


@pytest.fixture
def scene():
    """A standing person whom both views report with errors, and a filter that knows all joints."""
    random = np.random.default_rng(7)
    model = new_model(BODY, BODY.nominal_lengths, A_FROM_B)
    state, seen = new_arrays(State, J=J), new_arrays(Views, J=J)
    truth = standing(BODY)
    state.positions[:] = truth + random.normal(0.0, 0.01, (J, 3))
    state.velocities[:] = random.normal(0.0, 0.3, (J, 3))
    for i in range(J):
        root = random.normal(0.0, (0.01, 0.2), (2, 2))
        P = root @ root.T + np.diag((1e-5, 1e-3))
        state.variances[i] = P[0, 0], P[0, 1], P[1, 1]
        for v in range(2):
            root = random.normal(0.0, 0.02, (3, 3))
            seen.slow[v, i] = root @ root.T + 1e-5 * np.eye(3)
        root = random.normal(0.0, 0.02, (3, 3))
        state.shared_error[i] = root @ root.T + 1e-5 * np.eye(3)
    state.known[:] = True
    state.offsets[:] = random.normal(0.0, 0.02, (2, J, 3))
    state.offset_variances[:] = random.uniform(1e-5, 1e-3, (2, J))
    state.outlier_probability[:] = random.uniform(0.0, 0.6, (2, J))
    state.alone[:] = random.uniform(0.1, 0.5, (2, J))
    state.view_outlier_probability[:] = 0.1, 0.3
    seen.positions[:] = truth + random.normal(0.0, 0.03, (2, J, 3))
    seen.states[:] = random.integers(0, 3, (2, J))
    seen.fast[:] = random.uniform(1e-5, 1e-4, (2, J))
    seen.trust[:] = np.where(seen.states > 0, random.uniform(0.1, 1.0, (2, J)), 0.0)
    seen.delays[1] = 0.004
    seen.side_doubt[:] = 0.1, 0.4
    return Scene(model, state, seen, new_arrays(Solve, J=J), random)


def innovations(scene):
    s, w = scene.state, scene.views
    return w.positions - s.offsets - s.positions - s.velocities * w.delays[:, None, None]


def covariance_of(variances):
    return np.array(((variances[0], variances[1]), (variances[1], variances[2])))


def test_every_joint_of_every_body_has_a_kind_of_its_own_name():
    kinds = {joint: kind_of(joint) for joint in (*AZURE_KINECT.joints, *KINECT_V2.joints)}
    assert set(kinds.values()) == set(KINDS)
    assert kinds["HANDTIP_LEFT"] == kinds["HandTipRight"] == "tip"
    assert kinds["SHOULDER_LEFT"] == "girdle"
    assert kinds["SpineShoulder"] == kinds["PELVIS"] == "spine"
    with pytest.raises(KeyError, match="TOE_LEFT"):
        kind_of("TOE_LEFT")


def test_a_joint_of_a_new_kind_is_in_the_groups_of_the_kind_it_resembles(monkeypatch):
    monkeypatch.setitem(joint_kinds.KINDS, "toe", "foot")
    monkeypatch.setitem(joint_kinds._KIND_OF_NAME, "toe", "toe")
    renamed = replace(AZURE_KINECT, joints=tuple(j.replace("FOOT", "TOE") for j in AZURE_KINECT.joints))
    toes = np.array(["TOE" in joint for joint in renamed.joints])
    assert of_kind(renamed, "foot")[toes].all()
    np.testing.assert_array_equal(limbs(renamed), limbs(AZURE_KINECT))
    np.testing.assert_array_equal(
        new_facing_model(renamed).heading_placed, new_facing_model(AZURE_KINECT).heading_placed
    )
    errors = TrackerErrors.of(renamed)
    np.testing.assert_array_equal(by_joint(renamed, errors.jitter), by_joint(AZURE_KINECT, errors.jitter))
    assert (
        ViewEvents(renamed)._limbs["left leg"].tolist()
        == ViewEvents(AZURE_KINECT)._limbs["left leg"].tolist()
    )
    monkeypatch.setitem(joint_kinds.KINDS, "toe", None)
    with pytest.raises(KeyError, match="toe"):
        by_joint(renamed, errors.jitter)


def test_the_prediction_is_that_of_a_kalman_filter_whose_velocity_relaxes_to_the_parents(scene):
    model, before = scene.model, scene.state
    k = model.constants
    x, v, P = before.positions.copy(), before.velocities.copy(), before.variances.copy()
    interpreted(kalman.predict)(model, before, scene.views, NO_TRACE, 0, DT)
    unseen = (scene.views.states == 0).all(axis=0)
    assert unseen.any()
    kept = math.exp(-DT / k.velocity_seconds)
    for i in BODY.order:
        parent = BODY.parents[i]
        relax = np.diag((1.0, kept if parent >= 0 else 1.0))
        if parent >= 0:
            v[i] = before.velocities[parent] + kept * (v[i] - before.velocities[parent])
        F = np.array(((1.0, DT), (0.0, 1.0)))
        trust = scene.views.trust[:, i].sum()
        unseen[i] |= trust == 0.0
        trusted = 1.0 if unseen[i] else min(trust, 1.0)
        own = v[i] - model.limb[i] * trusted * v[BODY.root]
        sd = model.acceleration[i] * (k.acceleration + k.acceleration_by_speed * np.linalg.norm(own))
        sd *= k.unseen_acceleration if unseen[i] else 1.0
        white = np.array(((DT**3 / 3.0, DT**2 / 2.0), (DT**2 / 2.0, DT)))
        expected = F @ relax @ covariance_of(P[i]) @ relax.T @ F.T + sd**2 / 30.0 * white
        np.testing.assert_allclose(covariance_of(before.variances[i]), expected, rtol=ROUNDING)
        np.testing.assert_allclose(before.positions[i], x[i] + DT * v[i], rtol=ROUNDING)


def test_slow_errors_grow_under_a_cover(scene):
    model, seen = scene.model, scene.views
    trunk, wrist = BODY.joint("SpineMid"), BODY.joint("WristLeft")
    seen.states[:, (trunk, wrist)] = 2
    seen.positions[0, wrist] = 1.1 * seen.positions[0, trunk] + 0.02
    interpreted(covariance.set_rays)(model, seen)
    interpreted(covariance.find_covers)(model, seen)
    interpreted(covariance.set_covariances)(model, scene.state, seen)
    k = model.constants
    sensors = np.zeros(3), A_FROM_B.translation
    covered = 0
    for v in range(2):
        for i in np.flatnonzero(seen.states[v]):
            ray = seen.positions[v, i] - sensors[v]
            depth = float(np.linalg.norm(ray))
            ray /= depth
            best = math.inf
            for j in np.flatnonzero(seen.states[v]):
                other = seen.positions[v, j] - sensors[v]
                if not BODY.linked[i, j] and other @ ray <= depth:
                    best = min(best, float(np.linalg.norm(other * depth / (other @ ray) - ray * depth)))
            factor = min(1.0 + (k.near / (best + 1e-3)) ** k.near_power, k.near_limit)
            covered += factor > 2.0
            expected = (k.slow_scale * model.slow[i]) ** 2 * factor
            expected *= k.inferred_slow**2 if seen.states[v, i] == 1 else 1.0
            np.testing.assert_allclose(seen.slow[v, i], expected * np.eye(3), rtol=1e-9, atol=1e-15)
    assert covered > 0


def test_trust_is_the_posterior_over_all_hypotheses(scene):
    model, state, seen = scene.model, scene.state, scene.views
    seen.states[:] = np.where(seen.states == 0, 2, seen.states)
    seen.states[0, 3] = seen.states[1, 5] = 0
    e = innovations(scene)
    interpreted(outliers.outlier_probabilities)(model, state, seen, DT)
    k = model.constants
    uniform = k.outlier_side**-3
    assert (seen.trust[:, 6:] < 0.5).any()
    assert (seen.trust[:, 6:] > 0.5).any()
    for i in range(J):
        prior = []
        for v in range(2):
            rare = k.outlier if seen.states[v, i] == 2 else k.inferred_outlier
            p = rare + max(k.outlier_lasts - rare, 0.0) * max(
                state.outlier_probability[v, i], state.view_outlier_probability[v]
            )
            doubted = min(seen.side_doubt[v], 0.99) if model.mirror[i] != i else 0.0
            prior.append(max(p, doubted))
        noise = seen.fast[:, i] + state.offset_variances[:, i]
        total, good = 0.0, np.zeros(2)
        here = [v for v in range(2) if seen.states[v, i] > 0]
        for hypothesis in range(2 ** len(here)):
            right = [v for n, v in enumerate(here) if hypothesis >> n & 1]
            weight = 1.0
            for v in here:
                weight *= 1.0 - prior[v] if v in right else prior[v] * uniform
            if right:  # joint density of all right measurements, whose common part is the prediction
                S = np.kron(
                    np.full((len(right),) * 2, state.variances[i, 0]) + np.diag(noise[right]), np.eye(3)
                )
                weight *= multivariate_normal.pdf(e[right, i].ravel(), cov=S)
            total += weight
            good[right] += weight
        surprised = 0.0
        if len(here) == 2:
            d = multivariate_normal.pdf(e[0, i] - e[1, i], cov=noise.sum() * np.eye(3))
            surprised = k.surprise * uniform * d
            if np.sum((e[0, i] + e[1, i]) ** 2) / 4.0 >= 3.0 * state.variances[i, 0]:
                surprised *= (1.0 - prior[0]) * (1.0 - prior[1])
            total += surprised
            good += surprised
            np.testing.assert_allclose(seen.surprise[i], surprised / total, rtol=1e-7, atol=1e-12)
            misled = np.zeros(2)  # view v alone is right, and the prediction followed the other, w
            for v, w in ((0, 1), (1, 0)):
                S = (state.variances[i, 0] + noise[w]) * np.eye(3)
                near = multivariate_normal.pdf(e[w, i], cov=S)
                misled[v] = (1.0 - prior[v]) * prior[w] * state.alone[w, i] * near * uniform
            expected = misled / (total + misled.sum())
            np.testing.assert_allclose(seen.misled[:, i], expected, rtol=1e-7, atol=1e-12)
        np.testing.assert_allclose(seen.trust[:, i], good / total, rtol=1e-7, atol=1e-12)


def test_sigma_holds_the_place_in_the_view_that_is_not_followed(scene):
    state, seen, i = scene.state, scene.views, BODY.joint("WristLeft")
    seen.states[:, i], seen.trust[:, i] = 2, (1.0, 0.0)
    for _ in range(60):  # S* follows A alone
        interpreted(outliers.update_followed_views)(state, seen, DT)
    np.testing.assert_allclose(state.alone[:, i], (1.0, 0.0), atol=0.01)
    state.offsets[:] = state.velocities[:] = state.outlier_probability[:] = 0.0
    seen.log_odds[:] = seen.side_doubt[:] = 0.0
    state.view_outlier_probability[:] = 0.3
    seen.positions[0, i] = state.positions[i]
    d = np.array((0.2, -0.1, 0.05))
    seen.positions[1, i] = state.positions[i] + d
    interpreted(outliers.outlier_probabilities)(scene.model, state, seen, DT)
    covariance, sigma = np.tile(1e-4 * np.eye(3), (J, 1, 1)), np.full(J, np.sqrt(3e-4))
    interpreted(outliers.add_other_place)(state, seen, state.positions, covariance, sigma)
    p = seen.misled[1, i]
    assert 0.3 < p < 0.7  # nothing else speaks for either view
    np.testing.assert_allclose(covariance[i], 1e-4 * np.eye(3) + p * np.outer(d, d), rtol=1e-9)
    np.testing.assert_allclose(sigma**2, np.trace(covariance, axis1=1, axis2=2), rtol=1e-9)


def test_a_surprise_lets_both_views_through(scene):
    state, seen, i = scene.state, scene.views, 7
    seen.states[:, i] = 2
    state.offsets[:] = 0.0
    state.outlier_probability[:] = state.view_outlier_probability[:] = 0.0
    seen.delays[:] = seen.side_doubt[:] = 0.0
    state.variances[i] = 1e-4, 1e-3, 0.1
    for v in range(2):
        seen.positions[v, i] = state.positions[i] + (0.3, 0.2, 0.0)
    before = state.variances[i].copy()
    interpreted(outliers.outlier_probabilities)(scene.model, state, seen, DT)
    interpreted(process.inflate_on_surprise)(scene.model, state, seen, NO_TRACE, 0, DT)
    assert seen.surprise[i] > 0.95
    assert (seen.trust[:, i] > 0.95).all()
    g = np.array((1.0, 0.5 / DT))
    expected = covariance_of(before) + seen.surprise[i] * 0.13 / 3.0 * np.outer(g, g)
    np.testing.assert_allclose(covariance_of(state.variances[i]), expected, rtol=ROUNDING)


def test_measurements_are_taken_in_as_information(scene):
    state, seen = scene.state, scene.views
    x, v, P = state.positions.copy(), state.velocities.copy(), state.variances.copy()
    seen.delays[:] = 0.0
    interpreted(kalman.kalman_update)(scene.model, state, seen)
    for i in range(J):
        information = np.linalg.inv(covariance_of(P[i]))
        b = information @ np.stack((x[i], v[i]))
        for s in range(2):
            if seen.trust[s, i] > 0.0:
                w = seen.trust[s, i] / (seen.fast[s, i] + state.offset_variances[s, i])
                information = information + np.diag((w, 0.0))
                b[0] += w * (seen.positions[s, i] - state.offsets[s, i])
        expected = np.linalg.solve(information, b)
        np.testing.assert_allclose(state.positions[i], expected[0], rtol=1e-8)
        np.testing.assert_allclose(state.velocities[i], expected[1], rtol=1e-6, atol=1e-8)
        np.testing.assert_allclose(covariance_of(state.variances[i]), np.linalg.inv(information), rtol=1e-6)


def test_the_difference_of_the_views_is_shared_by_covariance(scene):
    state, seen = scene.state, scene.views
    before, variances, d = state.offsets.copy(), state.offset_variances.copy(), innovations(scene)
    interpreted(offsets.update_offsets)(scene.model, state, seen, scene.solve)
    changed = 0
    for i in range(J):
        trust = seen.trust[0, i] * seen.trust[1, i]
        both = variances[:, i].sum()
        gain = trust * both / (both + seen.fast[:, i].sum())
        V = [seen.slow[v, i] / np.trace(seen.slow[v, i]) * variances[v, i] for v in range(2)]
        share = V[0] @ np.linalg.solve(V[0] + V[1], d[0, i] - d[1, i])
        rest = d[0, i] - d[1, i] - share
        np.testing.assert_allclose(state.offsets[0, i], before[0, i] + gain * share, atol=1e-12)
        np.testing.assert_allclose(state.offsets[1, i], before[1, i] - gain * rest, atol=1e-12)
        changed += trust > 0.0
    assert 3 < changed < J


def test_a_joint_begins_at_the_mean_by_information(scene):
    state, seen = scene.state, scene.views
    state.known[:] = False
    interpreted(kalman.start_joints)(scene.model, state, seen, scene.solve)
    for i in range(J):
        here = [v for v in range(2) if seen.states[v, i] > 0]
        assert state.known[i] == bool(here)
        if not here:
            continue
        W = [np.linalg.inv(seen.slow[v, i]) for v in here]
        M = np.linalg.inv(sum(W))
        mean = M @ sum(w @ seen.positions[v, i] for w, v in zip(W, here, strict=True))
        np.testing.assert_allclose(state.positions[i], mean, rtol=1e-9)
        np.testing.assert_allclose(state.shared_error[i], M, rtol=1e-7)


def test_a_skeleton_that_is_too_large_is_brought_to_its_size(scene):
    state, seen = scene.state, scene.views
    model = scene.model._replace(constants=Constants.of(AZURE_KINECT))
    truth, root = standing(BODY), BODY.root
    seen.states[:] = 2
    for _ in range(15):
        seen.positions[0] = truth[root] + 1.04 * (truth - truth[root])
        seen.positions[1] = truth[root] + 0.97 * (truth - truth[root])
        interpreted(views.remove_scales)(model, state, seen, DT)
    # Kalman's gain leaves a share of about noise / (noise + variance) / 15 of a scale
    np.testing.assert_allclose(state.scales, (0.04, -0.03), rtol=0.06)
    np.testing.assert_allclose(seen.positions, [truth, truth], atol=0.003)
    # where too few bones are tracked to measure it, the scale that is known is removed
    seen.states[:] = 1
    seen.positions[0] = truth[root] + 1.04 * (truth - truth[root])
    interpreted(views.remove_scales)(model, state, seen, DT)
    assert state.scales[0] > 0.03
    left = 1.04 / (1.0 + state.scales[0])
    np.testing.assert_allclose(seen.positions[0], truth[root] + left * (truth - truth[root]), atol=1e-9)


def test_covariances_are_those_of_the_joints_that_keep_their_bones(scene):
    solve = scene.solve
    model = scene.model._replace(bone_lengths=np.full(J, 9.0))  # no joint is as uncertain as its bone is long
    solve.positions[:] = standing(BODY)
    for i in range(J):
        solve.information[i] = np.linalg.inv(scene.state.shared_error[i])
    solve.information[4] = 0.0  # it was never seen
    found, sigma = np.zeros((J, 3, 3)), np.zeros(J)
    interpreted(joint_covariances)(model, solve, found, sigma)
    W, constraints = np.zeros((3 * J, 3 * J)), []
    for i in range(J):
        W[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = solve.information[i] + np.eye(3)  # within a metre
        parent = BODY.parents[i]
        if parent >= 0:
            row = np.zeros(3 * J)
            bone = solve.positions[i] - solve.positions[parent]
            row[3 * i : 3 * i + 3], row[3 * parent : 3 * parent + 3] = bone, -bone
            constraints.append(row)
    Z = null_space(np.array(constraints))
    dense = Z @ np.linalg.inv(Z.T @ W @ Z) @ Z.T
    for i in range(J):
        block = dense[3 * i : 3 * i + 3, 3 * i : 3 * i + 3]
        np.testing.assert_allclose(found[i], scene.model.constants.spread**2 * block, rtol=1e-6, atol=1e-12)
        assert sigma[i] == pytest.approx(math.sqrt(np.trace(found[i])))


@given(
    shares=arrays(float, J, elements=st.floats(0.01, 1.0)),
    lengths=arrays(float, J, elements=st.floats(0.01, 1.0)),
)
def test_no_joint_is_more_uncertain_than_its_bone_allows(shares, lengths):
    """And what its bone does not limit is as uncertain as without that limit."""
    model = new_model(BODY, lengths, A_FROM_B)
    found, free = (np.zeros((J, 3, 3)) for _ in range(2))
    sigma, without = np.zeros(J), np.zeros(J)
    solve = new_arrays(Solve, J=J)
    solve.positions[:] = standing(BODY)
    solve.information[:] = np.eye(3) / shares[:, None, None] ** 2
    interpreted(joint_covariances)(model, solve, found, sigma)
    interpreted(joint_covariances)(model._replace(bone_lengths=np.full(J, 99.0)), solve, free, without)
    for i in BODY.order:
        parent = BODY.parents[i]
        most = math.hypot(sigma[parent], math.sqrt(2.0) * lengths[i]) if parent >= 0 else math.inf
        assert sigma[i] == pytest.approx(min(without[i], most), rel=1e-9)
        assert np.linalg.eigvalsh(found[i])[0] > 0.0
        assert math.sqrt(np.trace(found[i])) == pytest.approx(sigma[i], rel=1e-9)


def evidence_of(scene):
    scene.views.log_odds[:] = 0.0
    interpreted(evidence.other_limb_evidence)(scene.model, scene.views)
    return scene.views.log_odds


@given(
    moved=arrays(float, (2, J, 3), elements=st.floats(-0.5, 0.5)),
    errors=arrays(float, (2, J), elements=st.floats(-1.0, 20.0)),
)
def test_evidence_of_the_other_limb_is_symmetric_and_never_for_a_joint(moved, errors):
    """And the less, the worse the bones of the view that has the joint elsewhere."""
    seen = new_arrays(Views, J=J)
    seen.states[:], seen.positions[:] = 2, standing(BODY) + moved
    scene = Scene(new_model(BODY, BODY.nominal_lengths, A_FROM_B), None, seen, None, None)
    most = evidence_of(scene).copy()
    seen.length_errors[:] = errors
    told = evidence_of(scene).copy()
    assert (told <= 0.0).all()
    assert (told >= most).all()
    assert (most >= -scene.model.constants.other_limb_limit).all()
    assert (told == most)[errors[::-1] <= scene.model.constants.length_limit].all()
    assert (told[:, ~scene.model.limb] == 0.0).all()
    seen.positions[:], seen.length_errors[:] = seen.positions[::-1].copy(), errors[::-1]
    np.testing.assert_allclose(evidence_of(scene), told[::-1], atol=1e-12)
    seen.positions[:] = seen.positions[:, BODY.mirror].copy()
    seen.length_errors[:] = seen.length_errors[:, BODY.mirror].copy()
    np.testing.assert_allclose(evidence_of(scene), told[::-1, BODY.mirror], atol=1e-12)


def test_a_hand_on_the_other_hand_is_doubted_and_hands_that_touch_are_not():
    seen = new_arrays(Views, J=J)
    seen.states[:], seen.positions[:] = 2, standing(BODY)
    scene = Scene(new_model(BODY, BODY.nominal_lengths, A_FROM_B), None, seen, None, None)
    left, right = BODY.joint("WristLeft"), BODY.joint("WristRight")
    assert not evidence_of(scene).any()
    seen.positions[1, left] = seen.positions[1, right] + 0.05
    told = evidence_of(scene)
    assert told[1, left] == -scene.model.constants.other_limb_limit
    told[1, left] = 0.0
    assert (told > -0.5).all()
    seen.positions[0, left] = seen.positions[0, right] - 0.02
    assert (evidence_of(scene) > -1.0).all()
