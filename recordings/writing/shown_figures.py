"""Per-frame figures derived from recorded figures for the viewer. They are not read back.

To add a figure, add a row to :data:`SHOWN_FIGURES`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion.skeleton import TrackingState
from recordings import layout
from recordings.appearance.joint_trust import trust_colors
from recordings.session_arrays import SessionArrays


@dataclass(frozen=True, eq=False)
class ShownFigure:
    """A derived figure.

    Attributes:
        entity, component: Place in the file, named as in :class:`recordings.frame_fields.FrameField`.
        stored: Type in the file.
        compute: Computes (T, …) values from the frames.
    """

    entity: str
    component: str
    stored: type[np.generic]
    compute: Callable[[SessionArrays], NDArray[Any]]

    def values(self, rows: SessionArrays) -> NDArray[Any]:
        """(T, …) in the type of the file."""
        return self.compute(rows).astype(self.stored, copy=False)


def _tracked_joints(rows: SessionArrays) -> NDArray[Any]:
    return np.stack(
        [(s == TrackingState.TRACKED).sum(axis=1) for s in (rows.states_a, rows.states_b)], axis=1
    )


SHOWN_FIGURES = (
    ShownFigure(layout.FUSED_SKELETON, "Points3D:colors", np.uint8, trust_colors),
    ShownFigure(
        layout.FUSED_SKELETON,
        "view_difference_mm",
        np.float16,
        lambda rows: np.round(rows.view_difference * 1e3),
    ),
    # The viewer's transform is float32, so a component stores R and t again in float64.
    ShownFigure(layout.kinect("b"), "Transform3D:mat3x3", np.float64, lambda rows: rows.rotation),
    ShownFigure(layout.kinect("b"), "Transform3D:translation", np.float64, lambda rows: rows.translation),
    ShownFigure(layout.QUALITY, "figures.bone_error_mm", np.float32, lambda rows: rows.bone_error * 1e3),
    ShownFigure(layout.QUALITY, "figures.disagreement_mm", np.float32, lambda rows: rows.disagreement * 1e3),
    ShownFigure(
        layout.QUALITY, "figures.predicted_joints", np.uint8, lambda rows: rows.predicted.sum(axis=1)
    ),
    ShownFigure(layout.QUALITY, "sensors.tracked_joints", np.uint8, _tracked_joints),
)
