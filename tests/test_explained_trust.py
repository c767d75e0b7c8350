"""Where a joint of S* came from, as colours, data, a matrix and lanes."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from fusion.body import KINECT_V2
from fusion.calibration import Calibration
from fusion.fuser import Fuser
from fusion.skeleton import TrackingState
from recordings import layout
from recordings.arrays import SessionArrays
from recordings.explained_trust import StateLanes, TrustMatrix, details, trust_colors
from tests.conftest import A_FROM_B
from tests.pictures import pixels_near
from tests.test_live_session import frames

BODY = KINECT_V2
ELBOW = BODY.joint("ELBOW_RIGHT")


@pytest.fixture
def rows() -> SessionArrays:
    """Four seconds of both views."""
    fuser = Fuser(Calibration(BODY, A_FROM_B, BODY.nominal_lengths, "known"))
    return SessionArrays.stack(BODY, BODY.nominal_lengths, frames(fuser, 120))


def trusting(rows: SessionArrays, in_a: float) -> SessionArrays:
    weights = np.full_like(rows.weights_a, in_a)
    return replace(rows, weights_a=weights, weights_b=1.0 - weights)


def decoded(png: bytes) -> NDArray[np.uint8]:
    picture = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    return np.asarray(picture[..., ::-1])


def test_a_joint_has_the_colour_of_the_sensor_it_came_from(rows: SessionArrays) -> None:
    a, b = (np.array(layout.SKELETON_COLORS[side]) for side in layout.SIDES)
    assert (trust_colors(trusting(rows, 1.0)) == a).all()
    assert (trust_colors(trusting(rows, 0.0)) == b).all()
    assert np.abs(trust_colors(trusting(rows, 0.5)) - (a + b) / 2.0).max() <= 1.0
    nothing = replace(rows, predicted=np.ones_like(rows.predicted))
    assert (trust_colors(nothing) == layout.PREDICTED_COLOR).all()


def test_the_data_beside_a_joint_names_states_and_the_misleading_joint(rows: SessionArrays) -> None:
    states, misleading = rows.states_b.copy(), rows.misleading.copy()
    states[3, ELBOW] = TrackingState.INFERRED
    misleading[3, ELBOW] = BODY.joint("WRIST_RIGHT")
    misleading[4, ELBOW] = -1
    apart = rows.positions_a.copy()
    apart[3, ELBOW] += np.array([0.03, 0.04, 0.0], dtype=np.float32)
    made = details(replace(rows, states_b=states, misleading=misleading, positions_a=apart))
    said = {name: np.array(of.to_pylist()).reshape(len(rows), -1) for name, of in made.items()}
    assert said["state_a"][3, ELBOW] == "tracked"
    assert said["state_b"][3, ELBOW] == "inferred"
    assert said["misleading_joint"][3, ELBOW] == BODY.joints[BODY.joint("WRIST_RIGHT")]
    assert said["misleading_joint"][4, ELBOW] == "none"
    # the views agree, and then one is moved by 50 mm; whole millimetres
    assert said["view_difference_mm"][2, ELBOW] == 0.0
    assert said["view_difference_mm"][3, ELBOW] == 50.0
    assert said["weight_a"][3, ELBOW] == np.float16(rows.weights_a[3, ELBOW])


def test_the_matrix_is_drawn_once_a_second_and_shows_who_was_trusted(rows: SessionArrays) -> None:
    pictures = list(TrustMatrix(BODY).add(trusting(rows, 1.0)))
    assert [t for t, _ in pictures] == [0, 31, 61, 91]
    a, b = (layout.SKELETON_COLORS[side] for side in layout.SIDES)
    first, last = (pixels_near(decoded(pictures[k][1]), a, 2) for k in (0, -1))
    assert last > 10 * first  # what is older moves to the left and stays
    assert pixels_near(decoded(pictures[-1][1]), b, 2) < 400  # only the legend's


def test_the_matrix_is_the_same_frame_by_frame_and_at_once(rows: SessionArrays) -> None:
    at_once = [png for _, png in TrustMatrix(BODY).add(rows)]
    matrix = TrustMatrix(BODY)
    one_by_one = []
    for t in range(len(rows)):
        row = SessionArrays(
            **{
                name: value[t : t + 1] if isinstance(value, np.ndarray) and len(value) == len(rows) else value
                for name, value in vars(rows).items()
            }
        )
        one_by_one += [png for _, png in matrix.add(row)]
    assert one_by_one == at_once


def test_only_joints_that_change_have_a_lane_and_it_begins_at_the_beginning(rows: SessionArrays) -> None:
    states = rows.states_a.copy()
    states[40:50, ELBOW] = TrackingState.INFERRED
    lanes = StateLanes()
    news = list(lanes.add(replace(rows, states_a=states)))
    assert news == [("a", ELBOW, [(None, 2), (40, 1), (50, 2)])]
    states[:, ELBOW] = TrackingState.NOT_TRACKED
    assert list(lanes.add(replace(rows, states_a=states))) == [("a", ELBOW, [(0, 0)])]
    assert list(lanes.add(replace(rows, states_a=states))) == []
