"""Figures of each frame that follow from recorded ones: for the viewer, and checksums for the reader.

To add a figure, add a row to :data:`SHOWN_FIGURES`.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion.skeleton import TrackingState
from recordings.appearance.body_shape import (
    bone_vectors,
    capsule_lengths,
    capsule_rotations,
    nose_vectors,
    parents,
    pelvis_rotations,
)
from recordings.appearance.colors import VIEW_COLORS
from recordings.data import layout
from recordings.data.checksums import CHECKS_CRC, FRAME_CRC, checks_checksums, frame_checksums
from recordings.data.session_arrays import SessionArrays


@dataclass(frozen=True, eq=False)
class ShownFigure:
    """A derived figure."""

    entity: str  # place in the file, named as in :class:`recordings.data.frame_fields.FrameField`
    component: str
    compute: Callable[[SessionArrays], NDArray[Any] | None]
    """Computes (T, …) values from the frames; None if the session lacks what they come from."""
    stored: type[np.generic] = np.float32  # type in the file

    def values(self, rows: SessionArrays) -> NDArray[Any] | None:
        """(T, …) in the type of the file; None if there are none."""
        values = self.compute(rows)
        return None if values is None else values.astype(self.stored, copy=False)


_SPHERE_STEP = 1.0 / 512.0  # metres


def _tracked_joints(rows: SessionArrays) -> NDArray[Any]:
    return np.stack(
        [(s == TrackingState.TRACKED).sum(axis=1) for s in (rows.states_a, rows.states_b)], axis=1
    )


def _view_figures(side: str) -> Iterator[ShownFigure]:
    """Of S_A or S_B: colours, bones, and a class that is another one in frames whose sides are exchanged."""
    entity, ids = layout.skeleton(side), [layout.CLASS_IDS[key] for key in (side, f"exchanged_{side}")]

    def exchanged(rows: SessionArrays) -> NDArray[Any]:
        return np.asarray(rows.corrected[:, layout.VIEWS.index(side), None])

    def colors(rows: SessionArrays) -> NDArray[Any]:
        untracked = getattr(rows, f"states_{side}") != TrackingState.TRACKED
        return np.array(VIEW_COLORS[side], dtype=np.uint8)[np.where(exchanged(rows), 2, untracked)]

    def classes(rows: SessionArrays) -> NDArray[Any]:
        return np.repeat(np.where(exchanged(rows), ids[1], ids[0]), len(rows.body), axis=1)

    def bones(rows: SessionArrays) -> NDArray[Any]:
        return bone_vectors(rows.body, getattr(rows, f"positions_{side}"))

    yield ShownFigure(entity, "Points3D:colors", colors, np.uint8)
    yield ShownFigure(entity, layout.BONE_VECTORS, bones)
    yield ShownFigure(entity, "Points3D:class_ids", classes, np.uint16)


def _sigma_spheres(rows: SessionArrays) -> NDArray[Any] | None:
    """(T, J, 3) half sizes of spheres of one standard deviation, in steps that compress well.

    Before revision 8 of the method, σ of a joint without data was not limited by its bone. It is drawn as
    √(σ² of its parent + 2 L²) at most, so that the sphere of a thumb does not hide the person.
    """
    if rows.sigma is None:
        return None
    sigma, to_parent = rows.sigma, parents(rows.body)
    most = np.sqrt(sigma[:, to_parent] ** 2 + 2.0 * rows.bone_lengths**2)
    most[:, rows.body.root] = np.inf
    radii = np.round(np.fmin(sigma, most) / _SPHERE_STEP) * _SPHERE_STEP
    return np.repeat(radii[..., None], 3, axis=2)


_S, _PELVIS = layout.FUSED_SKELETON, layout.PELVIS
SHOWN_FIGURES = (
    *_view_figures("a"),
    *_view_figures("b"),
    ShownFigure(_S, layout.CAPSULE_ROTATIONS, lambda rows: capsule_rotations(rows.body, rows.fused)),
    ShownFigure(_S, layout.CAPSULE_LENGTHS, lambda rows: capsule_lengths(rows.body, rows.bone_lengths)),
    ShownFigure(_S, layout.NOSE_ORIGIN, lambda rows: rows.fused[:, [rows.body.joint("head")]]),
    ShownFigure(_S, layout.NOSE_VECTOR, lambda rows: nose_vectors(rows.body, rows.fused)),
    ShownFigure(_S, layout.SIGMA_SPHERES, _sigma_spheres),
    ShownFigure(_S, "view_difference_mm", lambda rows: np.round(rows.view_difference * 1e3), np.float16),
    ShownFigure(_PELVIS, "Transform3D:mat3x3", lambda rows: pelvis_rotations(rows.body, rows.fused)),
    ShownFigure(_PELVIS, "Transform3D:translation", lambda rows: rows.fused[:, rows.body.root]),
    ShownFigure(layout.QUALITY, "figures.bone_error_mm", lambda rows: rows.bone_error * 1e3),
    ShownFigure(layout.QUALITY, "figures.disagreement_mm", lambda rows: rows.disagreement * 1e3),
    ShownFigure(
        layout.QUALITY, "figures.predicted_joints", lambda rows: rows.predicted.sum(axis=1), np.uint8
    ),
    ShownFigure(layout.QUALITY, "sensors.tracked_joints", _tracked_joints, np.uint8),
    ShownFigure(layout.QUALITY, FRAME_CRC, frame_checksums, np.uint32),
    ShownFigure(layout.QUALITY, CHECKS_CRC, checks_checksums, np.uint32),
)
