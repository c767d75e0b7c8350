"""Evidence on outliers: bone lengths within a view, doubt about a whole view, and depth images."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fusion.body import BODIES, KINECT_V2
from fusion.estimator.arrays import Solve, State, Views, new_model
from fusion.estimator.constants import Constants
from fusion.estimator.duplex_fusion import DuplexFusion
from fusion.estimator.measurements import outliers
from fusion.estimator.measurements.evidence import depth_evidence, length_evidence, measure_surface
from fusion.facing.labels import Labels
from fusion.facing.model import ARMS, WHOLE, new_facing_model
from fusion.fuser import Fuser
from fusion.joint_kinds import kind_of
from fusion.pair_arrays import PairStacker
from fusion.setup import FuserSettings, FusionSetup
from fusion.skeleton import Skeleton, TrackingState
from fusion.support.array_fields import new_arrays
from fusion.witness import (
    EVIDENCE,
    FLESH,
    KNOTS,
    LARGEST,
    SURFACE_SD,
    JointEvidence,
    new_witness_model,
    weigh_witness,
)
from tests.helpers.interpreted import interpreted
from tests.helpers.laws import pairs_at
from tests.helpers.two_views import A_FROM_B, FRAME_NS, calibration_of, moving, noisy, pair_of, standing
from tests.helpers.witnesses import evidence_in

# --- Bone lengths within a view, and doubt about a whole view, as evidence on outliers.


BODY = KINECT_V2
J = len(BODY)
ROUNDING = 1e-9  # of a length in metres over length_error, after some operations in double precision


def two_views(random):
    """A standing person in both views, with errors of centimetres and of decimetres."""
    lengths = np.linalg.norm(standing(BODY) - standing(BODY)[BODY.parent_indices], axis=1)
    model = new_model(BODY, lengths, A_FROM_B)
    seen = new_arrays(Views, J=J)
    seen.positions[:] = standing(BODY) + random.normal(0.0, 0.01, (2, J, 3))
    far = random.random((2, J)) < 0.2
    seen.positions[far] += random.normal(0.0, 0.2, (int(far.sum()), 3))
    seen.states[:] = random.integers(0, 3, (2, J))
    seen.states[:, ::2] = 2
    seen.positions[seen.states == 0] = np.nan
    return model, seen


def test_the_worst_tracked_bone_at_a_joint_counts_against_it():
    random = np.random.default_rng(3)
    model, seen = two_views(random)
    image = random.normal(0.0, 1.0, (2, J))
    seen.log_odds[:] = image
    interpreted(length_evidence)(model, seen)
    k = model.constants
    costs = []
    for v in range(2):
        for i in range(J):
            bones = [(j, p) for j, p in enumerate(BODY.parents) if p >= 0 and i in (j, p)]
            errors = [
                abs(np.linalg.norm(seen.positions[v, j] - seen.positions[v, p]) - model.bone_lengths[j])
                / k.length_error
                for j, p in bones
                if seen.states[v, j] == seen.states[v, p] == 2
            ]
            costs.append(min(max(errors, default=0.0), k.length_limit))
            assert seen.log_odds[v, i] == pytest.approx(image[v, i] - costs[-1], abs=ROUNDING)
    assert max(costs) == k.length_limit, "some bones are decimetres off"
    assert 0.0 in costs, "some joints have no tracked bone"


def with_arm_near_trunk(skeleton, share):
    """The arm on its way, by this share, to a place beside the trunk where its joints are 2 cm apart."""
    at = skeleton.positions.astype(np.float64)
    for n, part in enumerate(("Elbow", "Wrist", "Hand", "HandTip", "Thumb")):
        there = at[BODY.joint("SpineMid")] + (0.15, 0.02 * n, 0.0)
        at[BODY.joint(f"{part}Right")] += share * (there - at[BODY.joint(f"{part}Right")])
    return Skeleton.of(BODY, at, skeleton.states, skeleton.time_ns)


def test_the_bones_tell_which_view_of_a_wrist_is_wrong():
    """No jump tells it: the arm slides away in B, a few centimetres per frame, while A is right.

    The bones bring at least a fifth; 29 % when this was written.
    """
    pairs = recording(90, 0.004)
    bad = [
        replace(p, b=with_arm_near_trunk(p.b, (t - 69) / 15)) if 70 <= t < 85 else p
        for t, p in enumerate(pairs)
    ]
    setup = FusionSetup(calibration_of(BODY))
    wrist = BODY.joint("WristRight")

    def moved(constants):
        found = []
        for some in (pairs, bad):
            fuser = Fuser(setup)
            fuser._fusion = DuplexFusion(setup, constants)
            frames = fuser.fuse_sequence(some, Labels.with_sides(np.zeros((len(some), 2))))
            found.append([frame.positions[wrist] for frame in frames])
        return float(np.linalg.norm(np.array(found[0]) - found[1], axis=1)[70:85].mean())

    default = Constants.of(BODY)
    assert moved(default) < 0.8 * moved(default._replace(length_limit=0.0))


def test_doubt_about_most_joints_of_a_view_is_doubt_about_the_others():
    model, state, seen = (
        two_views(np.random.default_rng(3))[0],
        new_arrays(State, J=J),
        new_arrays(Views, J=J),
    )
    seen.states[0] = 2
    seen.trust[0, : J - 5] = 0.0
    seen.trust[0, J - 5 :] = 1.0
    prior = interpreted(outliers.prior_outlier)
    lasts, frame = model.constants.outlier_lasts, 1.0 / 30.0
    before = prior(model, state, seen, 0, J - 1, lasts)
    interpreted(outliers.store_outlier_state)(model, state, seen, frame)
    assert state.view_outlier_probability[0] == pytest.approx((J - 5) / J)
    k = model.constants
    expected = k.outlier + (k.outlier_lasts - k.outlier) * (J - 5) / J
    assert before == pytest.approx(k.outlier)
    assert prior(model, state, seen, 0, J - 1, lasts) == pytest.approx(expected)
    seen.states[0] = 0
    interpreted(outliers.store_outlier_state)(model, state, seen, frame)
    assert state.view_outlier_probability[0] == pytest.approx(0.9 * (J - 5) / J), (
        "it fades while the view sees no one"
    )


# --- Depth images in the estimator: evidence, surface measurements, and no effect without an image.


FLOAT32 = 1e-6  # relative, or metres: an interpreted kernel computes some values in float32
LEFT, RIGHT = BODY.joint("WristLeft"), BODY.joint("WristRight")


def confirming():
    """The witness of a skeleton whose joints all agree with the image."""
    found = np.zeros((J, 4), dtype=np.float32)
    found[:, 0] = -new_witness_model(BODY).flesh
    found[:, 1] = 0.05
    return found


def witnessed(pair, a, b):
    return replace(pair, a=pair.a.with_witness(a), b=pair.b.with_witness(b))


def fused(pairs, method="duplex"):
    setup = FusionSetup(calibration_of(BODY), FuserSettings(method=method))
    return Fuser(setup).fuse_sequence(pairs, Labels.with_sides(np.zeros((len(pairs), 2))))


def recording(frames=60, sd=0.005):
    return pairs_at(np.arange(frames) * FRAME_NS, moving(BODY, frames), sd=sd, seed=1)


def same_bits(one, other):
    names = ("positions", "sigma", "covariance", "weights_a", "weights_b", "predicted")
    arrays = [(getattr(p, n), getattr(q, n)) for p, q in zip(one, other, strict=True) for n in names]
    return all(p is q if p is None else np.array_equal(p, q, equal_nan=True) for p, q in arrays)


def asked(code, witness):
    """Both views of one standing person with A's witness, after :func:`depth_evidence`."""
    model = new_model(BODY, BODY.nominal_lengths, A_FROM_B)
    pair = pair_of(BODY, standing(BODY), 0)
    views = new_arrays(Views, J=J)
    views.reported[0] = views.positions[0] = pair.a.positions
    views.reported[1] = views.positions[1] = A_FROM_B.apply(pair.b.positions.astype(np.float64))
    views.states[:] = TrackingState.TRACKED
    views.codes[0] = code
    pairs = PairStacker(BODY).of_pair(witnessed(pair, witness, None))
    interpreted(depth_evidence)(model, new_facing_model(BODY), views, pairs, 0)
    return model, views, pair.a


