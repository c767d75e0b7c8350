"""A per-frame figure is declared once; memory, file and checksum agree about it."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from fusion.body import KINECT_V1
from fusion.fuser import Fuser
from fusion.setup import FusionSetup
from recordings import layout
from recordings.frame_fields import JOINTS, FrameField, no_joint_or_joint
from recordings.fusing.pairs import fuse_one
from recordings.session_arrays import FRAME_FIELDS, SessionArrays
from tests.helpers.frame_pairs import frame_pairs
from tests.helpers.two_views import calibration_of

J = len(KINECT_V1)
SIGMA = FrameField(
    *(np.float64, (JOINTS,), layout.FUSED_SKELETON, "sigma_mm", np.float16),
    lambda frame: frame,
    absent=np.nan,
    optional=True,
    scale=1e3,
)


@given(hnp.arrays(np.float64, (3, J), elements=st.floats(0.0, 10.0)))
def test_a_scaled_figure_has_the_same_checksum_before_and_after_the_file(sigma):
    stored = SIGMA.to_file(KINECT_V1, sigma)
    back = SIGMA.from_file(KINECT_V1, stored)
    np.testing.assert_array_equal(SIGMA.checked(KINECT_V1, sigma), SIGMA.checked(KINECT_V1, back))
    np.testing.assert_allclose(back, sigma, rtol=2.0**-11, atol=2.0**-25 * 1e-3)  # of float16


def test_metres_are_stored_as_millimetres():
    assert SIGMA.to_file(KINECT_V1, np.full((1, J), 0.025))[0, 0] == np.float16(25.0)


def test_no_joint_is_the_last_name():
    spec = FRAME_FIELDS["misleading"]
    values = np.array([[-1, *range(J - 1)]], dtype=np.int32)
    stored = spec.to_file(KINECT_V1, values)
    assert spec.in_arrow(KINECT_V1, stored).to_pylist() == ["none", *KINECT_V1.joints[:-1]]
    np.testing.assert_array_equal(spec.from_file(KINECT_V1, stored), values)
    assert no_joint_or_joint(KINECT_V1)[-1] == "none"


def test_frames_without_a_value_have_the_absent_one_and_none_at_all_is_none():
    one = np.full(J, 0.01)
    stacked = SIGMA.stacked(KINECT_V1, [None, one])
    assert np.isnan(stacked[0]).all()
    np.testing.assert_array_equal(stacked[1], one)
    assert SIGMA.stacked(KINECT_V1, [None, None]) is None


def test_figures_that_share_a_component_are_neither_optional_nor_of_two_types():
    shared = {}
    for spec in FRAME_FIELDS.values():
        shared.setdefault((spec.entity, spec.component), []).append(spec)
    for specs in shared.values():
        assert len(specs) == 1 or not any(spec.optional for spec in specs)
        assert len({spec.stored for spec in specs}) == 1


@pytest.mark.parametrize("first_has_it", [True, False])
def test_a_session_has_an_optional_figure_if_its_first_frame_has_it(first_has_it):
    calibration = calibration_of(KINECT_V1)
    fuser = Fuser(FusionSetup(calibration))
    frames = [fuse_one(fuser, pair) for pair in frame_pairs(KINECT_V1, 4)]
    with_truth = [replace(frame, truth=frame.fused.positions) for frame in frames]
    first, then = (with_truth, frames) if first_has_it else (frames, with_truth)
    early = SessionArrays.stack(KINECT_V1, calibration.bone_lengths, first[:2])
    late = SessionArrays.stack(KINECT_V1, calibration.bone_lengths, then[2:], like=early)
    assert (early.truth is not None) == (late.truth is not None) == first_has_it
    assert np.isnan(late.filled("truth")).all()
