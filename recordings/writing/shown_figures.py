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
from recordings.appearance.body_shape import (
    bone_vectors,
    capsule_lengths,
    capsule_rotations,
    nose_vectors,
    parents,
    pelvis_rotations,
)
from recordings.appearance.colors import VIEW_COLORS
from recordings.session_arrays import SessionArrays


@dataclass(frozen=True, eq=False)
class ShownFigure:
    """A derived figure."""

    entity: str  # place in the file, named as in :class:`recordings.frame_fields.FrameField`
    component: str
    stored: type[np.generic]  # type in the file
    compute: Callable[[SessionArrays], NDArray[Any] | None]
    """Computes (T, …) values from the frames; None where the session lacks what they come from."""

    def values(self, rows: SessionArrays) -> NDArray[Any] | None:
        """(T, …) in the type of the file; None where there are none."""
        values = self.compute(rows)
        return None if values is None else values.astype(self.stored, copy=False)


_SPHERE_STEP = 1.0 / 512.0  # metres


def _tracked_joints(rows: SessionArrays) -> NDArray[Any]:
    return np.stack(
        [(s == TrackingState.TRACKED).sum(axis=1) for s in (rows.states_a, rows.states_b)], axis=1
    )


def _view_class(side: str) -> Callable[[SessionArrays], NDArray[Any]]:
    """(T, J) class of S_A or S_B: a second one in frames whose sides are exchanged."""

    def classes(rows: SessionArrays) -> NDArray[Any]:
        exchanged = rows.filled("exchanged")[:, layout.SIDES.index(side)] != 0
        ids = np.where(exchanged, layout.CLASS_IDS[layout.exchanged(side)], layout.CLASS_IDS[side])
        return np.repeat(ids[:, None], len(rows.body), axis=1)

    return classes


def _view_colors(side: str) -> Callable[[SessionArrays], NDArray[Any]]:
    """(T, J, 3) RGB of S_A or S_B, see :data:`recordings.appearance.colors.VIEW_COLORS`."""

    def colors(rows: SessionArrays) -> NDArray[Any]:
        states = rows.states_a if side == "a" else rows.states_b
        exchanged = rows.filled("exchanged")[:, layout.SIDES.index(side)] != 0
        chosen = np.where(exchanged[:, None], 2, np.where(states == TrackingState.TRACKED, 0, 1))
        return np.array(VIEW_COLORS[side], dtype=np.uint8)[chosen]

    return colors


def _pelvis(rows: SessionArrays) -> NDArray[Any]:
    return pelvis_rotations(rows.body, rows.fused)


def _sigma_spheres(rows: SessionArrays) -> NDArray[Any] | None:
    """(T, J, 3) half sizes of spheres of one standard deviation, in steps that compress well.

    A joint whose bone could have any direction is off by √(σ² of its parent + 2 L²): it lies on a sphere of
    radius L about its parent. A larger σ, which a joint without data may have, is drawn as that, so that the
    sphere of a thumb does not hide the person.
    """
    if rows.sigma is None:
        return None
    sigma, to_parent = rows.sigma, parents(rows.body)
    most = np.sqrt(sigma[:, to_parent] ** 2 + 2.0 * rows.bone_lengths**2)
    most[:, rows.body.root] = np.inf
    radii = np.round(np.fmin(sigma, most) / _SPHERE_STEP) * _SPHERE_STEP
    return np.repeat(radii[..., None], 3, axis=2)


SHOWN_FIGURES = (
    ShownFigure(layout.skeleton("a"), "Points3D:colors", np.uint8, _view_colors("a")),
    ShownFigure(layout.skeleton("b"), "Points3D:colors", np.uint8, _view_colors("b")),
    ShownFigure(
        layout.skeleton("a"),
        layout.BONE_VECTORS,
        np.float32,
        lambda rows: bone_vectors(rows.body, rows.positions_a),
    ),
    ShownFigure(
        layout.skeleton("b"),
        layout.BONE_VECTORS,
        np.float32,
        lambda rows: bone_vectors(rows.body, rows.positions_b),
    ),
    ShownFigure(
        layout.FUSED_SKELETON,
        layout.CAPSULE_ROTATIONS,
        np.float32,
        lambda rows: capsule_rotations(rows.body, rows.fused),
    ),
    ShownFigure(
        layout.FUSED_SKELETON,
        layout.CAPSULE_LENGTHS,
        np.float32,
        lambda rows: capsule_lengths(rows.body, rows.bone_lengths),
    ),
    ShownFigure(
        layout.FUSED_SKELETON,
        layout.NOSE_ORIGIN,
        np.float32,
        lambda rows: rows.fused[:, [rows.body.joint("head")]],
    ),
    ShownFigure(
        layout.FUSED_SKELETON,
        layout.NOSE_VECTOR,
        np.float32,
        lambda rows: nose_vectors(rows.body, rows.fused),
    ),
    ShownFigure(layout.skeleton("a"), "Points3D:class_ids", np.uint16, _view_class("a")),
    ShownFigure(layout.skeleton("b"), "Points3D:class_ids", np.uint16, _view_class("b")),
    ShownFigure(layout.FUSED_SKELETON, layout.SIGMA_SPHERES, np.float32, _sigma_spheres),
    ShownFigure(
        layout.FUSED_SKELETON,
        "view_difference_mm",
        np.float16,
        lambda rows: np.round(rows.view_difference * 1e3),
    ),
    ShownFigure(layout.PELVIS, "Transform3D:mat3x3", np.float32, _pelvis),
    ShownFigure(
        layout.PELVIS,
        "Transform3D:translation",
        np.float32,
        lambda rows: np.nan_to_num(rows.fused[:, rows.body.root]),
    ),
    ShownFigure(layout.QUALITY, "figures.bone_error_mm", np.float32, lambda rows: rows.bone_error * 1e3),
    ShownFigure(layout.QUALITY, "figures.disagreement_mm", np.float32, lambda rows: rows.disagreement * 1e3),
    ShownFigure(
        layout.QUALITY, "figures.predicted_joints", np.uint8, lambda rows: rows.predicted.sum(axis=1)
    ),
    ShownFigure(layout.QUALITY, "sensors.tracked_joints", np.uint8, _tracked_joints),
)