def test_an_image_without_readings_changes_no_bit():
    pairs = recording()
    nothing = np.full((J, 4), np.nan, dtype=np.float32)
    assert same_bits(fused(pairs), fused([witnessed(pair, nothing, nothing) for pair in pairs]))
    assert not same_bits(fused(pairs), fused([witnessed(pair, confirming(), nothing) for pair in pairs]))


def test_one_by_one_and_all_at_once_are_the_same_bits_with_images():
    pairs = [
        witnessed(pair, confirming(), None if k % 3 else confirming()) for k, pair in enumerate(recording())
    ]
    pairs[30] = replace(pairs[30], b=None)
    pairs[31] = replace(pairs[31], a=None, b=None)
    pairs[32] = replace(pairs[32], skew_ns=5_000_000)
    fuser = Fuser(FusionSetup(calibration_of(BODY)))
    one_by_one = [fuser.update(pair, Labels.with_sides([(0, 0)])) for pair in pairs]
    assert same_bits(one_by_one, fused(pairs))
    assert [frame.has_person for frame in one_by_one[30:33]] == [True, False, True]


def test_the_papers_methods_ignore_images():
    pairs = recording(5)
    seen = [witnessed(pair, confirming(), confirming()) for pair in pairs]
    assert same_bits(fused(pairs, "paper"), fused(seen, "paper"))


