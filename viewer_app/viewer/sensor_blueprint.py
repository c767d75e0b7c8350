"""The layout of the viewer for the recording of one sensor."""

from __future__ import annotations

import numpy as np
import rerun.blueprint as rrb
from numpy.typing import NDArray

from fusion.intrinsics import Intrinsics
from recordings import layout
from recordings.writing.sensor_log import SensorEntities

_BESIDE_SENSOR = np.array([1.6, -1.0, -1.2])  # metres: beside, above and behind the sensor
_BESIDE_PERSON = np.array([1.5, -0.6, 0.0])  # metres from a point between sensor and person
_TOWARDS_PERSON = 0.15  # of the way
_MIDDLE_OF_ROOM = np.array([0.0, 0.1, 2.5])


def sensor_blueprint(
    entities: SensorEntities, camera: Intrinsics, person_at: NDArray[np.float64] | None
) -> rrb.Blueprint:
    """A scene in the sensor's frame, and what the sensor's depth camera sees.

    Args:
        entities: Where the data is.
        camera: Intrinsics of the depth camera.
        person_at: (3,) metres in the sensor's frame: where to look; None without a person.
    """
    target = _MIDDLE_OF_ROOM if person_at is None else person_at
    eye = _BESIDE_SENSOR if person_at is None else _TOWARDS_PERSON * person_at + _BESIDE_PERSON
    scene = rrb.Spatial3DView(
        origin=entities.sensor,
        name="in the sensor's frame",
        eye_controls=rrb.EyeControls3D(position=eye, look_target=target, eye_up=(0.0, -1.0, 0.0)),
        line_grid=rrb.LineGrid3D(visible=False),
    )
    image = rrb.Spatial2DView(
        origin=entities.depth,
        contents=["$origin/**", f"{entities.people}/**"],
        name="as the depth camera sees it",
        visual_bounds=rrb.VisualBounds2D(x_range=(0, camera.width), y_range=(0, camera.height)),
    )
    return rrb.Blueprint(
        rrb.Horizontal(scene, image, column_shares=[3, 2]),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=layout.TIME),
        auto_views=False,
    )
