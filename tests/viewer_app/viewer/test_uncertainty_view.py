"""The uncertainty of S* is visible in the scene; an exchanged view has a class of its own."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fusion.setup import FuserSettings
from recordings import layout
from recordings.session_arrays import SessionArrays, SessionFrame
from tests.helpers.live_frames import BODY, frames, inspected_scenes, known_fuser, session_of_view
from tests.helpers.pictures import headless_viewer, picture_of
from tests.helpers.shown_values import shown_values
from tests.helpers.waiting import eventually

STEP = 1.0 / 512.0  # metres, of the spheres' radii


def exchanged_in_b(made: list[SessionFrame]) -> list[SessionFrame]:
    """The frames as if B had reported left and right exchanged in them."""
    return [replace(frame, fused=replace(frame.fused, exchanged_b=3)) for frame in made]


def test_a_view_has_another_class_while_its_sides_are_exchanged() -> None:
    made = frames(known_fuser(), 4)
    rows = SessionArrays.stack(BODY, BODY.nominal_lengths, made[:2] + exchanged_in_b(made[2:]))
    for side, expected in (("a", ["a"] * 4), ("b", ["b", "b", "exchanged_b", "exchanged_b"])):
        classes = shown_values(rows, layout.skeleton(side), "Points3D:class_ids")
        assert classes is not None
        assert classes.shape == (4, len(BODY))
        assert classes.tolist() == [[layout.CLASS_IDS[key]] * len(BODY) for key in expected]


def test_spheres_have_the_radius_of_one_standard_deviation() -> None:
    made = frames(known_fuser(), 3)
    rows = SessionArrays.stack(BODY, BODY.nominal_lengths, made)
    half_sizes = shown_values(rows, layout.FUSED_SKELETON, layout.SIGMA_SPHERES)
    assert half_sizes is not None
    sigma = np.array([frame.fused.sigma for frame in made])
    thumbs = [BODY.joint("THUMB_LEFT"), BODY.joint("THUMB_RIGHT")]  # see the next test
    sigma, half_sizes = np.delete(sigma, thumbs, axis=1), np.delete(half_sizes, thumbs, axis=1)
    np.testing.assert_allclose(half_sizes, np.repeat(sigma[..., None], 3, axis=2), rtol=0, atol=0.51 * STEP)


def test_a_sphere_is_no_larger_than_a_bone_of_any_direction_allows() -> None:
    """A point on a sphere of radius L is √2 L from a random one (RMS): L² (1 − cos) · 2 on average."""
    made = frames(known_fuser(), 1)
    thumb = BODY.joint("THUMB_LEFT")
    parent = int(BODY.parents[thumb])
    sigma = np.full(len(BODY), 0.03)
    sigma[thumb] = 0.7
    lost = [replace(made[0], fused=replace(made[0].fused, sigma=sigma))]
    rows = SessionArrays.stack(BODY, BODY.nominal_lengths, lost)
    half_sizes = shown_values(rows, layout.FUSED_SKELETON, layout.SIGMA_SPHERES)
    assert half_sizes is not None
    drawn = half_sizes[0, :, 0]
    most = np.hypot(sigma[parent], np.sqrt(2.0) * BODY.nominal_lengths[thumb])
    assert drawn[thumb] == pytest.approx(most, abs=0.51 * STEP)
    np.testing.assert_allclose(np.delete(drawn, thumb), 0.03, rtol=0, atol=0.51 * STEP)


def test_the_papers_methods_have_no_spheres() -> None:
    fuser = known_fuser()
    setup = replace(fuser.setup, settings=FuserSettings(method="paper"))
    rows = SessionArrays.stack(BODY, BODY.nominal_lengths, frames(type(fuser)(setup), 2))
    assert shown_values(rows, layout.FUSED_SKELETON, layout.SIGMA_SPHERES) is None


def test_spheres_are_drawn_about_the_joints(tmp_path: Path) -> None:
    """Spheres of 0.2 m cover several times the 0.2 % of the window that bones and joints cover."""
    sigma = np.full(len(BODY), 0.2)
    made = [replace(f, fused=replace(f.fused, sigma=sigma)) for f in frames(known_fuser(), 10)]
    with headless_viewer(str(session_of_view(inspected_scenes()[1], made, tmp_path))) as viewer:

        def purple() -> float:
            red, green, blue = np.moveaxis(picture_of(viewer, tmp_path / "w.png").astype(int), 2, 0)
            return float(((blue - green > 25) & (red - green > 15)).mean())

        assert eventually(lambda: purple() > 0.01, 30.0), purple()
        assert [report for view in viewer.get_state().views for report in view.reports] == []
