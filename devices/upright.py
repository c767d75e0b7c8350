"""Sensors on their side or upside down: their images, people and camera as if the sensor stood upright.

The images of a sensor with an orientation are turned clockwise by as much. A point (x, y, z) of a sensor that
is turned by 90° is at (-y, x, z) afterwards.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from devices.depth.camera import turned
from devices.sensor import (
    ColorCamera,
    ColorImage,
    Orientation,
    Sensor,
    SensorFrame,
    SensorWrapper,
)
from devices.skeletons.likelihood import axes_likelihood, size_likelihood
from devices.skeletons.meaning import CLEAR
from devices.skeletons.stated_format import ROLLED, SIGNED
from fusion.body import Body
from fusion.intrinsics import Intrinsics
from fusion.pair_arrays import View, joined_views
from fusion.rigid import RigidTransform
from fusion.skeleton import Skeleton
from fusion.support.large_arrays import parts

_QUARTER = np.array(((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)))


def rotation(orientation: Orientation) -> NDArray[np.float64]:
    """(3, 3) from the frame of a sensor to that of the same sensor upright."""
    return np.linalg.matrix_power(_QUARTER, orientation // 90)


def turned_image(image: NDArray[Any], orientation: Orientation) -> NDArray[Any]:
    """An image (h, w, …) of a sensor as the upright sensor gives it."""
    return np.ascontiguousarray(np.rot90(image, -(orientation // 90))) if orientation else image


def turned_camera(camera: Intrinsics, orientation: Orientation) -> Intrinsics:
    """The camera of these images."""
    for _ in range(orientation // 90):
        camera = turned(camera)
    return camera


def turned_view(view: View, orientation: Orientation) -> View:
    """The skeletons of a sensor in the frame of the upright sensor."""
    if not orientation or not len(view.time_ns):
        return view
    around = rotation(orientation).T.astype(np.float32)

    def block(rows: slice) -> View:
        witness = None if view.witness is None else view.witness[rows].copy()
        if witness is not None:
            witness[..., 2:] = witness[..., 2:] @ around[:2, :2]
        return View(view.time_ns[rows], view.positions[rows] @ around, view.states[rows], witness)

    return joined_views(block(rows) for rows in parts(len(view.time_ns)))


def orientation_of(
    body: Body, seconds: NDArray[np.float64], positions: NDArray[np.floating]
) -> tuple[Orientation, Orientation]:
    """The orientation of a sensor by the likelihood of the people that it saw, and another if one fits alike.

    A sensor stands unless another orientation is clear: who lies before it looks like who stands before a
    sensor on its side.

    Args:
        seconds: (T,) times.
        positions: (T, J, 3) in its frame; NaN where not tracked.
    """
    stature, _, scores, _ = axes_likelihood(body, seconds, positions.astype(np.float64))
    if stature is None or size_likelihood(stature) < -2.0 * CLEAR:  # nobody is so small or tall
        return 0, 0
    of_axes = dict(zip(SIGNED, np.logaddexp.reduce(scores, axis=0), strict=True))
    of = {degrees: of_axes[axes] - (degrees > 0) for axes, degrees in ROLLED.items()}
    best, other = sorted(of, key=lambda degrees: -of[degrees])[:2]
    return (best, best) if of[best] - of[other] > 1.0 else (0, best or other)


class UprightSensor(SensorWrapper):
    """A sensor with an orientation: gives what it would give if it stood upright."""

    def __init__(self, source: Sensor, orientation: Orientation) -> None:
        super().__init__(source)
        self.orientation = orientation
        self._colors: tuple[ColorCamera, ColorCamera] | None = None  # as given last, and turned

    @property
    def intrinsics(self) -> Intrinsics | None:  # type: ignore[override]
        """The camera of the turned images."""
        camera = self.source.intrinsics
        return None if camera is None else turned_camera(camera, self.orientation)

    def frames(self) -> Iterator[SensorFrame]:
        for frame in self.source.frames():
            yield replace(
                frame,
                people={name: self._skeleton(person) for name, person in frame.people.items()},
                depth=None if frame.depth is None else turned_image(frame.depth, self.orientation),
                ir=None if frame.ir is None else turned_image(frame.ir, self.orientation),
                color=None if frame.color is None else self._color(frame.color),
            )

    def _skeleton(self, one: Skeleton) -> Skeleton:
        witness = None if one.witness is None else one.witness[None]
        view = View(np.array((one.time_ns,)), one.positions[None], one.states[None], witness)
        return turned_view(view, self.orientation).row(one.body, 0)

    def _color(self, color: ColorImage) -> ColorImage | None:
        rgb = color.rgb()
        if rgb is None:
            return None
        if self._colors is None or self._colors[0] is not color.camera:
            around = RigidTransform.of(rotation(self.orientation), np.zeros(3))
            lens = turned_camera(color.camera.intrinsics, self.orientation)
            move = around @ color.camera.color_from_depth @ around.inverse()
            self._colors = color.camera, ColorCamera(lens, move)
        return ColorImage.of_rgb(turned_image(rgb, self.orientation), self._colors[1])


def upright(source: Sensor, orientation: Orientation) -> Sensor:
    """The sensor as if it stood upright; itself where it does."""
    return UprightSensor(source, orientation) if orientation else source
