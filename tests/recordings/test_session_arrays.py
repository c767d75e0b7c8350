"""Per-frame figures: declared once, in memory, file and checksum; and what is derived from them."""

import weakref
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from fusion.body import KINECT_V1
from fusion.fuser import Fuser
from fusion.setup import FusionSetup
from fusion.support.medians import median_of_known
from recordings.data import layout
from recordings.data.frame_fields import FRAME_FIELDS, JOINTS, FrameField, no_joint_or_joint
from recordings.data.session_arrays import SessionArrays
from recordings.fusing.pairs import fuse_one
from recordings.session import Session
from tests.helpers.frame_pairs import frame_pairs
from tests.helpers.two_views import calibration_of

J = len(KINECT_V1)
SIGMA = FrameField(
    *("sigma", np.float64, (JOINTS,), layout.FUSED_SKELETON, "sigma_mm", np.float16),
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


def test_disagreement_is_the_median_over_the_joints_that_both_see():
    fuser = Fuser(FusionSetup(calibration_of(KINECT_V1)))
    frames = [fuse_one(fuser, pair) for pair in frame_pairs(KINECT_V1, 30)]
    rows = SessionArrays.stack(KINECT_V1, KINECT_V1.nominal_lengths, frames)
    positions = rows.positions_a.copy()
    for t in range(len(rows)):
        positions[t, : t % (len(KINECT_V1) + 1)] = np.nan  # of 0 to all joints
    some = replace(rows, positions_a=positions)
    seen = [d[~np.isnan(d)] for d in some.view_difference]
    assert {len(d) for d in seen} >= {0, 1, 2, 3, 4}
    wanted = [np.median(d) if len(d) else np.nan for d in seen]
    np.testing.assert_array_equal(some.disagreement, wanted)


def test_stacking_keeps_what_the_loop_gave():
    fuser = Fuser(FusionSetup(calibration_of(KINECT_V1)))
    frames = [fuse_one(fuser, pair) for pair in frame_pairs(KINECT_V1, 20, only_a=(0,), noise=0.0)]
    rows = SessionArrays.stack(KINECT_V1, KINECT_V1.nominal_lengths, frames)
    assert len(rows) == 20
    assert np.isnan(rows.positions_b[0]).all()
    assert (rows.states_b[0] == 0).all()
    assert (rows.fused[3] == frames[3].fused.positions).all()
    assert rows.time_ns[-1] == frames[-1].pair.time_ns
    # without noise S_B in A's frame equals S_A, to float32
    both = np.isfinite(rows.b_in_a) & np.isfinite(rows.positions_a)
    assert both[1:].mean() > 0.9
    np.testing.assert_allclose(rows.b_in_a[both], rows.positions_a[both], atol=3e-6)
    assert rows.disagreement[1:].max() < 3e-6
    assert np.isnan(rows.disagreement[0])
    assert rows.bone_error.max() < 1e-9


def test_a_session_of_frames_is_theirs_and_does_not_keep_them():
    setup = FusionSetup(calibration_of(KINECT_V1))
    fuser = Fuser(setup)
    made = [fuse_one(fuser, pair) for pair in frame_pairs(KINECT_V1, 60, only_a=(0,), no_b=(20,))]
    alive = []
    most = 0

    def passing():
        nonlocal most
        for number in range(1000):
            frame = replace(made[number % 60])
            alive.append(weakref.ref(frame))
            most = max(most, sum(one() is not None for one in alive))
            yield frame

    session = Session.of([(setup, passing())])
    assert most <= 302  # the block, and the frame that is made
    whole = SessionArrays.stack(
        KINECT_V1, setup.calibration.bone_lengths, [made[k % 60] for k in range(1000)]
    )
    for name, _, values in whole.figures():
        np.testing.assert_array_equal(getattr(session.rows, name), values)
    np.testing.assert_array_equal(session.rows.frame, whole.frame)
    np.testing.assert_array_equal(session.rows.time_ns, whole.time_ns)
    np.testing.assert_array_equal(session.bone_lengths, whole.bone_lengths)


def test_the_median_of_what_is_known_is_that_of_numpy():
    values = np.random.default_rng(3).normal(size=(200, 6, 3))
    values[values > 0.5] = np.nan
    some = np.isfinite(values).any(axis=1)
    assert not some.all()
    found = median_of_known(values)
    assert np.isnan(found[~some]).all()
    filled = np.where(some[:, None], values, 0.0)
    np.testing.assert_array_equal(found[some], np.nanmedian(filled, axis=1)[some])
