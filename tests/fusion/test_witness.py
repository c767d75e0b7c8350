"""Evidence and surface measurements against plain formulas."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fusion.body import BODIES, KINECT_V2
from fusion.joint_kinds import kind_of
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
from tests.helpers.two_views import standing
from tests.helpers.witnesses import evidence_in

BODY = KINECT_V2
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