@pytest.mark.parametrize("code", [0, ARMS, WHOLE])
def test_the_evidence_of_an_image_follows_its_joint(code):
    witness = confirming()
    witness[LEFT] = 0.5, -0.1, 0.0, 0.0  # seen past
    _, views, skeleton = asked(code, witness)
    told, places, information = evidence_in(witness, skeleton)
    named = RIGHT if code else LEFT
    assert told[LEFT] < -2.0 < 0.0 < told[RIGHT]
    assert views.log_odds[0, named] == told[LEFT]
    assert views.log_odds[0, RIGHT if named == LEFT else LEFT] == told[RIGHT]
    elbow, other = BODY.joint("ElbowLeft"), BODY.joint("ElbowRight")
    named = other if code else elbow
    np.testing.assert_allclose(views.places[0, named], places[elbow], atol=FLOAT32)
    np.testing.assert_allclose(
        views.place_information[0, named], information[elbow], atol=FLOAT32 * np.abs(information).max()
    )
    assert not views.log_odds[1].any()
    assert np.isnan(views.places[1]).all()


def test_evidence_multiplies_the_odds_of_an_outlier():
    model, views, _ = asked(0, confirming())
    state = new_arrays(State, J=J)
    views.log_odds[:] = 0.0
    prior = interpreted(outliers.prior_outlier)
    before = prior(model, state, views, 0, LEFT, 0.9)
    for said in (-2.0, 1.5):
        views.log_odds[0, LEFT] = said
        after = prior(model, state, views, 0, LEFT, 0.9)
        assert after / (1.0 - after) == pytest.approx(before / (1.0 - before) * np.exp(-said))
        assert prior(model, state, views, 1, LEFT, 0.9) == before


