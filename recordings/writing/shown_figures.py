"""Per-frame figures that are derived from recorded ones, for the viewer; no reader asks for them.

A new one is a row of :data:`SHOWN_FIGURES`.
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
        entity, component: Where it is logged, named as in :class:`recordings.frame_fields.FrameField`.
        stored: Its type in the file.
        compute: (T, …) of the frames.
    """

    entity: str
    component: str
    stored: type[np.generic]
    compute: Callable[[SessionArrays], NDArray[Any]]

    def values(self, rows: SessionArrays) -> NDArray[Any]:
        """(T, …) as the file has it."""
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
    # a viewer's transform is in float32: R and t once more, in full, are a component beside it
    ShownFigure(layout.kinect("b"), "Transform3D:mat3x3", np.float64, lambda rows: rows.rotation),
    ShownFigure(layout.kinect("b"), "Transform3D:translation", np.float64, lambda rows: rows.translation),
    ShownFigure(layout.QUALITY, "figures.bone_error_mm", np.float32, lambda rows: rows.bone_error * 1e3),
    ShownFigure(layout.QUALITY, "figures.disagreement_mm", np.float32, lambda rows: rows.disagreement * 1e3),
    ShownFigure(
        layout.QUALITY, "figures.predicted_joints", np.uint8, lambda rows: rows.predicted.sum(axis=1)
    ),
    ShownFigure(layout.QUALITY, "sensors.tracked_joints", np.uint8, _tracked_joints),
)
