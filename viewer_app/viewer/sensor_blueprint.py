"""The layout of the viewer for the recording of one sensor."""

from __future__ import annotations

import numpy as np
import rerun.blueprint as rrb

from fusion.intrinsics import Intrinsics
from recordings import layout
from recordings.writing.sensor_log import SensorEntities

_EYE = np.array([1.6, -1.0, -1.2])  # metres: beside, above and behind the sensor
_LOOKS_AT = np.array([0.0, 0.1, 2.5])  # where people usually stand


def sensor_blueprint(entities: SensorEntities, camera: Intrinsics | None) -> rrb.Blueprint:
    """A scene in the sensor's frame and, where there is a camera, its depth images.

    Args:
        entities: Where the data is.
        camera: Intrinsics of the depth camera; None without one.
    """
    scene = rrb.Spatial3DView(
        origin=entities.sensor,
        name="in the sensor's frame",
        eye_controls=rrb.EyeControls3D(position=_EYE, look_target=_LOOKS_AT, eye_up=(0.0, -1.0, 0.0)),
        line_grid=rrb.LineGrid3D(visible=False),
    )
    shown: rrb.View | rrb.Container = scene
    if camera is not None:
        image = rrb.Spatial2DView(
            origin=entities.depth,
            name="depth camera",
            visual_bounds=rrb.VisualBounds2D(x_range=(0, camera.width), y_range=(0, camera.height)),
        )
        shown = rrb.Horizontal(scene, image, column_shares=[3, 2])
    return rrb.Blueprint(
        shown,
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=layout.TIME),
        auto_views=False,
    )
