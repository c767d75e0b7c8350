"""S* is a body in the scene, S_A and S_B are thin, and both show where they come from."""

from dataclasses import replace

import numpy as np
import pytest

from fusion.setup import FuserSettings
from fusion.skeleton import TrackingState
from recordings import layout
from recordings.appearance.colors import SKELETON_COLORS, VIEW_COLORS
from recordings.session_arrays import SessionArrays
from recordings.writing.shown_figures import SHOWN_FIGURES
from tests.helpers.live_frames import BODY, frames, known_fuser


def shown_values(rows, entity, component):
    """(T, …) values of one derived figure; None where there are none."""
    return next(f for f in SHOWN_FIGURES if (f.entity, f.component) == (entity, component)).values(rows)


@pytest.mark.parametrize("side", layout.SIDES)
def test_joints_of_a_view_are_dimmed_where_inferred_or_exchanged(side):
    made = frames(known_fuser(), 3)
    rows = SessionArrays.stack(BODY, BODY.nominal_lengths, made)
    states = {name: getattr(rows, f"states_{name}").copy() for name in layout.SIDES}
    states[side][1, 5] = TrackingState.INFERRED
    exchanged = np.zeros((3, 2), dtype=np.int8)
    exchanged[2, layout.SIDES.index(side)] = 3
    told = replace(rows, states_a=states["a"], states_b=states["b"], exchanged=exchanged)
    colors = shown_values(told, layout.skeleton(side), "Points3D:colors")
    tracked, inferred, swapped = VIEW_COLORS[side]
    assert (colors[0] == tracked).all()
    assert (colors[1, 5] == inferred).all()
    assert (np.delete(colors[1], 5, axis=0) == tracked).all()
    assert (colors[2] == swapped).all()
    assert max(inferred) < 0.75 * max(tracked)
    assert max(swapped) < 0.75 * max(SKELETON_COLORS[layout.exchanged(side)])


STEP = 1.0 / 512.0  # metres, of the spheres' radii


def test_spheres_have_the_radius_of_one_standard_deviation():
    made = frames(known_fuser(), 3)
    rows = SessionArrays.stack(BODY, BODY.nominal_lengths, made)
    half_sizes = shown_values(rows, layout.FUSED_SKELETON, layout.SIGMA_SPHERES)
    assert half_sizes is not None
    sigma = np.array([frame.fused.sigma for frame in made])
    thumbs = [BODY.joint("THUMB_LEFT"), BODY.joint("THUMB_RIGHT")]  # see the next test
    sigma, half_sizes = np.delete(sigma, thumbs, axis=1), np.delete(half_sizes, thumbs, axis=1)
    np.testing.assert_allclose(half_sizes, np.repeat(sigma[..., None], 3, axis=2), rtol=0, atol=0.51 * STEP)


def test_a_sphere_is_no_larger_than_a_bone_of_any_direction_allows():
    """A point on a sphere of radius L is √2 L from a random one (RMS): L² (1 − cos) · 2 on average."""
    made = frames(known_fuser(), 1)
    thumb = BODY.joint("THUMB_LEFT")
    parent = int(BODY.parents[thumb])
    sigma = np.full(len(BODY), 0.03)
    sigma[thumb] = 0.7
    lost = [replace(made[0], fused=replace(made[0].fused, sigma=sigma))]
    rows = SessionArrays.stack(BODY, BODY.nominal_lengths, lost)
    half_sizes = shown_values(rows, layout.FUSED_SKELETON, layout.SIGMA_SPHERES)
    drawn = half_sizes[0, :, 0]
    most = np.hypot(sigma[parent], np.sqrt(2.0) * BODY.nominal_lengths[thumb])
    assert drawn[thumb] == pytest.approx(most, abs=0.51 * STEP)
    np.testing.assert_allclose(np.delete(drawn, thumb), 0.03, rtol=0, atol=0.51 * STEP)


def test_the_papers_methods_have_no_spheres():
    fuser = known_fuser()
    setup = replace(fuser.setup, settings=FuserSettings(method="paper"))
    rows = SessionArrays.stack(BODY, BODY.nominal_lengths, frames(type(fuser)(setup), 2))
    assert shown_values(rows, layout.FUSED_SKELETON, layout.SIGMA_SPHERES) is None
