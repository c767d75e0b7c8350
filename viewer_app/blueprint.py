"""What the viewer shows, and where."""

from __future__ import annotations

import numpy as np
import rerun.blueprint as rrb
from numpy.typing import NDArray

from fusion.body import Body
from recordings import layout

_PLOTTED_BONES = ("upper_arm", "forearm", "thigh", "shin")  # the limbs of the paper's fig. 5


def inspect_blueprint(body: Body, person_at: NDArray[np.float64]) -> rrb.Blueprint:
    """The layout for finding out why a joint went where: 3D, bone lengths as in fig. 5, trust, quality.

    Args:
        body: The session's body.
        person_at: (3,) metres in K_A's frame: where to look.
    """
    bones = [
        rrb.TimeSeriesView(
            origin=layout.bone(f"{bone}_{side}"),
            name=f"{bone.replace('_', ' ')} {side} (m)",
            plot_legend=rrb.PlotLegend(visible=bone == _PLOTTED_BONES[0] and side == "left"),
        )
        for bone in _PLOTTED_BONES
        for side in ("left", "right")
        if f"{bone}_{side}" in body.bones
    ]
    trust = rrb.TimeSeriesView(
        origin=layout.weights("a"),
        name="trust in A (1) or in B (0)",
        axis_y=rrb.ScalarAxis(range=(-0.05, 1.05)),
        plot_legend=rrb.PlotLegend(rrb.Corner2D.RightTop),
    )
    quality = rrb.Tabs(
        *(
            rrb.TimeSeriesView(
                origin=layout.quality(name), name=title, plot_legend=rrb.PlotLegend(visible=False)
            )
            for name, title in (
                ("disagreement_mm", "S_A against S_B (mm)"),
                ("bone_error_mm", "S* bone error (mm)"),
                ("fuse_ms", "fusion (ms)"),
                ("skew_ms", "skew (ms)"),
            )
        ),
        rrb.TextLogView(origin=layout.EVENTS, name="events"),
        active_tab=0,
    )
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                _scene(person_at),
                rrb.Horizontal(trust, quality, column_shares=[3, 2]),
                row_shares=[5, 2],
            ),
            rrb.Grid(*bones, grid_columns=2, name="bone lengths"),
            column_shares=[5, 4],
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=layout.TIME),
        auto_views=False,
    )


def _scene(person_at: NDArray[np.float64]) -> rrb.Spatial3DView:
    """The skeletons from K_A's side: behind its right shoulder, a little above, so that K_B shows too."""
    away = person_at / max(float(np.linalg.norm(person_at)), 1e-6)
    eye = person_at - 2.1 * away + np.array([0.6, -0.35, 0.0])
    return rrb.Spatial3DView(
        origin="/",
        name="S_A brown, S_B blue, S* purple",
        eye_controls=rrb.EyeControls3D(position=eye, look_target=person_at, eye_up=(0.0, -1.0, 0.0)),
        line_grid=rrb.LineGrid3D(visible=False),
    )
