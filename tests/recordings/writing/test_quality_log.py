"""Jitter measures noise and not motion; the placement's figures start at zero."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fusion.calibration.calibration import Calibration
from fusion.rigid import RigidTransform
from recordings import layout
from recordings.file.rrd_file import RrdFile
from recordings.writing.changes import jitter
from tests.helpers.frame_pairs import frame_pairs
from tests.helpers.live_frames import BODY
from tests.helpers.recalibrated import record_recalibrated
from tests.helpers.two_views import A_FROM_B


def logged(path, entity):
    """The scalars of an entity, by frame."""
    found = {}
    with RrdFile(path) as file:
        for of_entity, batch in file.chunks(images=False):
            names = batch.schema.names
            if of_entity == entity and layout.FRAME in names and "Scalars:scalars" in names:
                columns = (batch.column(layout.FRAME), batch.column("Scalars:scalars"))
                found |= dict(zip(*(column.to_pylist() for column in columns), strict=True))
    return found


def test_a_moved_sensor_is_seen_in_millimetres_and_degrees(tmp_path):
    turned = Rotation.from_euler("y", 3.0, degrees=True).as_matrix()
    # 120 mm in all, along each axis
    shift = np.array([0.04, -0.08, 0.08])
    moved = RigidTransform.of(A_FROM_B.rotation @ turned, A_FROM_B.translation + shift)
    calibrations = [
        (0, Calibration(BODY, A_FROM_B, BODY.nominal_lengths, "first")),
        (40, Calibration(BODY, moved, BODY.nominal_lengths, "second")),
    ]
    file = tmp_path / "s.rrd"
    record_recalibrated(file, frame_pairs(BODY, 90), calibrations)
    placement = logged(file, layout.stream_figure("placement"))
    assert sorted(placement) == [2, *range(17, 90, 15)]  # jitter needs three frames
    before = [figures for frame, figures in placement.items() if frame < 40]
    assert len(before) >= 2
    # arccos near 1 magnifies float64 rounding of the trace to sqrt(2 * 1e-15) rad
    np.testing.assert_allclose(before, 0.0, atol=1e-5)
    np.testing.assert_allclose(placement[max(placement)], [120.0, 3.0], rtol=1e-6)


def test_even_motion_has_no_jitter():
    steps = np.arange(30.0)[:, None, None] * np.array([0.01, -0.02, 0.03])
    assert jitter((steps + np.ones((1, 20, 3))).astype(np.float32)) < 1e-6


@pytest.mark.parametrize("sigma", [0.002, 0.02])
def test_white_noise_has_a_jitter_of_3_8_sigma(sigma):
    """p(t−1) − 2p(t) + p(t+1) has variance 6 σ² per axis; the norm's median is 1.538 such deviations."""
    noise = np.random.default_rng(0).normal(0.0, sigma, (2000, 20, 3)).astype(np.float32)
    # 40 000 correlated samples: the median is certain to about 1 %
    assert jitter(noise) == pytest.approx(np.sqrt(6.0) * 1.538 * sigma, rel=0.03)


def test_missing_joints_are_left_out():
    still = np.zeros((10, 5, 3), dtype=np.float32)
    still[3, 2] = np.nan
    assert jitter(still) == 0.0
    assert np.isnan(jitter(np.full((10, 5, 3), np.nan, dtype=np.float32)))
