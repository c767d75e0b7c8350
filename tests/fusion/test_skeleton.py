import numpy as np
import pytest

from fusion.body import BODIES, KINECT_V1, KINECT_V2
from fusion.errors import FusionError
from fusion.handedness import mirrored_share
from fusion.skeleton import Skeleton, TrackingState
from tests.helpers.labelled_views import simulated_views
from tests.helpers.two_views import moving


def test_a_coordinate_that_is_no_number_makes_the_joint_not_tracked():
    positions = np.ones((20, 3))
    positions[3, 1], positions[5, 0] = np.nan, np.inf
    skeleton = Skeleton.of(KINECT_V1, positions)
    assert skeleton.states[[3, 5]].tolist() == [TrackingState.NOT_TRACKED] * 2
    assert np.isnan(skeleton.positions[[3, 5]]).all()
    assert skeleton.has_position.sum() == 18


def test_a_joint_that_is_not_tracked_has_no_position():
    states = np.full(20, 2)
    states[7] = 0
    assert np.isnan(Skeleton.of(KINECT_V1, np.ones((20, 3)), states).positions[7]).all()


def test_values_that_do_not_fit_the_body_are_refused():
    with pytest.raises(FusionError, match="20 joints"):
        Skeleton.of(KINECT_V1, np.ones((25, 3)))
    with pytest.raises(FusionError, match="0, 1 or 2"):
        Skeleton.of(KINECT_V1, np.ones((20, 3)), np.full(20, 3))


def test_arrays_of_a_callers_own_become_those_of_the_kernels():
    positions, states = np.ones((20, 3)), np.full(20, 2)
    skeleton = Skeleton(KINECT_V1, positions, states, 0)
    checked = Skeleton.of(KINECT_V1, positions, states)
    for array, other in ((skeleton.positions, checked.positions), (skeleton.states, checked.states)):
        assert array.dtype == other.dtype
        assert not array.flags.writeable
        assert array.flags.c_contiguous
    positions[0] = 0.0
    assert skeleton.positions[0].tolist() == [1.0, 1.0, 1.0]


def test_a_repeated_skeleton_is_noticed_holes_included():
    positions = np.ones((20, 3))
    positions[3] = np.nan
    first, again = Skeleton.of(KINECT_V1, positions, None, 0), Skeleton.of(KINECT_V1, positions, None, 33)
    positions[0, 0] += 1e-5
    assert again.repeats(first)
    assert not Skeleton.of(KINECT_V1, positions).repeats(first)
    assert not first.repeats(None)


@pytest.mark.parametrize("body", BODIES.values(), ids=BODIES)
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_one_reversed_axis_is_seen_in_every_frame(body, axis):
    positions = moving(body, 30)
    assert mirrored_share(body, positions) == 0.0
    reversed_ = positions.copy()
    reversed_[..., axis] *= -1.0
    assert mirrored_share(body, reversed_) == 1.0


def test_a_tracker_that_exchanges_sides_mirrors_no_body():
    views = simulated_views("walk", seconds=16.0)
    assert views.relabel().codes.any()
    for positions in (views.a, views.b_in_a):
        assert mirrored_share(views.body, positions) < 0.2


def test_nothing_is_said_of_a_body_without_feet():
    positions = moving(KINECT_V2, 5)
    positions[:, KINECT_V2.joint("FootLeft")] = np.nan
    assert mirrored_share(KINECT_V2, positions) is None