def test_the_surface_is_joined_with_the_tracker_by_information():
    model, views, _ = asked(0, confirming())
    random = np.random.default_rng(2)
    for i in range(J):
        root = random.normal(0.0, 0.02, (3, 3))
        views.slow[0, i] = root @ root.T + 1e-5 * np.eye(3)
    views.fast[:] = 1e-5
    z, C = views.positions[0].copy(), views.slow[0].copy()
    interpreted(measure_surface)(model, views, new_arrays(Solve, J=J))
    measured = 0
    for i in range(J):
        if np.isnan(views.places[0, i, 0]):
            np.testing.assert_array_equal(views.positions[0, i], z[i])
            assert views.fast[0, i] == 1e-5
            continue
        information = views.place_information[0, i] / model.constants.surface_slow**2
        W = np.linalg.inv(C[i]) + information
        expected = np.linalg.solve(W, np.linalg.solve(C[i], z[i]) + information @ views.places[0, i])
        np.testing.assert_allclose(views.positions[0, i], expected, rtol=1e-8)
        np.testing.assert_allclose(views.slow[0, i], np.linalg.inv(W), rtol=1e-6, atol=1e-12)
        assert views.fast[0, i] == pytest.approx(1e-5 + model.constants.surface_fast**2)
        measured += 1
    assert measured > 10


def test_a_hand_that_the_image_sees_past_counts_for_less():
    """A reports the right arm at a wrong position, and A's image sees past that position."""
    arm = [BODY.joint(f"{joint}Right") for joint in ("Wrist", "Hand", "HandTip", "Thumb")]
    past = np.full((J, 4), np.nan, dtype=np.float32)
    past[arm] = 0.5, -0.1, 0.0, 0.0
    truth = np.tile(standing(BODY), (60, 1, 1))
    errors = []
    for witness in (None, past):
        random = np.random.default_rng(3)
        pairs = []
        for k, at in enumerate(truth):
            pair = noisy(pair_of(BODY, at, k * FRAME_NS), random, 0.003)
            wrong = pair.a.positions.copy()
            wrong[arm] += (0.15, 0.0, 0.0)
            bad = Skeleton.of(BODY, wrong, pair.a.states, pair.a.time_ns).with_witness(witness)
            pairs.append(replace(pair, a=bad if k >= 20 else pair.a))
        found = np.array([frame.positions for frame in fused(pairs)])
        errors.append(np.linalg.norm(found - truth, axis=2)[30:, arm].mean())
    assert errors[1] < 0.7 * errors[0]


# --- Evidence and surface measurements against plain formulas.


WRIST, ELBOW = BODY.joint("WristLeft"), BODY.joint("ElbowLeft")


def witness_of(**wrist):
    """Of a skeleton whose joints are all where they should be, but for the left wrist's numbers."""
    found = np.zeros((len(BODY), 4), dtype=np.float32)
    found[:, 0] = -new_witness_model(BODY).flesh
    found[:, 1] = 0.05
    for name, value in wrist.items():
        found[WRIST, ("gap", "edge", "offset_x", "offset_y").index(name)] = value
    return found


@pytest.fixture
def skeleton():
    return Skeleton.of(BODY, standing(BODY))


def test_evidence_follows_the_table(skeleton):
    row = EVIDENCE["end"]
    flesh = FLESH["wrist"]
    cases = [
        (witness_of(), row[KNOTS.tolist().index(0.0)]),
        (witness_of(gap=1.0, edge=-0.04), row[KNOTS.tolist().index(0.04)]),
        (witness_of(gap=0.04, edge=-0.11), row[KNOTS.tolist().index(0.04)]),
        (witness_of(gap=1.0, edge=-0.12), row[-1]),
        (witness_of(gap=-flesh - 0.12), row[KNOTS.tolist().index(-0.12)]),
        (witness_of(gap=-flesh - 1.0), row[0]),
        (witness_of(gap=1.0, edge=-0.035), 0.5 * (row[8] + row[9])),
        (witness_of(gap=np.nan), 0.0),
    ]
    for witness, expected in cases:
        assert evidence_in(witness, skeleton).log_odds[WRIST] == pytest.approx(expected, abs=1e-5)


