"""The mirror image of a body is told from the body."""

from __future__ import annotations

import numpy as np
import pytest

from fusion.body import BODIES, KINECT_V2, Body
from fusion.handedness import mirrored_share
from tests.helpers.labelled_views import simulated_views
from tests.helpers.two_views import moving


@pytest.mark.parametrize("body", BODIES.values(), ids=BODIES)
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_one_reversed_axis_is_seen_in_every_frame(body: Body, axis: int) -> None:
    positions = moving(body, 30)
    assert mirrored_share(body, positions) == 0.0
    reversed_ = positions.copy()
    reversed_[..., axis] *= -1.0
    assert mirrored_share(body, reversed_) == 1.0


def test_a_tracker_that_exchanges_sides_mirrors_no_body() -> None:
    views = simulated_views("walk", seconds=16.0)
    assert views.relabel().codes.any()
    for positions in (views.a, views.b_in_a):
        assert mirrored_share(views.body, positions) < 0.2


def test_nothing_is_said_of_a_body_without_feet() -> None:
    positions = moving(KINECT_V2, 5)
    positions[:, KINECT_V2.joint("FootLeft")] = np.nan
    assert mirrored_share(KINECT_V2, positions) is None