def test_only_tracked_joints_are_judged(skeleton):
    states = np.array(skeleton.states)
    states[WRIST] = TrackingState.INFERRED
    inferred = Skeleton.of(BODY, skeleton.positions, states)
    witness = witness_of(gap=1.0, edge=-0.1)
    assert evidence_in(witness, skeleton).log_odds[WRIST] < -1.0
    assert evidence_in(witness, inferred).log_odds[WRIST] == 0.0
    _, places, information = evidence_in(witness_of(), inferred)
    assert np.isnan(places[WRIST]).all()
    assert not information[WRIST].any()


def test_evidence_falls_away_from_where_joints_should_be():
    for row in EVIDENCE.values():
        assert len(row) == len(KNOTS)
        top = int(np.argmax(row))
        assert (np.diff(row[: top + 1]) >= 0.0).all()
        assert (np.diff(row[top:]) <= 0.0).all()
        assert max(map(abs, row)) <= LARGEST


@pytest.mark.parametrize("body", BODIES.values(), ids=list(BODIES))
def test_every_joint_has_a_kind_and_a_neighbour(body):
    model = new_witness_model(body)
    assert {kind_of(joint) for joint in body.joints} <= set(FLESH)
    for j, n in enumerate(model.neighbours):
        assert j == body.root or n == body.parents[j]
        assert n != j
    assert set(SURFACE_SD) == set(FLESH)


def test_the_surface_places_a_joint_below_the_middle_of_its_silhouette(skeleton):
    witness = witness_of(gap=-0.01, offset_x=0.02, offset_y=-0.01)
    _, places, information = evidence_in(witness, skeleton)
    at = skeleton.positions.astype(np.float64)
    ray = at[WRIST] / np.linalg.norm(at[WRIST])
    offset = np.array([0.02, -0.01, 0.0])
    deeper = FLESH["wrist"] - 0.01
    np.testing.assert_allclose(
        places[WRIST], at[WRIST] + offset - offset @ ray * ray + deeper * ray, atol=1e-6
    )
    bone = at[WRIST] - at[ELBOW]
    bone -= bone @ ray * ray
    bone /= np.linalg.norm(bone)
    across, along, depth = SURFACE_SD["wrist"]
    for direction, sd in ((np.cross(ray, bone), across), (bone, along), (ray, depth)):
        np.testing.assert_allclose(information[WRIST] @ direction, direction / sd**2, rtol=1e-5, atol=1e-3)


@pytest.mark.parametrize(
    "wrist", [{"gap": 0.1}, {"gap": -0.3}, {"edge": -0.03}, {"offset_x": np.nan}, {"offset_x": 0.09}]
)
def test_a_surface_that_is_not_the_joints_measures_nothing(skeleton, wrist):
    _, places, information = evidence_in(witness_of(**wrist), skeleton)
    assert np.isnan(places[WRIST]).all()
    assert not information[WRIST].any()
    assert np.isfinite(places[ELBOW]).all()


def test_a_rotated_frame_rotates_places_and_information(skeleton):
    witness = witness_of(gap=-0.04, offset_x=0.015)
    _, places, information = evidence_in(witness, skeleton)
    R, t = Rotation.from_rotvec([0.3, -1.2, 0.4]).as_matrix(), np.array([1.0, -0.2, 2.0])
    found = new_arrays(JointEvidence, J=len(BODY))
    weigh_witness(new_witness_model(BODY), R, t, skeleton.positions, skeleton.states, witness, found)
    np.testing.assert_allclose(found.places, places @ R.T + t, atol=1e-12)
    np.testing.assert_allclose(found.information, R @ information @ R.T, rtol=1e-9, atol=1e-6)
    np.testing.assert_array_equal(found.log_odds, evidence_in(witness, skeleton).log_odds)
